"""Mechanisation and covariance together, interval by interval (numba).

The covariance goes in steps of its own, of several intervals. A step not yet complete is pending,
in an array with the offsets below, and is completed when the covariance is wanted.
"""

from __future__ import annotations

import math

from numba import njit

from deepseis_core.rotation import quat_from_rotvec_kernel, quat_multiply_kernel
from deepseis_core.types import FloatArray
from deepseis_ins.error_state_kernels import BIAS_RATE, covariance_kernel
from deepseis_ins.strapdown_kernels import (
    ATTITUDE,
    DELTA_THETA,
    DELTA_VEL,
    INTERVAL,
    POSITION,
    VELOCITY,
    earth_kernel,
    step_kernel,
)

START_VELOCITY = 0  # of the step
START_ATTITUDE = 3
ANGLE = 7  # sums of increments, biases removed
GAIN = 10
TIME = 13  # [s]
PENDING_SIZE = 14


@njit(cache=True, nogil=True)
def begin_kernel(x: FloatArray, pending: FloatArray) -> None:
    """Begin a step of the covariance at a state."""
    for k in range(3):
        pending[START_VELOCITY + k] = x[VELOCITY + k]
    for k in range(4):
        pending[START_ATTITUDE + k] = x[ATTITUDE + k]
    pending[ANGLE:] = 0.0


@njit(cache=True, nogil=True)
def complete_kernel(x, bias, pending, P, U, B, model, T):  # type: ignore[no-untyped-def]
    """Carry the covariance to the state's time and begin a new step there.

    The biases' estimates fade as their processes do.
    """
    if pending[TIME] > 0.0:
        for k in range(6):
            bias[k] *= math.exp(-pending[TIME] * model[BIAS_RATE + k])
        covariance_kernel(
            P,
            U,
            B,
            model,
            x,
            pending[START_VELOCITY : START_VELOCITY + 3],
            pending[START_ATTITUDE : START_ATTITUDE + 4],
            pending[ANGLE : ANGLE + 3],
            pending[GAIN : GAIN + 3],
            pending[TIME],
            T,
        )
    begin_kernel(x, pending)


@njit(cache=True, nogil=True)
def propagate_kernel(  # type: ignore[no-untyped-def]
    x, bias, pending, P, U, B, model, T, step, delta_theta, delta_vel, dt, geodetic, vel_n, quat_nb
):
    """Carry everything over m intervals and fill what the state is at the end of each.

    Parameters
    ----------
    x
        State of the mechanisation, shape (17,).
    bias
        Of gyroscopes and accelerometers, shape (6,) [rad/s, m/s^2].
    T
        Of `covariance_kernel`.
    step
        Of the covariance [s].
    delta_theta, delta_vel, dt
        As measured, shapes (m, 3) and (m,).
    """
    for i in range(delta_theta.shape[0]):
        t = dt[i]
        dtheta = (
            delta_theta[i, 0] - bias[0] * t,
            delta_theta[i, 1] - bias[1] * t,
            delta_theta[i, 2] - bias[2] * t,
        )
        dvel = (
            delta_vel[i, 0] - bias[3] * t,
            delta_vel[i, 1] - bias[4] * t,
            delta_vel[i, 2] - bias[5] * t,
        )
        step_kernel(x, dtheta, dvel, t)
        for k in range(3):
            pending[ANGLE + k] += dtheta[k]
            pending[GAIN + k] += dvel[k]
            geodetic[i, k] = x[POSITION + k]
            vel_n[i, k] = x[VELOCITY + k]
        for k in range(4):
            quat_nb[i, k] = x[ATTITUDE + k]
        pending[TIME] += t
        if pending[TIME] > step - 0.5 * t:
            complete_kernel(x, bias, pending, P, U, B, model, T)


@njit(cache=True, nogil=True)
def feed_back_kernel(x: FloatArray, bias: FloatArray, error: FloatArray) -> None:
    """Take an estimated error, shape (15,), off state and biases.

    The increments before are corrected as well, or the mechanisation would see their bias jump.
    """
    meridian, transverse, _ = earth_kernel(math.sin(x[POSITION]), x[POSITION + 2])
    x[POSITION + 1] -= error[1] / (transverse * math.cos(x[POSITION]))
    x[POSITION] -= error[0] / meridian
    x[POSITION + 2] += error[2]
    turn = quat_from_rotvec_kernel(error[6], error[7], error[8])
    q = x[ATTITUDE], x[ATTITUDE + 1], x[ATTITUDE + 2], x[ATTITUDE + 3]
    q = quat_multiply_kernel(turn, q)
    for k in range(4):
        x[ATTITUDE + k] = q[k]
    for k in range(3):
        x[VELOCITY + k] -= error[3 + k]
        x[DELTA_THETA + k] -= error[9 + k] * x[INTERVAL]
        x[DELTA_VEL + k] -= error[12 + k] * x[INTERVAL]
        bias[k] += error[9 + k]
        bias[3 + k] += error[12 + k]
