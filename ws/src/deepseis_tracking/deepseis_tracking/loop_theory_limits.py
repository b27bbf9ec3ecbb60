"""Limits of loops: least C/N0, best and least bandwidth, jamming."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq, minimize_scalar

from deepseis_core.constants import CA_RATE_CPS, L1_WAVELENGTH
from deepseis_core.types import FloatArray
from deepseis_tracking.loop_theory import THRESHOLD, linear

Error = Callable[[float], float]
"""Total phase error [rad] as a function of one quantity."""


def sensitivity(error: Error, threshold: float = THRESHOLD) -> float:
    """Return the least C/N0 [dB-Hz] that a loop can work with; infinite if there is none.

    Parameters
    ----------
    error : callable
        Total phase error [rad] at a C/N0 [dB-Hz].
    threshold : float
        [rad]

    Examples
    --------
    >>> from deepseis_tracking.loop_theory import thermal_noise
    >>> round(sensitivity(lambda cn0: float(thermal_noise(3.0, cn0, 1e-3))), 1)
    22.3
    """
    return _crossing(error, threshold, 0.0, 80.0)


def least_bandwidth(error: Error, threshold: float = THRESHOLD, greatest: float = 60.0) -> float:
    """Return the bandwidth [Hz] from which on the error is below the threshold.

    Parameters
    ----------
    error : callable
        Total phase error [rad] at a bandwidth [Hz].
    greatest : float
        Searched up to here [Hz], or to the best bandwidth; infinite if no bandwidth will do.
    """
    best, least = best_bandwidth(error, greatest=greatest)
    return np.inf if least > threshold else _crossing(error, threshold, 0.02, best)


def best_bandwidth(
    error: Error, least: float = 0.02, greatest: float = 60.0
) -> tuple[float, float]:
    """Return the bandwidth [Hz] of the least error, and that error [rad]."""
    grid = np.geomspace(least, greatest, 120)
    at = int(np.argmin([error(float(b)) for b in grid]))
    low, high = grid[max(at - 1, 0)], grid[min(at + 1, grid.size - 1)]
    found = minimize_scalar(error, bounds=(low, high), method="bounded")
    return float(found.x), float(found.fun)


def _crossing(error: Error, threshold: float, low: float, high: float) -> float:
    """Return where a falling error passes the threshold."""
    if error(high) > threshold:
        return np.inf
    if error(low) <= threshold:
        return low
    return float(brentq(lambda x: error(x) - threshold, low, high, xtol=1e-6))


def jammer_to_signal_db(
    cn0_jammed_dbhz: ArrayLike, cn0_dbhz: ArrayLike, *, factor: float = 1.0,
    code_rate_cps: float = CA_RATE_CPS,
) -> FloatArray:  # fmt: skip
    """Return J/S [dB] that brings C/N0 down to a value, D 8.

    ``10 lg((10^(-CN0eq / 10) - 10^(-CN0 / 10)) P fc)``.

    Parameters
    ----------
    factor : float
        ``P``: 1 narrow-band, 2 wide-band.

    Examples
    --------
    >>> print(np.round(jammer_to_signal_db([22.3, 28.8], 41.0), 2))
    [37.74 31.03]
    """
    density = 1.0 / linear(cn0_jammed_dbhz) - 1.0 / linear(cn0_dbhz)
    return np.asarray(10.0 * np.log10(density * factor * code_rate_cps))


def jammed_cn0_dbhz(
    jammer_to_signal: ArrayLike, cn0_dbhz: ArrayLike, *, factor: float = 1.0,
    code_rate_cps: float = CA_RATE_CPS,
) -> FloatArray:  # fmt: skip
    """Return C/N0 [dB-Hz] under a jammer of J/S [dB]: the inverse of `jammer_to_signal_db`."""
    density = 1.0 / linear(cn0_dbhz) + linear(jammer_to_signal) / (factor * code_rate_cps)
    return np.asarray(-10.0 * np.log10(density))


def jammer_range(
    jammer_to_signal: ArrayLike, *, power_dbw: float = 20.0, signal_dbw: float = -170.0
) -> FloatArray:
    """Return how far an isotropic jammer in sight reaches [m], D table 1.

    ``lambda / (4 pi) 10^((power - signal - J/S) / 20)``; the table's kilometres mean 100 W against
    a signal of -170 dBW.

    Examples
    --------
    >>> print(np.round(jammer_range([37.74, 31.03]) / 1e3))
    [ 621. 1345.]
    """
    loss = power_dbw - signal_dbw - np.asarray(jammer_to_signal)
    return np.asarray(L1_WAVELENGTH / (4.0 * np.pi) * 10.0 ** (loss / 20.0))
