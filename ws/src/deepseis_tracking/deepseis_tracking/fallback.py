"""A loop whose aiding is away: a design that follows the motion by itself (compiled).

An aided loop integrates for 20 ms and is narrow, for the aiding moves its NCO. Alone it loses 2 g
within some tenths of a second. So at the first data bit edge where the aiding is away it becomes a
loop of order 3 with short integrations, which takes frequency and acceleration over; it becomes an
aided loop again at a bit edge, when aiding has agreed with its own phase for a while. Decided by
sample and by what is known there, so a recording gives the same decisions again.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from deepseis_tracking.nco import PERIOD_S, TRACK, TRACK_AIDED, aid_at, may_be_aided, switch_off

AGREED_S = 0.25
"""Aiding has to agree with the loop's own phase so long before it is used again [s]: aiding that
stands still could do so at a swing's turning point, but not through half a swing of 2 Hz."""
PIECE_S = 0.05
"""Compared are means of so long [s]."""
AGREED_HZ = 3.0
"""Greatest difference of what it lacks in them [Hz]: noise makes 1.5 Hz of it at 34 dB-Hz."""
HYSTERESIS_DB = 1.0
"""Below the C/N0 from which on a short integration holds enough signal."""


@njit(cache=True, nogil=True)
def integration_periods(state: Any, config: Any) -> int:
    """Code periods of the coming integration."""
    if state.mode < TRACK:
        return 1
    return config.fallback_periods if state.fallback == 1 else config.periods


@njit(cache=True, nogil=True)
def choose_design(state: Any, config: Any, aid: Any, knots: np.ndarray, rates: np.ndarray) -> None:
    """At a bit edge, change into the fallback design or back; else nothing.

    Not before there has been aiding: a receiver without it, and one that still waits for its
    first, has the conventional loop.
    """
    if config.fallback_periods == 0 or state.mode < TRACK:
        return
    if state.bit_offset < 0 or state.period_count % 20 != state.bit_offset:
        return
    if state.fallback == 0:
        away = aid.valid == 0 or (state.mode == TRACK and not may_be_aided(state))
        if away and aid.through >= 0 and state.cn0 >= config.weak_dbhz:
            _fall_back(state, config, aid, knots, rates)
    elif state.cn0 < config.weak_dbhz - HYSTERESIS_DB:
        _end(state, config)
    elif aid.valid == 1 and state.next_sample >= aid.first and may_be_aided(state):
        if state.agreed_s >= AGREED_S - 0.5 * PERIOD_S:
            _come_back(state, config, aid, knots, rates)
        elif state.phase_lock == 0 and state.aid_held == 0:
            _end(state, config)  # it has lost the signal: aiding can only help


@njit(cache=True, nogil=True)
def _rescale(state: Any, ratio: float) -> None:
    """Mean powers are those of an integration: of one that is ``ratio`` as long from now on."""
    state.lock_num *= ratio
    state.lock_den *= ratio
    state.brief *= ratio
    state.usual *= ratio


@njit(cache=True, nogil=True)
def _advance_filter(state: Any, seconds: float) -> None:
    """Let the loop filter hold what it does for an integration longer by so much.

    Its output is the mean frequency of the coming integration, its integrator that at the end.
    """
    state.slope_hz += state.accel * seconds
    state.nco_hz += 0.5 * state.accel * seconds


@njit(cache=True, nogil=True)
def _fall_back(state: Any, config: Any, aid: Any, knots: np.ndarray, rates: np.ndarray) -> None:
    period, short = config.periods * PERIOD_S, config.fallback_periods * PERIOD_S
    if state.mode == TRACK_AIDED:
        start = float(state.next_sample)
        here = aid_at(start, aid, knots, rates, config.sample_rate)
        then = aid_at(start + PERIOD_S * config.sample_rate, aid, knots, rates, config.sample_rate)
        switch_off(state, config, here, 0.0)
        state.accel = (then - here) / PERIOD_S
        _advance_filter(state, short)
    else:
        _advance_filter(state, short - period)
    _rescale(state, short / period)
    state.fallback = 1
    state.fallback_count += 1
    state.agreed_s, state.piece_s = 0.0, 0.0


