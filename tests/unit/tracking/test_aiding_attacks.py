"""Aiding that is wrong, missing or flickering: the channel says so, the phase does not jump."""

import dataclasses

import numpy as np
import pytest
from unit.tracking.one_signal import (
    RATE,
    Signal,
    aiding_of,
    circle,
    column,
    half_cycle_free,
    phase_error,
    track,
)

from deepseis_core.types import TrackingFlag, TrackingMode
from deepseis_tracking.aiding_span import REASONS
from deepseis_tracking.channel import TrackingConfig

FROM = 100
"""Block from which the aiding is attacked: 2 s."""
LIMIT = np.sqrt(8 / 10**4.7) / (2 * np.pi)
"""Thermal sigma of the aided loop at 47 dB-Hz [cycles]."""
CONVENTIONAL = {"fallback_ms": 0}
"""Settings of a loop that goes on as it is where aiding is away (else: `test_fallback`)."""


@pytest.fixture(scope="module")
def still():
    return Signal()


@pytest.fixture(scope="module")
def moving():
    return Signal(motion=circle)


def attacked(signal, change, seconds=5.0, **settings):
    """Track with aiding that ``change(block, aiding)`` alters from ``FROM`` on."""
    right = aiding_of(signal)

    def aid(block):
        aiding = right(block)
        return change(block, aiding) if block >= FROM else aiding

    return track(signal, seconds, TrackingConfig(**settings), aid)


def shifted(aiding, hertz, rate=0.0):
    return dataclasses.replace(
        aiding,
        carrier_doppler_hz=aiding.carrier_doppler_hz + hertz,
        carrier_doppler_rate=aiding.carrier_doppler_rate + rate,
    )


def errors(signal, epochs, after=2.0):
    """Phase errors of 20 ms integrations from a time on [cycles]."""
    whole = column(epochs, "sample_count") > 0.015 * RATE
    late = column(epochs, "sample_index")[whole] > after * RATE
    return half_cycle_free(phase_error(signal, epochs)[late])


def flagged(epochs, flag, after=1.95):
    late = column(epochs, "sample_index") > after * RATE
    return int(np.sum((column(epochs, "flags")[late] & flag) != 0))


@pytest.mark.parametrize("form", ["velocity", "acceleration"])
@pytest.mark.parametrize(
    ("reason", "change"),
    [
        ("invalid", lambda _, a: dataclasses.replace(a, valid=False)),
        ("invalid", lambda _, a: dataclasses.replace(a, satellites=("G08",))),
        ("invalid", lambda _, a: shifted(a, np.nan)),
        ("invalid", lambda _, a: shifted(a, 0.0, np.inf)),
        ("uncertain", lambda _, a: dataclasses.replace(a, doppler_sd_hz=np.full(1, 6.0))),
        ("uncertain", lambda _, a: dataclasses.replace(a, doppler_sd_hz=np.full(1, np.nan))),
    ],
)
def test_aiding_that_is_no_use_is_dropped_counted_and_flagged_without_a_bump(
    still, reason, change, form
):
    channel, epochs = attacked(still, change, 3.0, aiding_form=form, **CONVENTIONAL)
    assert channel.mode == TrackingMode.TRACK
    assert channel.aid_dropped == dict.fromkeys(REASONS, 0) | {reason: 1}
    assert flagged(epochs, TrackingFlag.AID_MISSED) == 1
    assert flagged(epochs, TrackingFlag.SLIP) == 0
    frequency = column(epochs, "carrier_doppler_hz")
    missed = int(np.argmax((column(epochs, "flags") & TrackingFlag.AID_MISSED) != 0))
    noise = np.std(np.diff(frequency[missed - 20 : missed]))
    assert abs(frequency[missed] - frequency[missed - 1]) < 5 * noise


