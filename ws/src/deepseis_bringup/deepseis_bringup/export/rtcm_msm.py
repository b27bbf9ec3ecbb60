"""RTCM 3 message 1077: GPS observations at full resolution (MSM7) of L1 C/A.

References
----------
RTCM 10403.3, 3.5.16: tables 3.5-78 (header), 3.5-82 (satellite data), 3.5-90 (signal data),
3.5-91 (signals), 3.5-75 (lock time, DF407).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from deepseis_bringup.export.rtcm_station import gps_number
from deepseis_core.constants import L1_WAVELENGTH, SPEED_OF_LIGHT
from deepseis_core.errors import InputError
from deepseis_core.rtcm_frame import Bits, frame
from deepseis_core.types import Lli, Observations

MS: Final = SPEED_OF_LIGHT * 1e-3
"""Metres of a light millisecond."""

SIGNAL_1C: Final = 2
_NO_ROUGH_RATE, _NO_CODE, _NO_PHASE, _NO_RATE = -(2**13), -(2**19), -(2**23), -(2**14)


@dataclass(frozen=True)
class _Cell:
    """One satellite's integers; rough range in 1/1024 ms."""

    number: int
    rough: int
    rough_rate: int
    code: int
    phase: int
    lock: int
    half_cycle: int
    cn0: int
    rate: int


def lock_indicator(lock_time_s: float) -> int:
    """Return DF407 of a time of lock: the greatest whose minimum it reaches.

    Examples
    --------
    >>> [lock_indicator(ms / 1000) for ms in (0, 63, 64, 65, 66, 127, 128, 10**8)]
    [0, 63, 64, 64, 65, 95, 96, 704]
    """
    ms = int(lock_time_s * 1000 + 1e-6)
    if ms < 64:
        return max(ms, 0)
    octave = min(ms.bit_length() - 6, 20)  # 1 for 64 to 127 ms
    return min(32 * (octave + 1) + (ms >> octave) - 32, 704)


def msm7(station_id: int, observations: Observations, *, more_follows: bool = False) -> bytes:
    """Return message 1077 of an epoch.

    Satellites without a pseudorange, and values that a field cannot hold, are left out or marked
    as not available, never wrapped round: a phase must lie within 1171 m of the pseudorange, as
    those of `deepseis_pvt` do from the start of an arc on.

    Parameters
    ----------
    station_id : int
        0 to 4095.
    observations : Observations
        Receiver time a whole number of milliseconds: the message has no finer one.
    more_follows : bool, optional
        Whether another message of the same epoch follows.

    Raises
    ------
    InputError
        The epoch is between milliseconds.
    """
    o = observations
    tow_ms, rest = divmod(o.tow_ns, 1_000_000)
    if rest:
        raise InputError("RTCM 1077", f"cannot say an epoch at {o.tow_ns} ns of week")
    cells = sorted(filter(None, map(_cell, *_columns(o))), key=lambda cell: cell.number)
    bits = Bits().unsigned(1077, 12).unsigned(station_id, 12).unsigned(tow_ms, 30)
    bits.unsigned(more_follows, 1)
    bits.unsigned(0, 3 + 7)  # issue of data station; reserved
    bits.unsigned(0, 2 + 2)  # clock neither steered nor external
    bits.unsigned(0, 1 + 3)  # not smoothed
    bits.unsigned(sum(1 << (64 - cell.number) for cell in cells), 64)
    bits.unsigned(1 << (32 - SIGNAL_1C), 32)
    bits.unsigned((1 << len(cells)) - 1, len(cells))
    _put_cells(bits, cells)
    return frame(bits)


def _columns(o: Observations) -> tuple[list[object], ...]:
    return (
        list(o.satellites),
        o.pseudorange.tolist(),
        o.carrier_phase_cycles.tolist(),
        o.carrier_doppler_hz.tolist(),
        o.cn0_dbhz.tolist(),
        o.lli.tolist(),
        o.lock_time.tolist(),
    )


def _put_cells(bits: Bits, cells: list[_Cell]) -> None:
    """Append satellite data, then signal data, each field for all cells."""
    for cell in cells:
        bits.unsigned(cell.rough >> 10, 8)
    for _ in cells:
        bits.unsigned(0, 4)  # extended information: none
    for cell in cells:
        bits.unsigned(cell.rough & 1023, 10)
    for cell in cells:
        bits.signed(cell.rough_rate, 14)
    for cell in cells:
        bits.signed(cell.code, 20)
    for cell in cells:
        bits.signed(cell.phase, 24)
    for cell in cells:
        bits.unsigned(cell.lock, 10)
    for cell in cells:
        bits.unsigned(cell.half_cycle, 1)
    for cell in cells:
        bits.unsigned(cell.cn0, 10)
    for cell in cells:
        bits.signed(cell.rate, 15)


def _cell(
    satellite: str,
    pseudorange: float,
    phase_cycles: float,
    doppler_hz: float,
    cn0_dbhz: float,
    lli: int,
    lock_time: float,
) -> _Cell | None:
    """Return a satellite's integers; None where its range cannot be said."""
    code_ms = pseudorange / MS
    if not math.isfinite(code_ms) or not 0 < code_ms < 255 - 1 / 1024:
        return None
    rough = round(code_ms * 1024)
    # Differences in metres first: nothing is lost to the size of the range.
    rough_m = rough / 1024 * MS
    rate = -doppler_hz * L1_WAVELENGTH
    rough_rate = round(rate) if math.isfinite(rate) else _NO_ROUGH_RATE
    if abs(rough_rate) > 8191:
        rough_rate = _NO_ROUGH_RATE
    no_rate = rough_rate == _NO_ROUGH_RATE
    return _Cell(
        number=gps_number(satellite),
        rough=rough,
        rough_rate=rough_rate,
        code=_scaled((pseudorange - rough_m) / MS, 2.0**29, _NO_CODE),
        phase=_scaled((phase_cycles * L1_WAVELENGTH - rough_m) / MS, 2.0**31, _NO_PHASE),
        lock=lock_indicator(lock_time),
        half_cycle=int(bool(lli & Lli.HALF_CYCLE)),
        cn0=min(max(round(cn0_dbhz * 16), 0), 1023) if math.isfinite(cn0_dbhz) else 0,
        rate=_NO_RATE if no_rate else _scaled(rate - rough_rate, 1e4, _NO_RATE),
    )


def _scaled(value: float, per_unit: float, absent: int) -> int:
    """Return a value as an integer; ``absent``, the most negative, where it does not fit."""
    if not math.isfinite(value):
        return absent
    number = round(value * per_unit)
    return number if abs(number) < -absent else absent
