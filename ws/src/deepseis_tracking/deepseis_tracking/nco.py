"""The carrier NCO of one integration: aiding as a parabola, the loop on top (compiled).

Two forms of aiding (Doppler-aided 2.1, 2.2):

- *velocity*: the NCO runs at aiding Doppler + clock + loop output; the loop filter holds what the
  aiding does not explain.
- *acceleration*: the loop filter holds the whole frequency; what the Doppler grows over an
  integration, by the *rates* at the knots, is added to it. Steps of the Doppler do not enter.

Pull-in is aided in the second form always: it needs nothing but a frequency to start from.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

PULL_IN, TRACK, TRACK_AIDED = 1, 3, 4
AID_MISSED = 64
PERIOD_S = 1e-3


@njit(cache=True, nogil=True)
def aid_at(sample: float, aid: Any, knots: np.ndarray, rates: np.ndarray, rate_hz: float) -> float:
    """Aiding Doppler at a sample [Hz]: cubic Hermite between knots, a line beyond the last."""
    position = (sample - aid.first) / aid.step
    last = knots.shape[0] - 1
    if position >= last:
        return knots[last] + rates[last] * (sample - aid.first - last * aid.step) / rate_hz
    if position <= 0.0:
        return knots[0] + rates[0] * (sample - aid.first) / rate_hz
    index = int(position)
    x = position - index
    span = aid.step / rate_hz
    x2, x3 = x * x, x * x * x
    return (
        (2 * x3 - 3 * x2 + 1) * knots[index]
        + (x3 - 2 * x2 + x) * span * rates[index]
        + (3 * x2 - 2 * x3) * knots[index + 1]
        + (x3 - x2) * span * rates[index + 1]
    )


@njit(cache=True, nogil=True)
def aid_growth(begin: float, end: float, aid: Any, rates: np.ndarray, rate_hz: float) -> float:
    """Growth of the Doppler from one sample to another [Hz]: the rates' integral.

    Rates are straight lines between knots and constant beyond the first and the last.
    """
    last = rates.shape[0] - 1
    total, position = 0.0, (begin - aid.first) / aid.step
    stop = (end - aid.first) / aid.step
    if position < 0.0:
        total += rates[0] * (min(0.0, stop) - position)
        position = 0.0
    while position < stop and position < last:
        index = int(position)
        until = min(stop, index + 1.0)
        slope = rates[index + 1] - rates[index]
        total += (rates[index] + slope * (0.5 * (position + until) - index)) * (until - position)
        position = until
    if position < stop:
        total += rates[last] * (stop - position)
    return total * aid.step / rate_hz


@njit(cache=True, nogil=True)
def switch_on(state: Any, config: Any, aid: Any, aid_hz: float) -> None:
    """Begin aiding without a bump: the total frequency stays.

    Velocity form: the oscillator's part is frozen at what the aiding says now (thesis 4.1). If it
    does not say, the frequency integrator goes on holding it; with the policy ``reset``, which
    clears that, it is what the integrator holds now.
    """
    state.mode = TRACK_AIDED
    state.accel = 0.0
    if config.acceleration_form == 1:
        return
    state.clock_hz = 0.0
    if np.isfinite(aid.clock_hz):
        state.clock_hz = aid.clock_hz
    elif config.reset_samples > 0:
        state.clock_hz = state.slope_hz - aid_hz
    if config.reset_samples > 0:
        state.reset_epoch = state.next_sample // config.reset_samples
    state.slope_hz -= aid_hz + state.clock_hz
    state.slope_before = state.slope_hz
    state.nco_hz -= aid_hz + state.clock_hz


@njit(cache=True, nogil=True)
def switch_off(state: Any, config: Any, aid_hz: float, aid_rate: float) -> None:
    """End aiding without a bump; an order-3 loop takes over ``aid_rate`` [Hz/s]."""
    state.mode = TRACK
    if config.acceleration_form == 0:
        state.slope_hz += aid_hz + state.clock_hz
        state.nco_hz += aid_hz + state.clock_hz
    state.clock_hz = 0.0
    state.accel = aid_rate if config.track_gains[2] > 0.0 else 0.0


@njit(cache=True, nogil=True)
def _reset(state: Any, config: Any, aid: Any) -> None:
    """Policy ``reset`` (Doppler-aided 2.3): each aid epoch sets the base and clears the loop.

    Cleared is what had accumulated before the last update, so that the loop stays closed even
    where every integration begins an epoch.
    """
    epoch = state.next_sample // config.reset_samples
    if epoch != state.reset_epoch:
        state.reset_epoch = epoch
        if np.isfinite(aid.clock_hz):
            state.clock_hz = aid.clock_hz
        state.slope_hz -= state.slope_before
        state.nco_hz -= state.slope_before


@njit(cache=True, nogil=True)
def may_be_aided(state: Any) -> bool:
    """Whether aiding that is there may be used: after it has misled, only a settled loop's."""
    settled = state.phase_lock == 1 and state.mode_epochs > 10 and state.aid_wait_s <= 0.0
    return settled or state.aid_held == 0


