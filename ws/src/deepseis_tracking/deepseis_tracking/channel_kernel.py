"""One channel through the samples at hand: NCOs, correlators, discriminators, filters, locks.

Everything here is compiled and works on the records of `channel_state`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from deepseis_core.constants import CA_LENGTH, CA_RATE_CPS, L1_HZ
from deepseis_tracking.bit_sync import bits_in, clear_edge, resolve_bits, search_bit_edge
from deepseis_tracking.correlator import CARRIER_GROUP, correlate_period
from deepseis_tracking.discriminators import costas_atan, dll_envelope, frequency_error
from deepseis_tracking.fallback import (
    choose_design,
    compare_aiding,
    gather,
    gathered,
    integration_periods,
)
from deepseis_tracking.lock_detector import PERIOD_S, update_cn0, update_locks
from deepseis_tracking.nco import choose_aiding, plan_nco, plan_without_aiding
from deepseis_tracking.replica import MARGIN
from deepseis_tracking.slip_detector import is_quiet, may_have_slipped

IDLE, PULL_IN, BIT_SYNC, TRACK, TRACK_AIDED = 0, 1, 2, 3, 4
CODE_LOCK, PHASE_LOCK, BIT_SYNCED, POLARITY_KNOWN, SLIP = 1, 2, 4, 8, 16
AID_MISSED, AID_DIVERGED, GAP = 64, 128, 256
AIDED_RELOCK_S = 0.5
"""Aiding has misled a loop that lacks phase lock so long on a signal that is there [s]."""
LONGEST_WAIT_S = 64.0
"""Before aiding that has misled again and again is tried once more [s]."""
TRUSTED_S = 10.0
"""Aiding that has served so long has not failed "again" [s]."""
SETTLED_S = 0.4
"""The aided loop begins with the conventional gains, until it has been locked so long [s]."""
FAR_HZ = 12.0
"""Residual Doppler that a loop of 20 ms does not pull in."""
CARRIER_TO_CODE = CA_RATE_CPS / L1_HZ


@njit(cache=True, nogil=True)
def filter_carrier(
    state: Any, error: float, k1: float, k2: float, k3: float, period: float
) -> None:
    """One step of the loop filter (`loop_filter`): error in cycles, output ``nco_hz``."""
    accel = state.accel + k3 * error
    slope = state.slope_hz + k2 * error + 0.5 * period * (state.accel + accel)
    state.nco_hz = 0.5 * (state.slope_hz + slope) + k1 * error
    state.slope_before = state.slope_hz
    state.slope_hz = slope
    state.accel = accel


@njit(cache=True, nogil=True)
def _start_mode(state: Any, mode: int) -> None:
    state.mode = mode
    state.mode_epochs = 0
    state.fallback = 0
    if mode == BIT_SYNC:
        state.bit_energy[:] = 0.0
    if mode == TRACK:
        state.narrow = 0
        state.settled_s = 0.0
        state.mean_error = 0.0
        state.lock_num = 0.0
        state.lock_den = 0.0
        state.brief = 0.0
        state.usual = 0.0
        state.phase_lock = 0
        state.narrow_wide = -1.0
        state.cross_i = 0.0
        state.cross_q = 0.0


@njit(cache=True, nogil=True)
def _restart(state: Any, residual_hz: float) -> None:
    """Back to pull-in where the signal still is; transmit time survives, and with it bit edges."""
    _start_mode(state, PULL_IN)
    state.slope_hz += residual_hz
    state.nco_hz = state.slope_hz
    state.accel = 0.0
    state.phase_lock = 0
    state.unlocked_s = 0.0
    state.polarity = 0
    state.weak = 1 if state.weak > 0 else 0
    state.bit_sums = 0
    state.bit_energy[:] = 0.0
    state.clock_hz = 0.0
    state.pending_flags |= SLIP
    if state.transmit_ms < 0:
        state.bit_offset = -1  # no subframe has confirmed it


@njit(cache=True, nogil=True)
def bridge(states: np.ndarray, configs: np.ndarray, sample_index: int, doppler_hz: float) -> None:
    """Go on behind missing samples: at the first code period from ``sample_index`` on.

    Code phase, transmit time and bit edges are carried over at a constant Doppler; a phase is to
    be pulled in anew. A signal that is not there is given up as soon as its power says so.
    """
    state, config = states[0], configs[0]
    chips = (CA_RATE_CPS + doppler_hz * CARRIER_TO_CODE) / config.sample_rate
    missing = sample_index - state.next_sample
    periods = math.ceil((state.code_phase + missing * chips) / CA_LENGTH)
    count = math.ceil((periods * CA_LENGTH - state.code_phase) / chips)
    state.code_phase += count * chips - periods * CA_LENGTH
    state.next_sample += count
    state.carrier_phase += count * doppler_hz / config.sample_rate
    state.period_count += periods
    state.transmit_ms = (state.transmit_ms + periods) % 604_800_000
    state.slope_hz = 0.0
    _restart(state, doppler_hz)
    state.code_slope = 0.0
    state.weak_s = 0.0
    state.power = min(state.power, 10.0 ** (0.1 * config.code_lock_dbhz))
    state.pending_flags |= GAP


@njit(cache=True, nogil=True)
def _restart_tracking(state: Any, residual_hz: float) -> None:
    """Pull in again, without aiding: ``residual_hz`` holds its Doppler. Then try the other way."""
    failed_aided = state.mode == TRACK_AIDED
    _restart(state, residual_hz)
    state.aid_held = 1 if failed_aided else 0
    if failed_aided:
        state.pending_flags |= AID_DIVERGED
        if state.aided_s > TRUSTED_S:
            state.aid_failures = 0
        wait = 2.0**state.aid_failures if state.aid_failures > 0 else 0.0
        state.aid_wait_s = min(wait, LONGEST_WAIT_S)
        state.aid_failures = min(state.aid_failures + 1, 10)
        state.aided_s = 0.0


@njit(cache=True, nogil=True)
def _after_integration(
    state: Any, config: Any, row: Any, sums: np.ndarray, shift: float, periods: int
) -> None:
    """Discriminators, filters, mode changes after one integration; fills ``row``."""
    scale = 1.0 / (state.noise * math.sqrt(row.sample_count))
    i, q = sums[2] * scale, sums[3] * scale
    period = periods * PERIOD_S
    error = costas_atan(i, q)
    early = math.hypot(sums[0], sums[1])
    late = math.hypot(sums[4], sums[5])
    code_error = dll_envelope(early, late, config.spacing) - shift
    tracking = state.mode >= TRACK
    row.early_i, row.early_q = sums[0] * scale, sums[1] * scale
    row.prompt_i, row.prompt_q = i, q
    row.late_i, row.late_q = sums[4] * scale, sums[5] * scale
    row.carrier_error_cycles = error
    row.code_error_chips = code_error
    update_locks(state, config, i, q, period)
    state.aid_wait_s = max(0.0, state.aid_wait_s - period)
    if tracking:
        _note_lock(state, config, period)
        narrow = state.mode == TRACK_AIDED and state.narrow == 1
        gains = config.aided_gains if narrow else config.track_gains
        if state.fallback == 1:
            gains = config.fallback_gains
        power = i * i + q * q - 2.0
        quiet = is_quiet(state, power, period)
        followed = 0.0 if quiet else error
        filter_carrier(state, followed, gains[0], gains[1], gains[2], period)
        state.code_slope = config.dll_gain * code_error
        slipped = may_have_slipped(state, error, power, period, quiet)
        if slipped and state.phase_lock == 1:
            state.pending_flags |= SLIP
        if state.phase_lock == 0 or state.pending_flags & SLIP:
            state.polarity = 0  # half a cycle may be lost: the next subframe tells
    elif state.weak > 0:
        state.phase_lock = 0  # the phase turns: what looks like lock is none
        state.code_slope = config.dll_fast_gain * code_error
    else:
        if state.mode == PULL_IN and state.mode_epochs > 0:
            drift = frequency_error(i, q, state.last_i, state.last_q, period)
            state.slope_hz += config.fll_gain * drift
        filter_carrier(
            state, error, config.pull_gains[0], config.pull_gains[1], config.pull_gains[2], period
        )
        state.code_slope = config.dll_fast_gain * code_error
    state.last_i, state.last_q = i, q
    row.cn0_dbhz = state.cn0
    row.phase_lock_indicator = state.lock_num / max(state.lock_den, 0.5)
    flags = row.flags | state.pending_flags
    state.pending_flags = 0
    if state.code_lock == 1:
        flags |= CODE_LOCK
    if state.phase_lock == 1:
        flags |= PHASE_LOCK
    else:
        flags |= SLIP
    if state.bit_offset >= 0:
        flags |= BIT_SYNCED
    if state.polarity != 0:
        flags |= POLARITY_KNOWN
    row.flags = flags


@njit(cache=True, nogil=True)
def _note_lock(state: Any, config: Any, period: float) -> None:
    """Note in phase lock how the next pull-in is to be, and when an aided loop may be narrow."""
    if state.phase_lock == 0:
        state.settled_s = 0.0
        return
    state.settled_s += period
    state.weak = 1 if state.cn0 < config.weak_dbhz else 0
    if state.mode == TRACK_AIDED:
        state.aided_s += period
        if state.narrow == 0 and state.settled_s > SETTLED_S:
            state.narrow = 1
            state.accel = 0.0


@njit(cache=True, nogil=True)
def _pull_in_weak(state: Any, config: Any, stretch: np.ndarray, at_edge: bool) -> None:
    """Pull in where 1 ms holds too little signal for a loop: the NCO runs free (`resolve_bits`).

    ``stretch`` holds the prompts since the last look.
    """
    if state.weak == 2:
        if at_edge:
            state.unlocked_s = 0.0
            _start_mode(state, TRACK)
        return
    count = stretch.shape[0]
    if state.mode_epochs % count != 0:
        return
    first_period = state.period_count - count
    state.slope_hz += resolve_bits(stretch, first_period, state.bit_offset, state.bit_energy)
    state.nco_hz = state.slope_hz
    state.bit_sums += bits_in(count)
    if state.bit_offset < 0:
        state.bit_offset = clear_edge(state.bit_energy, state.bit_sums)
    if state.bit_offset >= 0:
        state.weak = 2
    elif state.mode_epochs >= config.pull_in_epochs + config.bit_sync_epochs:
        _restart(state, 0.0)


@njit(cache=True, nogil=True)
def _far_limit(state: Any, config: Any) -> float:
    """Residual Doppler that is too much for the loop, and 3 sigma of its own noise [Hz].

    The lag-1 product of prompts of amplitude a in sigmas has the variance 2 + 2 a^2 a component;
    0.4 s hold some 760 independent ones.
    """
    if config.periods < 2:
        return FAR_HZ
    power = math.hypot(state.cross_i, state.cross_q) / (config.periods - 1)
    angle = math.sqrt((2.0 + 2.0 * power) / 760.0) / max(power, 1e-3)
    return max(FAR_HZ, 3.0 * angle / (2.0 * math.pi * PERIOD_S))


@njit(cache=True, nogil=True)
def _misled(state: Any, config: Any) -> bool:
    """Whether the loop has been without phase lock too long."""
    if config.relock_s <= 0.0:
        return False
    begun = state.mode_epochs * config.periods * PERIOD_S > 1.0
    aided_on_signal = state.mode == TRACK_AIDED and state.code_lock == 1 and begun
    limit = min(config.relock_s, AIDED_RELOCK_S) if aided_on_signal else config.relock_s
    return state.unlocked_s > limit


@njit(cache=True, nogil=True)
def _change_mode(
    state: Any,
    config: Any,
    i: float,
    q: float,
    period_of_row: int,
    aid_hz: float,
    stretch: np.ndarray,
) -> None:
    """Decide what the channel does next; ``aid_hz`` is the aiding in use, 0 without."""
    at_edge = state.bit_offset >= 0 and state.period_count % 20 == state.bit_offset
    if state.mode == PULL_IN and state.weak > 0:
        _pull_in_weak(state, config, stretch, at_edge)
    elif state.mode == PULL_IN and state.mode_epochs >= config.pull_in_epochs:
        state.nco_hz = state.slope_hz
        _start_mode(state, BIT_SYNC)
    elif state.mode == BIT_SYNC:
        if state.bit_offset >= 0:
            if state.mode_epochs >= 60 and at_edge:
                state.nco_hz = state.slope_hz
                state.accel = 0.0
                _start_mode(state, TRACK)
        else:
            count = state.period_count
            state.period_count = period_of_row
            edge = search_bit_edge(state, i, q)
            state.period_count = count
            if edge >= 0:
                state.bit_offset = edge
            elif state.mode_epochs >= config.bit_sync_epochs:
                _restart(state, 0.0)
    elif state.mode >= TRACK:
        residual = math.atan2(state.cross_q, state.cross_i) / (2.0 * math.pi * PERIOD_S)
        far = abs(residual) > _far_limit(state, config) and state.phase_lock == 0
        far = far and config.relock_s > 0.0
        if state.mode_epochs > 25 and far:
            _restart_tracking(state, residual + aid_hz)
        elif _misled(state, config):
            _restart_tracking(state, aid_hz)
    if state.weak_s > config.loss_s:
        # Not even pulled in with aiding: try without it next time.
        state.aid_held = 1 if state.mode < TRACK and state.pull_in_aided == 1 else 0
        state.mode = IDLE
        state.pending_flags |= SLIP
        state.bit_offset = -1
        state.transmit_ms = -1
        state.polarity = 0


@njit(cache=True, nogil=True)
def advance(
    states: np.ndarray,
    configs: np.ndarray,
    baseband_i: np.ndarray,
    baseband_q: np.ndarray,
    buffer_start: int,
    buffer_end: int,
    rows: np.ndarray,
    chips_per_sample: float,
    aids: np.ndarray,
    knots: np.ndarray,
    rates: np.ndarray,
    history: np.ndarray,
    out: np.ndarray,
    aligned: np.ndarray,
) -> int:
    """Run every integration that ends inside the buffer.

    Parameters
    ----------
    states, configs : ndarray of STATE and CONFIG, shape (1,)
        The channel; the state is changed in place.
    baseband_i, baseband_q : ndarray of int8 or int16
        Samples ``buffer_start`` (inclusive) to ``buffer_end`` (exclusive).
    rows, chips_per_sample
        The satellite's `replica.ReplicaBank`.
    aids, knots, rates
        Aiding: a record of AID, shape (1,), Doppler [Hz] and rate [Hz/s] at its uniform knots.
    history : ndarray, shape (n, 2)
        The last prompts of an open-loop pull-in, which looks at them every n ms.
    out : ndarray of EPOCH, shape (n,)
        Room for the integrations.
    aligned : ndarray of int64, shape (n, 3)
        Of each integration: first code period, number of periods, 1 if aligned with data bits.

    Returns
    -------
    int
        Integrations done.
    """
    state, config, aid = states[0], configs[0], aids[0]
    phase_steps = rows.shape[0]
    sums = np.zeros(6)
    prompts = np.zeros((config.periods, 2))
    tap_rows, tap_columns = np.zeros(3, np.int64), np.zeros(3, np.int64)
    cosine, minus_sine = np.empty(CARRIER_GROUP, np.float32), np.empty(CARRIER_GROUP, np.float32)
    done = 0
    while state.mode != IDLE and done < out.shape[0]:
        choose_design(state, config, aid, knots, rates)
        periods = integration_periods(state, config)
        needed = int(periods * PERIOD_S * config.sample_rate) + 3
        if state.next_sample + needed > buffer_end or state.next_sample < buffer_start:
            break
        row = out[done]
        done += 1
        duration = periods * PERIOD_S
        row.flags = AID_MISSED if state.fallback == 1 else 0
        use_aid = choose_aiding(state, config, row, aid, knots, rates)
        grown = 0.0
        if use_aid:
            grown = plan_nco(state, config, row, aid, knots, rates, duration)
            if row.aid_age_s > 0.0:
                row.flags |= AID_MISSED
        else:
            plan_without_aiding(state, row)
        f0, f1, f2 = row.carrier_doppler_hz, row.carrier_doppler_rate, row.carrier_doppler_accel
        phase0 = state.carrier_phase
        row.sample_index = state.next_sample
        row.transmit_ms = state.transmit_ms
        row.code_phase_chips = state.code_phase
        row.carrier_phase_cycles = phase0
        first_period = state.period_count
        aligned[done - 1, 0] = first_period
        aligned[done - 1, 1] = periods
        aligned[done - 1, 2] = 1 if state.mode >= TRACK else 0
        sums[:] = 0.0
        code_phase = state.code_phase
        samples, shift, tau = 0, 0.0, 0.0
        for m in range(periods):
            mean_f = f0 + f1 * (tau + 0.5e-3) + f2 * (tau + 0.5e-3) ** 2
            code_rate = CA_RATE_CPS + mean_f * CARRIER_TO_CODE + state.code_slope
            chips = code_rate / config.sample_rate
            count = math.ceil((CA_LENGTH - code_phase) / chips)
            tau_end = (samples + count) / config.sample_rate
            phase = phase0 + tau * (f0 + tau * (0.5 * f1 + tau * f2 / 3.0))
            phase_end = phase0 + tau_end * (f0 + tau_end * (0.5 * f1 + tau_end * f2 / 3.0))
            wanted = code_phase + 0.5 * count * (chips - chips_per_sample)
            step = round(wanted / chips_per_sample * phase_steps)
            shift += wanted - step * chips_per_sample / phase_steps
            for tap in range(3):
                tap_step = step + (1 - tap) * config.tap_offset
                tap_rows[tap] = tap_step % phase_steps
                tap_columns[tap] = MARGIN + tap_step // phase_steps
            before_i, before_q = sums[2], sums[3]
            correlate_period(
                baseband_i,
                baseband_q,
                state.next_sample + samples - buffer_start,
                count,
                rows,
                tap_rows,
                tap_columns,
                phase,
                (phase_end - phase) / count,
                cosine,
                minus_sine,
                sums,
            )
            prompts[m, 0], prompts[m, 1] = sums[2] - before_i, sums[3] - before_q
            code_phase += count * chips - CA_LENGTH
            samples += count
            tau = tau_end
        seconds = samples / config.sample_rate
        aid_end = f0 + seconds * (f1 + seconds * f2) - state.nco_hz - grown if use_aid else 0.0
        state.slope_hz += grown
        state.nco_hz += grown
        row.sample_count = samples
        row.code_rate_cps = (code_phase + periods * CA_LENGTH - state.code_phase) / seconds
        state.code_phase = code_phase
        state.carrier_phase = phase0 + seconds * (f0 + seconds * (0.5 * f1 + seconds * f2 / 3.0))
        state.next_sample += samples
        state.period_count += periods
        if state.transmit_ms >= 0:
            state.transmit_ms = (state.transmit_ms + periods) % 604_800_000
        compare_aiding(
            state, config, aid, knots, rates, row.sample_index, state.carrier_phase - phase0
        )
        epoch = state.mode_epochs
        if state.fallback == 1:
            full = gather(state, config, prompts[:periods], first_period)
            if full:
                update_cn0(state, gathered(state, config))
        else:
            full = True
            if state.mode >= TRACK:
                update_cn0(state, prompts[:periods])
        _after_integration(state, config, row, sums, shift / periods, periods)
        state.mode_epochs += 1 if full else 0
        if state.mode == PULL_IN and state.weak == 1:
            history[epoch % history.shape[0], 0] = row.prompt_i
            history[epoch % history.shape[0], 1] = row.prompt_q
        aid_end = aid_end if state.mode == TRACK_AIDED else 0.0
        _change_mode(state, config, row.prompt_i, row.prompt_q, first_period, aid_end, history)
    return done
