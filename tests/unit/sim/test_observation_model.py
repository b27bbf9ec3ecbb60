"""Observables from the signals' closed forms; their noise against the theory of tracking loops."""

import dataclasses
from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from deepseis_core.constants import CA_RATE_CPS, L1_HZ, L1_WAVELENGTH, SPEED_OF_LIGHT
from deepseis_core.errors import InputError
from deepseis_core.geodesy import ecef_from_geodetic
from deepseis_core.gps_time import GpsTime
from deepseis_core.types import Lli
from deepseis_pvt.observables import GridClock
from deepseis_sim.constellation import visible_satellites
from deepseis_sim.nominal_constellation import nominal_constellation
from deepseis_sim.observation_model import ObservationConfig, ObservationModel
from deepseis_sim.signal_model import SignalModel, linear_clock, still

START = GpsTime(2399, 346258 * 10**9)
TOKYO = ecef_from_geodetic([*np.deg2rad([35.681298, 139.766247]), 10.0])
SATELLITES = visible_satellites(nominal_constellation(START), START, TOKYO)
CHIP = SPEED_OF_LIGHT / CA_RATE_CPS
T = 0.02
QUIET = ObservationConfig(carrier_noise_scale=0.0, code_noise_scale=0.0)


def signals(start=START, clock=None):
    clock = clock or linear_clock(3e-4, 8e-8)
    return SignalModel(SATELLITES, start, still(TOKYO), clock=clock)


def model(config=None, start=START, cn0_dbhz=None, **more):
    """Return a still receiver, all of its satellites at one C/N0 if that is given."""
    if cn0_dbhz is not None:
        more["cn0"] = lambda time: np.full((time.size, len(SATELLITES)), cn0_dbhz)
    return ObservationModel(signals(start), config, **more)


def column(epochs, name):
    return np.array([getattr(o, name) for o in epochs])


NAMES = ("pseudorange", "carrier_phase_cycles", "carrier_doppler_hz")


@cache
def truth(rate_hz, count):
    """Return the same observables without noise, and the fraction of their phase."""
    receiver = model(dataclasses.replace(QUIET, rate_hz=rate_hz))
    epochs = list(receiver.epochs(0, count))
    return [column(epochs, name) for name in NAMES], receiver.phase_fraction


def errors(config, cn0_dbhz, count, seed=1):
    """Return observed minus true: pseudorange [m], NCO phase [rad], Doppler [Hz], and epochs."""
    receiver = model(config, cn0_dbhz=cn0_dbhz, seed=seed)
    epochs = list(receiver.epochs(0, count))
    true, fraction = truth(config.rate_hz, count)
    code, phase, doppler = (
        column(epochs, name) - one for name, one in zip(NAMES, true, strict=True)
    )
    phase += receiver.phase_fraction - fraction
    phase -= np.round(phase[0])  # noise of metres at the start chooses other integers
    return code, -2 * np.pi * phase, doppler, epochs


def test_without_noise_the_pseudorange_is_the_codes_delay():
    epochs = list(model(QUIET).epochs(0, 60))
    truth = signals().delays(np.arange(60) * T)
    assert_allclose(column(epochs, "pseudorange"), truth.pseudorange, rtol=0, atol=1e-7)


def test_carrier_phase_grows_with_range_and_starts_near_the_code():
    epochs = list(model(QUIET).epochs(0, 60))
    phase = column(epochs, "carrier_phase_cycles")
    total = phase + signals().carrier_phase_cycles(np.arange(60) * T)
    fraction = total - np.floor(total)
    # One fraction for all satellites, and for all times: doubles of 1e8 cycles.
    assert_allclose(fraction, fraction[0, 0], rtol=0, atol=1e-6)
    gap = phase[0] - column(epochs, "pseudorange")[0] / L1_WAVELENGTH
    assert (np.abs(gap) <= 0.5 + 1e-6).all()


def test_doppler_is_the_negative_rate_of_the_phase():
    epochs = list(model(QUIET).epochs(0, 100))
    phase = column(epochs, "carrier_phase_cycles")
    doppler = column(epochs, "carrier_doppler_hz")
    # Doppler of a still antenna is a straight line over 40 ms; phases round to 1.5e-8 cycle.
    assert_allclose((phase[:-2] - phase[2:]) / (2 * T), doppler[1:-1], rtol=0, atol=2e-4)


