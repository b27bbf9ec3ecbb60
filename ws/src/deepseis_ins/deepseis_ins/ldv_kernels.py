"""Means of velocities over the windows of a velocimeter (numba)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from deepseis_core.constants import WGS84_EARTH_RATE
from deepseis_ins.error_state_kernels import matrix_kernel


@njit(cache=True, nogil=True)
def window_kernel(  # type: ignore[no-untyped-def]
    time, vel_n, quat_nb, omega_b, latitude, ldv_time, velocity_b, arms_b, own, predicted, measured
):
    """Fill mean velocities, n, at the moments of measurements; straight lines between states.

    Parameters
    ----------
    time, vel_n, quat_nb
        States of the mechanisation, shapes (k,), (k, 3), (k, 4); the first is that at the
        window's start.
    omega_b
        Angular rate between a state and the one before, shape (k, 3) [rad/s].
    ldv_time, velocity_b
        Measurements within the span, shapes (m,), (m, 3).
    arms_b
        To the sensor, and to the point that does not slip sideways, shape (2, 3) [m].
    own, predicted, measured
        Filled, shape (3,): velocity of the IMU; of the sensor; of the sensor as measured.
    """
    count = ldv_time.size
    own[:] = 0.0
    predicted[:] = 0.0
    measured[:] = 0.0
    C, q = np.empty((3, 3)), np.empty(4)
    earth_n = (WGS84_EARTH_RATE * math.cos(latitude), -WGS84_EARTH_RATE * math.sin(latitude))
    i = 1
    for j in range(count):
        while i < time.size - 1 and time[i] < ldv_time[j]:
            i += 1
        share = (ldv_time[j] - time[i - 1]) / (time[i] - time[i - 1])
        norm = 0.0
        for k in range(4):
            q[k] = quat_nb[i - 1, k] + share * (quat_nb[i, k] - quat_nb[i - 1, k])
            norm += q[k] * q[k]
        for k in range(4):
            q[k] /= math.sqrt(norm)
        matrix_kernel(q, C)
        w = np.empty(3)  # over the ground
        for k in range(3):
            w[k] = omega_b[i, k] - C[0, k] * earth_n[0] - C[2, k] * earth_n[1]
        slip = w[2] * (arms_b[0, 0] - arms_b[1, 0]) - w[0] * (arms_b[0, 2] - arms_b[1, 2])
        swing = (
            w[1] * arms_b[0, 2] - w[2] * arms_b[0, 1],
            w[2] * arms_b[0, 0] - w[0] * arms_b[0, 2],
            w[0] * arms_b[0, 1] - w[1] * arms_b[0, 0],
        )
        for k in range(3):
            v = vel_n[i - 1, k] + share * (vel_n[i, k] - vel_n[i - 1, k])
            own[k] += v / count
            turned = C[k, 0] * swing[0] + C[k, 1] * swing[1] + C[k, 2] * swing[2]
            predicted[k] += (v + turned) / count
            u = C[k, 0] * velocity_b[j, 0] + C[k, 2] * velocity_b[j, 2]
            measured[k] += (u + C[k, 1] * (velocity_b[j, 1] + slip)) / count
