"""Transmit times before a subframe is decoded: from a known position, coarse time and bit edges.

A channel in bit synchronism knows its transmit time modulo 20 ms. With position and ephemeris
known, the differences between satellites fix all multiples of 20 ms but a common one, as long as
coarse time is within minutes (a range rate is below 1 km/s, so a minute moves a range by less than
0.2 ms). The common one follows from time itself, which the ranges tell because each changes at
its own rate: with y the measured minus predicted transmit time and e the error of coarse time ::

    y_i = A - e range_rate_i / c

Metres of range error over hundreds of metres per second leave e good to milliseconds: enough for
20 ms, not for 1 ms, hence the need of bit edges (F. van Diggelen, "A-GPS: Assisted GPS, GNSS, and
SBAS", Artech House 2009, ch. 4: coarse-time navigation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from deepseis_core.atmosphere import klobuchar_delay, saastamoinen_delay
from deepseis_core.constants import L1_WAVELENGTH, NS_PER_S, NS_PER_WEEK, SPEED_OF_LIGHT
from deepseis_core.geodesy import geodetic_from_ecef
from deepseis_core.gps_time import GpsTime
from deepseis_core.propagation import LineOfSight, line_of_sight
from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import FloatArray, IntArray
from deepseis_pvt.ephemeris_book import EphemerisBook

NS_PER_MS = 1_000_000
MS_PER_WEEK = NS_PER_WEEK // NS_PER_MS
BIT_MS = 20
METRES_PER_MS = SPEED_OF_LIGHT / 1000.0
_GPS_EPOCH_UTC_NS = 315_964_800 * 1_000_000_000


@dataclass(frozen=True)
class Assistance:
    """What a station knows before it hears anything.

    ``position_ecef`` [m] within metres, as a surveyed antenna's is; ``gps_ns_at_sample_0`` GPS
    time since its epoch of sample 0 [ns], within minutes; ``range_sd`` error of a predicted zenith
    range [m]; ``troposphere`` False for signals that have none.
    """

    position_ecef: tuple[float, float, float]
    gps_ns_at_sample_0: int
    range_sd: float = 2.0
    troposphere: bool = True


def assistance_of(
    position_ecef: Sequence[float], clock: SampleClock, *, troposphere: bool
) -> Assistance | None:
    """Return what a station's own settings tell; None where the position or time is not known.

    Parameters
    ----------
    position_ecef : sequence of float
        Antenna [m], three numbers or empty.
    clock : SampleClock
        Coarse UTC of samples; one that starts before 1980 is not known.
    troposphere : bool
        The signal went through one.
    """
    if len(position_ecef) != 3 or clock.start_utc_ns < _GPS_EPOCH_UTC_NS:
        return None
    x, y, z = (float(value) for value in position_ecef)
    start = GpsTime.from_utc_ns(clock.start_utc_ns)
    return Assistance((x, y, z), start.total_ns, troposphere=troposphere)


def predict_transmit_ms(
    state: FloatArray, packed_row: FloatArray, gps_ns: int, code_ms: float
) -> int | None:
    """Return the millisecond of week a code period left, from receiver position and time.

    Parameters
    ----------
    state : ndarray, shape (4,)
        ECEF position and clock bias [m].
    packed_row : ndarray, shape (22,)
        Ephemeris.
    gps_ns : int
        Receiver time since the GPS epoch [ns].
    code_ms : float
        Code phase then, in milliseconds from the start of that period.

    Returns
    -------
    int or None
        None where prediction and code phase differ by more than 0.2 ms from whole milliseconds:
        that is no signal of this satellite.
    """
    week, tow_ns = divmod(gps_ns, NS_PER_WEEK)
    los = line_of_sight(
        packed_row[None], week, tow_ns, state[:3], offset=-state[3] / SPEED_OF_LIGHT
    )
    travel_ms = float(los.range[0] + state[3]) / METRES_PER_MS
    travel_ms -= 1000.0 * float(los.satellite_clock[0])
    whole_ms, rest_ns = divmod(tow_ns, NS_PER_MS)
    offset = rest_ns / NS_PER_MS - travel_ms - code_ms
    nearest = round(offset)
    if abs(offset - nearest) > 0.2:
        return None
    return (whole_ms + nearest) % MS_PER_WEEK


class Located(Protocol):
    """The part of ``ObservablesBuilder`` that is needed here."""

    row: IntArray
    code_ms: FloatArray

    def bit_ms(self) -> FloatArray:
        """Return time since a bit edge [ms], NaN where none is known."""


def resolve_start(
    assistance: Assistance,
    located: Located,
    satellites: tuple[str, ...],
    book: EphemerisBook,
    sample_index: int,
    gps_ns: int,
) -> dict[int, tuple[int, FloatArray]]:
    """Return transmit milliseconds since the GPS epoch and ephemerides, by satellite number.

    ``gps_ns`` is coarse GPS time of the sample [ns]. The result is empty where fewer than five
    satellites are in bit synchronism or time stays in doubt.
    """
    bit_ms = located.bit_ms()
    numbers, rows = [], []
    for i in np.flatnonzero(np.isfinite(bit_ms)).tolist():
        item = book.find(satellites[i], sample_index, gps_ns)
        if item is not None:
            numbers.append(i)
            rows.append(item[1])
    if len(numbers) < 5:
        return {}
    packed = np.stack(rows)
    left = resolve_bits(assistance, packed, bit_ms[numbers], gps_ns, book.klobuchar(sample_index))
    if left is None:
        return {}
    whole, rest = left
    start = whole + np.rint(rest - located.code_ms[numbers]).astype(np.int64)
    return {i: (int(ms), row) for i, ms, row in zip(numbers, start, rows, strict=True)}


def resolve_bits(
    assistance: Assistance,
    packed: FloatArray,
    bit_ms: FloatArray,
    gps_ns: int,
    klobuchar: FloatArray | None = None,
) -> tuple[int, FloatArray] | None:
    """Resolve transmit times known modulo 20 ms.

    Parameters
    ----------
    assistance : Assistance
        Position; error of predicted ranges.
    packed : ndarray, shape (n, 22)
        Ephemerides.
    bit_ms : ndarray, shape (n,)
        Time since a bit edge [ms].
    gps_ns : int
        Coarse GPS time since its epoch [ns].
    klobuchar : ndarray, shape (8,), optional
        Ionosphere.

    Returns
    -------
    (int, ndarray of shape (n,)) or None
        Transmit times in GPS time since its epoch: whole milliseconds [ms] common to all, and the
        rest [ms]. None if the multiple of 20 ms of time itself stays in doubt.
    """
    now_ns = gps_ns
    for _ in range(8):
        predicted_ms, los = _predict(assistance, packed, now_ns, klobuchar)
        reference = int(np.argmax(los.elevation))
        lag = predicted_ms - predicted_ms[reference] - (bit_ms - bit_ms[reference])
        relative = bit_ms + BIT_MS * np.rint(lag / BIT_MS)
        error_ms, sd_ms = _time_error(assistance, los, (relative - predicted_ms) * METRES_PER_MS)
        if not abs(error_ms) < 600_000.0:
            return None
        now_ns += round(error_ms * NS_PER_MS)
        if abs(error_ms) < 0.1:
            break
    else:
        return None
    if 3.0 * sd_ms > BIT_MS / 2:
        return None
    # now_ns is good to sd_ms; a bit edge of the reference pins it.
    whole_ms, rest_ns = divmod(now_ns, NS_PER_MS)
    total = (whole_ms % BIT_MS) + rest_ns / NS_PER_MS + predicted_ms[reference]
    lag_bits = (total - relative[reference]) / BIT_MS
    bits = round(lag_bits)
    if abs(lag_bits - bits) * BIT_MS > max(3.0 * sd_ms, 2.0):
        return None
    return whole_ms - whole_ms % BIT_MS, relative + BIT_MS * bits


def _predict(
    assistance: Assistance, packed: FloatArray, now_ns: int, klobuchar: FloatArray | None
) -> tuple[FloatArray, LineOfSight]:
    """Return transmit minus receive times [ms] at the known position."""
    week, tow_ns = divmod(now_ns, NS_PER_WEEK)
    position = np.array(assistance.position_ecef)
    los = line_of_sight(packed, week, tow_ns, position)
    latitude, longitude, height = geodetic_from_ecef(position).tolist()
    delay = np.zeros(len(los.elevation))
    if assistance.troposphere:
        delay += saastamoinen_delay(latitude, height, los.elevation.copy(), 0.7)
    if klobuchar is not None:
        delay += klobuchar_delay(
            klobuchar[:4], klobuchar[4:], latitude, longitude,
            los.elevation.copy(), los.azimuth.copy(), tow_ns / NS_PER_S,
        )  # fmt: skip
    return -(los.range + delay) / METRES_PER_MS + 1000.0 * los.satellite_clock, los


def _time_error(
    assistance: Assistance, los: LineOfSight, difference: FloatArray
) -> tuple[float, float]:
    """Return the error of coarse time and its sigma [ms] from measured minus predicted [m]."""
    sine = np.maximum(np.sin(los.elevation), 0.1)
    weight = sine / assistance.range_sd
    rate_per_ms = -L1_WAVELENGTH * los.doppler_hz / 1000.0
    design = np.column_stack((np.ones_like(rate_per_ms), -rate_per_ms)) * weight[:, None]
    covariance = np.linalg.inv(design.T @ design)
    _, error_ms = covariance @ (design.T @ (difference * weight))
    residual = difference * weight - design @ (covariance @ (design.T @ (difference * weight)))
    scale = max(1.0, float(residual @ residual) / (len(difference) - 2))
    return float(error_ms), float(np.sqrt(covariance[1, 1] * scale))
