"""Mechanisation: increments of a strapdown IMU to position, velocity and attitude.

Axes are north-east-down ``n`` and body forward-right-down ``b``; position is geodetic. Over every
interval a straight line in time is laid through the last two increments, of angle and of
velocity; with it attitude, velocity and position are integrated in closed form (coning, sculling
and scrolling compensation), under normal gravity with height, the Earth's rate and the transport
rate at the middle of the interval (thesis equations 2.9 to 2.13, the third entry of 2.11 with a
minus sign).

From error-free data of 2 g at 1 and 2 Hz, 200 samples a second, the position follows to some
micrometres over 120 s: what is not modelled is the second derivative of the acceleration, (w T)^3
/ 24 of the amplitude, and the spread of the velocity within an interval in v^2 / R. Coning at w
leaves (w T)^4 / 30 of the coning rate.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from deepseis_core.errors import InputError
from deepseis_core.types import FloatArray
from deepseis_ins import strapdown_kernels as kernels


def _nothing() -> FloatArray:
    return np.zeros(3)


@dataclass(frozen=True)
class NavState:
    """Where the IMU is, how it moves and how it stands; and the increments that led there.

    Attributes
    ----------
    latitude, longitude, height : float
        Geodetic [rad, rad, m].
    vel_n : ndarray, shape (3,)
        Velocity over ground, north, east, down [m/s].
    quat_nb : ndarray, shape (4,)
        Attitude, x, y, z, w; forward-right-down to north-east-down.
    previous_delta_theta_b, previous_delta_vel_b : ndarray, shape (3,)
        Increments of the interval that ended here [rad, m/s].
    previous_dt : float
        Its length [s]; 0 where there is none, as at the start and after a gap.
    """

    latitude: float
    longitude: float
    height: float
    vel_n: FloatArray
    quat_nb: FloatArray
    previous_delta_theta_b: FloatArray = field(default_factory=_nothing)
    previous_delta_vel_b: FloatArray = field(default_factory=_nothing)
    previous_dt: float = 0.0


@dataclass(frozen=True)
class Trajectory:
    """States at the ends of m intervals.

    Attributes
    ----------
    geodetic : ndarray, shape (m, 3)
        Latitude [rad], longitude [rad], height [m].
    vel_n : ndarray, shape (m, 3)
        Velocity, north, east, down [m/s].
    quat_nb : ndarray, shape (m, 4)
        Attitude, x, y, z, w.
    """

    geodetic: FloatArray
    vel_n: FloatArray
    quat_nb: FloatArray


class Strapdown:
    """A state that increments carry on.

    Parameters
    ----------
    initial : NavState
        State at the start of the first interval.

    Raises
    ------
    InputError
        The state is not finite, or is no place or attitude.

    Examples
    --------
    A second of free fall, with the axes level and forward pointing north:

    >>> fall = Strapdown(NavState(0.6, 2.4, 50.0, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])))
    >>> for _ in range(200):
    ...     fall.step(np.zeros(3), np.zeros(3), 0.005)
    >>> round(fall.state.height, 3), round(float(fall.state.vel_n[2]), 3)
    (45.102, 9.797)
    """

    def __init__(self, initial: NavState) -> None:
        self._x = _packed(initial)

    @property
    def state(self) -> NavState:
        """The state now; assign one to correct it (`dataclasses.replace`)."""
        x = self._x
        return NavState(
            float(x[0]),
            float(x[1]),
            float(x[2]),
            x[kernels.VELOCITY : kernels.ATTITUDE].copy(),
            x[kernels.ATTITUDE : kernels.DELTA_THETA].copy(),
            x[kernels.DELTA_THETA : kernels.DELTA_VEL].copy(),
            x[kernels.DELTA_VEL : kernels.INTERVAL].copy(),
            float(x[kernels.INTERVAL]),
        )

    @state.setter
    def state(self, state: NavState) -> None:
        self._x = _packed(state)

    def step(self, delta_theta_b: FloatArray, delta_vel_b: FloatArray, dt: float) -> None:
        """Carry the state over one interval.

        Parameters
        ----------
        delta_theta_b, delta_vel_b : ndarray, shape (3,)
            Integrals of angular rate and specific force, forward-right-down [rad, m/s].
        dt : float
            Length of the interval [s].
        """
        self.propagate(np.reshape(delta_theta_b, (1, 3)), np.reshape(delta_vel_b, (1, 3)), dt)

    def propagate(
        self, delta_theta_b: ArrayLike, delta_vel_b: ArrayLike, dt: ArrayLike
    ) -> Trajectory:
        """Carry the state over m intervals and return what it was at the end of each.

        Parameters
        ----------
        delta_theta_b, delta_vel_b : array_like, shape (m, 3)
            Integrals of angular rate and specific force, forward-right-down [rad, m/s].
        dt : array_like, shape () or (m,)
            Lengths of the intervals [s]. They follow each other without gaps: after one, assign
            a `state` with ``previous_dt`` 0.

        Raises
        ------
        InputError
            Shapes differ, an interval is not positive, or a value is not finite; the state
            stays as it was.
        """
        delta_theta, delta_vel = (
            np.ascontiguousarray(value, np.float64) for value in (delta_theta_b, delta_vel_b)
        )
        if delta_theta.ndim != 2 or delta_theta.shape[1:] != (3,):
            raise InputError("IMU increments", f"have shape {delta_theta.shape}", "(m, 3)")
        if delta_vel.shape != delta_theta.shape:
            raise InputError(
                "IMU increments", f"{delta_theta.shape} of angle, {delta_vel.shape} of velocity"
            )
        count = delta_theta.shape[0]
        dts = np.asarray(dt, np.float64)
        if dts.shape not in ((), (count,)):
            raise InputError("IMU intervals", f"have shape {dts.shape}", f"one, or {count}")
        dts = np.ascontiguousarray(np.broadcast_to(dts, (count,)))
        if not (np.isfinite(delta_theta).all() and np.isfinite(delta_vel).all()):
            raise InputError("IMU increments", "are not finite")
        if not (np.all(dts > 0.0) and np.isfinite(dts).all()):
            raise InputError("IMU intervals", "are not positive", "seconds")
        out = Trajectory(np.empty((count, 3)), np.empty((count, 3)), np.empty((count, 4)))
        kernels.propagate_kernel(
            self._x, delta_theta, delta_vel, dts, out.geodetic, out.vel_n, out.quat_nb
        )
        return out


def propagate(
    state: NavState, delta_theta_b: ArrayLike, delta_vel_b: ArrayLike, dt: ArrayLike
) -> tuple[NavState, Trajectory]:
    """Carry a state over m intervals; arguments of `Strapdown.propagate`."""
    strapdown = Strapdown(state)
    trajectory = strapdown.propagate(delta_theta_b, delta_vel_b, dt)
    return strapdown.state, trajectory


def _packed(state: NavState) -> FloatArray:
    """Return the kernels' array of a state, its quaternion of unit length."""
    quat = np.asarray(state.quat_nb, np.float64)
    x = np.hstack(
        [
            [state.latitude, state.longitude, state.height],
            state.vel_n,
            quat,
            state.previous_delta_theta_b,
            state.previous_delta_vel_b,
            state.previous_dt,
        ]
    ).astype(np.float64)
    if x.shape != (kernels.SIZE,) or not np.isfinite(x).all():
        raise InputError("navigation state", "is not a set of finite numbers")
    if abs(state.latitude) > np.pi / 2:
        raise InputError("navigation state", f"latitude {state.latitude} rad is beyond a pole")
    norm = np.linalg.norm(quat)
    if not abs(norm - 1.0) < 1e-3:
        raise InputError("navigation state", f"quaternion has length {norm:.6g}", "x, y, z, w")
    if abs(norm - 1.0) > 1e-12:  # a state handed back is itself, to the bit
        x[kernels.ATTITUDE : kernels.DELTA_THETA] /= norm
    return x
