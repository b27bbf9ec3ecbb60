"""Where data bits begin: the offset at which 20 ms sums hold most energy (compiled).

`search_bit_edge` takes prompts one by one as the phase loop follows the signal. Where that cannot
follow on 1 ms, `resolve_bits` takes many prompts of an NCO that runs free, finds the Doppler they
have left, and adds to the same energies.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

REACH_HZ, STEP_HZ = 22.5, 2.5
"""Of the residual Doppler searched for; 20 ms sums have their first zero at 50 Hz."""
PERIOD_S = 1e-3
TWO_PI = 2.0 * math.pi


@njit(cache=True, nogil=True)
def clear_edge(energy: np.ndarray, sums: int) -> int:
    """Return the offset (0..19) that leads clearly after ``sums`` sums at each, or -1."""
    best = 0
    for m in range(1, 20):
        if energy[m] > energy[best]:
            best = m
    left, right = energy[(best + 19) % 20], energy[(best + 1) % 20]
    top = energy[best] / sums
    # A 20 ms sum of amplitude a (in sigmas of 1 ms, so noise power 40) has power variance
    # 80 a^2 + 1600; neighbouring offsets share 19 of 20 periods, hence a tenth of it differs.
    spread = math.sqrt(max(80.0 * top + 1600.0, 1.0) * 0.1 / sums)
    lead = top - max(left, right) / sums
    return best if lead > 4.0 * spread and lead > 0.03 * top else -1


@njit(cache=True, nogil=True)
def search_bit_edge(state: Any, i: float, q: float) -> int:
    """Energy of 20 ms sums at each of the 20 offsets; the edge (0..19) once it is clear, or -1."""
    slot = state.period_count % 20
    state.recent_i[slot] = i
    state.recent_q[slot] = q
    if state.mode_epochs < 20:
        return -1
    sum_i, sum_q = 0.0, 0.0
    for m in range(20):
        sum_i += state.recent_i[m]
        sum_q += state.recent_q[m]
    edge = (slot + 1) % 20
    state.bit_energy[edge] += sum_i * sum_i + sum_q * sum_q - 40.0
    # The first sum came at epoch 20: only here has every offset had the same number of them.
    sums = (state.mode_epochs - 19) // 20
    if sums < 20 or state.mode_epochs % 20 != 19:
        return -1
    return clear_edge(state.bit_energy, sums)


@njit(cache=True, nogil=True)
def _energies(
    prompts: np.ndarray, first_period: int, frequency_hz: float, energy: np.ndarray
) -> None:
    """Energy of 20 ms sums at each offset with a residual Doppler taken out, noise subtracted."""
    count = prompts.shape[0]
    sums = np.zeros((count + 1, 2))
    for m in range(count):
        angle = -TWO_PI * frequency_hz * PERIOD_S * m
        c, s = math.cos(angle), math.sin(angle)
        sums[m + 1, 0] = sums[m, 0] + c * prompts[m, 0] - s * prompts[m, 1]
        sums[m + 1, 1] = sums[m, 1] + c * prompts[m, 1] + s * prompts[m, 0]
    for edge in range(20):
        first = (edge - first_period) % 20
        energy[edge] = 0.0
        for bit in range(bits_in(count)):
            low = first + 20 * bit
            i, q = sums[low + 20, 0] - sums[low, 0], sums[low + 20, 1] - sums[low, 1]
            energy[edge] += i * i + q * q - 40.0


@njit(cache=True, nogil=True)
def bits_in(count: int) -> int:
    """Whole bits in ``count`` prompts at whatever offset."""
    return (count - 19) // 20


@njit(cache=True, nogil=True)
def resolve_bits(
    prompts: np.ndarray, first_period: int, known_edge: int, energy: np.ndarray
) -> float:
    """Find the Doppler that prompts of a free-running NCO have left; add up bit energies.

    Doppler and bit edge are those of the largest energy in 20 ms sums (maximum likelihood for
    unknown bits); the deviation of the Doppler is about ``sqrt(6 / (CN0 T)) / (2 pi 20 ms)``, T
    the duration: 0.7 Hz after 1 s at 29 dB-Hz.

    Parameters
    ----------
    prompts : ndarray, shape (n, 2)
        In-phase and quadrature of successive code periods, in sigmas of their noise.
    first_period : int
        Number of the first one's period.
    known_edge : int
        Period number modulo 20 at a bit edge, or -1.
    energy : ndarray, shape (20,)
        That of this stretch is added, by period number modulo 20 at the bits' beginning.

    Returns
    -------
    float
        Residual Doppler [Hz].
    """
    steps = round(2 * REACH_HZ / STEP_HZ) + 1
    table = np.zeros((steps, 20))
    best, place, edge = -np.inf, 0, 0
    for k in range(steps):
        _energies(prompts, first_period, k * STEP_HZ - REACH_HZ, table[k])
        for m in range(20):
            if table[k, m] > best and (known_edge < 0 or m == known_edge):
                best, place, edge = table[k, m], k, m
    place = min(max(place, 1), steps - 2)
    before, at, after = table[place - 1, edge], table[place, edge], table[place + 1, edge]
    bend = before - 2.0 * at + after
    shift = min(max(0.5 * (before - after) / bend, -1.0), 1.0) if bend < 0.0 else 0.0
    frequency = (place + shift) * STEP_HZ - REACH_HZ
    found = np.zeros(20)
    _energies(prompts, first_period, frequency, found)
    energy += found
    return frequency