@pytest.mark.parametrize("form", ["velocity", "acceleration"])
@pytest.mark.parametrize("every", [2, 3, 7])
def test_flickering_aiding_does_not_move_the_phase(still, form, every):
    def flicker(block, aiding):
        return dataclasses.replace(aiding, valid=bool((block // every) % 2))

    settings = {
        "aiding_form": form,
        "pll_bandwidth_hz": 8.0,
        **CONVENTIONAL,
    }  # the same on and off
    _, epochs = attacked(still, flicker, 6.0, **settings)
    _, steady = attacked(still, lambda _, aiding: aiding, 6.0, **settings)
    assert flagged(epochs, TrackingFlag.AID_MISSED) >= 200 // (2 * every) - 1
    assert flagged(epochs, TrackingFlag.SLIP) == 0
    # The signal is the same to the sample: all that switching does shows in the difference.
    moved = errors(still, epochs) - errors(still, steady)
    assert np.abs(moved).max() < 0.2 * LIMIT


def test_what_the_clock_is_said_to_be_moves_nothing(still):
    """Thesis 4.1: frozen at the start of aiding; what changes is left to the loop."""
    values = [np.nan, 0.0, 700.0, np.nan, -3e3]

    def told(block, aiding):
        return dataclasses.replace(aiding, clock_drift_hz=values[block // 10 % len(values)])

    _, epochs = attacked(still, told, 4.0)
    _, silent = attacked(still, lambda _, aiding: aiding, 4.0)
    for name in ("carrier_doppler_hz", "carrier_phase_cycles"):
        np.testing.assert_allclose(column(epochs, name), column(silent, name), atol=1e-6)


def test_flickering_aiding_with_a_known_clock_does_not_move_the_phase(still):
    def told(block, aiding):
        known = dataclasses.replace(aiding, clock_drift_hz=100.0 * (block % 3))
        return dataclasses.replace(known, valid=block % 4 != 0)

    settings = {"pll_bandwidth_hz": 8.0, **CONVENTIONAL}
    _, epochs = attacked(still, told, 5.0, **settings)
    _, steady = attacked(still, lambda _, aiding: aiding, 5.0, **settings)
    assert np.abs(errors(still, epochs) - errors(still, steady)).max() < 0.2 * LIMIT


@pytest.mark.parametrize("form", ["velocity", "acceleration"])
@pytest.mark.parametrize("hertz", [0.5, 3.0, 5e3])
def test_steps_of_the_prediction_are_kept_out_and_counted(still, form, hertz):
    """A filter that corrects itself: the loop has held what the aiding had lacked."""

    def step(block, aiding):
        return shifted(aiding, hertz * (block // 25 % 2))

    channel, epochs = attacked(still, step, aiding_form=form)
    _, steady = attacked(still, lambda _, aiding: aiding, aiding_form=form)
    assert channel.aid_dropped == dict.fromkeys(REASONS, 0) | {"stepped": 5}
    assert channel.mode == TrackingMode.TRACK_AIDED
    assert np.abs(errors(still, epochs) - errors(still, steady)).max() < 1e-3 * LIMIT


def test_a_step_below_the_limit_is_followed_and_dies_away(still):
    """8 Hz, order 2: its peak is df / (e wn) (thesis 3.22)."""

    def step(_, aiding):
        return shifted(aiding, 3.0)

    channel, epochs = attacked(still, step, aid_step_limit_hz=3.5)
    assert channel.aid_dropped == dict.fromkeys(REASONS, 0)
    late = errors(still, epochs, 3.0)
    assert np.sqrt(np.mean(late**2)) < 1.5 * LIMIT
    assert np.abs(errors(still, epochs)[:50]).max() > 10 * LIMIT


@pytest.mark.parametrize("blocks", [1, 2])
def test_a_hole_in_the_aiding_of_a_shaken_antenna_is_no_step(moving, blocks):
    """Extrapolated with 2 g at 2 Hz, the Doppler is off by 1 Hz after 40 ms."""
    right = aiding_of(moving)

    def aid(block):
        return None if block >= FROM and block % 40 < blocks else right(block)

    channel, epochs = track(moving, 6.0, TrackingConfig(), aid)
    assert channel.aid_dropped == dict.fromkeys(REASONS, 0)
    assert flagged(epochs, TrackingFlag.SLIP) == 0


def test_drifting_aiding_leaves_the_error_that_the_order_leaves(still):
    def drift(block, aiding):
        t = aiding.knot_sample_index + aiding.knot_step_samples * np.arange(aiding.knot_count)
        return shifted(aiding, 4.0 * (t / RATE - 2.0), 4.0)

    channel, epochs = attacked(still, drift, 6.0)
    _, steady = attacked(still, lambda _, aiding: aiding, 6.0)
    k2 = float(channel.configs["aided_gains"][0][1])
    moved = (errors(still, epochs) - errors(still, steady))[-100:]
    # Ramp of 4 Hz/s against an integrator that gains k2 e a 20 ms step.
    assert moved.mean() == pytest.approx(4.0 * 0.02 / k2, rel=0.02)
    assert channel.mode == TrackingMode.TRACK_AIDED


WRONG = {
    "wrong sign": lambda _, a: shifted(dataclasses.replace(
        a, carrier_doppler_hz=-a.carrier_doppler_hz, carrier_doppler_rate=-a.carrier_doppler_rate
    ), 2 * 1234.5),
    "ten times": lambda _, a: dataclasses.replace(
        a, carrier_doppler_hz=10 * a.carrier_doppler_hz,
        carrier_doppler_rate=10 * a.carrier_doppler_rate,
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", WRONG)
def test_misleading_aiding_is_found_out_and_tried_ever_more_rarely(moving, kind):
    channel, epochs = attacked(moving, WRONG[kind], 9.0, loop_design="analog")
    assert channel.aid_dropped["diverged"] > 0
    assert flagged(epochs, TrackingFlag.AID_DIVERGED) == channel.aid_dropped["diverged"]
    assert channel.mode != TrackingMode.IDLE
    assert channel.lost == 0
    # 7 s, waits of 0, 2, 4, ... s after failures
    assert channel.aid_dropped["diverged"] <= 3


def test_frozen_aiding_is_found_out(moving):
    frozen = aiding_of(moving)(FROM + 60)  # the motion has begun

    def freeze(_, aiding):
        return dataclasses.replace(
            aiding,
            carrier_doppler_hz=np.broadcast_to(
                frozen.carrier_doppler_hz[:, :1], aiding.carrier_doppler_hz.shape
            ),
            carrier_doppler_rate=0 * aiding.carrier_doppler_rate,
        )

    channel, epochs = attacked(moving, freeze, 7.0, aided_bandwidth_hz=3.0)
    assert channel.aid_dropped["diverged"] > 0
    # The motion begins at 3 s; 0.3 s without lock at the most before the flag goes, then 0.5 s.
    flags, t = column(epochs, "flags"), column(epochs, "sample_index") / RATE
    unlocked = (flags & TrackingFlag.PHASE_LOCK) == 0
    diverged = (flags & TrackingFlag.AID_DIVERGED) != 0
    assert t[diverged][0] - t[unlocked & (t > 2.0)][0] < 0.6


def test_the_policy_reset_brings_the_same_transient_back_at_each_epoch(still):
    def offset(_, aiding):
        return dataclasses.replace(shifted(aiding, -0.5), clock_drift_hz=0.0)

    settings = {"aid_policy": "reset", "aid_epoch_ms": 1000}
    _, epochs = attacked(still, offset, 7.0, **settings)
    _, steady = attacked(still, lambda _, aiding: aiding, 7.0)
    moved = (errors(still, epochs, 3.0) - errors(still, steady, 3.0))[:150].reshape(3, 50)
    assert np.abs(moved).max() > 3 * LIMIT
    assert np.abs(moved - moved.mean(axis=0)).max() < 0.2 * np.abs(moved).max()


def test_reset_in_every_integration_is_a_loop_without_memory(still):
    def offset(_, aiding):
        return dataclasses.replace(shifted(aiding, -0.5), clock_drift_hz=0.0)

    channel, epochs = attacked(still, offset, 5.0, aid_policy="reset", aid_epoch_ms=1)
    k1, k2, _ = channel.configs["aided_gains"][0]
    mean = column(epochs, "carrier_error_cycles")[-100:].mean()
    # The frequency that the aiding lacks stands against k1 e + k2 e / 2.
    assert mean == pytest.approx(0.5 / (k1 + k2 / 2), rel=0.1)


def test_a_policy_that_needs_the_velocity_form_says_so():
    with pytest.raises(ValueError, match="velocity"):
        track(Signal(), 0.0, TrackingConfig(aid_policy="reset", aiding_form="acceleration"))