@pytest.mark.parametrize(("rate_hz", "sample_rate_hz"), [(1, 4e6), (50, 4e6), (100, 16.3676e6)])
def test_epochs_stand_on_the_grid_of_receiver_time_like_the_real_chains(rate_hz, sample_rate_hz):
    start = START.add_ns(-1_234_567)
    config = ObservationConfig(rate_hz=rate_hz)
    receiver = model(config, start=start, sample_rate_hz=sample_rate_hz)
    epochs = list(receiver.epochs(0, 2 * rate_hz + 1))
    clock = GridClock(sample_rate_hz, start.total_ns)
    interval = 10**9 // rate_hz
    for k, o in enumerate(epochs):
        gps_ns = GpsTime(o.week, o.tow_ns).total_ns
        assert gps_ns == START.total_ns + k * interval
        assert (o.sample_index, o.sample_fraction) == clock.sample_at(gps_ns)
        assert o.valid_through == clock.sample_at(gps_ns + interval)[0] - 1
        assert o.interval == 1.0 / rate_hz
    assert receiver.count(1.0) == rate_hz
    assert receiver.count(0.001) == 0


def test_the_grid_goes_on_over_the_end_of_a_week():
    start = GpsTime(2399, (604800 - 1) * 10**9)
    epochs = list(model(QUIET, start=start).epochs(49, 2))
    assert [(o.week, o.tow_ns) for o in epochs] == [(2399, 604800 * 10**9 - 20_000_000), (2400, 0)]
    phase = column(epochs, "carrier_phase_cycles")
    doppler = column(epochs, "carrier_doppler_hz").mean(axis=0)
    assert_allclose(phase[0] - phase[1], T * doppler, rtol=0, atol=1e-5)


@pytest.mark.parametrize(("cn0_dbhz", "bandwidth_hz"), [(45.0, 8.0), (41.0, 15.0), (30.0, 3.0)])
def test_phase_noise_is_that_of_theory(cn0_dbhz, bandwidth_hz):
    config = ObservationConfig(pll_bandwidth_hz=bandwidth_hz)
    measured = [errors(config, cn0_dbhz, 2000, seed)[1].std() for seed in range(3)]
    cn0 = 10 ** (cn0_dbhz / 10)
    theory = np.sqrt(bandwidth_hz / cn0 * (1 + 1 / (2 * T * cn0)))
    # 3 x 40 s x satellites with 4 Bn independent values a second: 1 % at 3 Hz.
    assert_allclose(np.sqrt(np.mean(np.square(measured))), theory, rtol=0.025)


def test_the_mean_phase_over_a_second_knows_nothing_of_the_loop():
    cn0 = 10**4.1
    for bandwidth_hz in (5.0, 15.0):
        _, phase, _, _ = errors(ObservationConfig(pll_bandwidth_hz=bandwidth_hz), 41.0, 2000)
        means = phase.reshape(40, 50, -1).mean(axis=1)
        # White noise of density 1/(2 CN0) through any loop that follows a constant; the edges of
        # the second add a little. 40 x satellites values: 4 %.
        assert_allclose(means.std(), np.sqrt((1 + 1 / (2 * T * cn0)) / (2 * cn0)), rtol=0.11)


def test_phase_noise_is_correlated_over_the_loops_time():
    _, phase, _, _ = errors(ObservationConfig(pll_bandwidth_hz=5.0), 45.0, 2000)
    gain = 4 * 5.0 * T / (1 + 2 * 5.0 * T)
    for lag in (1, 2, 5):
        measured = np.mean(phase[lag:] * phase[:-lag]) / np.mean(phase**2)
        assert_allclose(measured, (1 - gain) ** lag, rtol=0, atol=0.03)


def test_doppler_noise_is_the_nco_that_makes_the_phase_noise():
    _, phase, doppler, epochs = errors(ObservationConfig(), 45.0, 500)
    steps = np.diff(phase, axis=0) / (2 * np.pi)
    assert_allclose(steps, doppler[:-1] * T, rtol=0, atol=1e-6)
    shown = column(epochs, "carrier_error_cycles")
    gain = 4 * 8.0 * T / (1 + 2 * 8.0 * T)
    assert_allclose(doppler, gain / T * shown, rtol=0, atol=1e-3)


