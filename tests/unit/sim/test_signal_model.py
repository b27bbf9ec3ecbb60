"""Delay and phase against closed forms, and against a simulator that nobody here wrote."""

import numpy as np
import pytest

from deepseis_core.constants import L1_HZ, L1_WAVELENGTH, SPEED_OF_LIGHT
from deepseis_core.geodesy import ecef_from_geodetic, rotation_enu_ecef
from deepseis_core.gps_time import GpsTime
from deepseis_core.lnav import encode_frame_bits
from deepseis_core.rinex_nav import read_rinex_nav
from deepseis_sim.constellation import visible_satellites
from deepseis_sim.nominal_constellation import nominal_constellation
from deepseis_sim.oscillator import Oscillator, OscillatorConfig
from deepseis_sim.signal_model import SignalModel, linear_clock, still
from deepseis_sim.slow_table import SlowTable

TIME = GpsTime(2399, 346258 * 10**9)
PLACE = np.deg2rad(35.681298), np.deg2rad(139.766247)
TOKYO = ecef_from_geodetic([*PLACE, 10.0])
SPAN = 39 * 1024 / 4e6  # the segment at 4 MHz


@pytest.fixture(scope="module")
def visible():
    return visible_satellites(nominal_constellation(TIME), TIME, TOKYO)


def sine(amplitude, frequency_hz):
    """East-west oscillation [m]."""
    east = rotation_enu_ecef(*PLACE)[0]

    def trajectory(time):
        return TOKYO + amplitude * np.sin(2 * np.pi * frequency_hz * time)[:, None] * east

    return trajectory


def at(cubics, share):
    """Evaluate the cubics of every segment at a fraction of it."""
    return cubics @ share ** np.arange(4)


@pytest.mark.parametrize(
    ("amplitude", "frequency_hz"),
    [(0.0, 1.0), (0.12, 2.0), (0.5, 1.0), (0.497, 5.0), (1.2e-4, 45.0)],
    ids=["still", "2 g at 2 Hz", "2 g at 1 Hz", "50 g at 5 Hz", "1 g at 45 Hz"],
)
def test_cubics_follow_the_phase_to_a_thousandth_of_a_cycle(visible, amplitude, frequency_hz):
    clock = linear_clock(3e-4, 8e-8)
    model = SignalModel(visible, TIME, sine(amplitude, frequency_hz), clock=clock)
    segments = model.segments(7, 60, SPAN)
    worst = 0.0
    for share in (0.0, 0.1, 0.5, 0.9, 1.0):
        truth = model.carrier_phase_cycles((np.arange(7, 67) + share) * SPAN).T
        worst = max(worst, np.abs(at(segments.carrier_phase_cycles, share) - truth).max())
    # The cubic's own error, (span^4 / 24) x 0.035 x the fourth derivative (50 g at 5 Hz: 2.5e-6
    # cycle), and the rounding of phases of 1e8 cycles; far below the 0.001 asked for.
    fourth = amplitude * (2 * np.pi * frequency_hz) ** 4 / L1_WAVELENGTH
    assert worst < 2e-7 + 0.035 / 24 * 2 * SPAN**4 * fourth
    assert worst < 0.001


@pytest.mark.parametrize("kind", ["ocxo", "rubidium", "tcxo"])
def test_cubics_follow_a_noisy_oscillator(visible, kind):
    clock = Oscillator(OscillatorConfig(kind=kind), 1)
    model = SignalModel(visible, TIME, still(TOKYO), clock=clock)
    segments = model.segments(5, 300, SPAN)
    share = np.linspace(0.0, 1.0, 9)
    time = ((np.arange(5, 305)[:, None] + share) * SPAN).ravel()
    truth = model.carrier_phase_cycles(time).reshape(300, 9, -1).transpose(2, 0, 1)
    error = segments.carrier_phase_cycles @ (share ** np.arange(4)[:, None]) - truth
    # The oscillator's own cubics meet at multiples of 10 ms, within our segments of 9.984 ms.
    assert np.abs(error).max() < 0.0005


def test_phase_is_continuous_from_segment_to_segment_and_chunk_to_chunk(visible):
    model = SignalModel(visible, TIME, still(TOKYO))
    early, late = model.segments(0, 5, SPAN), model.segments(5, 5, SPAN)
    end = at(early.carrier_phase_cycles[:, -1], 1.0)
    np.testing.assert_allclose(end, late.carrier_phase_cycles[:, 0, 0], rtol=0, atol=1e-7)


