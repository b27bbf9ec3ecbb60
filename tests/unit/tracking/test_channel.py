"""A channel on a signal made here by plain NumPy: lock, phase, C/N0, chunks, aiding, loss."""

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
    phase_error,
    track,
)

from deepseis_core.constants import CA_LENGTH
from deepseis_core.types import TrackingFlag, TrackingMode
from deepseis_tracking.baseband_window import BasebandWindow
from deepseis_tracking.channel import Channel, TrackingConfig


@pytest.fixture(scope="module")
def tracked():
    signal = Signal()
    return (signal, *track(signal, 5.0))


def test_a_channel_reaches_tracking_and_its_phase_noise_is_thermal(tracked):
    signal, channel, epochs = tracked
    assert channel.mode == TrackingMode.TRACK
    flags = column(epochs, "flags")[-50:]
    wanted = TrackingFlag.CODE_LOCK | TrackingFlag.PHASE_LOCK | TrackingFlag.BIT_SYNC
    assert (flags & wanted == wanted).all()
    assert not (flags & TrackingFlag.SLIP).any()
    error = half_cycle_free(phase_error(signal, epochs)[50:])
    cn0 = 10**4.7
    limit = np.sqrt(15 / cn0 * (1 + 1 / (2 * 0.02 * cn0))) / (2 * np.pi)
    # Bn T = 0.3: about one independent value every 1.7 epochs, 4 sigma of an RMS
    assert np.sqrt(np.mean(error**2)) < limit * (1 + 4 / np.sqrt(2 * len(error) / 1.7))


def test_cn0_is_that_of_the_signal(tracked):
    _, _, epochs = tracked
    assert column(epochs, "cn0_dbhz")[-50:].mean() == pytest.approx(47.0, abs=0.6)


def test_code_phase_is_that_of_the_signal(tracked):
    signal, _, epochs = tracked
    t = column(epochs, "sample_index")[-100:] / RATE
    error = column(epochs, "code_phase_chips")[-100:] - signal.code_chips(t)
    error -= np.round(error / CA_LENGTH) * CA_LENGTH
    # DLL 1 Hz, d = 0.5: sqrt(Bn d / (2 CN0)) = 0.0022 chip; sampling 0.5 chip apart adds its own
    assert abs(error.mean()) < 0.01
    assert error.std() < 0.006


def test_phase_is_continuous_from_one_integration_to_the_next(tracked):
    _, _, epochs = tracked
    dt = column(epochs, "sample_count") / RATE
    f, rate, accel = (
        column(epochs, "carrier_doppler_" + name) for name in ("hz", "rate", "accel")
    )
    end = column(epochs, "carrier_phase_cycles") + dt * (f + dt * (rate / 2 + dt * accel / 3))
    jump = column(epochs, "carrier_phase_cycles")[1:] - end[:-1]
    assert np.abs(jump).max() < 1e-6
    gap = np.diff(column(epochs, "sample_index")) - column(epochs, "sample_count")[:-1]
    assert (gap == 0).all()


def test_any_chunking_gives_the_same_epochs():
    signal = Signal()
    _, one = track(signal, 2.0)
    _, two = track(signal, 2.0, blocks_at_once=2)
    for item in dataclasses.fields(one[0]):
        if isinstance(getattr(one[0], item.name), np.ndarray) and "aid" not in item.name:
            # float32 columns scaled by the noise level of the block may differ in its estimate
            dtype = column(one, item.name).dtype
            exact = dtype.kind in "iu" or dtype.itemsize == 8
            tolerance = 0 if exact else 2e-2
            a, b = column(one, item.name), column(two, item.name)
            np.testing.assert_allclose(a, b, rtol=tolerance, atol=tolerance)


def test_a_lost_signal_is_given_up_and_flagged():
    signal = Signal()
    channel = Channel("G07", RATE)
    channel.hand_over(signal.result(), 0)
    window = BasebandWindow(BLOCK + 60_000)
    for index in range(300):
        if index == 125:
            assert channel.mode == TrackingMode.TRACK
            signal.amplitude = 0.0
        window.push(*signal.block(index), index * BLOCK)
        channel.advance(window, index * BLOCK, index * BLOCK)
        if channel.mode == TrackingMode.IDLE:
            break
    assert channel.mode == TrackingMode.IDLE
    assert channel.lost == 1
    # 1 s below the threshold after the power filter (0.25 s) has fallen 20 dB
    assert index * 0.02 < 2.5 + 1.0 + 1.6


