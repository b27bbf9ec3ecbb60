"""IMU samples gathered by their stamps, with the rate that the stamps show."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from deepseis_core.errors import InputError
from deepseis_core.types import FloatArray, ImuSample, IntArray

BATCH = 16_384
LOOKED_AT = 1000

Batch = tuple[float, IntArray, FloatArray]
"""Rate [Hz], stamps [ns UTC] (n,), accelerations and rotation rates (n, 6)."""


class ImuGathering:
    """Gathers samples into batches; the first waits until the rate is known.

    Parameters
    ----------
    batch : int, optional
        Samples of a batch.
    looked_at : int, optional
        Samples whose stamps tell the rate.
    """

    def __init__(self, batch: int = BATCH, looked_at: int = LOOKED_AT) -> None:
        self.batch, self.looked_at = batch, looked_at
        self.count = 0
        self.rate_hz = 0.0
        self._stamps: list[int] = []
        self._values: list[FloatArray] = []

    def push(self, sample: ImuSample, utc_ns: int) -> Iterator[Batch]:
        """Take a sample with its stamp; yields batches that are full."""
        self.count += 1
        self._stamps.append(utc_ns)
        self._values.append(np.r_[sample.linear_acceleration, sample.angular_velocity])
        if not self.rate_hz and len(self._stamps) >= self.looked_at:
            self.rate_hz = nominal_rate(self._stamps)
        if self.rate_hz and len(self._stamps) >= self.batch:
            yield from self._give()

    def finish(self) -> Iterator[Batch]:
        """Yield the rest."""
        if len(self._stamps) < 2 and not self.rate_hz:
            return
        self.rate_hz = self.rate_hz or nominal_rate(self._stamps)
        yield from self._give()

    def _give(self) -> Iterator[Batch]:
        if self._stamps:
            yield self.rate_hz, np.array(self._stamps, np.int64), np.stack(self._values)
        self._stamps, self._values = [], []


def nominal_rate(stamps_ns: list[int]) -> float:
    """Return the rate that stamps show: the whole number that it is near, or as it is [Hz].

    The median step is not disturbed by gaps. Within 0.1 % of a whole number the rest is taken
    for the clock's drift, which the samples' own times keep.

    Examples
    --------
    >>> nominal_rate([0, 5_000_100, 10_000_200, 30_000_600]), nominal_rate([0, 8_888_889])
    (200.0, 112.499999)
    """
    step = float(np.median(np.diff(np.asarray(stamps_ns, np.int64))))
    if step <= 0:
        raise InputError("imu/data_raw", "has stamps that do not rise")
    rate = 1e9 / step
    whole = round(rate)
    return float(whole) if whole and abs(rate - whole) < 1e-3 * whole else round(rate, 6)
