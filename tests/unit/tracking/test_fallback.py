"""Loops whose aiding is away in the middle of a motion: they follow it by themselves."""

import dataclasses

import numpy as np
import pytest
from unit.tracking.one_signal import (
    BLOCK,
    RATE,
    Signal,
    aiding_of,
    circle,
    column,
    half_cycle_free,
    track,
)

from deepseis_core.types import TrackingFlag, TrackingMode
from deepseis_tracking.baseband_window import BasebandWindow
from deepseis_tracking.channel import Channel, TrackingConfig
from deepseis_tracking.loop_theory_discrete import DiscreteLoop
from deepseis_tracking.loop_theory_simulation import simulate_loop

GONE, BACK, END = 4.0, 5.3, 6.5
"""Aiding is away so long [s]; the circle of 2 g at 2 Hz turns from 3.5 s on."""
LEVEL = 43.0
"""C/N0 [dB-Hz]."""


@pytest.fixture(scope="module")
def moving():
    return Signal(LEVEL, motion=circle)


@pytest.fixture(scope="module")
def still():
    return Signal(LEVEL)


def away(aiding):
    """Aiding that says for a while that it is none."""

    def aid(block):
        missing = GONE <= block * 0.02 < BACK
        return dataclasses.replace(aiding(block), valid=False) if missing else aiding(block)

    return aid


def errors(signal, epochs):
    """Times [s], lengths [s] and phase errors at the middle [cycles] of all integrations."""
    start, length = column(epochs, "sample_index") / RATE, column(epochs, "sample_count") / RATE
    tau = length / 2
    f, f1, f2 = (column(epochs, f"carrier_doppler_{name}") for name in ("hz", "rate", "accel"))
    phase = column(epochs, "carrier_phase_cycles") + tau * (f + tau * (f1 / 2 + tau * f2 / 3))
    return start, length, phase - signal.phase_cycles(start + tau)


def rms(values):
    return float(np.sqrt(np.mean(values**2)))


def thermal(order, hertz, seconds):
    return float(DiscreteLoop.design(order, hertz, seconds).thermal_noise(LEVEL)) / (2 * np.pi)


@pytest.fixture(scope="module", params=["velocity", "acceleration"])
def gap(request, moving):
    """Channel, epochs, and a run whose aiding is always there."""
    config = TrackingConfig(aiding_form=request.param)
    channel, epochs = track(moving, END, config, away(aiding_of(moving)))
    return channel, epochs, track(moving, END, config, aiding_of(moving))[1]


def test_a_loop_without_aiding_keeps_2_g_and_takes_the_aiding_up_again(gap, moving):
    channel, epochs, steady = gap
    start, _, error = errors(moving, epochs)
    flags = column(epochs, "flags")
    locked = start > 2.0
    assert (flags[locked] & TrackingFlag.PHASE_LOCK).all()
    assert not (flags[locked] & TrackingFlag.SLIP).any()
    assert channel.mode == TrackingMode.TRACK_AIDED
    error = half_cycle_free(error)
    alone = (start > GONE + 0.1) & (start < BACK)
    truth = moving.motion(np.arange(GONE, BACK, 1e-4)) * 0.1903
    model = simulate_loop(
        DiscreteLoop.design(3, 50.0, 0.002).gains, 0.002, truth.reshape(-1, 20), LEVEL, seed=5
    )
    expected = rms(model.error[50:]) / (2 * np.pi)
    assert rms(error[alone]) == pytest.approx(expected, rel=0.2)
    assert np.abs(error[locked]).max() < 0.1
    # 0.25 s until the aiding is believed; then an 8 Hz loop forgets what the wide one has left
    after = error[start > BACK + 0.5]
    assert rms(after) < 1.5 * rms(half_cycle_free(errors(moving, steady)[2])[-after.size :])


