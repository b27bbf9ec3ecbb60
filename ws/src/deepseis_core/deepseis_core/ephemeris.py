"""Broadcast orbit and clock: position, velocity, acceleration in ECEF, clock and its rates.

Ephemerides are packed into one matrix (a row a satellite) for the kernels. Time goes in as week
and integer nanoseconds of week minus a small delay in seconds, so nothing is lost to rounding.

References
----------
IS-GPS-200, table 20-IV (orbit; derivatives taken here term by term), 20.3.3.3.3 (clock).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numba import njit

from deepseis_core.constants import (
    GPS_EARTH_RATE,
    GPS_GM,
    GPS_RELATIVITY_F,
    NS_PER_S,
    NS_PER_WEEK,
    S_PER_WEEK,
    SPEED_OF_LIGHT,
)
from deepseis_core.types import Ephemeris, FloatArray

# Columns of a packed ephemeris.
_FIELDS = (
    *("week", "toe", "toc", "af0", "af1", "af2", "tgd", "sqrt_a", "eccentricity", "i0"),
    *("omega0", "omega", "m0", "delta_n", "omega_dot", "i_dot"),
    *("cuc", "cus", "crc", "crs", "cic", "cis"),
)
PACKED_COLUMNS = len(_FIELDS)

# Columns of a state: position [m], velocity [m/s], acceleration [m/s^2] of ECEF coordinates, then
# the clock of the L1 C/A signal: ahead of GPS time [s], its rate [s/s], its change [s/s^2].
POSITION, VELOCITY, ACCELERATION = slice(0, 3), slice(3, 6), slice(6, 9)
CLOCK, CLOCK_RATE, CLOCK_ACCELERATION = 9, 10, 11
STATE_COLUMNS = 12

FIT_S = 7200.0  # half of the usual curve-fit interval of four hours


def pack(ephemerides: Sequence[Ephemeris]) -> FloatArray:
    """Return the matrix that the kernels take.

    Parameters
    ----------
    ephemerides : sequence of Ephemeris, length n

    Returns
    -------
    ndarray, shape (n, 22)
    """
    rows = [[getattr(ephemeris, name) for name in _FIELDS] for ephemeris in ephemerides]
    return np.array(rows, np.float64).reshape(len(rows), PACKED_COLUMNS)


@njit(cache=True, nogil=True)
def seconds_since(week: int, tow_ns: int, delay: float, week0: float, tow0: float) -> float:
    """Return ``(week, tow_ns) - delay - (week0, tow0)`` [s], integers taken first (kernel)."""
    ns = (week - int(week0)) * NS_PER_WEEK + tow_ns - round(tow0 * NS_PER_S)
    return ns * 1e-9 - delay


@njit(cache=True, nogil=True)
def eccentric_anomaly(mean_anomaly: float, eccentricity: float) -> float:
    """Solve Kepler's equation by Newton's method (kernel); exact to rounding below e = 0.1."""
    anomaly = mean_anomaly + eccentricity * math.sin(mean_anomaly)
    for _ in range(10):
        step = (anomaly - eccentricity * math.sin(anomaly) - mean_anomaly) / (
            1.0 - eccentricity * math.cos(anomaly)
        )
        anomaly -= step
        if abs(step) < 1e-13:
            break
    return anomaly


@njit(cache=True, nogil=True)
def _clock(row: FloatArray, week: int, tow_ns: int, delay: float, out: FloatArray) -> float:
    """Fill the clock columns; return the eccentric anomaly (kernel)."""
    tk = seconds_since(week, tow_ns, delay, row[0], row[1])
    # toc lies in the week of toe or next to it, whichever is nearer.
    toc_week = row[0] + round((row[1] - row[2]) / S_PER_WEEK)
    tc = seconds_since(week, tow_ns, delay, toc_week, row[2])
    e, sqrt_a = row[8], row[7]
    n = math.sqrt(GPS_GM) / (sqrt_a * sqrt_a * sqrt_a) + row[13]
    ek = eccentric_anomaly(row[12] + n * tk, e)
    ek_dot = n / (1.0 - e * math.cos(ek))
    ek_ddot = -e * math.sin(ek) * ek_dot * ek_dot / (1.0 - e * math.cos(ek))
    f = GPS_RELATIVITY_F * e * sqrt_a
    out[9] = row[3] + tc * (row[4] + tc * row[5]) + f * math.sin(ek) - row[6]
    out[10] = row[4] + 2.0 * row[5] * tc + f * math.cos(ek) * ek_dot
    out[11] = 2.0 * row[5] + f * (math.cos(ek) * ek_ddot - math.sin(ek) * ek_dot * ek_dot)
    return ek


@njit(cache=True, nogil=True)
def satellite_state(
    row: FloatArray, week: int, tow_ns: int, delay: float, out: FloatArray
) -> None:
    """Fill one satellite's state at GPS time ``(week, tow_ns) - delay``, ECEF of then (kernel).

    ``row`` is a row of `pack`, ``out`` has the 12 columns of `satellite_states`.
    """
    ek = _clock(row, week, tow_ns, delay, out)
    tk = seconds_since(week, tow_ns, delay, row[0], row[1])
    e, a = row[8], row[7] * row[7]
    n = math.sqrt(GPS_GM) / (a * row[7]) + row[13]
    sin_e, cos_e = math.sin(ek), math.cos(ek)
    shrink = 1.0 - e * cos_e
    e1 = n / shrink
    e2 = -e * sin_e * e1 * e1 / shrink
    root = math.sqrt(1.0 - e * e)

    # Argument of latitude before correction, with derivatives p1, p2.
    p0 = math.atan2(root * sin_e, cos_e - e) + row[11]
    p1 = root * e1 / shrink
    p2 = root * (e2 / shrink - e * sin_e * (e1 / shrink) ** 2)
    s2, c2 = math.sin(2.0 * p0), math.cos(2.0 * p0)
    # d/dt of (cs sin 2p + cc cos 2p) is t1 and then t2 for the pair (cs, cc).
    q1, q2, q3 = 2.0 * p1, 2.0 * p2, 4.0 * p1 * p1
    u0 = p0 + row[17] * s2 + row[16] * c2
    u1 = p1 + q1 * (row[17] * c2 - row[16] * s2)
    u2 = p2 + q2 * (row[17] * c2 - row[16] * s2) - q3 * (row[17] * s2 + row[16] * c2)
    r0 = a * shrink + row[19] * s2 + row[18] * c2
    r1 = a * e * sin_e * e1 + q1 * (row[19] * c2 - row[18] * s2)
    r2 = (
        a * e * (cos_e * e1 * e1 + sin_e * e2)
        + q2 * (row[19] * c2 - row[18] * s2)
        - q3 * (row[19] * s2 + row[18] * c2)
    )
    i0 = row[9] + row[15] * tk + row[21] * s2 + row[20] * c2
    i1 = row[15] + q1 * (row[21] * c2 - row[20] * s2)
    i2 = q2 * (row[21] * c2 - row[20] * s2) - q3 * (row[21] * s2 + row[20] * c2)

    # In the plane of the orbit.
    su, cu = math.sin(u0), math.cos(u0)
    x0, y0 = r0 * cu, r0 * su
    x1, y1 = r1 * cu - y0 * u1, r1 * su + x0 * u1
    x2 = r2 * cu - 2.0 * r1 * su * u1 - y0 * u2 - x0 * u1 * u1
    y2 = r2 * su + 2.0 * r1 * cu * u1 + x0 * u2 - y0 * u1 * u1

    # Into ECEF: x along the node P, y along Q; the node turns at w, the plane tilts at i1.
    w = row[14] - GPS_EARTH_RATE
    node = row[10] + w * tk - GPS_EARTH_RATE * row[1]
    so, co = math.sin(node), math.cos(node)
    si, ci = math.sin(i0), math.cos(i0)
    h0, z0 = y0 * ci, y0 * si  # across the node, along the pole
    h1, z1 = y1 * ci - z0 * i1, y1 * si + h0 * i1
    h2 = y2 * ci - 2.0 * y1 * si * i1 - z0 * i2 - h0 * i1 * i1
    z2 = y2 * si + 2.0 * y1 * ci * i1 + h0 * i2 - z0 * i1 * i1
    out[0] = x0 * co - h0 * so
    out[1] = x0 * so + h0 * co
    out[2] = z0
    out[3] = x1 * co - h1 * so - w * out[1]
    out[4] = x1 * so + h1 * co + w * out[0]
    out[5] = z1
    out[6] = x2 * co - h2 * so - 2.0 * w * (x1 * so + h1 * co) - w * w * out[0]
    out[7] = x2 * so + h2 * co + 2.0 * w * (x1 * co - h1 * so) - w * w * out[1]
    out[8] = z2


@njit(cache=True, nogil=True)
def satellite_states(packed: FloatArray, week: int, tow_ns: int, delay: FloatArray) -> FloatArray:
    """Return the states of satellites at GPS time ``(week, tow_ns) - delay`` (kernel).

    Parameters
    ----------
    packed : ndarray, shape (n, 22)
        From `pack`.
    week, tow_ns : int
        GPS time; nanoseconds of week [ns].
    delay : ndarray, shape (n,)
        Subtracted from the time, per satellite [s].

    Returns
    -------
    ndarray, shape (n, 12)
        Columns POSITION, VELOCITY, ACCELERATION in the ECEF frame of that moment, and CLOCK,
        CLOCK_RATE, CLOCK_ACCELERATION of the L1 C/A signal: polynomial + relativity - TGD.
    """
    out = np.empty((packed.shape[0], STATE_COLUMNS))
    for i in range(packed.shape[0]):
        satellite_state(packed[i], week, tow_ns, delay[i], out[i])
    return out


@njit(cache=True, nogil=True)
def states_from_pseudoranges(
    packed: FloatArray, week: int, tow_ns: int, pseudorange: FloatArray
) -> FloatArray:
    """Return the states when the signals left, from receiver time and pseudoranges (kernel).

    The satellite's clock showed ``t_receiver - P/c`` then, whatever the receiver's clock error.

    Parameters
    ----------
    packed : ndarray, shape (n, 22)
    week, tow_ns : int
        Receiver time of the observation.
    pseudorange : ndarray, shape (n,)
        [m]

    Returns
    -------
    ndarray, shape (n, 12)
        As `satellite_states`.
    """
    out = np.empty((packed.shape[0], STATE_COLUMNS))
    for i in range(packed.shape[0]):
        travel = pseudorange[i] / SPEED_OF_LIGHT
        _clock(packed[i], week, tow_ns, travel, out[i])
        _clock(packed[i], week, tow_ns, travel + out[i, 9], out[i])
        satellite_state(packed[i], week, tow_ns, travel + out[i, 9], out[i])
    return out


def age(ephemeris: Ephemeris, week: int, tow_ns: int) -> float:
    """Return the time since toe [s], negative before it."""
    return ((week - ephemeris.week) * NS_PER_WEEK + tow_ns) / NS_PER_S - ephemeris.toe


def select_ephemerides(
    ephemerides: Iterable[Ephemeris],
    week: int,
    tow_ns: int,
    *,
    max_age_s: float = FIT_S,
    healthy_only: bool = True,
) -> dict[str, Ephemeris]:
    """Choose each satellite's best ephemeris for a time.

    The nearest toe wins; of equal ones the message sent last.

    Parameters
    ----------
    ephemerides : iterable of Ephemeris
    week, tow_ns : int
        GPS time.
    max_age_s : float, optional
        Greatest distance from toe [s].
    healthy_only : bool, optional
        Leave out satellites that say they are unhealthy.

    Returns
    -------
    dict of str to Ephemeris
        By name, in the order of names; satellites without a usable ephemeris are missing.
    """
    best: dict[str, Ephemeris] = {}
    for candidate in ephemerides:
        distance = abs(age(candidate, week, tow_ns))
        if distance > max_age_s or (healthy_only and candidate.health):
            continue
        known = best.get(candidate.satellite)
        if known is None or (distance, -candidate.transmit_tow) < (
            abs(age(known, week, tow_ns)),
            -known.transmit_tow,
        ):
            best[candidate.satellite] = candidate
    return dict(sorted(best.items()))
