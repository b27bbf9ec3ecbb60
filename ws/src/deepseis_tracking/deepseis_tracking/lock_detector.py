"""C/N0, code lock and phase lock of a channel (compiled; state of `channel_state`)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

PERIOD_S = 1e-3
"""Code period [s]."""
BRIEF_S = 0.06
"""Time constant of the power that tells whether the signal is still there [s]."""
GONE = 0.05
"""Share of its mean power over 1 s below which a signal has vanished [-]: 13 dB."""
CLEAR = 6.0
"""Least mean power, in noise variances, of a signal whose vanishing can be told from noise [-]."""


@njit(cache=True, nogil=True)
def update_locks(state: Any, config: Any, i: float, q: float, duration: float) -> None:
    """Low-pass the lock detectors and apply their hysteresis; ``i``, ``q`` in noise sigmas.

    A signal that vanishes ends the phase lock within some 0.2 s, whatever its strength was.
    """
    alpha = min(1.0, duration / 0.25)
    power = i * i + q * q - 2.0
    state.brief += min(1.0, duration / BRIEF_S) * (power - state.brief)
    state.usual += min(1.0, duration) * (power - state.usual)
    if state.usual > CLEAR and state.brief < GONE * state.usual:
        # The ratio below forgets numerator and denominator alike: with a strong signal before, it
        # would call noise locked for seconds.
        state.phase_lock = 0
        state.lock_num, state.lock_den, state.usual = 0.0, 0.0, 0.0
        state.narrow_wide = -1.0
    state.lock_num += alpha * (i * i - q * q - state.lock_num)
    state.lock_den += alpha * (power - state.lock_den)
    state.power += alpha * (power / (2.0 * duration) - state.power)
    indicator = state.lock_num / max(state.lock_den, 0.5)
    seen = state.lock_den > 3.0 * 2.0 * math.sqrt(duration / (2.0 * 0.25))  # 3 sigma of noise
    clear = indicator > config.lock_threshold and seen
    if state.phase_lock == 0 and clear and state.mode_epochs > 3:
        state.phase_lock = 1
    elif state.phase_lock == 1 and indicator < config.unlock_threshold:
        state.phase_lock = 0
    fast_cn0 = 10.0 * math.log10(max(state.power, 1.0))
    if state.code_lock == 0 and fast_cn0 > config.code_lock_dbhz:
        state.code_lock = 1
    elif state.code_lock == 1 and fast_cn0 < config.loss_dbhz:
        state.code_lock = 0
    if state.narrow_wide < 0.0:
        state.cn0 = fast_cn0
    state.weak_s = 0.0 if state.code_lock == 1 else state.weak_s + duration
    state.unlocked_s = 0.0 if state.phase_lock == 1 else state.unlocked_s + duration


@njit(cache=True, nogil=True)
def update_cn0(state: Any, prompts: np.ndarray) -> None:
    """Narrow-to-wide power ratio over one data bit, averaged 1 s (Van Dierendonck 1996)."""
    count = prompts.shape[0]
    if count < 2:  # no ratio to take: the power estimate of `update_locks` stays
        state.cn0 = 10.0 * math.log10(max(state.power, 1.0))
        return
    total_i, total_q, wide, cross_i, cross_q = 0.0, 0.0, 0.0, 0.0, 0.0
    for m in range(count):
        i, q = prompts[m, 0], prompts[m, 1]
        total_i += i
        total_q += q
        wide += i * i + q * q
        if m > 0:
            cross_i += i * prompts[m - 1, 0] + q * prompts[m - 1, 1]
            cross_q += q * prompts[m - 1, 0] - i * prompts[m - 1, 1]
    duration = count * PERIOD_S
    state.cross_i += min(1.0, duration / 0.4) * (cross_i - state.cross_i)
    state.cross_q += min(1.0, duration / 0.4) * (cross_q - state.cross_q)
    ratio = (total_i * total_i + total_q * total_q) / wide
    if state.narrow_wide < 0.0:
        state.narrow_wide = ratio
    state.narrow_wide += max(duration, 1.0 / (2.0 + state.mode_epochs)) * (
        ratio - state.narrow_wide
    )
    mean = min(max(state.narrow_wide, 1.0 + 1e-3), count - 1e-3)
    state.cn0 = 10.0 * math.log10((mean - 1.0) / (count - mean) / PERIOD_S)
