"""GPS time of samples, as positions tell it."""

from __future__ import annotations

import numpy as np

from deepseis_core.gps_time import GpsTime
from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import IntArray, Pvt
from deepseis_ins.aiding import DopplerPredictor

JUMP_NS = 500_000
"""GPS time of samples off by more: the receiver's clock was set, by whole milliseconds."""


class Timebase:
    """Ties samples to GPS time with the first position, and anew when the clock is set.

    Parameters
    ----------
    source : str
        Name of who predicts.
    sample_rate_hz : float

    Attributes
    ----------
    predictor : DopplerPredictor or None
        None before the first position.
    jumps : int
        How often the clock was set.
    """

    def __init__(self, source: str, sample_rate_hz: float) -> None:
        self.source, self.sample_rate_hz = source, sample_rate_hz
        self.predictor: DopplerPredictor | None = None
        self.jumps = 0
        self._clock = SampleClock(0, sample_rate_hz)

    def take(self, pvt: Pvt) -> None:
        """Take the receiver's time from a position."""
        offset = self._clock.offset_ns(pvt.sample_index)
        start = GpsTime(pvt.week, pvt.tow_ns).add_ns(-offset)
        if self.predictor is not None and abs(start.diff_ns(self.predictor.start)) <= JUMP_NS:
            return
        self.jumps += self.predictor is not None
        self.predictor = DopplerPredictor(self.source, start, self.sample_rate_hz)

    def times(self, samples: IntArray) -> tuple[int, IntArray]:
        """Return the week of the first sample and nanoseconds of its week of all."""
        if self.predictor is None or not len(samples):
            return 0, np.zeros(0, np.int64)
        first = self.predictor.gps_time(int(samples[0]))
        offsets = np.array([self._clock.offset_ns(k) for k in samples.tolist()], np.int64)
        return first.week, first.tow_ns + offsets - offsets[0]
