"""Limits of the fast motion test, from the number of false switches that may be.

A still station's innovations are normal, so that the probability of each comparison is known:
a mean over n samples, squared and over its variance, exceeds its limit with that of chi-square
of one degree of freedom, a triad's of three, the energy of n samples of n, a triad's of 3 n. All
comparisons have the same probability, the expected number of false switches divided by the number
of comparisons: their sum bounds the probability that any fires, however they depend on each other.

With coloured noise the mean has ``min(n, colour)`` times the variance, and the energy
``n / colour`` degrees of freedom (F. E. Satterthwaite, Biometrics Bulletin 2, 1946).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import chdtri

from deepseis_core.types import FloatArray, IntArray
from deepseis_ins.motion_noise import AxisNoise

DAY: Final = 86400.0

DENSE: Final = (2, 3, 4, 5, 6, 8, 10, 12, 16)
"""Shortest windows [samples], compared at every sample."""
RATIO: Final = 2.0**0.5
"""Between longer ones. A window 19 % too long or short loses 4 % of its deflection."""
STRIDES_PER_WINDOW: Final = 16
"""Longer ones are compared this often in their length."""
ENERGY_TIMES: Final = (0.05, 0.1, 0.2, 0.5, 1.0)
"""Windows of energy [s]."""

CLIP: Final = 0.8
"""Of the limit of one sample. One alone never passes; two of one sign, 1.13, do, and so do two
that a triad shares: their square, 1.28 that of an axis' limit, is above that of a triad."""
FALSE_RESTARTS: Final = 0.01
"""Share of quiet spells that the sensitive limits break."""
LOOK_BACK: Final = 1e-4
"""Probability of a comparison from which a window before a motion is suspicious."""


@dataclass(frozen=True)
class Limits:
    """What windows are compared with.

    Attributes
    ----------
    lengths, strides : ndarray of int64, shape (s,)
        Samples in a window, and between its comparisons.
    energy_lengths, energy_strides : ndarray of int64, shape (e,)
    mean, triad : ndarray, shape (3, s, 6), (3, s, 2)
        Of squared sums: sensitive, strict, and looking back.
    energy, triad_energy : ndarray, shape (3, e, 6), (3, e, 2)
        Of sums of squares.
    clip : ndarray, shape (2,)
        Largest innovation, sensitive and strict.
    probability : ndarray, shape (3,)
        Of one comparison.
    """

    lengths: IntArray
    strides: IntArray
    energy_lengths: IntArray
    energy_strides: IntArray
    mean: FloatArray
    triad: FloatArray
    energy: FloatArray
    triad_energy: FloatArray
    clip: FloatArray
    probability: FloatArray


def window_lengths(rate_hz: float, longest: float) -> IntArray:
    """Return numbers of samples from 2 to ``longest`` seconds."""
    lengths, wanted = list(DENSE), DENSE[-1] * RATIO
    while wanted < longest * rate_hz * RATIO**0.5:
        lengths.append(round(wanted))
        wanted *= RATIO
    return np.array(lengths, np.int64)


def make_limits(
    noise: AxisNoise, rate_hz: float, longest: float, quiet: float, false_per_day: float
) -> Limits:
    """Work out the limits.

    Parameters
    ----------
    noise : AxisNoise
    rate_hz : float
    longest, quiet : float
        Longest window, time without a sign of motion before it is called still [s].
    false_per_day : float
        Expected number of false switches in a day of rest, at most.
    """
    lengths = window_lengths(rate_hz, longest)
    energy_lengths = np.unique(np.maximum(np.round(np.multiply(ENERGY_TIMES, rate_hz)), 4))
    energy_lengths = energy_lengths.astype(np.int64)
    strides, energy_strides = _strides(lengths), _strides(energy_lengths)
    per_sample = 8.0 * np.sum(1.0 / strides) + 8.0 * np.sum(1.0 / energy_strides)
    probability = np.array(
        [
            FALSE_RESTARTS / (per_sample * rate_hz * quiet),
            false_per_day / (per_sample * rate_hz * DAY),
            LOOK_BACK,
        ]
    )
    wider = np.minimum(lengths[:, None], noise.colour) * lengths[:, None]
    triad = np.maximum.reduceat(wider, [0, 3], axis=1)
    colour = np.maximum.reduceat(noise.colour, [0, 3])
    freedom, triad_freedom = (energy_lengths[:, None] / each for each in (noise.colour, colour))
    p = probability[:, None, None]
    return Limits(
        lengths,
        strides,
        energy_lengths,
        energy_strides,
        mean=chdtri(1, p) * wider,
        triad=chdtri(3, p) * triad,
        energy=chdtri(freedom, p) * noise.colour,
        triad_energy=chdtri(3.0 * triad_freedom, p) * colour,
        clip=CLIP * np.sqrt(chdtri(1, probability[:2])),
        probability=probability,
    )


def _strides(lengths: IntArray) -> IntArray:
    """Return powers of two: every sample for short windows, about 16 times a length for long."""
    powers = np.log2(np.maximum(lengths / STRIDES_PER_WINDOW, 1.0))
    return np.left_shift(1, powers.astype(np.int64))
