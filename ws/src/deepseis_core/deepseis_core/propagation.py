"""From a satellite to a receiver: geometry, Doppler and its rate, atmosphere.

The signal received at GPS time t left at t - tau, ``c tau = |R(w tau) r_s(t - tau) - r(t)|``, R
the turn of the Earth during the flight (Sagnac). Its phase is that of the satellite's clock at
departure, so with a perfect receiver clock the carrier Doppler and its rate are ::

    f  = f1 (-tau' + dt_s' (1 - tau'))
    f' = f1 (-tau'' + dt_s'' (1 - tau')^2 - dt_s' tau'')

with dt_s the satellite's clock, relativity included. tau' and tau'' are exact derivatives of the
first equation; e being the unit vector from satellite to receiver they are, to first order,
``e . (v - v_s)/c`` and ``(e . (a - a_s) + |v_perp|^2/r)/c``. The atmosphere is not in them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from deepseis_core.constants import GPS_EARTH_RATE, L1_HZ, SPEED_OF_LIGHT
from deepseis_core.ephemeris import STATE_COLUMNS, satellite_state
from deepseis_core.geodesy import geodetic_point
from deepseis_core.types import FloatArray, IntArray

# Columns of the table that `line_of_sight_table` fills.
RANGE, RANGE_RATE, RANGE_ACCELERATION = 0, 1, 2
UNIT = slice(3, 6)
ELEVATION, AZIMUTH = 6, 7
CLOCK, CLOCK_RATE, CLOCK_ACCELERATION = 8, 9, 10
DOPPLER_HZ, DOPPLER_RATE = 11, 12
SATELLITE = slice(13, 16)
LOS_COLUMNS = 16


@njit(cache=True, nogil=True)
def geometry_kernel(
    state: FloatArray, delay: float, receiver: FloatArray, out: FloatArray
) -> float:
    """Fill range, its rates, unit vector and turned satellite position (kernel).

    Returns c less the range's derivative by the delay [m/s], for the next guess of the delay.

    Parameters
    ----------
    state : ndarray, shape (12,)
        Of the satellite at departure (`ephemeris.satellite_state`).
    delay : float
        Time of flight [s].
    receiver, out : ndarray, shapes (9,) and (16,)
        A row of those of `line_of_sight_table`; filled are RANGE, RANGE_RATE,
        RANGE_ACCELERATION, UNIT and SATELLITE.
    """
    theta = GPS_EARTH_RATE * delay
    s, c = math.sin(theta), math.cos(theta)
    # Position, velocity and acceleration turned into the frame of reception.
    x, y, z = c * state[0] + s * state[1], c * state[1] - s * state[0], state[2]
    vx, vy, vz = c * state[3] + s * state[4], c * state[4] - s * state[3], state[5]
    ax, ay, az = c * state[6] + s * state[7], c * state[7] - s * state[6], state[8]
    dx, dy, dz = x - receiver[0], y - receiver[1], z - receiver[2]
    distance = math.sqrt(dx * dx + dy * dy + dz * dz)
    ux, uy, uz = dx / distance, dy / distance, dz / distance
    # Velocity of the turned position with the delay: that of the satellite less the turning.
    w = GPS_EARTH_RATE
    closing = SPEED_OF_LIGHT + ux * (vx - w * y) + uy * (vy + w * x) + uz * vz
    rate = (ux * (vx - receiver[3]) + uy * (vy - receiver[4]) + uz * (vz - receiver[5])) / closing
    wx = vx * (1.0 - rate) + w * rate * y - receiver[3]
    wy = vy * (1.0 - rate) - w * rate * x - receiver[4]
    wz = vz * (1.0 - rate) - receiver[5]
    along = ux * wx + uy * wy + uz * wz
    across2 = wx * wx + wy * wy + wz * wz - along * along
    flow2 = (1.0 - rate) * (1.0 - rate)
    cross = 2.0 * w * rate * (1.0 - rate)
    turn2 = (w * rate) * (w * rate)
    bx = ax * flow2 + cross * vy - turn2 * x - receiver[6]
    by = ay * flow2 - cross * vx - turn2 * y - receiver[7]
    bz = az * flow2 - receiver[8]
    rate2 = (ux * bx + uy * by + uz * bz + across2 / distance) / closing
    out[0] = distance
    out[1] = SPEED_OF_LIGHT * rate
    out[2] = SPEED_OF_LIGHT * rate2
    out[3], out[4], out[5] = -ux, -uy, -uz
    out[13], out[14], out[15] = x, y, z
    return closing


@njit(cache=True, nogil=True)
def _one(
    row: FloatArray,
    week: int,
    tow_ns: int,
    offset: float,
    receiver: FloatArray,
    sky: FloatArray,
    state: FloatArray,
    out: FloatArray,
) -> None:
    """Fill one row of `line_of_sight_table` (kernel); ``sky`` is C_enu_e of the receiver."""
    delay = 0.075
    # One step of Newton's from within 20 ms: the range's curvature of 0.3 m/s^2 leaves 2e-13 s,
    # in which the range changes by less than 1e-9 m.
    satellite_state(row, week, tow_ns, delay - offset, state)
    closing = geometry_kernel(state, delay, receiver, out)
    delay += (out[0] - SPEED_OF_LIGHT * delay) / closing
    satellite_state(row, week, tow_ns, delay - offset, state)
    geometry_kernel(state, delay, receiver, out)
    east = -(sky[0, 0] * out[3] + sky[0, 1] * out[4])
    north = -(sky[1, 0] * out[3] + sky[1, 1] * out[4] + sky[1, 2] * out[5])
    up = -(sky[2, 0] * out[3] + sky[2, 1] * out[4] + sky[2, 2] * out[5])
    out[6] = math.atan2(up, math.hypot(east, north))
    out[7] = math.atan2(east, north) % (2.0 * math.pi)
    out[8], out[9], out[10] = state[9], state[10], state[11]
    rate, rate2 = out[1] / SPEED_OF_LIGHT, out[2] / SPEED_OF_LIGHT
    out[11] = L1_HZ * (-rate + out[9] * (1.0 - rate))
    out[12] = L1_HZ * (-rate2 + out[10] * (1.0 - rate) ** 2 - out[9] * rate2)


@njit(cache=True, nogil=True)
def _fill_sky(receiver: FloatArray, sky: FloatArray) -> None:
    lat, lon, _ = geodetic_point(receiver[0], receiver[1], receiver[2])
    s, c, sl, cl = math.sin(lat), math.cos(lat), math.sin(lon), math.cos(lon)
    sky[0, 0], sky[0, 1], sky[0, 2] = -sl, cl, 0.0
    sky[1, 0], sky[1, 1], sky[1, 2] = -s * cl, -s * sl, c
    sky[2, 0], sky[2, 1], sky[2, 2] = c * cl, c * sl, s


@njit(cache=True, nogil=True)
def line_of_sight_table(
    packed: FloatArray,
    week: int,
    tow_ns: IntArray,
    offset: FloatArray,
    receiver: FloatArray,
    out: FloatArray,
) -> None:
    """Fill the geometry of all satellites at many moments (kernel).

    Parameters
    ----------
    packed : ndarray, shape (n, 22)
        From `ephemeris.pack`.
    week : int
        GPS week that ``tow_ns`` counts from.
    tow_ns, offset : ndarray of int64, of float64, shape (m,)
        GPS time of reception is ``tow_ns`` [ns] + ``offset`` [s]; it may run over the week's end.
    receiver : ndarray, shape (m, 9)
        ECEF position [m], velocity [m/s] and acceleration [m/s^2] of the antenna, each the plain
        derivative of the coordinates before.
    out : ndarray, shape (m, n, 16)
        Columns RANGE [m], RANGE_RATE [m/s], RANGE_ACCELERATION [m/s^2], UNIT (ECEF, satellite to
        receiver), ELEVATION, AZIMUTH [rad], CLOCK [s], CLOCK_RATE [s/s], CLOCK_ACCELERATION
        [s/s^2] of the satellite at departure, DOPPLER_HZ [Hz], DOPPLER_RATE [Hz/s], SATELLITE
        (position at departure in the ECEF frame of reception [m]).
    """
    sky = np.empty((3, 3))
    state = np.empty(STATE_COLUMNS)
    for j in range(tow_ns.shape[0]):
        _fill_sky(receiver[j], sky)
        for i in range(packed.shape[0]):
            _one(packed[i], week, tow_ns[j], offset[j], receiver[j], sky, state, out[j, i])


@dataclass(frozen=True)
class LineOfSight:
    """Geometry of n satellites at one moment (columns of `line_of_sight_table`), or at m.

    Arrays have shape (n,), vectors (n, 3); with m moments (m, n) and (m, n, 3). ``doppler_hz``
    and ``doppler_rate`` are for a perfect receiver clock; add ``f1`` times the fractional rate of
    the receiver's oscillator with a minus sign when it runs fast.
    """

    table: FloatArray

    @property
    def range(self) -> FloatArray:
        """Geometric range with the Earth's rotation [m]."""
        return self.table[..., RANGE]

    @property
    def range_rate(self) -> FloatArray:
        """Its derivative by reception time [m/s]."""
        return self.table[..., RANGE_RATE]

    @property
    def range_acceleration(self) -> FloatArray:
        """Its second derivative [m/s^2]."""
        return self.table[..., RANGE_ACCELERATION]

    @property
    def unit(self) -> FloatArray:
        """Unit vector from satellite to receiver, ECEF."""
        return self.table[..., UNIT]

    @property
    def elevation(self) -> FloatArray:
        """Above the ellipsoid's horizon [rad]."""
        return self.table[..., ELEVATION]

    @property
    def azimuth(self) -> FloatArray:
        """From north to east, 0 to 2 pi [rad]."""
        return self.table[..., AZIMUTH]

    @property
    def satellite_clock(self) -> FloatArray:
        """Ahead of GPS time at departure, L1 C/A, relativity included [s]."""
        return self.table[..., CLOCK]

    @property
    def satellite_clock_rate(self) -> FloatArray:
        """Rate of that clock [s/s]."""
        return self.table[..., CLOCK_RATE]

    @property
    def doppler_hz(self) -> FloatArray:
        """Carrier Doppler, positive approaching [Hz]."""
        return self.table[..., DOPPLER_HZ]

    @property
    def doppler_rate(self) -> FloatArray:
        """Its derivative [Hz/s]."""
        return self.table[..., DOPPLER_RATE]

    @property
    def satellite_position(self) -> FloatArray:
        """Satellite at departure, in the ECEF frame of reception [m]."""
        return self.table[..., SATELLITE]