def test_segments_do_not_depend_on_the_chunk_they_are_made_in(visible):
    model = SignalModel(visible, TIME, sine(0.12, 2.0), clock=linear_clock(3e-4, 8e-8))
    whole, part = model.segments(0, 40, SPAN), model.segments(17, 9, SPAN)
    np.testing.assert_array_equal(
        part.carrier_phase_cycles, whole.carrier_phase_cycles[:, 17:26], strict=True
    )
    np.testing.assert_array_equal(part.code_phase_chips, whole.code_phase_chips[:, 17:26])
    first = whole.code_period[:, 17] - part.code_period[:, 0]
    assert (first % 20 == 0).all()  # whole bits


def test_code_phase_and_bits_are_those_of_the_satellites_time(visible):
    model = SignalModel(visible, TIME, still(TOKYO), clock=linear_clock(3e-4, 8e-8))
    segments = model.segments(0, 60, SPAN)
    number = 33
    sent = number * SPAN - model.delays(np.array([number * SPAN])).pseudorange[0] / SPEED_OF_LIGHT
    for k, item in enumerate(visible):
        frame = encode_frame_bits(item.ephemeris, 346254, 2, week=2399)
        since_frame = sent[k] + 4.0
        period = segments.code_period[k, number]
        assert segments.bits[k, period // 20] == frame[int(since_frame / 0.02)]
        chips = 1023 * (period % 20) + segments.code_phase_chips[k, number, 0]
        # 1e-9 s of a difference of times near 1 s, in double: 1e-6 chip is ample.
        assert chips == pytest.approx(since_frame % 0.02 * 1.023e6, abs=1e-6)


def test_carrier_phase_moves_with_pseudorange_but_for_twice_the_ionosphere(visible):
    model = SignalModel(visible, TIME, still(TOKYO), clock=linear_clock(3e-4, 8e-8))
    delays = model.delays(np.array([0.0, 30.0]))
    total = delays.carrier_phase_cycles + delays.pseudorange / L1_WAVELENGTH
    np.testing.assert_allclose(total, 2 * delays.ionosphere / L1_WAVELENGTH, rtol=0, atol=1e-6)
    assert (delays.ionosphere > 1.0).all()  # the built-in day: 5 ns and more at night
    assert (delays.troposphere > 2.2).all()
    np.testing.assert_allclose(delays.receiver_clock, [3e-4, 3e-4 + 2.4e-6], rtol=1e-12)


def test_a_fast_receiver_clock_lowers_every_doppler(visible):
    right = SignalModel(visible, TIME, still(TOKYO))
    fast = SignalModel(visible, TIME, still(TOKYO), clock=linear_clock(0.0, 1e-7))
    time = np.array([0.0])
    difference = fast.carrier_doppler_hz(time) - right.carrier_doppler_hz(time)
    # f1 x drift, but for the Doppler's own stretching of time (1e-7 of some kHz) and rounding of
    # the phases over 1 ms (3e-8 cycle / 1 ms).
    np.testing.assert_allclose(difference, -L1_HZ * 1e-7, rtol=0, atol=1e-3)


def test_doppler_is_the_derivative_of_the_phase_under_motion(visible):
    model = SignalModel(visible, TIME, sine(0.12, 2.0))
    time = np.linspace(0.0, 1.0, 101)
    phase = model.carrier_phase_cycles(np.linspace(0.0, 1.0, 100 * 64 + 1))
    step = 1.0 / 6400
    # Simpson's rule over the derivative would hide an error: differences of the phase instead.
    rate = (phase[65:-63:64] - phase[63:-65:64]) / (2 * step)
    np.testing.assert_allclose(model.carrier_doppler_hz(time[1:-1]), rate, rtol=0, atol=1e-3)


def test_doppler_with_a_noisy_fast_clock_is_the_phases_difference(visible):
    clock = Oscillator(OscillatorConfig(kind="ocxo", drift=1e-5), 1)
    model = SignalModel(visible, TIME, sine(0.12, 2.0), clock=clock)
    time, h = np.linspace(0.0, 1.0, 41), 5e-4
    phase = [model.carrier_phase_cycles(time + shift) for shift in (-h, h)]
    delays, doppler = model.delays_and_doppler(time)
    # Rounding of 1e8 cycles over 1 ms, 3e-5 Hz and more, and 5e-5 Hz of the differences.
    np.testing.assert_allclose(doppler, (phase[1] - phase[0]) / (2 * h), rtol=0, atol=3e-4)
    np.testing.assert_array_equal(delays.range, model.delays(time).range)
    np.testing.assert_array_equal(doppler, model.carrier_doppler_hz(time))


def test_cn0_may_change_from_segment_to_segment(visible):
    def cn0(time):
        return np.where(time[:, None] < 0.1, 40.0, -np.inf) + np.zeros(len(visible))

    model = SignalModel(visible, TIME, still(TOKYO), cn0=cn0)
    table = model.segments(0, 20, 0.01).cn0_dbhz
    assert (table[:, :10] == 40.0).all()
    assert np.isinf(table[:, 10:]).all()
    power = model.carriers_hz(np.array([0.05, 0.2]))
    np.testing.assert_allclose(power, [len(visible) * 1e4, 0.0])
    constant = SignalModel(visible, TIME, still(TOKYO)).segments(0, 2, 0.01).cn0_dbhz
    np.testing.assert_array_equal(constant[:, 1], [item.cn0_dbhz for item in visible])


def test_a_slow_table_is_exact_for_quadratics_and_knows_no_history():
    table = SlowTable(lambda number: np.array([3.0, -0.5 * number + 0.1 * number**2]), 10.0)
    time = np.array([0.0, 3.0, 17.5, -4.0, 1000.0])
    expected = np.stack([3.0 + 0 * time, -0.05 * time + 0.001 * time**2], axis=1)
    np.testing.assert_allclose(table(time), expected, rtol=0, atol=1e-12)
    for k, t in enumerate(time):
        np.testing.assert_array_equal(table(np.array([t]))[0], table(time)[k])


def test_atmosphere_can_be_left_out(visible):
    bare = SignalModel(visible, TIME, still(TOKYO), ionosphere=False, troposphere=False)
    delays = bare.delays(np.array([0.0, 11.0]))
    assert not delays.ionosphere.any()
    assert not delays.troposphere.any()


@pytest.fixture(scope="module")
def outside(shared_data):
    folder = shared_data / "if_captures" / "independent_sim"
    with np.load(folder / "still_truth.npz") as truth:
        values = dict(truth)
    start = GpsTime.from_calendar(2022, 1, 1, 2)
    ephemerides = read_rinex_nav(folder / "brdc0010.22n").ephemerides
    seen = visible_satellites(ephemerides, start, TOKYO, elevation_mask=0.0)
    return values, SignalModel(seen, start, still(TOKYO), troposphere=False)


def test_the_same_satellites_stand_where_the_outside_simulator_has_them(outside):
    truth, model = outside
    assert [item.prn for item in model.satellites] == truth["prn"].tolist()
    elevation = np.rad2deg([item.elevation for item in model.satellites])
    azimuth = np.rad2deg([item.azimuth for item in model.satellites])
    # Printed to a thousandth of a degree; it gives directions to the satellite at reception.
    np.testing.assert_allclose(elevation, truth["el_deg"], rtol=0, atol=2e-3)
    np.testing.assert_allclose(azimuth, truth["az_deg"], rtol=0, atol=2e-3)


def test_phase_equals_the_outside_simulators_once_its_ionosphere_has_our_sign(outside):
    truth, model = outside
    delays = model.delays(truth["t_s"])
    phase = delays.carrier_phase_cycles - 2 * delays.ionosphere / L1_WAVELENGTH
    difference = phase - phase[0] - truth["carrier_phase_cycles"]
    # Over 40 s and 1e5 cycles: 0.0001 cycle = 0.02 mm. Its truth is rounded to 1e-6 cycle; orbits
    # agree to micrometres a second, and its ionosphere is a step a block where ours is smooth.
    assert np.abs(difference).max() < 1e-4


def test_doppler_differs_from_the_outside_simulators_by_the_ionospheres_rate(outside):
    truth, model = outside
    time = truth["t_s"][10:-10:100]
    ionosphere = [model.delays(time + shift).ionosphere for shift in (-1.0, 1.0)]
    rate = (ionosphere[1] - ionosphere[0]) / 2.0 / L1_WAVELENGTH
    difference = model.carrier_doppler_hz(time) - truth["carrier_doppler_hz"][10:-10:100]
    # Twice the rate (sign turned), up to 0.022 Hz near the horizon; what is left is the outside
    # file's Doppler, a mean over its own step.
    np.testing.assert_allclose(difference, 2 * rate, rtol=0, atol=1e-3)