@njit(cache=True, nogil=True)
def _end(state: Any, config: Any) -> None:
    """Go on as a conventional loop."""
    period, short = config.periods * PERIOD_S, config.fallback_periods * PERIOD_S
    _advance_filter(state, period - short)
    if config.track_gains[2] == 0.0:
        state.accel = 0.0
    _rescale(state, period / short)
    state.fallback = 0


@njit(cache=True, nogil=True)
def _come_back(state: Any, config: Any, aid: Any, knots: np.ndarray, rates: np.ndarray) -> None:
    """Give the loop to the aiding: it keeps what the aiding has lacked on the mean.

    The wide loop's own frequency is noisy by hertz, which would throw a narrow one.
    """
    lacks = state.agreed_cycles / state.agreed_s
    _end(state, config)
    here = aid_at(float(state.next_sample), aid, knots, rates, config.sample_rate)
    state.accel = 0.0
    state.slope_hz = here + lacks
    state.nco_hz = here + lacks


@njit(cache=True, nogil=True)
def compare_aiding(
    state: Any,
    config: Any,
    aid: Any,
    knots: np.ndarray,
    rates: np.ndarray,
    begin: int,
    cycles: float,
) -> None:
    """Add up what aiding lacks of the cycles that an integration from ``begin`` on has had."""
    if state.fallback == 0 or aid.valid == 0 or begin < aid.first:
        state.agreed_s, state.piece_s = 0.0, 0.0
        return
    if state.piece_s == 0.0:
        state.piece_cycles = 0.0
    rate, samples = config.sample_rate, float(state.next_sample - begin)
    seconds = samples / rate
    first = aid_at(float(begin), aid, knots, rates, rate)
    middle = aid_at(begin + 0.5 * samples, aid, knots, rates, rate)
    last = aid_at(begin + samples, aid, knots, rates, rate)
    state.piece_s += seconds
    state.piece_cycles += cycles - seconds * (first + 4.0 * middle + last) / 6.0
    if state.piece_s >= PIECE_S - 0.5 * PERIOD_S:
        _add_piece(state)


@njit(cache=True, nogil=True)
def _add_piece(state: Any) -> None:
    """Add a mean to those before; begin anew with it if they do not agree."""
    lacks = state.piece_cycles / state.piece_s
    if state.agreed_s > 0.0:
        state.least_hz = min(state.least_hz, lacks)
        state.most_hz = max(state.most_hz, lacks)
    if state.agreed_s == 0.0 or state.most_hz - state.least_hz > AGREED_HZ:
        state.least_hz, state.most_hz = lacks, lacks
        state.agreed_s, state.agreed_cycles = 0.0, 0.0
    state.agreed_s += state.piece_s
    state.agreed_cycles += state.piece_cycles
    state.piece_s = 0.0


@njit(cache=True, nogil=True)
def gather(state: Any, config: Any, prompts: np.ndarray, first_period: int) -> bool:
    """Keep the 1 ms prompts of a short integration; tell whether a normal one is full.

    C/N0 and residual Doppler are measured over as many as in a normal integration.
    """
    count = prompts.shape[0]
    place = (first_period - state.bit_offset) % config.periods
    for m in range(count):
        state.recent_i[place + m] = prompts[m, 0]
        state.recent_q[place + m] = prompts[m, 1]
    return place + count == config.periods


@njit(cache=True, nogil=True)
def gathered(state: Any, config: Any) -> np.ndarray:
    """Return the prompts of a normal integration, shape (periods, 2)."""
    prompts = np.empty((config.periods, 2))
    prompts[:, 0] = state.recent_i[: config.periods]
    prompts[:, 1] = state.recent_q[: config.periods]
    return prompts
