"""Phase, frequency and code errors from correlator outputs."""

from __future__ import annotations

import math

from numba import njit

TWO_PI = 2.0 * math.pi


@njit(cache=True, nogil=True)
def costas_atan(in_phase: float, quadrature: float) -> float:
    """Phase error blind to the data bit, ``atan(Q / I)`` [cycles], within +-1/4.

    Maximum likelihood at high and low C/N0 (thesis table 2.2).

    Examples
    --------
    >>> round(costas_atan(-1.0, -1.0), 6)
    0.125
    """
    if in_phase == 0.0:
        return 0.25 if quadrature > 0.0 else (-0.25 if quadrature < 0.0 else 0.0)
    return math.atan(quadrature / in_phase) / TWO_PI


@njit(cache=True, nogil=True)
def pure_atan2(in_phase: float, quadrature: float) -> float:
    """Phase error where the data bit has been wiped off, ``atan2(Q, I)`` [cycles]."""
    return math.atan2(quadrature, in_phase) / TWO_PI


@njit(cache=True, nogil=True)
def frequency_error(
    in_phase: float, quadrature: float, last_in_phase: float, last_quadrature: float, dt: float
) -> float:
    """Frequency error from two prompts ``dt`` seconds apart, blind to data [Hz], +-1/(4 dt)."""
    dot = in_phase * last_in_phase + quadrature * last_quadrature
    cross = quadrature * last_in_phase - in_phase * last_quadrature
    return costas_atan(dot, cross) / dt


@njit(cache=True, nogil=True)
def dll_envelope(early: float, late: float, spacing_chips: float) -> float:
    """Code error from early and late envelopes [chips], positive when the replica is late.

    ``(1 - d/2) (|E| - |L|) / (|E| + |L|)`` has unit slope and is exact for an unfiltered
    triangular peak while ``|error| < d/2`` (Kaplan and Hegarty 2006, table 5.5).

    Examples
    --------
    >>> round(dll_envelope(0.85, 0.65, 0.5), 6)
    0.1
    """
    total = early + late
    if total <= 0.0:
        return 0.0
    return (1.0 - 0.5 * spacing_chips) * (early - late) / total
