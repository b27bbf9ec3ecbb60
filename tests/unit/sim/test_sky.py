"""Who rises during a run and how strongly each is received, and what stands before them."""

import numpy as np
import pytest

from deepseis_core.errors import InputError
from deepseis_core.geodesy import ecef_from_geodetic
from deepseis_core.gps_time import GpsTime
from deepseis_core.lnav import quantise
from deepseis_core.rinex_nav import write_rinex_nav
from deepseis_sim.constellation import cn0_at_elevation, visible_satellites
from deepseis_sim.nominal_constellation import nominal_constellation
from deepseis_sim.signal_model import still
from deepseis_sim.sky import Obstruction, Sky, SkyConfig, broadcast_ephemerides

TIME = GpsTime(2399, 346258 * 10**9)
TOKYO = ecef_from_geodetic([np.deg2rad(35.681298), np.deg2rad(139.766247), 10.0])
ALL = nominal_constellation(TIME)


def sky(duration=60.0, time=TIME, **settings):
    return Sky(SkyConfig(**settings), ALL, time, still(TOKYO), duration)


def finite(cn0):
    return np.isfinite(cn0).sum(axis=1)


def test_a_short_clear_run_sees_what_is_above_the_mask_at_its_start():
    seen = visible_satellites(ALL, TIME, TOKYO)
    ours = sky(1.0)
    assert [item.satellite for item in ours.satellites] == [item.satellite for item in seen]
    for item, other in zip(ours.satellites, seen, strict=True):
        assert item.elevation == pytest.approx(other.elevation, abs=1e-9)
        assert item.azimuth == pytest.approx(other.azimuth, abs=1e-9)
        assert item.cn0_dbhz == pytest.approx(other.cn0_dbhz, abs=1e-6)
    np.testing.assert_allclose(
        ours.cn0_dbhz(np.zeros(1))[0], [item.cn0_dbhz for item in seen], atol=1e-6
    )


def test_satellites_that_rise_or_set_during_the_run_belong_to_it():
    whole = sky(3600.0)
    time = np.arange(0.0, 3601.0, 60.0)
    counts = set()
    for t in time:
        now = TIME.add_ns(int(t * 1e9))
        seen = {item.satellite for item in visible_satellites(ALL, now, TOKYO)}
        cn0 = whole.cn0_dbhz(np.array([t]))[0]
        names = {
            item.satellite for item, c in zip(whole.satellites, cn0, strict=True) if c > -np.inf
        }
        assert names == seen
        counts.add(len(seen))
    assert len(whole.satellites) > max(counts)
    assert len(counts) > 1


def test_cn0_follows_the_elevation_of_the_moment():
    ours = sky(1800.0, zenith_cn0_dbhz=50.0, low_cn0_dbhz=38.0, cn0_offset_db=-2.0)
    time = np.array([0.0, 777.0, 1800.0])
    for t, row in zip(time, ours.cn0_dbhz(time), strict=True):
        now = TIME.add_ns(int(t * 1e9))
        for item in visible_satellites(ALL, now, TOKYO):
            k = [s.satellite for s in ours.satellites].index(item.satellite)
            low = np.sin(np.deg2rad(10.0))
            share = (np.sin(item.elevation) - low) / (1 - low)
            assert row[k] == pytest.approx(36.0 + 12.0 * share, abs=1e-5)
    assert cn0_at_elevation(np.pi / 2, zenith_dbhz=50.0) == 50.0


def test_only_so_many_satellites_the_highest():
    few = sky(satellites=4)
    full = sky()
    highest = sorted(full.satellites, key=lambda item: -item.elevation)[:4]
    assert {item.satellite for item in few.satellites} == {item.satellite for item in highest}
    names = [item.satellite for item in few.satellites]
    assert names == sorted(names)


