"""Samples with times of their own, cut into runs: gaps stay gaps, start times stay exact."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from deepseis_core.constants import NS_PER_S
from deepseis_core.types import FloatArray, IntArray

STRAY = 1e-3
"""A run is cut where a sample's time strays from start + k / rate by this part of an interval."""


@dataclass(frozen=True)
class Run:
    """Samples without a gap: times since the GPS epoch (n,) [ns], values (n, m).

    ``continues``: no sample is missing between the run before and this one.
    """

    gps_ns: IntArray
    values: FloatArray
    rate_hz: float
    continues: bool = False

    @property
    def interval_ns(self) -> float:
        """Nominal interval [ns]."""
        return NS_PER_S / self.rate_hz


@dataclass
class GapCount:
    """What was missing: gaps, samples in them; samples that came again or too early."""

    gaps: int = 0
    missing: int = 0
    repeated: int = 0


class RunCutter:
    """Cuts a stream of samples at its gaps, any chunking.

    A sample is missing where a step is longer than one and a half intervals, or where one of its
    values is not finite. Samples that do not come after the last one are dropped and counted.

    Parameters
    ----------
    rate_hz : float
        Nominal rate [Hz].
    """

    def __init__(self, rate_hz: float) -> None:
        self.rate_hz = rate_hz
        self.count = GapCount()
        self._last: int | None = None

    def push(self, gps_ns: IntArray, values: FloatArray) -> list[Run]:
        """Return the runs of the next samples, (n,) and (n, m)."""
        keep = np.isfinite(values).all(axis=1)
        times = gps_ns[keep]
        last = -(2**62) if self._last is None else self._last
        newest = np.maximum.accumulate(np.concatenate([[last], times]))
        later = times > newest[:-1]
        self.count.repeated += int(len(times) - later.sum())
        times, values = times[later], values[keep][later]
        if not len(times):
            return []
        return self._cut(times, values)

    def _cut(self, times: IntArray, values: FloatArray) -> list[Run]:
        interval = NS_PER_S / self.rate_hz
        first = times[0] if self._last is None else self._last
        steps = np.diff(times, prepend=first) / interval
        gap = steps > 1.5
        self.count.gaps += int(gap.sum())
        self.count.missing += int((np.rint(steps[gap]) - 1).sum())
        starts = np.flatnonzero(gap)
        whole = self._last is not None and not gap[0]
        self._last = int(times[-1])
        edges = sorted({0, *starts.tolist(), len(times)})
        return [
            Run(times[a:b], values[a:b], self.rate_hz, whole and a == 0)
            for a, b in pairwise(edges)
        ]


def exact_pieces(run: Run) -> Iterator[slice]:
    """Cut a run so that within each piece every time is start + k / rate.

    They agree to `STRAY` of an interval; a clock that drifts against the nominal rate gives new
    pieces now and then, one that is set gives one.
    """
    limit = STRAY * run.interval_ns
    first, n = 0, len(run.gps_ns)
    while first < n:
        since = (run.gps_ns[first:] - run.gps_ns[first]).astype(np.float64)
        strays = np.abs(since - np.arange(n - first) * run.interval_ns) > limit
        end = first + int(np.argmax(strays)) if strays.any() else n
        yield slice(first, end)
        first = end
