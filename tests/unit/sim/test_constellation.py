"""The built-in sky looks like the real one; who is visible, and how strongly."""

import dataclasses

import numpy as np
import pytest

from deepseis_core.ephemeris import pack, satellite_states
from deepseis_core.geodesy import ecef_from_geodetic
from deepseis_core.gps_time import GpsTime
from deepseis_core.lnav import quantise
from deepseis_sim.constellation import cn0_at_elevation, visible_satellites
from deepseis_sim.nominal_constellation import SEMI_MAJOR_AXIS, SLOTS_DEG, nominal_constellation

TIME = GpsTime(2399, 346258 * 10**9)
TOKYO = ecef_from_geodetic([np.deg2rad(35.7), np.deg2rad(139.8), 10.0])


@pytest.fixture(scope="module")
def sky():
    return nominal_constellation(TIME)


def states(sky, seconds=0.0):
    return satellite_states(pack(sky), TIME.week, TIME.tow_ns, np.full(len(sky), -seconds))


def test_satellites_are_where_orbits_of_gps_are(sky):
    state = states(sky)
    radius = np.linalg.norm(state[:, :3], axis=1)
    # a (1 +- e), e at most 0.015, and the harmonic corrections of a few hundred metres.
    assert (np.abs(radius / SEMI_MAJOR_AXIS - 1) < 0.0151).all()
    inertial = state[:, 3:6] + np.cross([0.0, 0.0, 7.2921151467e-5], state[:, :3])
    assert np.linalg.norm(inertial, axis=1) == pytest.approx(3874.0, rel=0.02)


def test_the_six_planes_hold_five_satellites_each(sky):
    nodes = np.rad2deg([item.omega0 for item in sky]) % 360
    first = np.rad2deg(sky[0].omega0) % 360
    turns = np.round((nodes - first) / 60.0)
    # The planes are 60 degrees apart; nodes are drawn with no spread beyond the slots' own.
    assert np.abs(nodes - first - 60.0 * turns).max() < 0.1
    assert np.bincount(turns.astype(int) % 6).tolist() == [5] * 6
    assert len(SLOTS_DEG) == 6


def test_the_slots_are_those_of_the_standard_at_its_epoch():
    # At the epoch of the table, satellites of one plane differ in argument of latitude as there.
    epoch = GpsTime.from_utc_calendar(1993, 7, 1)
    sky = nominal_constellation(epoch)
    toe = GpsTime(sky[0].week, int(sky[0].toe) * 10**9)
    drift = 360.0 / 43077.0 * (toe.diff_ns(epoch) / 1e9)
    angles = []
    for item in sky:
        true = item.m0 + 2 * item.eccentricity * np.sin(item.m0)
        angles.append((np.rad2deg(true + item.omega) - drift) % 360)
    wanted = [angle for _, plane in SLOTS_DEG for angle in plane]
    distance = np.abs((np.array(angles)[:, None] - wanted + 180) % 360 - 180).min(axis=1)
    # Equation of the centre to first order in e: 1.25 e^2 = 0.016 degree and the drift's rate.
    assert distance.max() < 0.1


def test_every_element_is_in_the_resolution_of_the_message(sky):
    for item in sky:
        assert quantise(item) == item


def test_the_sky_follows_the_seed():
    assert nominal_constellation(TIME, seed=1) == nominal_constellation(TIME, seed=1)
    assert nominal_constellation(TIME, seed=1) != nominal_constellation(TIME, seed=2)


@pytest.mark.parametrize("hour", [0, 3, 6, 9, 12, 15, 18, 21])
@pytest.mark.parametrize("latitude", [-60.0, 0.0, 35.0, 80.0])
def test_enough_satellites_are_visible_everywhere_all_day(hour, latitude):
    time = TIME.add_ns(hour * 3600 * 10**9)
    place = ecef_from_geodetic([np.deg2rad(latitude), 1.0, 0.0])
    visible = visible_satellites(nominal_constellation(time), time, place)
    assert 6 <= len(visible) <= 14


def test_only_healthy_satellites_above_the_mask_are_taken(sky):
    visible = visible_satellites(sky, TIME, TOKYO, elevation_mask=np.deg2rad(20.0))
    assert all(item.elevation > np.deg2rad(20.0) for item in visible)
    ill = visible[0].satellite
    changed = [
        dataclasses.replace(item, health=32) if item.satellite == ill else item for item in sky
    ]
    names = [item.satellite for item in visible_satellites(changed, TIME, TOKYO)]
    assert ill not in names


def test_cn0_falls_from_45_at_the_zenith_to_41_at_ten_degrees(sky):
    angles = np.deg2rad([90.0, 10.0, 30.0])
    expected = [45.0, 41.0, 41.0 + 4 * (0.5 - 0.17364818) / (1 - 0.17364818)]
    np.testing.assert_allclose(cn0_at_elevation(angles), expected, atol=1e-6)
    visible = visible_satellites(sky, TIME, TOKYO, cn0_dbhz={"G14": 50.0})
    assert {item.satellite: item.cn0_dbhz for item in visible}["G14"] == 50.0


def test_without_ephemerides_nothing_is_visible():
    assert visible_satellites([], TIME, TOKYO) == ()
