"""Rings of samples and of their envelopes: an hour of ground motion in bounded memory."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import Final

import numpy as np

from deepseis_core.types import Float32Array, FloatArray, IntArray

BACKWARDS_S: Final = 5.0
"""Samples so far behind the newest belong to a run that began anew [s]; nearer, they are late."""
ENVELOPE_S: Final = 0.5
"""Samples wait at most so long for their envelopes, if nobody asks [s]."""


@dataclass(frozen=True)
class Level:
    """How finely a trace is kept: cells of ``step`` [s], 0 for every sample, ``length`` [s]."""

    step: float
    length: float


LEVELS: Final = (Level(0.0, 60.0), Level(0.1, 600.0), Level(1.0, 3600.0))
"""A minute of samples, ten minutes and an hour of least and greatest values."""


class Ring:
    """The newest rows, counted since the beginning.

    Rows lie in a buffer of twice the room, so that the newest are always in one piece.

    Parameters
    ----------
    room : int
        Rows kept.
    columns : int
        Values in a row.

    Attributes
    ----------
    count : int
        Rows ever pushed.

    Examples
    --------
    >>> ring = Ring(room=2, columns=1)
    >>> ring.push(np.array([0.0, 1.0, 2.0]), np.array([[5.0], [6.0], [7.0]]))
    >>> ring.since(0)[0], ring.count
    (array([1., 2.]), 3)
    """

    def __init__(self, room: int, columns: int) -> None:
        self.room, self.count = room, 0
        self._times: FloatArray = np.zeros(2 * room)
        self._rows: Float32Array = np.zeros((2 * room, columns), np.float32)
        self._end = 0

    def push(self, times: FloatArray, rows: Float32Array) -> None:
        """Add rows."""
        self.count += len(times)
        times, rows = times[-self.room :], rows[-self.room :]
        if self._end + len(times) > len(self._times):
            kept = slice(max(0, self._end - self.room), self._end)
            held = kept.stop - kept.start
            self._times[:held] = self._times[kept]
            self._rows[:held] = self._rows[kept]
            self._end = held
        new = slice(self._end, self._end + len(times))
        self._times[new], self._rows[new] = times, rows
        self._end = new.stop

    def since(self, count: int, most: int | None = None) -> tuple[FloatArray, Float32Array]:
        """Return the rows after the first ``count``, the newest ``most`` of them, as views."""
        wanted = min(self.count - count, self.room, self._end)
        wanted = wanted if most is None else min(wanted, most)
        rows = slice(self._end - max(0, wanted), self._end)
        return self._times[rows], self._rows[rows]


class _Envelope:
    """Least and greatest values in cells of time; the newest cell is still open."""

    def __init__(self, level: Level, columns: int) -> None:
        self.step = level.step
        self.ring = Ring(math.ceil(level.length / level.step), 2 * columns)
        self._cell = -1
        self._low: Float32Array = np.zeros(columns, np.float32)
        self._high: Float32Array = np.zeros(columns, np.float32)

    def push(self, times: FloatArray, values: Float32Array) -> None:
        cells = np.floor(times / self.step + 1e-6).astype(np.int64)
        starts = np.flatnonzero(np.diff(cells, prepend=cells[0] - 1))
        low = np.fmin.reduceat(values, starts)
        high = np.fmax.reduceat(values, starts)
        cells = cells[starts]
        if cells[0] == self._cell:
            low[0], high[0] = np.fmin(low[0], self._low), np.fmax(high[0], self._high)
        elif self._cell >= 0:
            self._close(np.array([self._cell]), self._low[None], self._high[None])
        self._close(cells[:-1], low[:-1], high[:-1])
        self._cell, self._low, self._high = int(cells[-1]), low[-1].copy(), high[-1].copy()

    def _close(self, cells: IntArray, low: Float32Array, high: Float32Array) -> None:
        if len(cells):
            middles = np.asarray((cells + 0.5) * self.step, np.float64)
            self.ring.push(middles, np.hstack([low, high]))


class Trace:
    """Some channels over time, at every level of `LEVELS`.

    Parameters
    ----------
    name : str
    channels : tuple of str
        Their names.
    levels : tuple of Level, optional
        The first keeps samples, the others envelopes.

    Attributes
    ----------
    generation : int
        Raised when all was forgotten: what comes does not follow on what was.
    newest : float
        Time of the last sample [s]; -inf before the first.

    Examples
    --------
    >>> trace = Trace("z", ("z",), (Level(0.0, 10.0), Level(0.1, 10.0)))
    >>> trace.push(np.array([0.0, 0.05, 0.1]), np.array([[1.0], [-3.0], [2.0]]), 0.05)
    >>> trace.rings[1].since(0)[1]
    array([[-3.,  1.]], dtype=float32)
    """

    def __init__(
        self, name: str, channels: tuple[str, ...], levels: tuple[Level, ...] = LEVELS
    ) -> None:
        self.name, self.channels, self.levels = name, channels, levels
        self.generation = 0
        self.interval = 0.0
        self.newest = -math.inf
        self._samples: Ring | None = None
        self._envelopes: list[_Envelope] = []
        self._enveloped = 0

    def push(self, times: FloatArray, values: FloatArray, interval: float) -> None:
        """Add samples, in order; late ones and repeated ones are left out.

        Parameters
        ----------
        times : ndarray, shape (n,)
            [s]
        values : ndarray, shape (n, channels)
            NaN: not known.
        interval : float
            Between samples [s]; for the room that is made.
        """
        if not len(times):
            return
        if times[-1] < self.newest - BACKWARDS_S or interval != self.interval:
            self._begin(interval)
        new = times > self.newest + 0.25 * interval
        times, values = times[new], values[new]
        if not len(times):
            return
        rows = values.astype(np.float32)
        self.newest = float(times[-1])
        samples = self._samples
        assert samples is not None
        for first in range(0, len(times), samples.room):
            samples.push(times[first : first + samples.room], rows[first : first + samples.room])
            if (samples.count - self._enveloped) * interval > ENVELOPE_S:
                self._envelop(samples)

    @property
    def rings(self) -> list[Ring]:
        """One for each level, up to the newest sample; none before the first."""
        if self._samples is None:
            return []
        self._envelop(self._samples)
        return [self._samples, *(envelope.ring for envelope in self._envelopes)]

    def _envelop(self, samples: Ring) -> None:
        """Work out the envelopes of what has come: many samples at once cost no more than one."""
        times, rows = samples.since(self._enveloped)
        self._enveloped = samples.count
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # a cell of nothing but NaN
            for envelope in self._envelopes if len(times) else ():
                envelope.push(times, rows)

    def _begin(self, interval: float) -> None:
        """Forget everything, and make room for samples that come so often."""
        self.generation += 1
        self.interval, self.newest = interval, -math.inf
        columns, first = len(self.channels), self.levels[0]
        self._envelopes = [_Envelope(level, columns) for level in self.levels[1:]]
        self._samples = Ring(math.ceil(first.length / interval), columns)
        self._enveloped = 0
