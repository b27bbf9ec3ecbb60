"""Lines are found by where the vehicle rests and runs; passes agree as arithmetic says."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from deepseis_ins.gravimetry_coupling import find_coupling, without_coupling
from deepseis_ins.gravimetry_lines import LineConfig, Way, coincidence, survey_lines

CONFIG = LineConfig()
SPEED, LENGTH = 10.0, 3000.0


def there_and_back(passes=4, *, offset=0.0, shift=0.0):
    """Drive a bent road to and fro, with rests of 30 s and a loop beyond the end."""
    along, still, beyond = [np.zeros(30)], [np.ones(30, bool)], [np.zeros(30)]
    for k in range(passes):
        run = np.arange(0.0, LENGTH, SPEED)
        run = run if k % 2 == 0 else LENGTH - run
        end = run[-1]
        along += [run, np.full(30, end), np.full(10, end)]
        still += [np.zeros(run.size, bool), np.ones(30, bool), np.zeros(10, bool)]
        beyond += [np.zeros(run.size), np.zeros(30), 20.0 * np.sin(np.linspace(0.0, np.pi, 10))]
    s, still, beyond = (np.concatenate(part) for part in (along, still, beyond))
    north = 200.0 * np.sin(s / 500.0) + offset + beyond
    east = s + np.where(s > LENGTH / 2, beyond, -beyond)
    position = np.stack([east, north, 0.03 * s], axis=1)
    gravity = 10.0 * np.sin(s / 700.0) + shift
    way = np.where(np.gradient(s) < 0.0, -1.0, 1.0)
    force = np.stack([0.3 * way, way * np.cos(s / 300.0)], axis=1)
    return Way(np.arange(s.size) * 1.0, position, still, gravity, force)


def test_passes_of_one_road_are_one_line_either_way():
    (line,) = survey_lines([there_and_back()], CONFIG)
    assert [item.direction for item in line.passes] == [1, -1, 1, -1]
    truth = 10.0 * np.sin(np.interp(line.position[:, 0], [0.0, LENGTH], [0.0, LENGTH]) / 700.0)
    # 10 m between points of the way, 5 m of the reference: half a step of a slope of 1/70.
    assert_allclose(line.gravity, np.broadcast_to(truth, line.gravity.shape), atol=0.15)
    assert coincidence(line.gravity).total < 0.1


def test_drives_share_lines_and_other_roads_do_not():
    ways = [there_and_back(2), there_and_back(2, shift=1.0), there_and_back(2, offset=500.0)]
    first, second = survey_lines(ways, CONFIG)
    assert [item.drive for item in first.passes] == [0, 0, 1, 1]
    assert [item.drive for item in second.passes] == [2, 2]
    found = coincidence(first.gravity)
    # Two at 0, two at 1: half from the mean each.
    assert found.total == pytest.approx(0.5, abs=0.02)


def test_total_is_the_quadratic_mean_of_the_lines_as_in_the_papers_tables():
    """Paper's table 2: 0.73 0.47 0.66 1.05 0.53 0.59 give 0.70; table 3: 1.53."""
    for rms, total in (
        ((0.73, 0.47, 0.66, 1.05, 0.53, 0.59), 0.70),
        ((1.03, 1.30, 1.75, 1.02, 2.46, 1.05), 1.53),
    ):
        assert np.sqrt(np.mean(np.square(rms))) == pytest.approx(total, abs=0.005)
    values = np.random.default_rng(1).standard_normal((6, 400))
    found = coincidence(values)
    assert found.total == pytest.approx(np.sqrt(np.mean(found.rms**2)))
    # Six passes of unit noise: sqrt(5/6), 2400 values.
    assert found.total == pytest.approx(np.sqrt(5.0 / 6.0), abs=0.05)


def test_stations_that_a_pass_does_not_reach_are_left_out():
    values = np.array([[1.0, 2.0, np.nan], [1.0, 4.0, 9.0]])
    found = coincidence(values)
    assert found.deviation.shape == (2, 2)
    assert found.total == pytest.approx(np.sqrt(0.5))


def test_a_drive_without_lines_has_none():
    way = there_and_back(1)
    still = replace(way, still=np.ones(way.time.size, bool))
    assert survey_lines([still], CONFIG) == []


def leaking(coefficient, passes=6, noise=0.0):
    """Let forces leak into a drive's gravity."""
    way = there_and_back(passes)
    rng = np.random.default_rng(2)
    leak = way.force @ coefficient + noise * rng.standard_normal(way.time.size)
    return replace(way, gravity=way.gravity + leak)


def test_what_leaks_from_forces_is_found_where_the_road_is_driven_both_ways():
    put_in = np.array([2.0, -6.0])
    lines = survey_lines([leaking(put_in)], CONFIG)
    found = find_coupling(lines, prior=5.0, independent_s=60.0)
    # The reference's 5 m and the way's 10 m leave 0.1 mGal; its share in the fit is a per cent.
    assert_allclose(found.coefficient, put_in, atol=0.1)
    clean = without_coupling(lines, found)
    assert coincidence(lines[0].gravity).total > 4.0
    assert coincidence(clean[0].gravity).total < 0.15


def test_driven_one_way_nothing_can_be_told_and_nothing_is_taken_off():
    lines = survey_lines([leaking(np.array([2.0, -6.0]))], CONFIG)
    one_way = [replace(lines[0], passes=lines[0].passes[::2])]
    found = find_coupling(one_way, prior=2.5, independent_s=60.0)
    assert np.all(np.abs(found.coefficient) < 0.5)
    # The prior but for what a point between two says.
    assert np.all(found.sd > 0.5)


def test_coefficients_are_as_sure_as_they_say():
    """White noise of 1 mGal a second, 12 drives: errors over their sd."""
    scores = []
    for seed in range(12):
        way = there_and_back(6)
        noise = np.random.default_rng(seed).standard_normal(way.time.size)
        lines = survey_lines([replace(way, gravity=way.gravity + noise)], CONFIG)
        # 50 m from station to station: 5 s, and values in between average to sqrt(1 / 1).
        found = find_coupling(lines, prior=5.0, independent_s=5.0)
        scores.append(found.coefficient / found.sd)
    assert 0.5 < np.std(scores) < 1.6
