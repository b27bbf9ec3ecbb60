"""Integrations of all satellites that still wait for their grid epoch, and how far they reach.

The store keeps one row per integration in arrays that the observables' kernels read. Rows leave
it as the work passes them, so its size is the backlog of the slowest satellite: of a second of
2 ms integrations 4 MB for 32 satellites, which are given back when it has been worked off.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

import numpy as np

from deepseis_core.types import FloatArray, IntArray, TrackingEpochs, TrackingFlag

START, COUNT, TRANSMIT_MS, FLAGS, BREAK = range(5)
"""Columns of ``TrackStore.ints``; ``BREAK``: 1 where the carrier phase does not
continue the row before, plus 2 where polarity turned."""

FLOAT_FIELDS = (
    "code_phase_chips",
    "code_rate_cps",
    "carrier_phase_cycles",
    "carrier_doppler_hz",
    "carrier_doppler_rate",
    "carrier_doppler_accel",
    "carrier_error_cycles",
    "code_error_chips",
    "cn0_dbhz",
)
"""Columns of ``TrackStore.floats``: fields of ``TrackingEpochs``."""

_SLIP, _PHASE_LOCK = int(TrackingFlag.SLIP), int(TrackingFlag.PHASE_LOCK)
_HALF_CYCLE = int(TrackingFlag.HALF_CYCLE)

LEAST_ROWS, MAX_ROWS = 64, 65536
"""Rows of one satellite; the most are 65 s of 1 ms or 22 minutes of 20 ms integrations [-]."""
SPARE = 8
"""Arrays that have room for so many times what is needed are given back [-]."""


class TrackStore:
    """Rows of every satellite from the first one still needed, in order of the sample index.

    Parameters
    ----------
    satellites : iterable of str
        All satellites of the graph, tracked or idle.

    Attributes
    ----------
    ints, floats : ndarray, shape (n_satellites, capacity, n_columns)
        Rows ``head[i]`` to ``tail[i]`` of satellite ``i`` are the ones waiting.
    published : ndarray of int64, shape (n_satellites,)
        ``valid_through`` of the last message [samples].
    counts : dict
        ``late``, ``disordered`` and ``unknown_satellite`` rows or messages met.
    """

    def __init__(self, satellites: Iterable[str]) -> None:
        self.satellites = tuple(satellites)
        self.number = {name: i for i, name in enumerate(self.satellites)}
        n = len(self.satellites)
        self.ints, self.floats = _rows(n, LEAST_ROWS)
        self.head: IntArray = np.zeros(n, np.int64)
        self.tail: IntArray = np.zeros(n, np.int64)
        self.published: IntArray = np.full(n, -1, np.int64)
        self.end: IntArray = np.full(n, -1, np.int64)
        self.counts = {"late": 0, "disordered": 0, "unknown_satellite": 0}
        self._promised: list[deque[tuple[int, int]]] = [deque() for _ in range(n)]
        self._ephemerides: IntArray = np.zeros(n, np.int64)
        self._announced: IntArray = np.zeros(n, np.int64)

    def push(self, epochs: TrackingEpochs, worked_through: int = -1) -> None:
        """Take one message; rows wholly at or before ``worked_through`` only count as late."""
        i = self.number.get(epochs.satellite)
        if i is None:
            self.counts["unknown_satellite"] += 1
            return
        if epochs.valid_through < self.published[i]:
            self.counts["disordered"] += 1
            return
        self.published[i] = epochs.valid_through
        self._announced[i] = epochs.ephemeris_count
        if epochs.ephemeris_count > self._ephemerides[i]:
            self._promised[i].append((epochs.valid_through, epochs.ephemeris_count))
        n = len(epochs.sample_index)
        if n:
            if self.tail[i] + n > self.ints.shape[1]:
                self._make_room(i, n)
            self._append(i, n, epochs, worked_through)

    def received_ephemeris(self, satellite: str) -> None:
        """Count an ephemeris that the satellite's channel has published."""
        i = self.number.get(satellite)
        if i is None:
            return
        self._ephemerides[i] += 1
        promised = self._promised[i]
        while promised and promised[0][1] <= self._ephemerides[i]:
            promised.popleft()

    def ephemerides_through(self) -> int:
        """Return the sample up to which every ephemeris that was announced has arrived."""
        return min((p[0][0] for p in self._promised if p), default=np.iinfo(np.int64).max)

    def give_up_ephemerides(self, sample_index: int) -> None:
        """Wait no longer for those announced before a sample: their tracker may have died."""
        for promised in self._promised:
            while promised and promised[0][0] < sample_index:
                promised.popleft()

    def announced(self, satellite: str) -> int:
        """Return how many ephemerides of a satellite its messages have announced so far."""
        i = self.number.get(satellite)
        return -1 if i is None else int(self._announced[i])

    def laggard(self) -> str:
        """Return the satellite whose messages reach least far."""
        return self.satellites[int(np.argmin(self.published))]

    def _append(self, i: int, n: int, epochs: TrackingEpochs, worked_through: int) -> None:
        rows = slice(int(self.tail[i]), int(self.tail[i]) + n)
        ints, floats = self.ints[i, rows], self.floats[i, rows]
        start, flags = ints[:, START], ints[:, FLAGS]
        start[:] = epochs.sample_index
        ints[:, COUNT] = epochs.sample_count
        ints[:, TRANSMIT_MS] = epochs.transmit_ms
        flags[:] = epochs.flags
        for column, name in enumerate(FLOAT_FIELDS):
            floats[:, column] = getattr(epochs, name)
        end = start + ints[:, COUNT]
        before = np.empty(n, np.int64)
        before[0] = self.end[i]
        before[1:] = end[:-1]
        lost = (flags & _SLIP != 0) | (flags & _PHASE_LOCK == 0) | (start != before)
        ints[:, BREAK] = lost + 2 * (flags & _HALF_CYCLE != 0)
        self.counts["disordered"] += int(np.count_nonzero(start < before))
        if end[0] <= worked_through:
            self.counts["late"] += int(np.count_nonzero(end <= worked_through))
        self.end[i] = end[-1]
        self.tail[i] = rows.stop

    def _make_room(self, i: int, extra: int) -> None:
        """Move a satellite's rows to the front, or all into arrays as large as the backlog."""
        waiting = self.tail - self.head
        waiting[i] += extra
        capacity = LEAST_ROWS
        while capacity < 2 * int(waiting.max()):
            capacity *= 2
        if capacity > MAX_ROWS:
            ahead, behind = self.satellites[int(np.argmax(waiting))], self.laggard()
            raise BufferError(
                f"{ahead} is {waiting.max()} integrations ahead of {behind}: "
                f"is the tracker of {behind} running?"
            )
        present = self.ints.shape[1]
        if capacity > present or SPARE * capacity <= present:
            self._resize(capacity)
        else:
            self._to_front(i, self.ints, self.floats)

    def _resize(self, capacity: int) -> None:
        ints, floats = self.ints, self.floats
        n = len(self.satellites)
        self.ints, self.floats = _rows(n, capacity)
        for i in range(n):
            self._to_front(i, ints, floats)

    def _to_front(self, i: int, ints: IntArray, floats: FloatArray) -> None:
        waiting = int(self.tail[i] - self.head[i])
        rows = slice(int(self.head[i]), int(self.tail[i]))
        self.ints[i, :waiting] = ints[i, rows].copy()
        self.floats[i, :waiting] = floats[i, rows].copy()
        self.head[i], self.tail[i] = 0, waiting


def _rows(satellites: int, capacity: int) -> tuple[IntArray, FloatArray]:
    return (
        np.zeros((satellites, capacity, 5), np.int64),
        np.zeros((satellites, capacity, len(FLOAT_FIELDS))),
    )
