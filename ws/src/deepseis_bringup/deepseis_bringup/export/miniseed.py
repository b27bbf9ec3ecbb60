"""Runs as miniSEED 2 records of 512 bytes: Steim-2 counts, microseconds, leap seconds.

ObsPy (libmseed) packs. It knows no second 60: records that begin in a leap second are given
their true time and flag afterwards (SEED 2.4, BTIME and activity flag bit 4).
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from io import BytesIO
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from deepseis_bringup.export.fdsn_channels import ChannelCode, Place
from deepseis_bringup.export.quiet_obspy import obspy_modules
from deepseis_bringup.export.sample_runs import Run, exact_pieces
from deepseis_bringup.export.utc_pieces import DAY_NS, UtcMoment, cut_at_days
from deepseis_core.constants import NS_PER_S
from deepseis_core.errors import InputError
from deepseis_core.types import FloatArray, IntArray

RECORD_BYTES: Final = 512
SEQUENCES: Final = 999_999
"""Records are numbered from 1 to here, and again."""
STEIM2_STEP: Final = 2**29
"""Counts by which neighbours may differ at most."""

_TIME_AT, _FLAGS_AT, _BLOCKETTES_AT = 20, 36, 46  # offsets in a record
_LEAP_FLAG = 0x10


def counts_of(values: FloatArray, channel: ChannelCode) -> NDArray[np.int32]:
    """Return values as counts, rounded to the nearest.

    Raises
    ------
    InputError
        They do not fit 32 bits, or neighbours differ by more than Steim-2 can say.
    """
    counts = np.rint(values * channel.counts)
    jump = np.abs(np.diff(counts)).max(initial=0.0)
    if np.abs(counts).max(initial=0.0) >= 2**31 or jump >= STEIM2_STEP:
        limit = STEIM2_STEP / channel.counts
        raise InputError(
            f"{channel.code} {channel.location}", f"changes by more than {limit:g} {channel.unit}"
        )
    return counts.astype(np.int32)


def day_records(
    run: Run, column: int, channel: ChannelCode, place: Place, sequence: int = 1
) -> Iterator[tuple[int, bytes]]:
    """Yield a run's records: midnight of their UTC day [ns since 1970], and whole records.

    Every record's start time is exact to the microsecond; samples follow at the nominal rate
    within `STRAY` of an interval.

    Parameters
    ----------
    run : Run
    column : int
        Of the run's values.
    channel, place : ChannelCode, Place
        What is written in front.
    sequence : int, optional
        Number of the first record.
    """
    for piece in exact_pieces(run):
        times, values = run.gps_ns[piece], run.values[piece, column]
        for part in cut_at_days(times):
            start = UtcMoment.of_gps_ns(int(times[part][0]))
            data = _packed(counts_of(values[part], channel), start, channel, place, sequence)
            sequence = (sequence - 1 + len(data) // RECORD_BYTES) % SEQUENCES + 1
            yield start.day_ns, data


def _packed(
    counts: NDArray[np.int32], start: UtcMoment, channel: ChannelCode, place: Place, sequence: int
) -> bytes:
    obspy: Any = obspy_modules()
    trace = obspy.Trace(counts)
    trace.stats.update(
        {
            "network": place.network,
            "station": place.station,
            "location": channel.location,
            "channel": channel.code,
            "sampling_rate": channel.rate_hz,
            "starttime": obspy.UTCDateTime(ns=start.unix_ns),
        }
    )
    out = BytesIO()
    trace.write(
        out,
        format="MSEED",
        reclen=RECORD_BYTES,
        encoding="STEIM2",
        byteorder=">",
        sequence_number=sequence,
    )
    return _leap_marked(out.getvalue(), start) if start.leap else out.getvalue()


def _leap_marked(data: bytes, start: UtcMoment) -> bytes:
    """Give records that begin within a leap second the second 60 of the day before."""
    out = bytearray(data)
    day = np.datetime64(start.day_ns // DAY_NS, "D")
    year = int(day.astype("datetime64[Y]").astype(int)) + 1970
    day_of_year = int((day - day.astype("datetime64[Y]")).astype(int)) + 1
    for at in range(0, len(out), RECORD_BYTES):
        struct.pack_into(">HHBBB", out, at + _TIME_AT, year, day_of_year, 23, 59, 60)
        out[at + _FLAGS_AT] |= _LEAP_FLAG
    return bytes(out)


def record_span(record: bytes) -> tuple[int, int]:
    """Return UTC of a record's first and last sample [ns since 1970].

    A leap second has the number of the second that follows.
    """
    year, day, hour, minute, second, fraction, count, factor, multiplier = struct.unpack_from(
        ">HHBBBxHHhh", record, _TIME_AT
    )
    midnight = np.datetime64(f"{year}-01-01", "ns").astype(np.int64) + (day - 1) * DAY_NS
    seconds = (hour * 60 + minute) * 60 + second
    start = int(midnight) + seconds * NS_PER_S + fraction * 100_000 + _microseconds(record) * 1000
    rate = (factor if factor > 0 else -1.0 / factor) * (
        multiplier if multiplier > 0 else -1.0 / multiplier
    )
    return start, start + round((count - 1) / rate * NS_PER_S)


def _microseconds(record: bytes) -> int:
    """Return what blockette 1001 adds to the start time [us]; 0 without one."""
    (at,) = struct.unpack_from(">H", record, _BLOCKETTES_AT)
    while at:
        kind, following = struct.unpack_from(">HH", record, at)
        if kind == 1001:
            return int(struct.unpack_from(">b", record, at + 5)[0])
        at = following
    return 0


def sample_times(start_ns: int, count: int, rate_hz: float) -> IntArray:
    """Return times that are uniform to the nanosecond: n from a start [ns] at a rate."""
    return start_ns + np.rint(np.arange(count) * (1e9 / rate_hz)).astype(np.int64)