def test_between_two_integrations_the_phase_noise_goes_straight():
    fast = errors(ObservationConfig(rate_hz=100), 45.0, 201)[1]
    assert_allclose(fast[1:-1:2], (fast[:-2:2] + fast[2::2]) / 2, rtol=0, atol=1e-6)


def test_discriminators_show_open_loop_noise_and_the_loops_own():
    config = ObservationConfig()
    *_, epochs = errors(config, 41.0, 2000)
    cn0 = 10**4.1
    energy = cn0 * T
    open_loop = np.sqrt(1 / (2 * energy) * (1 + 1 / (2 * energy)))
    thermal = np.sqrt(config.pll_bandwidth_hz / cn0 * (1 + 1 / (2 * energy)))
    shown = 2 * np.pi * column(epochs, "carrier_error_cycles").astype(float)
    assert_allclose(shown.std(), np.hypot(open_loop, thermal), rtol=0.02)
    sd = column(epochs, "carrier_error_sd_cycles")
    assert_allclose(sd, open_loop / (2 * np.pi), rtol=1e-6)
    code = column(epochs, "code_error_sd_chips")
    assert_allclose(code, np.sqrt(0.5 / (4 * energy) * (1 + 2 / (1.5 * energy))), rtol=1e-6)


@pytest.mark.parametrize(("cn0_dbhz", "spacing"), [(45.0, 0.5), (33.0, 1.0)])
def test_code_noise_is_that_of_theory(cn0_dbhz, spacing):
    config = ObservationConfig(spacing_chips=spacing)
    measured = [errors(config, cn0_dbhz, 2000, seed)[0].std() for seed in range(3)]
    cn0 = 10 ** (cn0_dbhz / 10)
    squaring = 1 + 2 / (T * cn0 * (2 - spacing))  # Kaplan, eq. 5.20
    theory = CHIP * np.sqrt(1.0 * spacing / (2 * cn0) * squaring)
    # 3 x 40 s x satellites with 4 independent values a second.
    assert_allclose(np.sqrt(np.mean(np.square(measured))), theory, rtol=0.04)


def test_a_positive_code_error_means_a_late_replica():
    code, _, _, epochs = errors(ObservationConfig(dll_bandwidth_hz=5.0), 45.0, 2000)
    shown = CHIP * column(epochs, "code_error_chips")
    # A late replica makes the pseudorange long; the discriminator shows that plus noise.
    slope = np.sum(shown * code) / np.sum(code * code)
    assert_allclose(slope, 1.0, rtol=0, atol=0.1)
    # ... and is steered back by what it showed.
    gain = 4 * 5.0 * T / (1 + 2 * 5.0 * T)
    assert_allclose(np.diff(code, axis=0), -gain * shown[:-1], rtol=0, atol=1e-4)


def test_a_receiver_known_by_its_data_sheet_has_those_levels():
    sheet = ObservationConfig(
        rate_hz=1,
        pseudorange_sd=5.0,
        pseudorange_mean=2.0,
        range_rate_sd=0.5,
        range_rate_mean=0.1,
    )
    code, _, doppler, _ = errors(sheet, 45.0, 400)
    n = code.size
    assert_allclose(code.mean(), 2.0, rtol=0, atol=4 * 5.0 / np.sqrt(n))
    assert_allclose(code.std(), 5.0, rtol=4 / np.sqrt(2 * n))
    rate = -doppler * SPEED_OF_LIGHT / L1_HZ
    assert_allclose(rate.mean(), 0.1, rtol=0, atol=4 * 0.5 / np.sqrt(n))
    assert_allclose(rate.std(), 0.5, rtol=4 / np.sqrt(2 * n))
    neighbours = np.mean((code[1:] - 2) * (code[:-1] - 2)) / 25.0
    assert abs(neighbours) < 4 / np.sqrt(n) + np.exp(-4.0)