def test_any_moments_asked_together_give_what_they_give_alone():
    ours = sky(900.0, obstructions=(Obstruction(from_s=100.0, ramp_s=7.0, loss_db=20.0),))
    time = np.array([3.0, 103.0, 890.0, 55.0])
    together = ours.cn0_dbhz(time)
    for k, t in enumerate(time):
        np.testing.assert_array_equal(ours.cn0_dbhz(np.array([t]))[0], together[k])


def test_fewer_than_four_satellites_for_a_while():
    ours = sky(300.0, obstructions=(Obstruction(keep=3, from_s=60.0, to_s=270.0),))
    time = np.array([0.0, 59.99, 60.0, 150.0, 269.99, 270.0, 300.0])
    seen = finite(ours.cn0_dbhz(time))
    assert seen[[0, 1, 5, 6]].min() > 6
    assert seen[2:5].tolist() == [3, 3, 3]
    left = ours.cn0_dbhz(np.array([150.0]))[0] > -np.inf
    elevation, _ = ours.directions(np.array([150.0]))
    assert elevation[0, left].min() > elevation[0, ~left].max()


@pytest.mark.parametrize(("begin", "end"), [(300.0, 60.0), (-60.0, 60.0)])
def test_a_sector_may_pass_north(begin, end):
    wall = Obstruction(azimuth_from_deg=begin, azimuth_to_deg=end, elevation_to_deg=40.0)
    ours = sky(obstructions=(wall,))
    elevation, azimuth = (np.rad2deg(part[0]) for part in ours.directions(np.zeros(1)))
    hidden = ((azimuth >= 300.0) | (azimuth <= 60.0)) & (elevation <= 40.0)
    assert 0 < hidden.sum() < hidden.size
    np.testing.assert_array_equal(np.isinf(ours.cn0_dbhz(np.zeros(1))[0]), hidden)


def test_trees_weaken_and_their_edges_are_ramps():
    trees = Obstruction(loss_db=10.0, from_s=10.0, to_s=20.0, ramp_s=4.0)
    clear, ours = sky(), sky(obstructions=(trees,))
    time = np.array([9.0, 10.0, 12.0, 14.0, 15.0, 17.0, 19.0, 20.0])
    loss = clear.cn0_dbhz(time) - ours.cn0_dbhz(time)
    expected = np.array([0.0, 0.0, 5.0, 10.0, 10.0, 7.5, 2.5, 0.0])
    np.testing.assert_allclose(loss, np.broadcast_to(expected[:, None], loss.shape), atol=1e-9)


def test_a_navigation_file_is_read_as_a_receiver_would_decode_it(tmp_path):
    path = tmp_path / "brdc.rnx"
    write_rinex_nav(path, ALL[:5], leap_seconds=18, date="20260101 000000 UTC")
    again = broadcast_ephemerides(path, TIME)
    assert [item.satellite for item in again] == [item.satellite for item in ALL[:5]]
    assert all(quantise(item) == item for item in again)
    assert broadcast_ephemerides("", TIME, 3) == nominal_constellation(TIME, seed=3)
    with pytest.raises(InputError):
        broadcast_ephemerides(tmp_path / "none.rnx", TIME)


def test_twelve_satellites_can_be_had():
    time = GpsTime(2399, 415258 * 10**9)
    place = ecef_from_geodetic([np.deg2rad(38.7292), np.deg2rad(141.0217), 40.0])
    ours = Sky(SkyConfig(), nominal_constellation(time), time, still(place), 150.0)
    assert finite(ours.cn0_dbhz(np.array([0.0, 75.0, 150.0]))).tolist() == [12, 12, 12]


def test_what_makes_no_sense_is_refused():
    with pytest.raises(InputError, match="obstruction 2: ends before it begins"):
        sky(obstructions=(Obstruction(), Obstruction(from_s=5.0, to_s=4.0)))
    with pytest.raises(InputError, match="no ephemeris for its time"):
        sky(time=GpsTime(2390, 0))
    with pytest.raises(InputError, match="no satellite is visible"):
        sky(elevation_mask_deg=89.0)
