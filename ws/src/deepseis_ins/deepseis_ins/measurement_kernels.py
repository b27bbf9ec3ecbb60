"""Innovations and sensitivities of `deepseis_ins.measurements` (numba).

Hundreds of microseconds in NumPy, a few here; with ten GNSS epochs a second it counts.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from deepseis_core.constants import WGS84_A, WGS84_E2, WGS84_EARTH_RATE
from deepseis_core.types import FloatArray
from deepseis_ins.error_state_kernels import matrix_kernel


@njit(cache=True, nogil=True)
def matrix_of(quat: FloatArray) -> FloatArray:
    """Return the matrix of a unit quaternion (x, y, z, w)."""
    C = np.empty((3, 3))
    matrix_kernel(quat, C)
    return C


@njit(cache=True, nogil=True)
def ned_from_ecef_kernel(latitude: float, longitude: float) -> FloatArray:
    """Return ``C_ne``; as `deepseis_core.geodesy.rotation_ned_ecef`."""
    sin_lat, cos_lat = math.sin(latitude), math.cos(latitude)
    sin_lon, cos_lon = math.sin(longitude), math.cos(longitude)
    C = np.empty((3, 3))
    C[0, 0], C[0, 1], C[0, 2] = -sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat
    C[1, 0], C[1, 1], C[1, 2] = -sin_lon, cos_lon, 0.0
    C[2, 0], C[2, 1], C[2, 2] = -cos_lat * cos_lon, -cos_lat * sin_lon, -sin_lat
    return C


@njit(cache=True, nogil=True)
def ecef_kernel(latitude: float, longitude: float, height: float) -> FloatArray:
    """Return the ECEF position [m] of geodetic coordinates."""
    sin_lat, cos_lat = math.sin(latitude), math.cos(latitude)
    transverse = WGS84_A / math.sqrt(1.0 - WGS84_E2 * sin_lat * sin_lat)
    p = (transverse + height) * cos_lat
    z = (transverse * (1.0 - WGS84_E2) + height) * sin_lat
    return np.array([p * math.cos(longitude), p * math.sin(longitude), z])


@njit(cache=True, nogil=True)
def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


@njit(cache=True, nogil=True)
def _skew(a: FloatArray) -> FloatArray:
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


@njit(cache=True, nogil=True)
def position_kernel(latitude, longitude, height, quat, lever_b, measured, cov, z, H, R):  # type: ignore[no-untyped-def]
    """Fill z, H of zeros and R of a position; ``cov`` and ``measured`` are ECEF."""
    C_ne = ned_from_ecef_kernel(latitude, longitude)
    lever_n = matrix_of(quat) @ lever_b
    z[:] = C_ne @ (ecef_kernel(latitude, longitude, height) - measured) + lever_n
    H[:, 0:3] = np.eye(3)
    H[:, 6:9] = _skew(lever_n)
    R[:] = C_ne @ cov @ C_ne.T


@njit(cache=True, nogil=True)
def velocity_kernel(  # type: ignore[no-untyped-def]
    latitude, longitude, vel_n, quat, omega, lever_b, measured, cov, rate_sd, z, H, R
):
    """Fill z, H of zeros and R of a velocity; ``cov`` and ``measured`` are ECEF."""
    C_ne, C_nb = ned_from_ecef_kernel(latitude, longitude), matrix_of(quat)
    lever_n, swing_n = C_nb @ lever_b, C_nb @ _cross(omega, lever_b)
    earth = np.array(
        [WGS84_EARTH_RATE * math.cos(latitude), 0.0, -WGS84_EARTH_RATE * math.sin(latitude)]
    )
    z[:] = vel_n + swing_n - _cross(earth, lever_n) - C_ne @ measured
    H[:, 3:6] = np.eye(3)
    H[:, 6:9] = _skew(swing_n) - _skew(earth) @ _skew(lever_n)
    by_rate = -(C_nb @ _skew(lever_b))
    H[:, 9:12] = by_rate
    R[:] = C_ne @ cov @ C_ne.T + rate_sd * rate_sd * (by_rate @ by_rate.T)
