"""The mechanisation of `deepseis_ins.strapdown`, one interval at a time (numba).

A state is an array of 17 numbers, at the offsets below. Equations: T is the thesis on GNSS/INS
deep integration for strong-motion seismographs, section 2.2.3 (the third entry of 2.11 has a
minus sign); S is P. G. Savage, "Strapdown Inertial Navigation Integration Algorithm Design",
parts 1 and 2, Journal of Guidance, Control, and Dynamics 21, 1998.
"""

from __future__ import annotations

import math

from numba import njit

from deepseis_core.constants import (
    WGS84_A,
    WGS84_B,
    WGS84_E2,
    WGS84_EARTH_RATE,
    WGS84_F,
    WGS84_GM,
    WGS84_GRAVITY_EQUATOR,
    WGS84_GRAVITY_POLE,
)
from deepseis_core.rotation import (
    Vector,
    quat_change_kernel,
    quat_multiply_kernel,
    quat_rotate_kernel,
)
from deepseis_core.types import FloatArray

POSITION = 0  # latitude, longitude [rad], height [m]
VELOCITY = 3  # north, east, down [m/s]
ATTITUDE = 6  # quat_nb
DELTA_THETA = 10  # of the interval before, body [rad]
DELTA_VEL = 13  # [m/s]
INTERVAL = 16  # its length [s]; 0: there is none
SIZE = 17

_SOMIGLIANA_K = WGS84_B * WGS84_GRAVITY_POLE / (WGS84_A * WGS84_GRAVITY_EQUATOR) - 1.0
_GRAVITY_M = WGS84_EARTH_RATE**2 * WGS84_A**2 * WGS84_B / WGS84_GM
_COS_LAT_MIN = 1e-9  # nearer than a centimetre to a pole east and north mean nothing


@njit(cache=True, nogil=True)
def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(cache=True, nogil=True)
def _sum(a: Vector, factor: float, b: Vector) -> Vector:
    """Return ``a + factor b``."""
    return a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]


@njit(cache=True, nogil=True)
def _times(factor: float, a: Vector) -> Vector:
    return factor * a[0], factor * a[1], factor * a[2]


@njit(cache=True, nogil=True)
def earth_kernel(sin_lat: float, height: float) -> Vector:
    """Return R_M + h, R_N + h [m] and normal gravity [m/s^2], positive down.

    Formulas of `deepseis_core.geodesy`, which share a root here.
    """
    sin2 = sin_lat * sin_lat
    root = math.sqrt(1.0 - WGS84_E2 * sin2)
    transverse = WGS84_A / root
    meridian = transverse * (1.0 - WGS84_E2) / (root * root)
    surface = WGS84_GRAVITY_EQUATOR * (1.0 + _SOMIGLIANA_K * sin2) / root
    slope = 2.0 / WGS84_A * (1.0 + WGS84_F + _GRAVITY_M - 2.0 * WGS84_F * sin2)
    gravity = surface * (1.0 - height * (slope - 3.0 * height / WGS84_A**2))
    return meridian + height, transverse + height, gravity


@njit(cache=True, nogil=True)
def _body_integrals(w0: Vector, w1: Vector, f0: Vector, f1: Vector, t: float):  # type: ignore[no-untyped-def]
    """Integrate specific force once and twice over an interval, axes of the body at its start.

    With angular rate ``w0 + w1 s`` and specific force ``f0 + f1 s`` in body axes, the attitude
    ``C`` at time s against that at 0 obeys ``dC/ds = C (w x)``, and ``C f`` is a power series of
    s; its first four terms hold rotation, sculling and scrolling (S part 2) and their mixed and
    second-order parts.
    """
    w0f0, w1f0, w0f1, w1f1 = _cross(w0, f0), _cross(w1, f0), _cross(w0, f1), _cross(w1, f1)
    w0w0f0 = _cross(w0, w0f0)
    s1 = _sum(f1, 1.0, w0f0)
    s2 = _sum(_sum(w0f1, 0.5, w0w0f0), 0.5, w1f0)
    s3 = _sum(_cross(w0, _sum(w0f1, 1.0 / 3.0, w0w0f0)), 1.0 / 3.0, _cross(w1, w0f0))
    s3 = _sum(_sum(s3, 2.0 / 3.0, _cross(w0, w1f0)), 1.0, w1f1)  # twice the term
    vel = _sum(_sum(_sum(_times(t, f0), t**2 / 2.0, s1), t**3 / 3.0, s2), t**4 / 8.0, s3)
    half = _sum(_times(t**2 / 2.0, f0), t**3 / 6.0, s1)
    return vel, _sum(_sum(half, t**4 / 12.0, s2), t**5 / 40.0, s3)