def line_of_sight(
    packed: FloatArray,
    week: int,
    tow_ns: ArrayLike,
    receiver: ArrayLike,
    *,
    offset: ArrayLike = 0.0,
) -> LineOfSight:
    """Return range, Doppler and direction of satellites seen from a receiver.

    Parameters
    ----------
    packed : ndarray, shape (n, 22)
        From `ephemeris.pack`.
    week : int
        GPS week.
    tow_ns : int or array_like of int, shape (m,)
        Reception, GPS time [ns of week].
    receiver : array_like, shape (k,) or (m, k), k = 3, 6 or 9
        ECEF position [m], velocity [m/s], acceleration [m/s^2] of coordinates; missing ones are
        zero. One row serves all moments.
    offset : float or array_like, shape (m,), optional
        Added to the time of reception [s]: fractions of a nanosecond, or minus the clock bias.

    Returns
    -------
    LineOfSight
        Arrays of shape (n, ...) for one moment, (m, n, ...) for many.
    """
    times = np.atleast_1d(np.asarray(tow_ns, np.int64))
    given = np.asarray(receiver, np.float64)
    rows = np.zeros((times.size, 9))
    rows[:, : given.shape[-1]] = given
    offsets = np.ascontiguousarray(np.broadcast_to(np.asarray(offset, np.float64), times.shape))
    out = np.empty((times.size, packed.shape[0], LOS_COLUMNS))
    line_of_sight_table(packed, week, times, offsets, rows, out)
    return LineOfSight(out if np.ndim(tow_ns) else out[0])
