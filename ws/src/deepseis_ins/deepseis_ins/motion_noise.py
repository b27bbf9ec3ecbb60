"""The noise of six inertial axes at rest, which tells what is motion.

A still sensor reads a constant, white noise of standard deviation ``sigma`` a sample, and a bias
that walks at random by ``drift`` sqrt(t). Where the noise is not white, the mean of n samples has
the variance ``colour sigma^2 / n`` for all but few of them: a low-pass filter makes colour > 1.

It comes from the grade of the unit, from thresholds in the manner of the thesis (3.4.3: twice the
RMS of the variances of windows at rest), or from the unit itself while the station is still.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from deepseis_core.errors import InputError
from deepseis_core.imu_grades import ImuGrade
from deepseis_core.types import FloatArray

AXES: Final = (
    "gyro x", "gyro y", "gyro z", "accelerometer x", "accelerometer y", "accelerometer z",
)  # fmt: skip

SMALLEST: Final = np.repeat([1e-6, 1e-5], 3)
"""Standard deviations [rad/s, m/s^2] below which a sample's noise is never taken: what the Earth,
the building and rounding do to a perfect sensor."""

FACTOR: Final = 2.0
"""Threshold over the RMS of variances at rest (thesis 3.4.3)."""

SHORT_MEANS: Final = (0.02, 0.1, 0.25)
"""Lengths [s] of the means that show the colour."""
PERSISTENT: Final = 0.4
"""Share of the variance that may outlast the longest of them: noise of sensors does not; what
shakes slower than 1.5 times a second does."""
CHI_SQUARE_MEDIAN: Final = 0.4549
"""Of one degree of freedom: variance from the median of squares."""
OUTLIER: Final = 7.0
"""Standard deviations by which a window of a still may differ from the others."""
ABOVE_GRADE: Final = 4.0
"""Variance over that of the grade from which a still is taken for vibration."""


@dataclass(frozen=True)
class AxisNoise:
    """Noise at rest of gyroscopes and accelerometers, x, y, z each.

    Attributes
    ----------
    sigma : ndarray, shape (6,)
        Standard deviation of a sample [rad/s, m/s^2].
    drift : ndarray, shape (6,)
        Random walk of the bias [rad/s/sqrt(s), m/s^2/sqrt(s)]; 0: not known.
    colour : ndarray, shape (6,)
        Variance of means over what it would be if the samples were independent, 1 or more.
    """

    sigma: FloatArray
    drift: FloatArray
    colour: FloatArray


def noise_of_grade(grade: ImuGrade, rate_hz: float) -> AxisNoise:
    """Return what mean rates over 1 / rate_hz seconds show at rest.

    White noise of the density ``walk``, and the steps of increments, whose remainders go on:
    the difference of two of them has the variance ``resolution^2 / 6``. A Gauss-Markov process of
    deviation s and correlation time T walks like ``s sqrt(2 / T)`` over times below T.
    """
    triads = [grade.gyros] * 3 + [grade.accelerometers] * 3
    variance = [t.walk**2 * rate_hz + (t.resolution * rate_hz) ** 2 / 6.0 for t in triads]
    drift = [t.instability * (2.0 / t.correlation_time) ** 0.5 for t in triads]
    sigma = np.maximum(np.sqrt(variance), SMALLEST)
    return AxisNoise(sigma, np.array(drift), np.ones(6))


def noise_of_thresholds(thresholds: ArrayLike, drift: FloatArray) -> AxisNoise:
    """Return the noise whose thresholds these are [rad^2/s^2 x3, m^2/s^4 x3]."""
    values = np.asarray(thresholds, np.float64)
    if values.shape != (6,) or not np.all((values > 0.0) & np.isfinite(values)):
        raise InputError(
            "motion thresholds", f"are {values.tolist()}", "six variances above zero, gyros first"
        )
    return AxisNoise(np.maximum(np.sqrt(values / FACTOR), SMALLEST), drift, np.ones(6))


def thresholds_of_noise(noise: AxisNoise, window: int) -> FloatArray:
    """Return thesis thresholds of windows of n samples of normal noise, shape (6,).

    Their variances have the RMS ``sigma^2 sqrt(1 + 2 / (n - 1))``.
    """
    spread = np.sqrt(1.0 + 2.0 * noise.colour / max(window - 1, 1))
    return np.asarray(FACTOR * noise.sigma**2 * spread)


def window_variances(samples: FloatArray, window: int) -> FloatArray:
    """Return sample variances (thesis 3.40) of whole windows, shape (windows, axes)."""
    whole = samples.shape[0] // window
    cut = samples[: whole * window].reshape(whole, window, samples.shape[1])
    return np.asarray(cut.var(axis=1, ddof=1))


@dataclass(frozen=True)
class Calibration:
    """What a still has shown.

    Attributes
    ----------
    noise : AxisNoise or None
        None where the station was not still.
    thresholds : ndarray, shape (6,)
        Twice the RMS of the variances of its windows [rad^2/s^2 x3, m^2/s^4 x3].
    problem : str
        Why the station was not still; empty if it was.
    """

    noise: AxisNoise | None
    thresholds: FloatArray
    problem: str = ""


def calibrate(
    samples: FloatArray, rate_hz: float, window: int, expected: AxisNoise | None = None
) -> Calibration:
    """Learn the noise from a still, and notice if it was none.

    Not still: a window whose variance or mean stands out, a sensor that gives nothing or always
    the same, noise that lasts (shaking below 1.5 Hz), more than four times the variance that is
    expected. What cannot be noticed without an expectation: steady vibration that began before.

    Parameters
    ----------
    samples : ndarray, shape (m, 6)
        Rates [rad/s] and specific forces [m/s^2]; gyros that are not a number are absent.
    rate_hz : float
    window : int
        Samples in a window; at least four windows.
    expected : AxisNoise, optional
        Of the unit's grade.
    """
    sigma, thresholds = np.full(6, np.nan), np.full(6, np.nan)
    colour = np.ones(6)
    for j in range(6):
        x = samples[:, j]
        if j < 3 and not np.isfinite(x).any():
            continue
        if not np.isfinite(x).all():
            return Calibration(None, thresholds, f"{AXES[j]}: samples are missing")
        variances = window_variances(x[:, None], window)[:, 0]
        thresholds[j] = FACTOR * np.sqrt(np.mean(variances**2))
        sigma[j] = np.sqrt(np.median(variances))
        colour[j], problem = _colour(x, sigma[j], rate_hz)
        problem = problem or _standing_out(x, variances, colour[j], window)
        if expected is not None and not problem:
            problem = _above(sigma[j], colour[j], expected, j)
        if problem:
            return Calibration(None, thresholds, f"{AXES[j]}: {problem}")
    absent = np.isnan(sigma)
    sigma = np.where(absent, SMALLEST, np.maximum(sigma, SMALLEST))
    drift = np.zeros(6) if expected is None else expected.drift
    thresholds = np.where(absent, FACTOR * SMALLEST**2, thresholds)
    return Calibration(AxisNoise(sigma, drift, colour), thresholds)


def _colour(x: FloatArray, sigma: float, rate_hz: float) -> tuple[float, str]:
    """Return by how much means vary more than those of independent samples."""
    if sigma == 0.0:
        return 1.0, "always the same value"
    largest = 1.0
    for seconds in SHORT_MEANS:
        n = max(2, round(seconds * rate_hz))
        means = x[: x.size // n * n].reshape(-1, n).mean(axis=1)
        # Differences of neighbours, and their median: neither drift nor one jolt is colour.
        variance = 0.5 * float(np.median(np.diff(means) ** 2)) / CHI_SQUARE_MEDIAN
        largest = max(largest, variance * n / sigma**2)
    if variance > PERSISTENT * sigma**2:
        return largest, f"{variance / sigma**2:.0%} of its variance lasts for 0.25 s: motion"
    # The estimate itself is uncertain by this much; white noise must not pass for coloured.
    slack = 1.0 + 6.0 * np.sqrt(2.0 * n / x.size)
    return (largest if largest > slack else 1.0), ""


def _standing_out(x: FloatArray, variances: FloatArray, colour: float, window: int) -> str:
    """Compare windows with one another."""
    middle = float(np.median(variances))
    ratio = float(variances.max()) / middle
    if ratio > 1.0 + OUTLIER * np.sqrt(2.0 * colour / (window - 1)):
        return f"one window has {ratio:.1f} times the variance of the others"
    whole = variances.size
    means = x[: whole * window].reshape(whole, window).mean(axis=1)
    apart = float(np.abs(np.diff(means)).max()) / np.sqrt(2.0 * colour * middle / window)
    if apart > OUTLIER * 2.0:
        return f"means of neighbouring windows differ by {apart:.0f} sigma"
    return ""


def _above(sigma: float, colour: float, expected: AxisNoise, j: int) -> str:
    """Compare with what is expected."""
    ratio = max(1.0, colour / ABOVE_GRADE) * (sigma / expected.sigma[j]) ** 2
    if ratio > ABOVE_GRADE:
        return f"{ratio:.1f} times the variance of the unit's grade: vibration"
    return ""
