import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose
from unit.pvt.conftest import circle
from unit.pvt.tracked_signals import L1_HZ, LOCKED, TOW, WEEK, C, Receiver, Sky, visible

from deepseis_core.types import Lli, TrackingFlag
from deepseis_pvt.observables import (
    CYCLES_PER_MS,
    GridClock,
    ObservablesBuilder,
    ObservablesConfig,
)
from deepseis_pvt.track_store import TrackStore

RATE = 4e6
START_NS = (WEEK * 604800 + TOW) * 10**9


def observe(messages, first=0.1, last=1.1, rate_hz=50, offset_ns=0, change=None):
    """Return observations of every grid epoch, with sample 0 at TOW + offset."""
    store = TrackStore(messages)
    builder = ObservablesBuilder(ObservablesConfig(rate_hz=rate_hz), RATE, store)
    for batch in messages.values():
        for message in batch:
            store.push(change(message) if change else message)
    clock = GridClock(RATE, START_NS + offset_ns)
    out = []
    for k in range(round(first * rate_hz), round(last * rate_hz)):
        gps_ns = START_NS + k * builder.interval_ns
        sample, fraction = clock.sample_at(gps_ns)
        builder.locate(sample, fraction)
        out.append(builder.build(sample, fraction, gps_ns, sample))
    return out


def flagged(satellite, sample_from, sample_to, flags):
    """Return a change of messages: other flags on some integrations of one satellite."""

    def change(message):
        if message.satellite != satellite:
            return message
        inside = (message.sample_index >= sample_from) & (message.sample_index < sample_to)
        return dataclasses.replace(
            message, flags=np.where(inside, int(flags), message.flags).astype(np.uint16)
        )

    return change


def column(epochs, satellite, name):
    """Return one satellite's values."""
    return np.array([getattr(o, name)[o.satellites.index(satellite)] for o in epochs])


def test_carrier_phase_follows_a_2_hz_circle_to_a_thousandth_of_a_cycle(moving):
    epochs, sky = observe(moving, rate_hz=100), Sky(circle, atmosphere=True)
    for name in visible():
        true = [L1_HZ * sky.travel(name, k / 100)[1] for k in range(10, 110)]
        difference = column(epochs, name, "carrier_phase_cycles") - true
        # A double of 1e8 cycles is good to 1.5e-8, RTKLIB's time to 6e-11 s x 900 m/s.
        assert np.ptp(difference) < 1e-5


def test_pseudorange_of_a_still_antenna_is_true_to_a_tenth_of_a_millimetre(still):
    epochs, sky = observe(still), Sky()
    for name in visible():
        # Receiver time k/50 is GPS time k/50 (1 - drift): the receiver's clock is ahead.
        true = [
            C * (sky.travel(name, k / 50 * (1 - 3e-7))[0] + k / 50 * 3e-7) for k in range(5, 55)
        ]
        assert_allclose(column(epochs, name, "pseudorange"), true, rtol=0, atol=1e-4)


def test_pseudorange_of_a_moving_antenna_is_as_good_as_a_linear_code_replica(moving):
    epochs, sky = observe(moving), Sky(circle, atmosphere=True)
    for name in visible():
        true = [C * sky.travel(name, k / 50)[0] for k in range(5, 55)]
        # 0.12 (4 pi)^2 (0.02 s)^2 / 2: curvature of the range within one integration.
        assert_allclose(column(epochs, name, "pseudorange"), true, rtol=0, atol=0.0038)


def test_doppler_is_the_negative_rate_of_the_phase(moving):
    epochs = observe(moving, rate_hz=100)
    for name in visible():
        phase = column(epochs, name, "carrier_phase_cycles")
        central = (phase[2:] - phase[:-2]) * 50
        doppler = column(epochs, name, "carrier_doppler_hz")[1:-1]
        # Third derivative of 12 cm at 2 Hz: 0.12 (4 pi)^3 / 0.19 x (0.01 s)^2 / 6 = 0.021 Hz.
        assert_allclose(-central, doppler, rtol=0, atol=0.025)


def test_sampling_between_samples_uses_the_fraction(still):
    whole, moved = observe(still), observe(still, offset_ns=101)  # 0.404 samples
    name = visible()[0]
    rate = -column(whole, name, "carrier_doppler_hz") * C / L1_HZ
    # The epoch lies 101 ns earlier on the signal while the receiver's clock is that much ahead.
    expected = column(whole, name, "pseudorange") + C * 101e-9 - rate * 101e-9
    assert_allclose(column(moved, name, "pseudorange"), expected, rtol=0, atol=1e-5)


def test_phase_starts_near_the_code_and_by_whole_cycles_only(still):
    first = observe(still)[0]
    cycles = first.carrier_phase_cycles - first.pseudorange * L1_HZ / C
    assert_allclose(cycles, 0.0, atol=0.5001)
    one = observe(still, first=0.5)[0]
    other = observe(still)[20]
    gap = one.carrier_phase_cycles - other.carrier_phase_cycles
    assert_allclose(gap, np.round(gap), atol=1e-6)