@njit(cache=True, nogil=True)
def _line(now: Vector, before: Vector, t: float, t_before: float):  # type: ignore[no-untyped-def]
    """Return start value and slope of the line with given integrals over two intervals."""
    mean = _times(1.0 / t, now)
    if t_before <= 0.0:
        return mean, (0.0, 0.0, 0.0)
    slope = _times(2.0 / (t + t_before), _sum(mean, -1.0 / t_before, before))
    return _sum(mean, -0.5 * t, slope), slope


@njit(cache=True, nogil=True)
def step_kernel(x: FloatArray, dtheta: Vector, dvel: Vector, t: float) -> None:
    """Carry a state over one interval of ``t`` seconds (see `Strapdown`)."""
    before_theta = x[DELTA_THETA], x[DELTA_THETA + 1], x[DELTA_THETA + 2]
    before_vel = x[DELTA_VEL], x[DELTA_VEL + 1], x[DELTA_VEL + 2]
    w0, w1 = _line(dtheta, before_theta, t, x[INTERVAL])
    f0, f1 = _line(dvel, before_vel, t, x[INTERVAL])
    vel_b, pos_b = _body_integrals(w0, w1, f0, f1, t)
    q = x[ATTITUDE], x[ATTITUDE + 1], x[ATTITUDE + 2], x[ATTITUDE + 3]
    gained, moved = quat_rotate_kernel(q, vel_b), quat_rotate_kernel(q, pos_b)

    # Middle of the interval: latitude, height, and the mean velocity, which carries gravity's
    # share of the motion but not Coriolis's: that one is below 1e-9 of the velocity.
    velocity = x[VELOCITY], x[VELOCITY + 1], x[VELOCITY + 2]
    meridian, transverse, gravity = earth_kernel(math.sin(x[0]), x[2])
    mean = _sum(velocity, 1.0 / t, moved)
    mean = mean[0], mean[1], mean[2] + 0.5 * gravity * t
    latitude = x[0] + 0.5 * t * mean[0] / meridian
    sin_lat, cos_lat = math.sin(latitude), max(math.cos(latitude), _COS_LAT_MIN)
    meridian, transverse, gravity = earth_kernel(sin_lat, x[2] - 0.5 * t * mean[2])

    # T 2.10, 2.11: rates of the Earth and of the local axes over it.
    east = mean[1] / transverse
    earth = WGS84_EARTH_RATE * cos_lat, 0.0, -WGS84_EARTH_RATE * sin_lat
    over_earth = east, -mean[0] / meridian, -east * sin_lat / cos_lat
    rate = _sum(earth, 1.0, over_earth)

    # T 2.9. The axes turn by ``rate s`` below a force that acts at s: half the turn counts for
    # the velocity, a third for the position.
    accel = _cross(_sum(rate, 1.0, earth), mean)
    accel = -accel[0], -accel[1], gravity - accel[2]
    gained = _sum(_sum(gained, -0.5 * t, _cross(rate, gained)), t, accel)
    moved = _sum(_sum(moved, -t / 3.0, _cross(rate, moved)), 0.5 * t * t, accel)
    moved = _sum(moved, t, velocity)

    # T 2.12, 2.13.
    x[0] += moved[0] / meridian
    x[1] += moved[1] / (transverse * cos_lat)
    x[2] -= moved[2]
    coning = _cross(w0, w1)
    turn = _sum(dtheta, t**3 / 12.0, coning)
    # What the two turns change is added up, not what they make: at rest they cancel, and the
    # attitude does not wander by a rounding a step.
    axes = quat_change_kernel(-rate[0] * t, -rate[1] * t, -rate[2] * t)
    body = quat_change_kernel(turn[0], turn[1], turn[2])
    by_axes, by_body = quat_multiply_kernel(axes, q), quat_multiply_kernel(q, body)
    by_both = quat_multiply_kernel(by_axes, body)
    excess = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3] - 1.0
    for k in range(4):
        x[ATTITUDE + k] += by_axes[k] + by_body[k] + by_both[k] - 0.5 * excess * q[k]
    for k in range(3):
        x[VELOCITY + k] += gained[k]
        x[DELTA_THETA + k] = dtheta[k]
        x[DELTA_VEL + k] = dvel[k]
    x[INTERVAL] = t


@njit(cache=True, nogil=True)
def propagate_kernel(x, delta_theta, delta_vel, dt, geodetic, vel_n, quat_nb):  # type: ignore[no-untyped-def]
    """Carry a state over m intervals of ``dt``, (m,), and fill what it is at the end of each."""
    for i in range(delta_theta.shape[0]):
        dtheta = delta_theta[i, 0], delta_theta[i, 1], delta_theta[i, 2]
        dvel = delta_vel[i, 0], delta_vel[i, 1], delta_vel[i, 2]
        step_kernel(x, dtheta, dvel, dt[i])
        for k in range(3):
            geodetic[i, k] = x[POSITION + k]
            vel_n[i, k] = x[VELOCITY + k]
        for k in range(4):
            quat_nb[i, k] = x[ATTITUDE + k]
