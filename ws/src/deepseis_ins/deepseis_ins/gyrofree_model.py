"""Dynamics of the filter without gyroscopes: layout of its errors, transition, noise."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.linalg import expm

from deepseis_core.constants import WGS84_EARTH_RATE
from deepseis_core.geodesy import meridian_radius, normal_gravity, transverse_radius
from deepseis_core.types import FloatArray
from deepseis_ins import gyrofree_kernels as kernels

POS: Final = slice(0, 3)
VEL: Final = slice(3, 6)
BIAS: Final = slice(6, 9)
DRIFT: Final = slice(9, 12)


def mechanics(
    latitude: float, height: float, bias_rate: float, drift_rates: FloatArray
) -> FloatArray:
    """Return the array of constants that the kernel wants; offsets there.

    Parameters
    ----------
    latitude, height : float
        Of the station [rad, m].
    bias_rate : float
        Inverse of the bias' correlation time [1/s].
    drift_rates : ndarray, shape (3,)
        Those of the drift of GNSS positions, east, north, up [1/s].
    """
    gravity = float(normal_gravity(latitude, height))
    meridian = float(meridian_radius(latitude)) + height
    transverse = float(transverse_radius(latitude)) + height
    model = np.zeros(kernels.MODEL_SIZE)
    model[kernels.GRAVITY] = -gravity
    model[kernels.GRADIENT] = -gravity / transverse
    model[kernels.GRADIENT + 1] = -gravity / meridian
    model[kernels.GRADIENT + 2] = gravity / transverse + gravity / meridian
    model[kernels.EARTH_RATE + 1] = WGS84_EARTH_RATE * np.cos(latitude)
    model[kernels.EARTH_RATE + 2] = WGS84_EARTH_RATE * np.sin(latitude)
    model[kernels.BIAS_RATE : kernels.BIAS_RATE + 3] = bias_rate
    model[kernels.DRIFT_RATE : kernels.DRIFT_RATE + 3] = drift_rates
    return model


def dynamics(model: FloatArray, states: int) -> FloatArray:
    """Return ``F``, shape (states, states), of ``dx/dt = F x + w``.

    Parameters
    ----------
    model : ndarray
        Of `mechanics`.
    states : int
        9 or 12.
    """
    F = np.zeros((states, states))
    a, b, c = model[kernels.EARTH_RATE : kernels.EARTH_RATE + 3]
    F[POS, VEL] = np.eye(3)
    F[VEL, POS] = np.diag(model[kernels.GRADIENT : kernels.GRADIENT + 3])
    F[VEL, VEL] = -2.0 * np.array([[0.0, -c, b], [c, 0.0, -a], [-b, a, 0.0]])
    F[VEL, BIAS] = np.eye(3)
    F[BIAS, BIAS] = -np.diag(model[kernels.BIAS_RATE : kernels.BIAS_RATE + 3])
    if states == 12:
        F[DRIFT, DRIFT] = -np.diag(model[kernels.DRIFT_RATE : kernels.DRIFT_RATE + 3])
    return F


def discretise_exactly(F: FloatArray, Q: FloatArray, dt: float) -> tuple[FloatArray, FloatArray]:
    """Return transition and noise of an interval of any length (C. F. Van Loan, 1978)."""
    n = len(F)
    block = np.zeros((2 * n, 2 * n))
    block[:n, :n], block[:n, n:], block[n:, n:] = -F, Q, F.T
    exponential = expm(block * dt)
    Phi = exponential[n:, n:].T.copy()
    noise = Phi @ exponential[:n, n:]
    return Phi, 0.5 * (noise + noise.T)
