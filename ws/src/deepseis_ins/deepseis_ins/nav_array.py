"""What callers give to the filters, checked, as the arrays that kernels take."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from deepseis_core.errors import InputError
from deepseis_core.types import FloatArray
from deepseis_ins.strapdown import NavState, Strapdown
from deepseis_ins.strapdown_kernels import ATTITUDE, DELTA_THETA, DELTA_VEL, INTERVAL, VELOCITY


def pack(nav: NavState) -> FloatArray:
    """Return the kernels' array of a state."""
    state = Strapdown(nav).state  # which refuses what is no state
    return np.hstack(
        [
            [state.latitude, state.longitude, state.height],
            state.vel_n,
            state.quat_nb,
            state.previous_delta_theta_b,
            state.previous_delta_vel_b,
            state.previous_dt,
        ]
    )


def unpack(x: FloatArray) -> NavState:
    """Return the state of an array of the kernels."""
    return NavState(
        float(x[0]),
        float(x[1]),
        float(x[2]),
        x[VELOCITY:ATTITUDE].copy(),
        x[ATTITUDE:DELTA_THETA].copy(),
        x[DELTA_THETA:DELTA_VEL].copy(),
        x[DELTA_VEL:INTERVAL].copy(),
        float(x[INTERVAL]),
    )


def increments(
    delta_theta_b: ArrayLike, delta_vel_b: ArrayLike, dt: ArrayLike
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return increments and intervals, shapes (m, 3), (m, 3), (m,)."""
    theta = np.ascontiguousarray(delta_theta_b, np.float64)
    vel = np.ascontiguousarray(delta_vel_b, np.float64)
    if theta.ndim != 2 or theta.shape[1] != 3 or vel.shape != theta.shape:
        raise InputError("IMU increments", f"have shapes {theta.shape}, {vel.shape}", "(m, 3)")
    dts = np.asarray(dt, np.float64)
    if dts.shape not in ((), (len(theta),)):
        raise InputError("IMU intervals", f"have shape {dts.shape}", f"one, or {len(theta)}")
    dts = np.ascontiguousarray(np.broadcast_to(dts, (len(theta),)))
    if not (np.isfinite(theta).all() and np.isfinite(vel).all()):
        raise InputError("IMU increments", "are not finite")
    if not (np.all(dts > 0.0) and np.isfinite(dts).all()):
        raise InputError("IMU intervals", "are not positive", "seconds")
    return theta, vel, dts


def vector(name: str, value: ArrayLike) -> FloatArray:
    """Return three finite numbers as an array."""
    array = np.asarray(value, np.float64)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise InputError(name, "is not three finite numbers")
    return array


def covariance(name: str, sd: ArrayLike) -> FloatArray:
    """Return the covariance, shape (3, 3), of standard deviations, or the one given."""
    array = np.asarray(sd, np.float64)
    if array.shape == (3, 3):
        if not np.isfinite(array).all() or not np.allclose(array, array.T, rtol=1e-9, atol=0.0):
            raise InputError(f"covariance of the {name}", "is not finite and symmetric")
        return array
    array = np.broadcast_to(array, (3,))
    if not (np.isfinite(array).all() and np.all(array >= 0.0)):
        raise InputError(f"standard deviation of the {name}", f"is {sd!r}", "finite, 0 or more")
    return np.diag(array**2)