def test_the_change_is_at_bit_edges_flagged_and_counted(gap):
    channel, epochs, _ = gap
    start, length = column(epochs, "sample_index") / RATE, column(epochs, "sample_count") / RATE
    flags = column(epochs, "flags")
    short = (length < 0.015) & (start > 2.0)
    assert start[short][0] - GONE < 0.0201
    assert 0.24 < start[short][-1] - BACK < 0.28
    assert length[short] == pytest.approx(0.002, abs=2e-6)
    assert (np.diff(np.flatnonzero(short)) == 1).all()
    assert short.sum() % 10 == 0
    edges = np.diff(start[(start > 2.0) & ~short])  # before and after, whole bits apart
    assert np.abs(edges / 0.02 - np.round(edges / 0.02)).max() < 1e-3
    assert (flags[short] & TrackingFlag.AID_MISSED).all()
    assert not (flags[~short] & TrackingFlag.AID_MISSED).any()
    assert int(channel.state["fallback_count"]) == 1
    assert channel.aid_dropped["invalid"] == 1


def test_the_phase_goes_on_and_so_do_power_and_lock(gap, moving):
    _, epochs, _ = gap
    start, length, _ = errors(moving, epochs)
    f, f1, f2 = (column(epochs, f"carrier_doppler_{n}") for n in ("hz", "rate", "accel"))
    phase = column(epochs, "carrier_phase_cycles")
    end = phase + length * (f + length * (f1 / 2 + length * f2 / 3))
    on = start[1:] > 2.0
    assert np.abs(phase[1:] - end[:-1])[on].max() < 1e-6
    cn0 = column(epochs, "cn0_dbhz")[start > 3.0]
    assert np.ptp(cn0) < 1.0
    assert column(epochs, "phase_lock_indicator")[start > 3.0].min() > 0.85


def test_late_and_invalid_aiding_are_the_same_to_a_loop(moving):
    """Late aiding is extrapolated for 0.05 s first."""
    right = aiding_of(moving)
    channel, window, epochs = Channel("G07", RATE), BasebandWindow(BLOCK + 60_000), []
    channel.hand_over(moving.result(), 0)
    for block in range(round(END / 0.02)):
        window.push(*moving.block(block), block * BLOCK)
        if GONE <= block * 0.02 < BACK:
            channel.aid_missing((block + 1) * BLOCK - 1)
        else:
            channel.aid(right(block))
        epochs.append(channel.advance(window, block * BLOCK, -1)[0])
    start, length, error = errors(moving, epochs)
    assert channel.aid_dropped["late"] == 1
    short = (length < 0.015) & (start > 2.0)
    assert 0.02 < start[short][0] - GONE < 0.0801
    flags = column(epochs, "flags")[start > 2.0]
    assert not (flags & TrackingFlag.SLIP).any()
    assert np.abs(half_cycle_free(error)[start > 2.0]).max() < 0.1


def test_without_the_fallback_such_a_loop_is_lost(moving):
    _, epochs = track(moving, BACK, TrackingConfig(fallback_ms=0), away(aiding_of(moving)))
    start, _, _ = errors(moving, epochs)
    flags = column(epochs, "flags")
    assert (flags[start > GONE] & TrackingFlag.SLIP).any()
    assert not (flags[(start > 2.0) & (start < GONE)] & TrackingFlag.SLIP).any()


def test_at_rest_it_costs_the_noise_of_its_bandwidth(still):
    _, epochs = track(still, BACK, aiding=away(aiding_of(still)))
    start, _, error = errors(still, epochs)
    shown = half_cycle_free(error[start > GONE + 0.1])
    # 1.4 s of 50 Hz: 140 independent values, 4 sigma of an RMS are 24 %
    assert rms(shown) == pytest.approx(thermal(3, 50.0, 0.002), rel=0.25)


def test_where_short_integrations_hold_too_little_the_conventional_loop_goes_on():
    signal = Signal(32.0)
    result = dataclasses.replace(signal.result(), cn0_dbhz=32.0)
    channel, epochs = track(signal, 5.0, None, away(aiding_of(signal)), result=result)
    late = column(epochs, "sample_index") > 3.5 * RATE
    assert (column(epochs, "sample_count")[late] > 0.015 * RATE).all()
    assert channel.mode == TrackingMode.TRACK
    assert int(channel.state["fallback_count"]) == 0


def test_a_receiver_that_has_had_no_aiding_has_the_conventional_loop(still):
    for aiding in (None, lambda block: dataclasses.replace(aiding_of(still)(block), valid=False)):
        channel, epochs = track(still, 3.0, None, aiding)
        late = column(epochs, "sample_index") > 2.0 * RATE
        assert (column(epochs, "sample_count")[late] > 0.015 * RATE).all()
        assert int(channel.state["fallback_count"]) == 0


