"""What a base station says, in order of its validity: where its antenna is, and its epochs."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from deepseis_core.gps_time import GpsTime
from deepseis_core.types import Float32Array, FloatArray, Lli, Observations, Station

LOOK_AHEAD: Final = 5
"""Events of a bag that may stand before one that comes first."""


@dataclass(frozen=True)
class BaseReference:
    """The base's antenna, for its epochs from a UTC on [m ECEF, ns since 1970]."""

    utc_ns: int
    position_ecef: FloatArray
    name: str = ""

    def station(self) -> Station:
        """Return the antenna as a station whose monument it is."""
        return Station(
            name=self.name,
            network="",
            monument_ecef=np.array(self.position_ecef),
            antenna_lever_arm=np.zeros(3),
            imu_to_antenna=np.zeros(3),
            imu_orientation_xyzw=np.array([0.0, 0.0, 0.0, 1.0]),
        )


BaseEvent = BaseReference | Observations


def utc_of(event: BaseEvent) -> int:
    """Return the UTC from which an event holds [ns since 1970]."""
    if isinstance(event, BaseReference):
        return event.utc_ns
    return GpsTime(event.week, event.tow_ns).to_utc_ns()


def in_order(events: Iterable[BaseEvent]) -> Iterator[BaseEvent]:
    """Put events in order of their times, a reference before its epoch.

    Epochs keep their order: one that goes back in time is the reader's to refuse.
    """
    waiting: list[tuple[int, bool, int, BaseEvent]] = []
    newest = 0
    for number, event in enumerate(events):
        is_epoch = isinstance(event, Observations)
        newest = max(newest, utc_of(event)) if is_epoch else newest
        heapq.heappush(waiting, (newest if is_epoch else utc_of(event), is_epoch, number, event))
        if len(waiting) > LOOK_AHEAD:
            yield heapq.heappop(waiting)[3]
    while waiting:
        yield heapq.heappop(waiting)[3]


@dataclass(frozen=True)
class Row:
    """One satellite of an epoch, GPS L1 C/A; units as in `deepseis_core.types.Observations`."""

    satellite: str
    pseudorange: float
    carrier_phase_cycles: float
    carrier_doppler_hz: float
    cn0_dbhz: float
    lli: int


@dataclass
class Arcs:
    """Makes epochs of rows, and remembers how long each phase has gone on.

    Attributes
    ----------
    interval : float
        Time between the last epochs [s]; 0 before the second.
    """

    interval: float = 0.0
    _begun: dict[str, GpsTime] = field(default_factory=dict)
    _last: GpsTime | None = None

    def epoch(self, time: GpsTime, sample_index: int, rows: Iterable[Row]) -> Observations:
        """Return an epoch; the satellites in order of their names."""
        rows = sorted(rows, key=lambda row: row.satellite)
        if self._last is not None and time.diff_ns(self._last) > 0:
            self.interval = 1e-9 * time.diff_ns(self._last)
        self._last = time
        begun = {
            row.satellite: time if row.lli & Lli.SLIP else self._begun.get(row.satellite, time)
            for row in rows
        }
        self._begun = begun
        lock = [1e-9 * time.diff_ns(begun[row.satellite]) for row in rows]
        unknown: Float32Array = np.full(len(rows), np.nan, np.float32)
        return Observations(
            sample_index=sample_index,
            sample_fraction=0.0,
            week=time.week,
            tow_ns=time.tow_ns,
            valid_through=sample_index,
            interval=self.interval,
            satellites=tuple(row.satellite for row in rows),
            pseudorange=np.array([row.pseudorange for row in rows]),
            carrier_phase_cycles=np.array([row.carrier_phase_cycles for row in rows]),
            carrier_doppler_hz=np.array([row.carrier_doppler_hz for row in rows]),
            cn0_dbhz=np.array([row.cn0_dbhz for row in rows], np.float32),
            lli=np.array([row.lli for row in rows], np.uint8),
            lock_time=np.array(lock, np.float32),
            carrier_error_cycles=unknown,
            carrier_error_sd_cycles=unknown,
            code_error_chips=unknown,
            code_error_sd_chips=unknown,
            flags=np.zeros(len(rows), np.uint16),
        )
