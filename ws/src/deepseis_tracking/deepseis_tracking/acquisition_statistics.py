"""Detection statistics of the acquisition: thresholds, cross-correlation, error bounds."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import special
from scipy.optimize import brentq

from deepseis_core.types import FloatArray

CELL_INDEPENDENCE = 0.92
"""Independent cells per cell searched (half-chip, half-bin grid); Monte Carlo in the tests."""


def cell_false_alarm(false_alarm_probability: float, cell_count: float) -> float:
    """Return the probability per cell that gives a probability over all cells.

    ``1 - (1 - p)**cell_count = false_alarm_probability``

    Examples
    --------
    >>> round(cell_false_alarm(0.1, 1000) * 1000, 4)
    0.1054
    """
    return float(-np.expm1(np.log1p(-false_alarm_probability) / cell_count))


def detection_threshold(
    false_alarm_probability: float, cell_count: float, sums: float, reference_count: float
) -> float:
    """Return the threshold on peak power over mean noise power.

    One cell holds the sum of ``sums`` squared magnitudes of complex Gaussian noise, a gamma
    variable of shape ``sums``. It is divided by the mean of ``reference_count`` independent
    cells of the same Doppler row (cell-averaging CFAR), so that the ratio is F distributed with
    ``(2 sums, 2 sums reference_count)`` degrees of freedom, whatever the noise power; the
    largest of ``cell_count`` independent ratios is then held to ``false_alarm_probability``.

    Parameters
    ----------
    false_alarm_probability : float
        Of the largest ratio passing the threshold where there is noise only.
    cell_count : float
        Independent cells searched.
    sums : float
        Non-coherent sums in a cell.
    reference_count : float
        Independent cells in the noise estimate.

    Examples
    --------
    One sum against a well known mean is exponential:

    >>> round(detection_threshold(1e-3, 1.0, 1, 1e9), 2)
    6.91
    """
    probability = cell_false_alarm(false_alarm_probability, cell_count)
    numerator, denominator = 2 * sums, 2 * sums * reference_count

    def excess(ratio: float) -> float:
        tail = float(special.fdtrc(numerator, denominator, ratio))
        return math.log(max(tail, 1e-300)) - math.log(probability)

    # SciPy's own inverses give nonsense here before 1.12, which Ubuntu 24.04 has.
    high = 2.0
    while excess(high) > 0:
        high *= 2
    return float(brentq(excess, 0.0, high, xtol=1e-12, rtol=1e-13))


def doppler_crlb_hz(cn0_hz: float, spans: FloatArray) -> float:
    """Return the Cramer-Rao bound of the Doppler from coherent spans of unrelated phase.

    A tone over ``T`` has ``var(omega) = 6 / (cn0 T**3)``; information of the spans adds.

    Parameters
    ----------
    cn0_hz : float
        Carrier to noise density [Hz], linear.
    spans : ndarray
        Durations of the coherent spans [s].

    Examples
    --------
    >>> round(doppler_crlb_hz(10**3.5, np.full(5, 0.02)), 2)
    1.1
    """
    information = cn0_hz * np.sum(spans**3) / 6
    return float(1 / (2 * np.pi * np.sqrt(information)))


def reference_cells(replica: NDArray[np.complex64]) -> float:
    """Return how many independent cells one Doppler row of code phases is worth.

    Noise through the replica has the spectrum ``|C_k|**2``; the variance of its mean power is
    that of ``(sum |C|**2)**2 / sum |C|**4`` independent values.
    """
    power = np.abs(replica.astype(np.complex128)) ** 2
    return float(np.sum(power) ** 2 / np.sum(power**2))


def band_fraction(replica: NDArray[np.complex64]) -> float:
    """Return the fraction of the signal's power inside the working band."""
    return float(np.sum(np.abs(replica.astype(np.complex128)) ** 2))