class Fading(Signal):
    """A signal that is away for a while [s]."""

    def __init__(self, level, begin, end, seed):
        super().__init__(level, motion=circle, seed=seed)
        self.begin, self.end = begin, end

    def block(self, index):
        full, self.amplitude = self.amplitude, 0.0
        noise = super().block(index)
        self.amplitude = full
        t = (index * BLOCK + np.arange(BLOCK)) / RATE
        away = (t >= self.begin) & (t < self.end)
        return [np.where(away, n, w) for n, w in zip(noise, super().block(index), strict=True)]


@pytest.mark.parametrize("seed", [5, 7])
@pytest.mark.parametrize("level", [36.0, 38.0])
def test_a_signal_that_vanishes_from_a_wide_loop_takes_no_phase_with_it(level, seed):
    """On noise alone the loop would walk half a cycle before anything tells it (a soak's find)."""
    gone = 4.5034
    signal = Fading(level, gone, END, seed)
    result = dataclasses.replace(signal.result(), cn0_dbhz=level)
    _, epochs = track(signal, 4.9, None, away(aiding_of(signal)), result=result)
    start, length, error = errors(signal, epochs)
    flags, error = column(epochs, "flags"), half_cycle_free(error)
    assert length[(start > GONE + 0.1) & (start < gone)].max() < 0.0021
    marked = start[(start > 3.0) & (flags & TrackingFlag.SLIP != 0)]
    assert gone < marked[0] < gone + 0.05
    before = (start > 3.0) & (start < marked[0])
    assert np.abs(error[before]).max() < 0.2


@pytest.mark.parametrize("level", [39.0])
def test_a_short_fade_is_coasted_through(level):
    signal = Fading(level, 4.5034, 4.5154, 3)
    result = dataclasses.replace(signal.result(), cn0_dbhz=level)
    _, epochs = track(signal, 5.2, None, away(aiding_of(signal)), result=result)
    start, _, error = errors(signal, epochs)
    assert not (column(epochs, "flags")[start > 3.0] & TrackingFlag.SLIP).any()
    assert np.abs(half_cycle_free(error)[start > 3.0]).max() < 0.2


def test_aiding_that_comes_back_wrong_is_not_believed(moving):
    right = aiding_of(moving)
    frozen = right(round(3.9 / 0.02))

    def aid(block):
        if block * 0.02 < BACK:
            return away(right)(block)
        return dataclasses.replace(
            right(block),
            carrier_doppler_hz=0.0 * right(block).carrier_doppler_hz
            + frozen.carrier_doppler_hz[:, :1],
            carrier_doppler_rate=0.0 * right(block).carrier_doppler_rate,
        )

    channel, epochs = track(moving, 7.0, None, aid)
    start, _, _ = errors(moving, epochs)
    flags = column(epochs, "flags")[start > 2.0]
    assert (flags & TrackingFlag.PHASE_LOCK).all()
    assert not (flags & TrackingFlag.SLIP).any()
    assert channel.mode == TrackingMode.TRACK


@pytest.mark.parametrize(("integration_ms", "short"), [(20, 2), (10, 2), (5, 1), (4, 2), (1, 1)])
def test_a_short_integration_divides_a_normal_one(integration_ms, short):
    channel = Channel("G07", RATE, TrackingConfig(integration_ms=integration_ms))
    assert int(channel.configs["fallback_periods"][0]) == short


def test_bits_come_through_both_changes(moving):
    config, pushed = TrackingConfig(), []
    channel, window = Channel("G07", RATE, config), BasebandWindow(BLOCK + 60_000)
    channel.hand_over(moving.result(), 0)
    push = channel.decoder.push
    channel.decoder.push = lambda bits, index: pushed.append((index, bits[0])) or push(bits, index)
    for block in range(round(END / 0.02)):
        window.push(*moving.block(block), block * BLOCK)
        channel.aid(away(aiding_of(moving))(block))
        channel.advance(window, block * BLOCK, -1)
    index, bits = np.array(pushed).T
    assert (np.diff(index) == 1).all()
    sign = np.sign(bits)
    match = [abs(float(sign @ moving.bits[k : k + sign.size])) for k in range(100)]
    assert max(match) == sign.size