@pytest.mark.parametrize(("cn0_dbhz", "until"), [(34.0, 4.0), (47.0, 2.5)])
def test_no_phase_is_called_locked_when_the_signal_has_vanished(cn0_dbhz, until):
    signal = Signal(cn0_dbhz=cn0_dbhz)
    channel = Channel("G07", RATE)
    channel.hand_over(signal.result(), 0)
    window = BasebandWindow(BLOCK + 60_000)
    epochs = []
    for index in range(round((until + 1.0) / 0.02)):
        if index == round(until / 0.02):
            assert channel.mode == TrackingMode.TRACK
            signal.amplitude = 0.0
        window.push(*signal.block(index), index * BLOCK)
        epochs.append(channel.advance(window, index * BLOCK, -1)[0])
    t = column(epochs, "sample_index") / RATE
    locked = (column(epochs, "flags") & TrackingFlag.PHASE_LOCK) > 0
    assert locked[(t > until - 0.5) & (t < until - 0.03)].all()
    assert not locked[t > until + 0.35].any()
    assert column(epochs, "cn0_dbhz")[t > until + 0.5].max() < 24.0


def test_every_integration_without_a_signal_is_marked_before_the_lock_is_given_up():
    signal = Signal(cn0_dbhz=47.0)
    channel = Channel("G07", RATE)
    channel.hand_over(signal.result(), 0)
    window = BasebandWindow(BLOCK + 60_000)
    epochs = []
    for index in range(140):
        if index == 125:
            signal.amplitude = 0.0
        window.push(*signal.block(index), index * BLOCK)
        epochs.append(channel.advance(window, index * BLOCK, -1)[0])
    t, flags = column(epochs, "sample_index") / RATE, column(epochs, "flags")
    locked = (flags & TrackingFlag.PHASE_LOCK) > 0
    slip = (flags & TrackingFlag.SLIP) > 0
    assert locked[t > 2.501].any()
    assert slip[t > 2.501].all()
    assert not slip[(t > 1.5) & (t < 2.47)].any()


def test_a_loop_that_slips_is_marked_before_it_is_half_a_cycle_off():
    signal = Signal(motion=circle)
    _, epochs = track(signal, 8.0, TrackingConfig(pll_bandwidth_hz=8.0))
    error = phase_error(signal, epochs)
    whole = column(epochs, "sample_count") > 0.015 * RATE
    t = column(epochs, "sample_index")[whole] / RATE
    marked = (column(epochs, "flags")[whole] & TrackingFlag.SLIP) > 0
    assert np.ptp(error[t > 4.0]) > 0.5  # it does slip
    arcs = np.split(np.arange(t.size), np.flatnonzero(marked))
    assert max(np.ptp(error[arc]) for arc in arcs if arc.size) < 0.5


def test_after_a_slip_the_polarity_is_not_called_known():
    signal = Signal(motion=lambda t: 4 * circle(t))
    channel, window = Channel("G07", RATE, TrackingConfig(relock_s=0.0)), BasebandWindow(100_000)
    channel.hand_over(signal.result(), 0)
    epochs = []
    for index in range(200):
        if index == 100:
            channel.state["polarity"] = 1  # as a subframe does
        window.push(*signal.block(index), index * BLOCK)
        epochs.append(channel.advance(window, index * BLOCK, -1)[0])
    flags = column(epochs, "flags")[column(epochs, "sample_index") > 2.1 * RATE]
    slip = int(np.argmax((flags & TrackingFlag.SLIP) != 0))
    known = (flags & TrackingFlag.POLARITY_KNOWN) != 0
    assert slip > 20
    assert known[:slip].all()
    assert not known[slip:].any()


def test_a_signal_that_is_10_db_weaker_at_once_keeps_its_lock():
    signal = Signal(cn0_dbhz=45.0)
    strong = signal.amplitude
    channel = Channel("G07", RATE)
    channel.hand_over(signal.result(), 0)
    window = BasebandWindow(BLOCK + 60_000)
    epochs = []
    for index in range(200):
        signal.amplitude = strong * (1.0 if index < 125 else 10**-0.5)
        window.push(*signal.block(index), index * BLOCK)
        epochs.append(channel.advance(window, index * BLOCK, -1)[0])
    t = column(epochs, "sample_index") / RATE
    assert ((column(epochs, "flags")[t > 2.0] & TrackingFlag.PHASE_LOCK) > 0).all()


def test_aiding_keeps_the_narrow_loop_on_a_shaken_antenna_and_its_absence_does_not():
    signal = Signal(motion=circle)
    config = TrackingConfig(pll_bandwidth_hz=8.0, aided_bandwidth_hz=8.0)
    channel, epochs = track(signal, 6.0, config, aiding_of(signal))
    assert channel.mode == TrackingMode.TRACK_AIDED
    aided = half_cycle_free(phase_error(signal, epochs))
    plain = half_cycle_free(phase_error(signal, track(signal, 6.0, config)[1]))
    cn0 = 10**4.7
    limit = np.sqrt(8 / cn0 * (1 + 1 / (2 * 0.02 * cn0))) / (2 * np.pi)
    moving = slice(-100, None)
    # 100 epochs of Bn T = 0.16: about 32 independent values, 4 sigma of an RMS is 50 %
    assert np.sqrt(np.mean(aided[moving] ** 2)) < 1.5 * limit
    assert np.sqrt(np.mean(plain[moving] ** 2)) > 5 * limit


