"""Records of any length in bounded memory: least and greatest values in bins of time."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from deepseis_core.types import FloatArray

BINS: Final = 1500
"""Pieces of a record along time: of each the least and the greatest value is kept."""
BATCH: Final = 500
"""Single values wait until there are so many."""


class Envelope:
    """Least and greatest values of a record in bins of time, and when they were reached.

    Parameters
    ----------
    start, end : float
        Of the record [s]; what lies outside does not count.
    columns : int
        Values at a time. What is not finite is a hole.
    """

    def __init__(self, start: float, end: float, columns: int) -> None:
        self.start, self.end = start, end
        self.low = np.full((BINS, columns), np.inf)
        self.high = np.full((BINS, columns), -np.inf)
        self._low_t = np.zeros((BINS, columns))
        self._high_t = np.zeros((BINS, columns))
        self._waiting: list[tuple[float, FloatArray]] = []

    def push(self, t: float, row: FloatArray) -> None:
        """Take in one time's values, shape (columns,), later than all before."""
        self._waiting.append((t, row))
        if len(self._waiting) >= BATCH:
            self._take_waiting()

    def add(self, t: FloatArray, values: NDArray[Any]) -> None:
        """Take in values, shape (n, columns), at ascending times [s]."""
        inside = (t >= self.start) & (t <= self.end)
        t, values = t[inside], values[inside]
        at = ((t - self.start) / (self.end - self.start) * BINS).astype(np.int64)
        at = np.minimum(at, BINS - 1)
        edges = [0, *(np.flatnonzero(np.diff(at)) + 1), t.size]
        for a, b in pairwise(edges):
            if a < b:
                self._take(int(at[a]), t[a:b], values[a:b])

    def _take_waiting(self) -> None:
        if self._waiting:
            t, rows = zip(*self._waiting, strict=True)
            self._waiting.clear()
            self.add(np.array(t), np.array(rows))

    def _take(self, number: int, t: FloatArray, values: NDArray[Any]) -> None:
        holes = ~np.isfinite(values)
        for best, when, sign in ((self.low, self._low_t, 1.0), (self.high, self._high_t, -1.0)):
            signed = np.where(holes, np.inf, sign * values)
            row = signed.argmin(axis=0)
            least = signed.min(axis=0)
            better = least < sign * best[number]
            best[number][better] = sign * least[better]
            when[number][better] = t[row][better]

    def record(self, column: int) -> tuple[FloatArray, FloatArray]:
        """Return times and values of all extremes in the order in which they came."""
        self._take_waiting()
        kept = np.isfinite(self.low[:, column])
        t = np.stack([self._low_t[kept, column], self._high_t[kept, column]], axis=1)
        y = np.stack([self.low[kept, column], self.high[kept, column]], axis=1)
        order = np.argsort(t, axis=1, kind="stable")
        t = np.take_along_axis(t, order, axis=1).ravel()
        y = np.take_along_axis(y, order, axis=1).ravel()
        new = np.append(True, np.diff(t) > 0.0)[: t.size]
        return t[new], y[new]

    def peak(self, column: int) -> float:
        """Return the greatest absolute value, NaN if there is none."""
        self._take_waiting()
        values = np.concatenate([self.low[:, column], self.high[:, column]])
        values = values[np.isfinite(values)]
        return float(np.abs(values).max()) if values.size else float("nan")


def window_of(span: tuple[float, float], duration: float) -> tuple[float, float]:
    """Return the part of a run that shows its motion: long rests before and after are cut.

    Examples
    --------
    >>> window_of((900.0, 1020.0), 1020.0)
    (888.0, 1020.0)
    >>> window_of((0.0, 0.0), 60.0)
    (0.0, 60.0)
    """
    begin, end = max(span[0], 0.0), min(span[1], duration)
    if end <= begin:
        return 0.0, duration
    margin = max(0.1 * (end - begin), 2.0)
    return max(begin - margin, 0.0), min(end + margin, duration)
