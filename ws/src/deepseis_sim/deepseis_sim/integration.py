"""From an accelerogram to velocity and displacement: baseline, taper, band-pass, integration.

An accelerometer's offset grows with the square of time in the displacement, so a record is freed
of its mean and of what lies below a corner frequency before it is integrated. The filter is a
Butterworth run forwards and backwards, so nothing is delayed. Filtered in this way a record has
tails before its beginning and after its end; they are kept, for without them velocity and
displacement do not come back to zero (D. M. Boore, "On pads and filters: processing
strong-motion data", BSSA 95, 2005).
"""

from __future__ import annotations

from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import butter, sosfiltfilt

from deepseis_core.types import FloatArray
from deepseis_sim.motions_shapes import rise_by, smooth_step
from deepseis_sim.uniform_spline import UniformSpline

PAD_FACTOR: Final = 1.5
"""Zeros before and after a record, in units of order over low corner (Boore 2005)."""


def remove_mean(samples: FloatArray, first: int = 0) -> FloatArray:
    """Take off the mean of the ``first`` samples (before the shaking), shape (m, k); 0: of all."""
    return samples - samples[: first or None].mean(axis=0)


def remove_velocity_trend(acceleration: FloatArray, rate_hz: float, degree: int) -> FloatArray:
    """Make the velocity free of the polynomial that fits it best.

    Parameters
    ----------
    acceleration : ndarray, shape (m, k)
        [m/s^2].
    degree : int
        Of the polynomial; 1 takes a constant off the acceleration, 0 changes nothing.
    """
    if degree < 1:
        return acceleration
    velocity, _ = integrate(acceleration, rate_hz)
    x = np.linspace(-1.0, 1.0, velocity.shape[0])
    fit = np.polynomial.legendre.legfit(x, velocity, degree)
    slope = np.polynomial.legendre.legval(x, np.polynomial.legendre.legder(fit)).T
    return acceleration - slope * (2.0 * rate_hz / (velocity.shape[0] - 1))


def taper(samples: FloatArray, rate_hz: float, length_s: float) -> FloatArray:
    """Let samples (m, k) rise from zero at the beginning and sink to zero at the end."""
    if length_s <= 0:
        return samples
    time = np.arange(samples.shape[0]) / rate_hz
    window = smooth_step(time / length_s)[0] * smooth_step((time[-1] - time) / length_s)[0]
    return samples * window[:, np.newaxis]


def padding(rate_hz: float, low_hz: float, order: int = 4) -> int:
    """Return how many samples the tails of `band_pass` need on either side."""
    return round(PAD_FACTOR * order / low_hz * rate_hz) if low_hz > 0 else 0


def band_pass(
    samples: ArrayLike, rate_hz: float, low_hz: float, high_hz: float, *, order: int = 4
) -> FloatArray:
    """Filter samples (m, k) by a zero-phase Butterworth band-pass.

    The filter of the given order runs both ways: the gain is 1/2 (-6 dB) at the corners. Outside
    its span the record counts as zero; to keep the tails lengthen it by `padding` zeros first.

    Parameters
    ----------
    low_hz, high_hz : float
        Corners; a low one of 0, or a high one of 0 or beyond half the rate, is left out.
    """
    x = np.asarray(samples, np.float64)
    pad = padding(rate_hz, low_hz, order)
    x = np.pad(x, ((pad, pad), (0, 0)))
    sides: list[tuple[Literal["highpass", "lowpass"], float]] = []
    sides += [("highpass", low_hz)] if low_hz > 0 else []
    sides += [("lowpass", high_hz)] if 0 < high_hz < rate_hz / 2 else []
    for kind, corner in sides:
        sections = butter(order, corner, kind, fs=rate_hz, output="sos")
        x = sosfiltfilt(sections, x, axis=0, padtype="constant", padlen=min(100, len(x) - 1))
    return x[pad : x.shape[0] - pad]


def integrate(
    acceleration: FloatArray,
    rate_hz: float,
    velocity: ArrayLike = 0.0,
    displacement: ArrayLike = 0.0,
) -> tuple[FloatArray, FloatArray]:
    """Return velocity and displacement at the samples, each (m, k), from given first values."""
    spline = UniformSpline.from_acceleration(0.0, 1 / rate_hz, acceleration, velocity=velocity)
    return spline.knots[:, 1], spline.knots[:, 0] + np.asarray(displacement)


def ground_motion(
    acceleration: FloatArray,
    rate_hz: float,
    *,
    low_hz: float = 0.01,
    high_hz: float = 45.0,
    order: int = 4,
    still_s: float = 0.0,
    trend_degree: int = 0,
    taper_s: float = 0.0,
) -> UniformSpline:
    """Correct a record and integrate it.

    The spline interpolates between samples, so it also serves every higher rate.

    Parameters
    ----------
    acceleration : ndarray, shape (m, k)
        As recorded [m/s^2].
    still_s : float
        The mean is that of this time at the beginning [s]; 0: of the whole record.
    trend_degree : int
        Degree of the polynomial taken off the velocity; 0: none.
    taper_s : float
        Rise and fall of the record before it is filtered [s].

    Returns
    -------
    UniformSpline
        Time 0 is the first sample; it begins `padding` samples earlier and ends so much later.
    """
    x = remove_mean(np.asarray(acceleration, np.float64), round(still_s * rate_hz))
    x = taper(remove_velocity_trend(x, rate_hz, trend_degree), rate_hz, taper_s)
    pad = padding(rate_hz, low_hz, order)
    x = band_pass(np.pad(x, ((pad, pad), (0, 0))), rate_hz, low_hz, high_hz, order=order)
    return UniformSpline.from_acceleration(-pad / rate_hz, 1 / rate_hz, x)


def with_static_step(
    displacement: FloatArray, rate_hz: float, step: ArrayLike, at_s: float, over_s: float
) -> FloatArray:
    """Give a displacement the permanent offset that the high-pass took away.

    Parameters
    ----------
    displacement : ndarray, shape (m, 3)
        At rest before and after [m].
    step : array_like, shape (3,)
        Known from elsewhere, such as GNSS [m].
    at_s, over_s : float
        Middle and duration of its smooth rise [s after the first sample]. A high-passed step
        still swings for about half the period of the corner: a rise of ``0.5 / low_hz`` is what
        it leaves room for.
    """
    time = np.arange(displacement.shape[0]) / rate_hz
    amount = rise_by(time, at_s - over_s / 2, over_s)[0]
    return displacement + amount[:, np.newaxis] * np.asarray(step, np.float64)