@njit(cache=True, nogil=True)
def choose_aiding(
    state: Any, config: Any, row: Any, aid: Any, knots: np.ndarray, rates: np.ndarray
) -> bool:
    """Switch aiding on or off before an integration; tells whether it is used."""
    start = float(state.next_sample)
    covered = aid.valid == 1 and knots.shape[0] > 0 and start >= aid.first
    if state.mode < TRACK:
        in_time = start + PERIOD_S * config.sample_rate - 2.0 <= aid.through
        state.pull_in_aided = 1 if covered and in_time and state.aid_held == 0 else 0
        return state.pull_in_aided == 1
    if state.mode == TRACK and covered and state.fallback == 0:
        if may_be_aided(state):
            switch_on(state, config, aid, aid_at(start, aid, knots, rates, config.sample_rate))
    elif state.mode == TRACK_AIDED and aid.valid == 0:
        row.flags |= AID_MISSED
        here = aid_at(start, aid, knots, rates, config.sample_rate)
        next_ms = start + PERIOD_S * config.sample_rate
        then = aid_at(next_ms, aid, knots, rates, config.sample_rate)
        switch_off(state, config, here, (then - here) / PERIOD_S)
    if state.mode == TRACK_AIDED and config.reset_samples > 0:
        _reset(state, config, aid)
    return state.mode == TRACK_AIDED


@njit(cache=True, nogil=True)
def plan_nco(
    state: Any,
    config: Any,
    row: Any,
    aid: Any,
    knots: np.ndarray,
    rates: np.ndarray,
    duration: float,
) -> float:
    """NCO polynomial of the coming aided integration.

    Returns
    -------
    float
        What to add to the loop's frequency at its end [Hz]: 0 in the velocity form.
    """
    rate_hz, start = config.sample_rate, float(state.next_sample)
    length = duration * rate_hz
    first = aid_at(start, aid, knots, rates, rate_hz)
    row.aid_doppler_hz = first
    row.aid_age_s = max(0.0, (start + length - 2.0 - aid.through) / rate_hz)
    by_growth = state.mode != TRACK_AIDED or config.acceleration_form == 1
    if by_growth:
        first, base = 0.0, state.nco_hz
        middle = aid_growth(start, start + 0.5 * length, aid, rates, rate_hz)
        last = middle + aid_growth(start + 0.5 * length, start + length, aid, rates, rate_hz)
    else:
        base = state.nco_hz + state.clock_hz
        middle = aid_at(start + 0.5 * length, aid, knots, rates, rate_hz)
        last = aid_at(start + length, aid, knots, rates, rate_hz)
    row.carrier_doppler_hz = base + first
    row.carrier_doppler_rate = (-3.0 * first + 4.0 * middle - last) / duration
    row.carrier_doppler_accel = 2.0 * (first - 2.0 * middle + last) / (duration * duration)
    return last if by_growth else 0.0


@njit(cache=True, nogil=True)
def plan_without_aiding(state: Any, row: Any) -> None:
    """NCO of an integration without aiding: the loop's output."""
    row.aid_doppler_hz = np.nan
    row.aid_age_s = 0.0
    row.carrier_doppler_hz = state.nco_hz
    row.carrier_doppler_rate = 0.0
    row.carrier_doppler_accel = 0.0
