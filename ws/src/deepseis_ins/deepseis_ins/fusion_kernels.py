"""From the filter's state to the present, and to the axes of topics (numba)."""

from __future__ import annotations

import math

from numba import njit

from deepseis_core.rotation import quat_multiply_kernel
from deepseis_ins.measurement_kernels import ecef_kernel, matrix_of, ned_from_ecef_kernel
from deepseis_ins.strapdown_kernels import ATTITUDE, DELTA_THETA, POSITION, VELOCITY, step_kernel


@njit(cache=True, nogil=True)
def ecef_node_kernel(geodetic, vel_n, quat_nb, lever_b, origin, position, velocity, lever):  # type: ignore[no-untyped-def]
    """Fill position from ``origin``, velocity and lever arm of one state, ECEF, (3,) each."""
    C_ne = ned_from_ecef_kernel(geodetic[0], geodetic[1])
    place = ecef_kernel(geodetic[0], geodetic[1], geodetic[2])
    lever_n = matrix_of(quat_nb) @ lever_b
    for i in range(3):
        position[i] = place[i] - origin[i]
        velocity[i], lever[i] = 0.0, 0.0
        for j in range(3):
            velocity[i] += C_ne[j, i] * vel_n[j]
            lever[i] += C_ne[j, i] * lever_n[j]


@njit(cache=True, nogil=True)
def ecef_nodes_kernel(geodetic, vel_n, quat_nb, lever_b, origin, position, velocity, lever):  # type: ignore[no-untyped-def]
    """Do `ecef_node_kernel` for n states, (n, 3) each but ``quat_nb``, (n, 4)."""
    for k in range(geodetic.shape[0]):
        ecef_node_kernel(
            geodetic[k], vel_n[k], quat_nb[k], lever_b, origin,
            position[k], velocity[k], lever[k],
        )  # fmt: skip


@njit(cache=True, nogil=True)
def carry_on_kernel(x, bias, delta, dt, geodetic, vel_n, quat_nb, gained):  # type: ignore[no-untyped-def]
    """Fill the state ``x`` and what follows it after each of n - 1 increments, (n - 1, 6).

    Increments are as measured; ``bias``, (6,), is taken off [rad/s, m/s^2], but not from their
    sum ``gained``, (n, 3).
    """
    for k in range(delta.shape[0] + 1):
        gained[k, :] = 0.0
        if k > 0:
            d, b = delta[k - 1], bias
            angle = d[0] - b[0] * dt, d[1] - b[1] * dt, d[2] - b[2] * dt
            velocity = d[3] - b[3] * dt, d[4] - b[4] * dt, d[5] - b[5] * dt
            step_kernel(x, angle, velocity, dt)
            for i in range(3):
                gained[k, i] = gained[k - 1, i] + d[3 + i]
        geodetic[k, :] = x[POSITION:VELOCITY]
        vel_n[k, :] = x[VELOCITY:ATTITUDE]
        quat_nb[k, :] = x[ATTITUDE:DELTA_THETA]


@njit(cache=True, nogil=True)
def orientation_kernel(quat_ae, latitude, longitude, quat_nb, out):  # type: ignore[no-untyped-def]
    """Fill attitudes of forward-left-up against axes ``a`` that are fixed to the Earth.

    ``quat_nb``, (n, 4), are of forward-right-down against north, east, down at a place.
    """
    east, down = 0.5 * longitude, -0.25 * math.pi - 0.5 * latitude
    turn = quat_ae[0], quat_ae[1], quat_ae[2], quat_ae[3]
    turn = quat_multiply_kernel(turn, (0.0, 0.0, math.sin(east), math.cos(east)))
    turn = quat_multiply_kernel(turn, (0.0, math.sin(down), 0.0, math.cos(down)))
    for k in range(quat_nb.shape[0]):
        q = quat_nb[k, 0], quat_nb[k, 1], quat_nb[k, 2], quat_nb[k, 3]
        q = quat_multiply_kernel(turn, quat_multiply_kernel(q, (1.0, 0.0, 0.0, 0.0)))
        for i in range(4):
            out[k, i] = q[i]
