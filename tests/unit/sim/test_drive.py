"""The drive through a town: what a scenario may count on."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from deepseis_core import rotation
from deepseis_core.errors import InputError
from deepseis_core.geodesy import ecef_from_geodetic, enu_from_ecef
from deepseis_ins.strapdown import NavState, propagate
from deepseis_sim.drive import MOTION_KINDS, Drive
from deepseis_sim.imu import ImuSynthesizer
from deepseis_sim.motion import Surroundings
from deepseis_sim.site import Site
from deepseis_sim.vehicle_path import Ride

ORIGIN = (np.radians(38.7), np.radians(141.0), 40.0)


def build(seed=1, **settings):
    return Drive(**settings).build(Surroundings(ORIGIN, 1200.0, seed))


@pytest.fixture(scope="module")
def motion():
    return build()


def test_twenty_minutes_with_stops_and_turns_both_ways(motion):
    begin, end = motion.span
    assert begin == 20.0
    assert 1190.0 - 60.0 < end <= 1190.0
    t = np.arange(0.0, 1200.0, 0.1)
    at = motion.at(t)
    speed = np.linalg.norm(at.velocity, axis=1)
    assert 13.0 < speed.max() <= 16.01
    inside = (t > begin + 1.0) & (t < end - 1.0)
    stops = np.diff((speed[inside] == 0.0).astype(int)) == 1
    assert 5 <= stops.sum() <= 40
    heading = np.unwrap(np.arctan2(at.C_enu_b[:, 1, 0], at.C_enu_b[:, 0, 0]))
    assert heading[-1] - heading[0] > 3.0 * np.pi  # laps
    assert np.degrees(at.omega_b[:, 2].max()) > 10.0
    assert np.degrees(at.omega_b[:, 2].min()) < -10.0
    assert 3.0 < np.ptp(at.position[:, 2]) < 40.0


def test_it_starts_at_the_origin_with_its_heading():
    at = build(heading_deg=30.0).at(np.zeros(1))
    assert_allclose(at.position[0], 0.0, atol=1e-8)
    assert_allclose(at.C_enu_b[0, :2, 0], np.sin(np.radians([30.0, 60.0])), atol=0.02)
    assert at.C_enu_b[0, 0, 0] / at.C_enu_b[0, 1, 0] == pytest.approx(np.tan(np.radians(30.0)))


def test_every_lap_takes_the_same_road(motion):
    """A point passed 3 times or more: laps differ in speed, not in place."""
    t = np.arange(20.0, motion.span[1], 0.05)
    place = motion.at(t).position
    first = place[t < 200.0][::200]
    later = place[t > 700.0]
    nearest = np.linalg.norm(first[:, None, :2] - later[None, :, :2], axis=2).min(axis=1)
    assert np.median(nearest) < 0.5  # 0.05 s at 16 m/s is 0.8 m


def test_it_stays_near_its_base_station(motion):
    place = motion.at(np.arange(0.0, 1200.0, 1.0)).position
    assert np.linalg.norm(place, axis=1).max() < 2500.0


def test_seed_decides_everything():
    t = np.linspace(0.0, 200.0, 500)
    a, b, c = (build(seed, duration=120.0).at(t) for seed in (1, 1, 2))
    assert np.array_equal(a.position, b.position)
    assert np.abs(a.position - c.position).max() > 1.0


@pytest.mark.parametrize("duration", [10.0, 20.0, 90.0, 300.0])
def test_short_drives_end_in_time_and_at_rest(duration):
    motion = build(start=5.0, duration=duration)
    assert 5.0 < motion.span[1] <= 5.0 + duration
    assert motion.distance(np.array([1e4]))[0] > 10.0
    after = motion.at(np.array([motion.span[1], motion.span[1] + 50.0]))
    assert_allclose(after.velocity, 0.0, atol=1e-10)


def test_no_red_lights_no_stops():
    motion = build(duration=200.0, red_lights=0.0, relief=0.0, ride=Ride(vibration=0.0))
    t = np.arange(motion.span[0] + 2.0, motion.span[1] - 2.0, 0.1)
    assert np.linalg.norm(motion.at(t).velocity, axis=1).min() > 0.0


@pytest.mark.parametrize("settings", [{"duration": 1.0}, {"speed": np.nan}, {"red_lights": 2.0}])
def test_senseless_settings_are_refused_in_one_line(settings):
    with pytest.raises(InputError, match=next(iter(settings))):
        build(**settings)
    assert MOTION_KINDS["drive"] is Drive


def mechanised(motion, seconds, rate_hz=200.0):
    """Return the error of the trajectory that error-free increments give [m], (m, 3)."""
    site = Site(ORIGIN)
    ideal = ImuSynthesizer(motion, site, rate_hz).increments(0, round(seconds * rate_hz))
    sums = [rotation.flu_from_frd(each) for each in (ideal.delta_theta, ideal.delta_vel)]
    C_nb = rotation.ned_frd_from_enu_flu(motion.at(np.zeros(1)).C_enu_b)[0]
    start = NavState(*ORIGIN, np.zeros(3), rotation.quat_from_matrix(C_nb))
    _, ours = propagate(start, *sums, ideal.dt)
    enu = enu_from_ecef(ecef_from_geodetic(ours.geodetic), site.origin_ecef)
    return enu - motion.at(ideal.time_end).position


def test_its_inertial_data_mechanise_back_to_the_road():
    """Rate, attitude and acceleration belong together: bends, slopes and vibration included."""
    assert_allclose(mechanised(build(duration=100.0), 120.0), 0.0, atol=2e-5)