def test_switching_the_aiding_on_does_not_bump_the_phase():
    signal = Signal()
    _, epochs = track(signal, 3.0, TrackingConfig(), aiding_of(signal))
    mode = np.repeat([e.mode for e in epochs], [len(e.flags) for e in epochs])
    first = int(np.argmax(mode == TrackingMode.TRACK_AIDED))
    assert first > 0
    frequency = column(epochs, "carrier_doppler_hz")
    noise = np.std(np.diff(frequency[first - 8 : first - 1]))
    assert abs(frequency[first] - frequency[first - 1]) < 6 * noise


@pytest.mark.parametrize("seed", range(4))
def test_a_weak_signal_is_pulled_in_by_an_nco_that_runs_free(seed):
    signal = Signal(cn0_dbhz=29.5, seed=seed)
    result = dataclasses.replace(signal.result(-6.0 + 4.0 * seed), cn0_dbhz=29.0)
    channel, epochs = track(signal, 3.5, result=result)
    assert channel.mode == TrackingMode.TRACK
    flags = column(epochs, "flags")[-50:]
    assert ((flags & TrackingFlag.PHASE_LOCK) != 0).all()
    pull_in = column(epochs, "sample_count") < 0.015 * RATE
    assert not (column(epochs, "flags")[pull_in] & TrackingFlag.PHASE_LOCK).any()
    error = half_cycle_free(phase_error(signal, epochs)[-50:])
    # 9 deg of noise at 15 Hz; 50 epochs scatter by 13 %
    assert np.std(error) < 1.5 * np.sqrt(15 / 10**2.95 * (1 + 1 / (0.04 * 10**2.95))) / (2 * np.pi)


def test_aiding_carries_a_weak_pull_in_through_motion():
    signal = Signal(cn0_dbhz=31.0, motion=lambda t: circle(t + 10.0))
    start = (signal.phase_cycles(1e-4) - signal.phase_cycles(-1e-4)) / 2e-4
    result = dataclasses.replace(signal.result(), carrier_doppler_hz=start + 2.0, cn0_dbhz=31.0)
    config = TrackingConfig(aided_bandwidth_hz=3.0)
    channel, epochs = track(signal, 4.5, config, aiding_of(signal), result=result)
    assert channel.mode == TrackingMode.TRACK_AIDED
    error = half_cycle_free(phase_error(signal, epochs)[-75:])
    assert np.std(error) < 1.5 * np.sqrt(3 / 10**3.1 * (1 + 1 / (0.04 * 10**3.1))) / (2 * np.pi)


def test_the_hand_over_knows_how_the_doppler_has_grown_since_the_search():
    signal = Signal(motion=lambda t: circle(t + 10.0))
    channel, aid = Channel("G07", RATE), aiding_of(signal)
    for block in range(14):
        channel.aid(aid(block))

    def doppler(t):
        return (signal.phase_cycles(t + 1e-4) - signal.phase_cycles(t - 1e-4)) / 2e-4

    found = dataclasses.replace(signal.result(), carrier_doppler_hz=doppler(0.0))
    channel.hand_over(found, 13 * BLOCK)
    assert abs(doppler(0.26) - doppler(0.0)) > 5.0
    assert float(channel.state["nco_hz"]) == pytest.approx(doppler(0.26), abs=0.02)


def test_short_integrations_do_not_take_noise_for_slips():
    signal = Signal(cn0_dbhz=38.0)
    _, epochs = track(signal, 4.0, TrackingConfig(integration_ms=1))
    late = column(epochs, "sample_index") > 2.5 * RATE
    assert (np.abs(column(epochs, "carrier_error_cycles")[late]) > 0.2).any()
    assert not (column(epochs, "flags")[late] & TrackingFlag.SLIP).any()


def test_without_relock_the_loop_is_left_to_itself():
    """The papers' receivers show what a loop does that has lost the phase."""
    signal = Signal(motion=lambda t: 4 * circle(t))
    for relock_s, stays in ((0.0, True), (1.5, False)):
        _, epochs = track(signal, 6.0, TrackingConfig(relock_s=relock_s))
        late = column(epochs, "sample_index") > 3.3 * RATE
        assert (column(epochs, "flags")[late] & TrackingFlag.PHASE_LOCK == 0).any()
        assert (column(epochs, "sample_count")[late] > 0.015 * RATE).all() == stays
