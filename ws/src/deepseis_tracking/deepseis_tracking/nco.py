"""The carrier NCO of one integration: aiding as a parabola, the loop on top (compiled)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

TRACK, TRACK_AIDED = 3, 4


@njit(cache=True, nogil=True)
def aid_at(
    sample: float, knots: np.ndarray, rates: np.ndarray, first: int, step: int, rate_hz: float
) -> float:
    """Aiding Doppler at a sample [Hz]: cubic Hermite between knots, a line beyond the last."""
    position = (sample - first) / step
    last = knots.shape[0] - 1
    if position >= last:
        return knots[last] + rates[last] * (sample - first - last * step) / rate_hz
    if position <= 0.0:
        return knots[0] + rates[0] * (sample - first) / rate_hz
    index = int(position)
    x = position - index
    span = step / rate_hz
    x2, x3 = x * x, x * x * x
    return (
        (2 * x3 - 3 * x2 + 1) * knots[index]
        + (x3 - 2 * x2 + x) * span * rates[index]
        + (3 * x2 - 2 * x3) * knots[index + 1]
        + (x3 - x2) * span * rates[index + 1]
    )


@njit(cache=True, nogil=True)
def switch_aiding(state: Any, on: bool, aid_hz: float, aid_rate: float) -> None:
    """Begin or end aiding without a bump: the total frequency stays, and its rate at the end.

    With aiding on, the frequency integrator holds what the aiding does not explain: the clock.
    ``aid_rate`` [Hz/s] is what an order-3 loop takes over when aiding ends.
    """
    if on and state.mode == TRACK:
        state.mode = TRACK_AIDED
        state.slope_hz -= aid_hz
        state.nco_hz -= aid_hz
        state.accel = 0.0
    elif not on and state.mode == TRACK_AIDED:
        state.mode = TRACK
        state.slope_hz += aid_hz
        state.nco_hz += aid_hz
        state.accel = aid_rate


@njit(cache=True, nogil=True)
def plan_nco(
    state: Any,
    config: Any,
    row: Any,
    use_aid: bool,
    knots: np.ndarray,
    rates: np.ndarray,
    knot_first: int,
    knot_step: int,
    aid_through: int,
    duration: float,
) -> None:
    """NCO polynomial of the coming integration: aiding as a parabola, plus the loop's output."""
    rate_hz = config.sample_rate
    row.aid_doppler_hz = np.nan
    row.aid_age_s = 0.0
    start = float(state.next_sample)
    row.carrier_doppler_rate = 0.0
    row.carrier_doppler_accel = 0.0
    if not use_aid:
        row.carrier_doppler_hz = state.nco_hz
        return
    length = duration * rate_hz
    first = aid_at(start, knots, rates, knot_first, knot_step, rate_hz)
    middle = aid_at(start + 0.5 * length, knots, rates, knot_first, knot_step, rate_hz)
    last = aid_at(start + length, knots, rates, knot_first, knot_step, rate_hz)
    row.aid_doppler_hz = first
    row.aid_age_s = max(0.0, (start + length - 2.0 - aid_through) / rate_hz)
    row.carrier_doppler_hz = state.nco_hz + first
    row.carrier_doppler_rate = (-3.0 * first + 4.0 * middle - last) / duration
    row.carrier_doppler_accel = 2.0 * (first - 2.0 * middle + last) / (duration * duration)
