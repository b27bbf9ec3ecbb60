"""An IMU's samples on the clock of the IF samples, by trigger counts: a robust straight line.

Whoever latches the front end's sample counter at some of the IMU's samples (a PPS or the IMU's
own trigger line into the front end's GPIO, or the other way round) has pairs of an IMU count n
and an IF sample s. Over minutes, both oscillators being steady, ::

    s = s0 + k (n - n0),    rate of the IMU = rate of the IF / k

The line is fitted by least squares with weights that leave out latches that were missed or late
(Tukey's biweight; P. J. Huber, "Robust Statistics", chapter 7); what is left over tells the
jitter of a latch, and that the uncertainty of the line at any count.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from deepseis_core.errors import InputError
from deepseis_core.types import FloatArray

BIWEIGHT: Final = 4.685
"""In sigmas: 95 % efficient where all latches are good."""
ITERATIONS: Final = 20
LEAST_PAIRS: Final = 4
QUANTUM: Final = 1.0 / np.sqrt(12.0)
"""Of a counter: one sample, uniform [samples]."""
LARGEST_JITTER: Final = 0.25
"""Of the IMU's interval: beyond it a latch may belong to the next sample."""
LEAST_SHARE: Final = 0.6
"""Of latches that must fit one line."""


@dataclass(frozen=True)
class ImuClock:
    """The line, and how well it is known.

    Attributes
    ----------
    count, sample : float
        A point of the line: weighted means.
    samples_per_count : float
    covariance : ndarray, shape (2, 2)
        Of the sample at ``count``, and of the slope.
    jitter : float
        R.m.s. of what is left of good latches [samples].
    outliers : int
        Latches that were left out.
    """

    count: float
    sample: float
    samples_per_count: float
    covariance: FloatArray
    jitter: float
    outliers: int

    def sample_at(self, count: ArrayLike) -> FloatArray:
        """Return IF samples of IMU counts, not rounded."""
        return self.sample + self.samples_per_count * (np.asarray(count, np.float64) - self.count)

    def sd_at(self, count: ArrayLike) -> FloatArray:
        """Return one sigma of that [samples]; it grows beyond the latches."""
        d = np.asarray(count, np.float64) - self.count
        P = self.covariance
        return np.asarray(np.sqrt(P[0, 0] + 2.0 * P[0, 1] * d + P[1, 1] * d * d))

    def rate_hz(self, sample_rate_hz: float) -> float:
        """Return the IMU's rate by the IF's clock [Hz]."""
        return sample_rate_hz / self.samples_per_count

    def rate_sd_hz(self, sample_rate_hz: float) -> float:
        """Return one sigma of it [Hz]."""
        slope_sd = float(np.sqrt(self.covariance[1, 1])) / self.samples_per_count
        return self.rate_hz(sample_rate_hz) * slope_sd


def fit_imu_clock(counts: ArrayLike, samples: ArrayLike) -> ImuClock:
    """Fit IMU counts to IF samples.

    Parameters
    ----------
    counts, samples : array_like, shape (n,)
        Pairs, in order.

    Raises
    ------
    InputError
        There are too few, they do not grow, or most of them fit no line.

    Examples
    --------
    >>> clock = fit_imu_clock([0, 200, 400, 600], [1000, 4_001_000, 8_001_000, 12_001_000])
    >>> clock.rate_hz(4e6)
    200.0
    """
    n, s = np.asarray(counts, np.float64), np.asarray(samples, np.float64)
    if n.shape != s.shape or n.ndim != 1 or len(n) < LEAST_PAIRS:
        raise InputError("trigger counts", f"are {n.size} pairs", f"at least {LEAST_PAIRS}")
    if not (np.isfinite(n).all() and np.isfinite(s).all()):
        raise InputError("trigger counts", "are not finite")
    if not (np.all(np.diff(n) > 0) and np.all(np.diff(s) > 0)):
        raise InputError("trigger counts", "do not grow", "did a counter wrap, or start again?")
    middle_n, middle_s = float(np.median(n)), float(np.median(s))
    x, y = n - middle_n, s - middle_s
    slope = _median_slope(x, y)
    weight = np.ones(len(x))
    offset = float(np.median(y - slope * x))
    for _ in range(ITERATIONS):
        left = y - offset - slope * x
        scale = max(1.4826 * float(np.median(np.abs(left))), QUANTUM)
        u = left / (BIWEIGHT * scale)
        weight = np.where(np.abs(u) < 1.0, (1.0 - u * u) ** 2, 0.0)
        offset, slope, _ = _line(x, y, weight)
    good = weight > 0.0
    if np.mean(good) < LEAST_SHARE:
        reason = f"{np.sum(~good)} of {len(n)} fit no straight line"
        raise InputError("trigger counts", reason, "a counter has lost counts, or jumps")
    offset, slope, N = _line(x, y, good.astype(np.float64))
    left = (y - offset - slope * x)[good]
    variance = max(float(left @ left) / max(1, good.sum() - 2), QUANTUM**2)
    if variance > (LARGEST_JITTER * slope) ** 2:
        reason = f"are {variance**0.5:.4g} IF samples off a straight line"
        raise InputError("trigger counts", reason, "a counter has lost counts, or jumps")
    centre = float(np.mean(x[good]))
    turn = np.array([[1.0, centre], [0.0, 1.0]])
    covariance = turn @ np.linalg.inv(N) @ turn.T * variance
    return ImuClock(
        middle_n + centre,
        middle_s + offset + slope * centre,
        slope,
        covariance,
        float(np.sqrt(variance)),
        int(np.sum(~good)),
    )


def _median_slope(x: FloatArray, y: FloatArray) -> float:
    """Return the median slope from the first to the second half: half the latches may be bad."""
    half = len(x) // 2
    return float(np.median((y[half : 2 * half] - y[:half]) / (x[half : 2 * half] - x[:half])))


def _line(x: FloatArray, y: FloatArray, weight: FloatArray) -> tuple[float, float, FloatArray]:
    N = np.array([[weight.sum(), weight @ x], [weight @ x, weight @ (x * x)]])
    if not np.linalg.det(N) > 0.0:
        raise InputError("trigger counts", "fit no straight line", "are they pairs of one moment?")
    offset, slope = np.linalg.solve(N, [weight @ y, weight @ (x * y)])
    return float(offset), float(slope), N