def test_multipath_moves_the_code_slowly_and_the_phase_not():
    config = dataclasses.replace(QUIET, rate_hz=1, multipath_sd=0.7, multipath_tau=5.0)
    code, phase, _, _ = errors(config, 45.0, 1500)
    assert_allclose(code.std(), 0.7, rtol=0.08)
    lagged = np.mean(code[5:] * code[:-5]) / np.mean(code**2)
    assert_allclose(lagged, np.exp(-1.0), rtol=0, atol=0.08)
    assert np.abs(phase).max() < 1e-6


def test_chunks_and_going_back_change_nothing():
    whole = list(model().epochs(0, 230))
    chopped = model()
    parts = [list(chopped.epochs(a, b - a)) for a, b in ((0, 7), (7, 50), (50, 181), (181, 230))]
    made = [o for part in parts for o in part] + list(chopped.epochs(20, 3))
    expected = [*whole, *whole[20:23]]
    ahead = list(model().epochs(120, 4))
    for this, one in zip([*made, *ahead], [*expected, *whole[120:124]], strict=True):
        for item in dataclasses.fields(this):
            assert_array_equal(getattr(this, item.name), getattr(one, item.name))


def test_receivers_have_noise_of_their_own():
    one, other = (list(model(stream=s).epochs(0, 500)) for s in (61, 62))
    a, b = (column(epochs, "carrier_error_cycles") for epochs in (one, other))
    assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 4 / np.sqrt(a.size)


def blocked(since, until, number=2):
    """Return the C/N0 of a sky in which one satellite is hidden for a while."""

    def cn0(time):
        out = np.full((time.size, len(SATELLITES)), 45.0)
        out[(time >= since) & (time < until), number] = -np.inf
        return out

    return cn0


def test_a_hidden_satellite_drops_out_and_comes_back_as_a_new_arc():
    receiver = ObservationModel(
        signals(), ObservationConfig(reacquisition=0.5), cn0=blocked(1.0, 1.7)
    )
    name = SATELLITES[2].satellite
    epochs = list(receiver.epochs(0, 150))
    seen = np.array([name in o.satellites for o in epochs])
    assert not seen[50:110].any()
    assert seen[:50].all()
    assert seen[110:].all()
    assert_array_equal([len(o.satellites) for o in epochs], len(SATELLITES) - 1 + seen)
    mine = [(o, o.satellites.index(name)) for o in epochs if name in o.satellites]
    lli = [o.lli[k] for o, k in mine]
    assert lli[0] == Lli.SLIP
    assert np.flatnonzero(lli[1:]).tolist() == [49]
    lock = [o.lock_time[k] for o, k in mine]
    assert lock[50] == 0.0
    assert_allclose(lock[49], 0.98, rtol=1e-6)
    gap = [o.carrier_phase_cycles[k] - o.pseudorange[k] / L1_WAVELENGTH for o, k in mine]
    assert abs(gap[50]) <= 0.5 + 1e-6
    assert all(o.lli[i] == 0 for o in epochs[1:] for i, s in enumerate(o.satellites) if s != name)


def test_what_happens_between_two_epochs_is_not_lost():
    config = ObservationConfig(rate_hz=1, reacquisition=0.2)
    receiver = ObservationModel(signals(), config, cn0=blocked(3.3, 3.5))
    epochs = list(receiver.epochs(0, 7))
    assert [int(o.lli[2]) for o in epochs] == [1, 0, 0, 0, 1, 0, 0]


@pytest.mark.parametrize("cn0_dbhz", [24.9, -np.inf, np.nan])
def test_without_signal_there_are_epochs_without_satellites(cn0_dbhz):
    epochs = list(model(cn0_dbhz=cn0_dbhz).epochs(0, 3))
    assert [len(o.satellites) for o in epochs] == [0, 0, 0]
    assert epochs[0].pseudorange.shape == (0,)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rate_hz": 30}, "rate_hz = 30 divides 1e9 unevenly"),
        ({"rate_hz": 0}, "rate_hz = 0 is outside"),
        ({"spacing_chips": 2.0}, "spacing_chips = 2.0 is outside"),
        ({"threshold_dbhz": -np.inf}, "threshold_dbhz = -inf is outside"),
    ],
)
def test_settings_that_make_no_sense_are_refused(change, message):
    with pytest.raises(InputError, match=message):
        model(ObservationConfig(**change))
