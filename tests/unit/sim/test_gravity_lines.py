"""Repeated lines: the same points every time, the paper's length, height change and speed."""

from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose

from deepseis_core.errors import InputError
from deepseis_core.geodesy import ecef_from_enu, ecef_from_geodetic, geodetic_from_ecef
from deepseis_sim.gravity_lines import MOTION_KINDS, GravityLines
from deepseis_sim.motion import Surroundings
from deepseis_sim.vehicle_path import Ride

ORIGIN = (np.radians(28.5), np.radians(113.0), 60.0)


def build(seed=1, **settings):
    return GravityLines(**settings).build(Surroundings(ORIGIN, 4800.0, seed))


@pytest.fixture(scope="module")
def motion():
    return build(ride=Ride(vibration=0.0))


def test_six_lines_back_and_forth_within_the_scenario(motion):
    lines = motion.lines()
    assert [line.direction for line in lines] == [1, -1, 1, -1, 1, -1]
    assert lines[0].start_time == motion.span[0] == 60.0
    assert lines[-1].end_time == motion.span[1] < 4800.0
    for before, after in pairwise(lines):
        assert before.end_time + 60.0 < after.start_time < before.end_time + 120.0
        rest = np.linspace(before.end_time, before.end_time + 60.0, 50)
        assert np.abs(motion.at(rest).velocity).max() < 1e-10


def test_lines_have_the_papers_length_height_change_and_speed(motion):
    line = motion.lines()[0]
    t = np.linspace(line.start_time, line.end_time, 20001)
    at = motion.at(t)
    along = motion.along_line(t)
    assert along[0] == 0.0
    assert 11000.0 < along[-1] < 11020.0  # in space; 11 km in plan
    place = geodetic_from_ecef(ecef_from_enu(at.position, ecef_from_geodetic(np.array(ORIGIN))))
    assert np.ptp(place[:, 2]) == pytest.approx(332.7, abs=0.05)
    speed = np.linalg.norm(at.velocity, axis=1)
    assert speed.max() <= 20.0 + 1e-4
    assert 14.0 < along[-1] / (line.end_time - line.start_time) < 20.0
    grade = at.C_enu_b[:, 2, 0]
    assert np.abs(grade).max() < 0.12


def test_every_pass_meets_the_same_points(motion):
    where = np.linspace(5.0, 10990.0, 2001)

    def points(line):
        t = np.linspace(line.start_time, line.end_time, 100001)
        along, place = motion.along_line(t), motion.at(t).position
        order = np.argsort(along)
        return np.column_stack([np.interp(where, along[order], p[order]) for p in place.T])

    first, *others = (points(line) for line in motion.lines())
    for place in others:
        assert_allclose(place, first, atol=1e-3)  # linear between points 0.1 m apart


def test_distance_along_the_line_stays_at_its_ends_in_loops_and_rests(motion):
    lines = motion.lines()
    for k, (before, after) in enumerate(pairwise(lines)):
        t = np.linspace(before.end_time, after.start_time, 101)
        end = motion.along_line(t[:1])[0]
        assert_allclose(motion.along_line(t), end, atol=1e-6)
        assert end == (0.0 if k % 2 else pytest.approx(11000.0, abs=20.0))


def test_vehicle_faces_the_way_it_drives(motion):
    out, back = motion.lines()[:2]
    there = motion.at(np.array([out.start_time]))
    home = motion.at(np.array([back.end_time]))
    assert_allclose(there.C_enu_b[0, :, 0], -home.C_enu_b[0, :, 0], atol=1e-6)


def test_short_form_scales_its_height():
    motion = build(length=1500.0, passes=2)
    assert len(motion.lines()) == 2
    up = motion.at(np.arange(0.0, motion.span[1], 0.5)).position[:, 2]
    assert np.ptp(up) == pytest.approx(1500.0 * 0.030245, abs=0.3)  # the Earth curves by 0.2 m


def test_one_pass_is_a_line(motion):
    single = build(length=500.0, passes=1)
    assert len(single.lines()) == 1
    assert_allclose(single.along_line(np.array([0.0, 1e5])), [0.0, single.bounds[0, 1]])


def test_memory_is_that_of_the_road(motion):
    hours = motion.span[1] / 3600.0
    assert motion.road.nodes.nbytes + motion.programme.phases.nbytes < 5e6 * hours


@pytest.mark.parametrize("settings", [{"length": 10.0}, {"passes": 0}, {"rest": np.inf}])
def test_senseless_settings_are_refused_in_one_line(settings):
    with pytest.raises(InputError, match=next(iter(settings))):
        build(**settings)
    assert MOTION_KINDS["gravity-lines"] is GravityLines
