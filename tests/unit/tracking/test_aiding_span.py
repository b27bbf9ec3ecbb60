"""Knots joined over messages, and the two ways to read them: values, and growth by the rates."""

import dataclasses

import numpy as np
import pytest

from deepseis_core.types import Aiding
from deepseis_tracking.aiding_span import AidingSpan, AidLimits
from deepseis_tracking.channel_state import CONFIG, STATE
from deepseis_tracking.nco import aid_at, aid_growth, switch_off, switch_on

RATE = 4e6
STEP = 4000
LIMITS = AidLimits(5.0, 0.25)


def doppler(t):
    """Of 2 g at 2 Hz [Hz]."""
    return 8.2 * np.sin(4 * np.pi * t)


def rate(t):
    return 8.2 * 4 * np.pi * np.cos(4 * np.pi * t)


def message(block, **changes):
    first = 80_000 * block
    knots = first + STEP * np.arange(21)
    t = knots / RATE
    made = Aiding(
        "truth", first, first + 79_999, True, first, STEP, 21, ("G07",),
        doppler(t)[None], rate(t)[None], float("nan"), np.zeros(1, np.float32),
    )  # fmt: skip
    return dataclasses.replace(made, **changes)


@pytest.fixture
def span():
    made = AidingSpan(RATE)
    for block in range(100):
        made.take(message(block), "G07", LIMITS)
    return made


def test_a_second_of_the_past_is_kept(span):
    count, first = len(span.knots), int(span.record["first"][0])
    assert first + (count - 1) * STEP == 100 * 80_000
    assert 1.2 <= count * STEP / RATE < 1.25
    t = (first + STEP * np.arange(count)) / RATE
    np.testing.assert_array_equal(span.knots, doppler(t))


def test_values_are_cubics_and_growth_is_the_integral_of_the_rates(span):
    samples = np.random.default_rng(1).uniform(7.2e6, 8e6, 200)
    aid = span.record[0]
    for begin, end in np.sort(samples.reshape(-1, 2), axis=1):
        value = aid_at(begin, aid, span.knots, span.rates, RATE)
        assert value == pytest.approx(doppler(begin / RATE), abs=1e-7)
        grown = aid_growth(begin, end, aid, span.rates, RATE)
        # Straight lines between rates: (w 1 ms)^2 / 12 of them
        exact = doppler(end / RATE) - doppler(begin / RATE)
        assert grown == pytest.approx(exact, abs=16.4 * (4e-3 * np.pi) ** 2 / 12)


def test_beyond_the_knots_the_rate_stays(span):
    aid, last = span.record[0], 100 * 80_000
    for way in (-1, 1):
        edge = last if way > 0 else int(aid["first"])
        value = span.knots[-1] if way > 0 else span.knots[0]
        slope = span.rates[-1] if way > 0 else span.rates[0]
        far = edge + way * 12_000
        assert aid_at(far, aid, span.knots, span.rates, RATE) == pytest.approx(
            value + way * slope * 0.003
        )
        begin, end = sorted((edge, far))
        assert aid_growth(begin, end, aid, span.rates, RATE) == pytest.approx(slope * 0.003)


def test_growth_over_time_that_was_not_covered_is_not_made_up(span):
    assert span.growth(0, 8_000_000) == 0.0
    assert span.growth(6_000_000, 8_000_000) == pytest.approx(
        doppler(2.0) - doppler(1.5), abs=1e-3
    )


def test_knots_after_a_hole_begin_anew(span):
    span.take(message(100, valid=False), "G07", LIMITS)
    assert not span.valid
    span.take(message(103), "G07", LIMITS)
    assert span.valid
    assert int(span.record["first"][0]) == 103 * 80_000


def plus(hertz, block):
    return message(block, carrier_doppler_hz=message(block).carrier_doppler_hz + hertz)


def test_single_steps_are_kept_out(span):
    hertz = {100: 6.0, 101: 6.1, 150: -2.0}
    offset, told = 0.0, []
    for block in range(100, 160):
        offset = hertz.get(block, offset)
        told.append(span.take(plus(offset, block), "G07", LIMITS))
    assert [k for k, what in enumerate(told) if what] == [0, 50]
    assert span.valid
    t = (int(span.record["first"][0]) + STEP * np.arange(len(span.knots))) / RATE
    late = np.where(t >= 101 * 0.02, 0.1, 0.0)  # what was not kept out
    np.testing.assert_allclose(span.knots, doppler(t) + late, atol=1e-9)


def test_corrections_of_a_drift_are_followed(span):
    """A filter whose IMU clips drifts, and is put right again and again."""
    growing = 1.0 * np.linspace(0.0, 1.0, 21)[None]
    for block in range(100, 200):
        told = message(block)
        drifting = dataclasses.replace(told, carrier_doppler_hz=told.carrier_doppler_hz + growing)
        assert (span.take(drifting, "G07", LIMITS) == "stepped") == (block == 101)
    assert span.offset_hz == pytest.approx(1.0)


def test_aiding_that_begins_anew_is_what_it_says(span):
    span.take(plus(6.0, 100), "G07", LIMITS)
    assert span.take(message(101, valid=False), "G07", LIMITS) == "invalid"
    assert span.take(plus(6.0, 102), "G07", LIMITS) == ""
    np.testing.assert_array_equal(span.knots, plus(6.0, 102).carrier_doppler_hz[0])


def test_beyond_a_hole_a_swing_is_no_step_and_a_step_is(span):
    for block, hertz in ((101, 0.0), (104, 1.0), (106, 12.0)):
        told = span.take(plus(hertz, block), "G07", LIMITS)
        assert told == ("stepped" if hertz == 12.0 else "")
    assert abs(span.offset_hz + 11.0) < 2.0


@pytest.mark.parametrize("form", [0, 1])
@pytest.mark.parametrize("epoch", [0, 4_000_000])
@pytest.mark.parametrize("clock", [np.nan, -126.0])
def test_switching_on_and_off_leaves_the_frequency_as_it_is(span, form, epoch, clock):
    state, config = (np.zeros(1, kind).view(np.recarray)[0] for kind in (STATE, CONFIG))
    config.acceleration_form, config.reset_samples = form, epoch
    state.mode, state.nco_hz, state.slope_hz = 3, 1500.25, 1500.0
    span.record["clock_hz"] = clock
    switch_on(state, config, span.record.view(np.recarray)[0], 400.0)
    assert state.mode == 4
    aid = 0.0 if form else 400.0
    assert state.nco_hz + state.clock_hz + aid == pytest.approx(1500.25, abs=1e-9)
    if not form:
        frozen = clock if np.isfinite(clock) else (1100.0 if epoch else 0.0)
        assert state.clock_hz == pytest.approx(frozen)
    switch_off(state, config, 400.0, 7.0)
    assert (state.mode, state.clock_hz) == (3, 0.0)
    assert (state.nco_hz, state.slope_hz) == pytest.approx((1500.25, 1500.0), abs=1e-9)
