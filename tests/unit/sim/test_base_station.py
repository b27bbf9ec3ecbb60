"""The base: where it stands, its clock, and whole ambiguities of double differences."""

import dataclasses

import allantools
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from deepseis_core.constants import L1_HZ
from deepseis_core.errors import InputError
from deepseis_core.geodesy import ecef_from_geodetic, rotation_enu_ecef
from deepseis_core.gps_time import GpsTime
from deepseis_sim.base_station import BaseClock, BaseConfig, BaseStation
from deepseis_sim.constellation import visible_satellites
from deepseis_sim.nominal_constellation import nominal_constellation
from deepseis_sim.observation_model import ObservationConfig, ObservationModel
from deepseis_sim.signal_model import SignalModel, linear_clock, still

START = GpsTime(2399, 346258 * 10**9)
ORIGIN = np.array([*np.deg2rad([38.7292, 141.0217]), 40.0])
HERE = ecef_from_geodetic(ORIGIN)
SATELLITES = visible_satellites(nominal_constellation(START), START, HERE)
ROVER = SignalModel(SATELLITES, START, still(HERE), clock=linear_clock(3.2e-4, 8e-8), seed=5)
QUIET = BaseConfig(carrier_noise_scale=0.0, code_noise_scale=0.0)


def double_differences(base, rover, count):
    """Return NCO-free double differences at the base's epochs: phase minus geometry [cycles]."""
    step = base.config.rate_hz
    mine = list(rover.epochs(0, count * rover.config.rate_hz // step))
    out = []
    for k, theirs in enumerate(base.epochs(0, count)):
        o = mine[k * rover.config.rate_hz // step]
        assert (o.week, o.tow_ns, o.satellites) == (theirs.week, theirs.tow_ns, theirs.satellites)
        time = np.array([k / step])
        truth = (
            rover.signals.delays(time).carrier_phase_cycles
            - base.signals.delays(time).carrier_phase_cycles
        )
        single = o.carrier_phase_cycles - theirs.carrier_phase_cycles + truth[0]
        out.append(single[1:] - single[0])
    return np.array(out)


def test_it_stands_within_5_km_and_where_the_settings_say():
    base = BaseStation(ROVER, ORIGIN, BaseConfig(east=300.0, north=-400.0, up=25.0))
    offset = rotation_enu_ecef(*ORIGIN[:2]) @ (base.position_ecef - HERE)
    assert_allclose(offset, [300.0, -400.0, 25.0], rtol=0, atol=1e-6)
    usual = BaseStation(ROVER, ORIGIN)
    assert 2500.0 < np.linalg.norm(usual.position_ecef - HERE) < 5000.0


def test_double_differences_have_whole_ambiguities():
    rover = ObservationModel(
        ROVER, ObservationConfig(carrier_noise_scale=0.0, code_noise_scale=0.0)
    )
    cycles = double_differences(BaseStation(ROVER, ORIGIN, QUIET), rover, 20)
    # Four doubles of 1e8 cycles, and their truth.
    assert_allclose(cycles, np.round(cycles), rtol=0, atol=5e-7)
    assert_array_equal(np.ptp(np.round(cycles), axis=0), 0.0)


def test_noise_of_double_differences_is_that_of_four_carrier_loops():
    rover = ObservationModel(ROVER, seed=3)
    cycles = double_differences(BaseStation(ROVER, ORIGIN, seed=3), rover, 1200)
    cn0 = 10 ** (np.array([item.cn0_dbhz for item in SATELLITES]) / 10)
    variance = 8.0 / cn0 * (1 + 1 / (2 * 0.02 * cn0))
    theory = np.sqrt(2 * (variance[1:] + variance[0])) / (2 * np.pi)
    # 120 s at some 10 independent values a second: 2 % each.
    assert_allclose(cycles.std(axis=0), theory, rtol=0.08)
    means = cycles.mean(axis=0)
    assert_allclose(means, np.round(means), rtol=0, atol=0.002)


def test_single_differences_within_a_receiver_need_not_be_whole():
    base = BaseStation(ROVER, ORIGIN, QUIET)
    epoch = next(base.epochs(0, 1))
    total = epoch.carrier_phase_cycles + base.signals.delays(np.zeros(1)).carrier_phase_cycles[0]
    assert np.ptp(total - np.floor(total)) > 0.1


def test_its_receiver_is_its_own():
    rover = next(ObservationModel(ROVER).epochs(0, 1))
    base = next(BaseStation(ROVER, ORIGIN, BaseConfig(cn0_offset_db=2.0)).epochs(0, 1))
    # 2.9 km turn the elevation by 5e-4 rad at most.
    assert_allclose(base.cn0_dbhz - rover.cn0_dbhz, 2.0, rtol=0, atol=3e-3)
    assert base.interval == 0.1
    # Clocks: half a millisecond apart, and a fast clock lowers every Doppler.
    difference = base.pseudorange - rover.pseudorange
    assert_allclose(difference, -5.3e-4 * 299792458.0, rtol=0, atol=4000.0)
    doppler = base.carrier_doppler_hz - rover.carrier_doppler_hz
    assert_allclose(doppler, 11e-8 * L1_HZ, rtol=0, atol=3.0)


def test_satellites_rise_and_set_over_it():
    base = BaseStation(ROVER, ORIGIN, QUIET)
    time = np.array([0.0, 7200.0])
    elevation = base.signals.delays(time).elevation
    cn0 = base.cn0_dbhz(time)
    assert_array_equal(np.isfinite(cn0), elevation > np.deg2rad(10.0))
    up = np.isfinite(cn0[1])
    assert 0 < np.count_nonzero(up) < len(SATELLITES)
    # 45 dB-Hz at the zenith, 41 at 10 degrees, a line in sin(elevation).
    low = np.sin(np.deg2rad(10.0))
    expected = 41.0 + 4.0 * (np.sin(elevation[1, up]) - low) / (1.0 - low)
    assert_allclose(cn0[1, up], expected, rtol=0, atol=3e-3)


def test_chunks_change_nothing():
    whole = list(BaseStation(ROVER, ORIGIN).epochs(0, 40))
    other = BaseStation(ROVER, ORIGIN)
    parts = [*other.epochs(0, 3), *other.epochs(3, 24), *other.epochs(27, 13)]
    for a, b in zip(whole, parts, strict=True):
        for item in dataclasses.fields(a):
            assert_array_equal(getattr(a, item.name), getattr(b, item.name))


def test_the_clock_has_white_frequency_noise():
    clock = BaseClock(1e-4, -3e-8, 1e-10, seed=2)
    time = np.arange(20000.0)
    phase = clock(time) - 1e-4 + 3e-8 * time
    tau, deviation, _, _ = allantools.oadev(phase, rate=1.0, data_type="phase", taus=[1, 10, 100])
    assert_allclose(deviation, 1e-10 / np.sqrt(tau), rtol=0.15)
    assert phase[0] == 0.0


def test_the_clock_answers_in_any_order_and_without_corners():
    clock, other = (BaseClock(0.0, 0.0, 1e-10, seed=2) for _ in range(2))
    late = other(np.array([5000.3]))
    time = np.arange(-2.0, 6000.0, 0.1)
    whole = clock(time)
    assert_allclose(np.interp(5000.3, time, whole), late[0], rtol=0, atol=1e-18)
    assert_array_equal(other(time[::-1])[::-1], whole)
    # Its frequency turns within seconds, by no more than some sigma.
    assert np.abs(np.diff(whole, 2)).max() < 1e-10
    assert not whole[time < -1].any()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"east": 45e3, "north": 45e3}, "more than 50 km off"),
        ({"rate_hz": 3}, "divides 1e9 unevenly"),
        ({"clock_drift": 1.0}, "clock_drift = 1.0 is outside"),
    ],
)
def test_settings_that_make_no_sense_are_refused(change, message):
    with pytest.raises(InputError, match=message):
        BaseStation(ROVER, ORIGIN, BaseConfig(**change))
