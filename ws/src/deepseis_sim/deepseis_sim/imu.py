"""What an ideal inertial measurement unit on the moving body delivers: increments.

Sample k covers the receiver time from k / rate to (k + 1) / rate and holds the integrals over it
of the angular rate against inertial space and of the specific force, along the body axes forward,
left, up: the sums of an ideal rate-integrating unit, not a rotation vector. In the tangent frame,
which turns with the Earth at the rate W::

    f = a + 2 W x v - g(p),      omega_ib = omega_b + C_b_enu W

with normal gravity g, centrifugal part included, along the ellipsoid's normal at the point where
the body is. Errors are added later (`deepseis_core.imu_errors`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit

from deepseis_core.constants import WGS84_A, WGS84_B, WGS84_E2, WGS84_EARTH_RATE, WGS84_F
from deepseis_core.errors import InputError
from deepseis_core.geodesy import normal_gravity
from deepseis_core.types import FloatArray
from deepseis_sim.motion import Kinematics, Motion
from deepseis_sim.site import Site

_NODES = 4
"""Gauss-Legendre nodes in an interval: exact to the seventh power of time. A rotation at 5 Hz
sampled at 50 Hz is integrated to 1e-11 of its size, at 200 Hz to rounding."""

Clock = Callable[[FloatArray], FloatArray]
GravityDisturbance = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class ImuIncrements:
    """Increments of m samples, axes forward, left, up.

    Attributes
    ----------
    time_end : ndarray, shape (m,)
        End of each sample's interval, receiver time since the start [s].
    delta_theta : ndarray, shape (m, 3)
        Integral of the angular rate [rad].
    delta_vel : ndarray, shape (m, 3)
        Integral of the specific force [m/s]; at rest and level g dt upwards.
    dt : float
        Nominal length of an interval [s].
    """

    time_end: FloatArray
    delta_theta: FloatArray
    delta_vel: FloatArray
    dt: float


class ImuSynthesizer:
    """Error-free increments along a motion, for any samples in any order.

    A sample depends on its number alone: however a span is cut, its bytes are the same. Where the
    body never turns the integrals are exact, velocity and position at the ends of the interval
    give them; otherwise they are Gauss-Legendre sums.

    Parameters
    ----------
    motion : Motion
        Of the IMU, as a function of true time.
    site : Site
        Place of the motion's tangent frame.
    rate_hz : float
        Samples a second of receiver time [Hz].
    clock : callable, optional
        Receiver time [s], shape (m,), to receiver minus true time [s], shape (m,): the receiver
        triggers the IMU. Without it the clocks agree.
    gravity : callable, optional
        Position in the tangent frame [m], shape (m, 3), to gravity in excess of the normal one
        [m/s^2], shape (m,), positive down.

    Raises
    ------
    InputError
        The rate is not positive.
    """

    def __init__(
        self,
        motion: Motion,
        site: Site,
        rate_hz: float,
        *,
        clock: Clock | None = None,
        gravity: GravityDisturbance | None = None,
    ) -> None:
        if not 0.0 < rate_hz < math.inf:
            raise InputError("IMU rate_hz", f"{rate_hz} is not a positive number")
        self.motion, self.site, self.rate_hz = motion, site, float(rate_hz)
        self.clock, self.gravity = clock, gravity
        self._earth_rate: FloatArray = WGS84_EARTH_RATE * site.C_e_enu[2]

    def increments(self, first: int, count: int) -> ImuIncrements:
        """Return samples ``first`` to ``first + count``, the last excluded.

        Parameters
        ----------
        first, count : int
            Any, the count not negative; samples before number 0 are as good as others.
        """
        if count < 0:
            raise InputError("IMU samples", f"their count is {count}", "0 or more")
        receiver = np.arange(first, first + count + 1) / self.rate_hz
        true, dt = receiver, np.full(count, 1.0 / self.rate_hz)
        if self.clock is not None:
            bias = self.clock(receiver)
            # Differences of late times would be rounded; those of the bias keep their digits.
            true, dt = receiver - bias, dt - np.diff(bias)
        integrate = self._turning if self.motion.rotates else self._translating
        delta_theta, delta_vel = integrate(true, dt)
        return ImuIncrements(receiver[1:], delta_theta, delta_vel, 1.0 / self.rate_hz)

    def _translating(self, edge: FloatArray, dt: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Integrate between edges, shape (m + 1,), ``dt`` apart [s], at constant attitude."""
        at = self.motion.at(edge)
        moved, gained = np.diff(at.position, axis=0), np.diff(at.velocity, axis=0)
        # The mean of a position that has a cubic's values and slopes at the ends.
        mean = at.position[:-1] + 0.5 * moved - dt[:, None] / 12.0 * gained
        C_enu_b = at.C_enu_b if at.C_enu_b.ndim == 2 else at.C_enu_b[0]
        out = np.empty((2, edge.size - 1, 3))
        pull = self._gravity(mean)
        _fixed_attitude(dt, moved, gained, pull, self._earth_rate, _copy(C_enu_b), out)
        return out[0], out[1]

    def _turning(self, edge: FloatArray, dt: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Integrate between edges, shape (m + 1,), ``dt`` apart [s], by Gauss-Legendre sums."""
        node, weight = np.polynomial.legendre.leggauss(_NODES)
        node, weight = 0.5 * (node + 1.0), 0.5 * weight
        time = edge[:-1, None] + dt[:, None] * node
        at = self.motion.at(time.ravel())
        mean = np.zeros((dt.size, 3))
        for j in range(_NODES):
            mean += weight[j] * at.position[j::_NODES]
        out = np.empty((2, dt.size, 3))
        _sums(dt, weight, *_arrays(at, time.size), self._gravity(mean), self._earth_rate, out)
        return out[0], out[1]

    def _gravity(self, position: FloatArray) -> FloatArray:
        """Return gravity [m/s^2] along east, north, up, shape (m, 3).

        Once an interval, at the mean position: its change on the way is linear for all purposes.
        """
        up, lat_height = np.empty_like(position), np.empty((2, position.shape[0]))
        _verticals(position, self.site.origin_ecef, self.site.C_e_enu, up, lat_height)
        size = normal_gravity(lat_height[0], lat_height[1])
        if self.gravity is not None:
            size = size + self.gravity(position)
        up *= -size[:, None]
        return up


def _copy(array: FloatArray) -> FloatArray:
    return np.ascontiguousarray(array, np.float64)


def _arrays(at: Kinematics, m: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return velocity, acceleration, attitude and rate of every one of m times."""
    C_enu_b = np.broadcast_to(at.C_enu_b, (m, 3, 3))
    return at.velocity, at.acceleration, _copy(C_enu_b), _copy(np.broadcast_to(at.omega_b, (m, 3)))


@njit(cache=True, nogil=True)
def _verticals(position, origin, C, up, lat_height):  # type: ignore[no-untyped-def]
    """Fill the ellipsoid's normals in the tangent frame, latitudes and heights at positions.

    Bowring's formula as in `geodesy.geodetic_point`, on sines and cosines instead of angles.
    """
    second_e2 = WGS84_E2 / (1.0 - WGS84_E2)
    for i in range(position.shape[0]):
        e, n, u = position[i, 0], position[i, 1], position[i, 2]
        x = origin[0] + C[0, 0] * e + C[0, 1] * n + C[0, 2] * u
        y = origin[1] + C[1, 0] * e + C[1, 1] * n + C[1, 2] * u
        z = origin[2] + C[2, 0] * e + C[2, 1] * n + C[2, 2] * u
        p = math.sqrt(x * x + y * y)
        s, c = z, p * (1.0 - WGS84_F)
        sin_lat, cos_lat = 0.0, 1.0
        for _ in range(3):
            size = math.sqrt(s * s + c * c)
            s, c = s / size, c / size
            s = z + second_e2 * WGS84_B * s * s * s
            c = p - WGS84_E2 * WGS84_A * c * c * c
            size = math.sqrt(s * s + c * c)
            sin_lat, cos_lat = s / size, c / size
            s, c = (1.0 - WGS84_F) * sin_lat, cos_lat
        scale = cos_lat / p if p > 0.0 else 0.0
        nx, ny, nz = x * scale, y * scale, sin_lat
        for k in range(3):
            up[i, k] = C[0, k] * nx + C[1, k] * ny + C[2, k] * nz
        lat_height[0, i] = math.atan2(sin_lat, cos_lat)
        root = math.sqrt(1.0 - WGS84_E2 * sin_lat * sin_lat)
        lat_height[1, i] = p * cos_lat + z * sin_lat - WGS84_A * root


@njit(cache=True, nogil=True)
def _fixed_attitude(dt, moved, gained, gravity, rate, C, out):  # type: ignore[no-untyped-def]
    """Fill the increments from changes of position and velocity, tangent frame."""
    for i in range(dt.size):
        mx, my, mz = moved[i, 0], moved[i, 1], moved[i, 2]
        fx = gained[i, 0] + 2.0 * (rate[1] * mz - rate[2] * my) - gravity[i, 0] * dt[i]
        fy = gained[i, 1] + 2.0 * (rate[2] * mx - rate[0] * mz) - gravity[i, 1] * dt[i]
        fz = gained[i, 2] + 2.0 * (rate[0] * my - rate[1] * mx) - gravity[i, 2] * dt[i]
        for k in range(3):
            turned = C[0, k] * rate[0] + C[1, k] * rate[1] + C[2, k] * rate[2]
            out[0, i, k] = turned * dt[i]
            out[1, i, k] = C[0, k] * fx + C[1, k] * fy + C[2, k] * fz


@njit(cache=True, nogil=True)
def _sums(dt, weight, velocity, acceleration, C, omega, gravity, rate, out):  # type: ignore[no-untyped-def]
    """Fill the increments from values at the nodes, which run interval by interval."""
    nodes = weight.size
    for i in range(dt.size):
        out[:, i] = 0.0
        for j in range(nodes):
            n = i * nodes + j
            vx, vy, vz = velocity[n, 0], velocity[n, 1], velocity[n, 2]
            fx = acceleration[n, 0] + 2.0 * (rate[1] * vz - rate[2] * vy) - gravity[i, 0]
            fy = acceleration[n, 1] + 2.0 * (rate[2] * vx - rate[0] * vz) - gravity[i, 1]
            fz = acceleration[n, 2] + 2.0 * (rate[0] * vy - rate[1] * vx) - gravity[i, 2]
            share = weight[j] * dt[i]
            for k in range(3):
                a, b, c = C[n, 0, k], C[n, 1, k], C[n, 2, k]
                out[0, i, k] += share * (omega[n, k] + a * rate[0] + b * rate[1] + c * rate[2])
                out[1, i, k] += share * (a * fx + b * fy + c * fz)
