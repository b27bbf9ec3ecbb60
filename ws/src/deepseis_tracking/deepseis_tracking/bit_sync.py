"""Where data bits begin: the offset at which 20 ms sums hold most energy (compiled)."""

from __future__ import annotations

import math
from typing import Any

from numba import njit


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
    best = 0
    for m in range(1, 20):
        if state.bit_energy[m] > state.bit_energy[best]:
            best = m
    left, right = state.bit_energy[(best + 19) % 20], state.bit_energy[(best + 1) % 20]
    top = state.bit_energy[best] / sums
    # A 20 ms sum of amplitude a (in sigmas of 1 ms, so noise power 40) has power variance
    # 80 a^2 + 1600; neighbouring offsets share 19 of 20 periods, hence a tenth of it differs.
    spread = math.sqrt(max(80.0 * top + 1600.0, 1.0) * 0.1 / sums)
    lead = top - max(left, right) / sums
    return best if lead > 4.0 * spread and lead > 0.03 * top else -1