def test_a_slip_sets_lli_once_and_starts_a_new_arc(still):
    name = visible()[2]
    slip = flagged(name, 2_000_000, 2_080_000, LOCKED | TrackingFlag.SLIP)

    def change(message):
        message = slip(message)
        if message.satellite != name:
            return message
        jump = np.where(message.sample_index >= 2_000_000, 1234.25, 0.0)
        phase = message.carrier_phase_cycles + jump
        return dataclasses.replace(message, carrier_phase_cycles=phase)

    epochs = observe(still, change=change)
    lli = column(epochs, name, "lli")
    assert lli[0] == Lli.SLIP
    assert np.count_nonzero(lli[1:]) == 1
    phase = column(epochs, name, "carrier_phase_cycles") * C / L1_HZ
    assert np.all(np.abs(phase - column(epochs, name, "pseudorange")) < 0.2)
    at = 1 + int(np.argmax(lli[1:]))
    lock = column(epochs, name, "lock_time")
    assert lock[at] == 0.0
    assert_allclose(lock[at + 5], 0.1, rtol=1e-5)


@pytest.mark.parametrize("integration_ms", [1, 5])
def test_a_slip_between_epochs_is_not_lost(integration_ms):
    name = visible()[0]
    messages = {name: Receiver(Sky()).messages(name, 0.2, integration_ms)}
    length = round(integration_ms * 4000)
    first = next(int(m.sample_index[0]) for m in messages[name] if len(m.sample_index))
    start = first + (452_000 - first) // length * length  # in the midst of an interval
    slip = flagged(name, start, start + 1, LOCKED | TrackingFlag.SLIP)
    lli = column(observe(messages, 0.1, 0.16, change=slip), name, "lli")
    assert lli.tolist() == [1, 1, 0]


def test_unknown_polarity_sets_the_half_cycle_bit_and_keeps_the_arc(still):
    name = visible()[1]
    unknown = LOCKED & ~TrackingFlag.POLARITY_KNOWN
    epochs = observe(still, change=flagged(name, 0, 2_000_000, unknown))
    lli = column(epochs, name, "lli")
    assert lli[0] == Lli.SLIP | Lli.HALF_CYCLE
    assert set(lli[1:15]) == {Lli.HALF_CYCLE}
    assert set(lli[26:]) == {0}
    plain = observe(still)
    assert_allclose(
        column(epochs, name, "carrier_phase_cycles"),
        column(plain, name, "carrier_phase_cycles"),
        rtol=0,
        atol=0,
    )


def test_a_mended_half_cycle_is_told_but_keeps_the_integer(still):
    name = visible()[1]
    turned = flagged(name, 2_000_000, 2_080_000, LOCKED | TrackingFlag.HALF_CYCLE)
    epochs, plain = observe(still, change=turned), observe(still)
    assert np.count_nonzero(column(epochs, name, "lli")[1:] == Lli.SLIP) == 1
    assert np.array_equal(
        column(epochs, name, "carrier_phase_cycles"), column(plain, name, "carrier_phase_cycles")
    )


def test_without_code_lock_a_satellite_is_left_out_and_without_phase_lock_only_its_phase(still):
    one, other = visible()[:2]
    no_code = flagged(one, 2_000_000, 2_400_000, 0)
    no_phase = flagged(other, 2_000_000, 2_400_000, TrackingFlag.CODE_LOCK)
    epochs = observe(still, change=lambda m: no_phase(no_code(m)))
    assert [one in o.satellites for o in epochs].count(False) == 5
    blank = np.isnan(column(epochs, other, "carrier_phase_cycles"))
    assert np.count_nonzero(blank) == 5
    after = int(np.flatnonzero(blank)[-1]) + 1
    assert column(epochs, other, "lli")[after] == Lli.SLIP


def test_transmit_times_no_satellite_can_have_are_refused(still):
    name = visible()[0]

    def change(message):
        wrong = message.satellite == name
        return dataclasses.replace(message, transmit_ms=message.transmit_ms - 6000 * wrong)

    assert all(name not in o.satellites for o in observe(still, change=change))


def test_thermal_sigmas_are_those_of_theory(still):
    first = observe(still)[0]
    energy = 10**4.5 * 0.02
    carrier = np.sqrt((1 + 1 / (2 * energy)) / (2 * energy)) / (2 * np.pi)
    assert_allclose(first.carrier_error_sd_cycles, carrier, rtol=1e-6)
    # d/(4 T CN0) (1 + 2/((2 - d) T CN0)) at d = 0.5 chips.
    code = np.sqrt(0.5 / (4 * energy) * (1 + 2 / (1.5 * energy)))
    assert_allclose(first.code_error_sd_chips, code, rtol=1e-6)


def test_the_grid_clock_is_exact_after_a_year():
    clock = GridClock(16.368e6, START_NS)
    year_ns = 365 * 86400 * 10**9 + 10_000_000
    assert clock.sample_at(START_NS + year_ns) == (365 * 86400 * 16_368_000 + 163_680, 0.0)
    assert clock.gps_ns_at(365 * 86400 * 16_368_000) == START_NS + year_ns - 10_000_000


def test_a_millisecond_is_a_whole_number_of_cycles():
    assert L1_HZ / 1000 == CYCLES_PER_MS
