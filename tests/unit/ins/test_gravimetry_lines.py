"""Lines are found by where the vehicle rests and runs; passes agree as arithmetic says."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

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
    return Way(np.arange(s.size) * 1.0, position, still, gravity)


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
    still = Way(way.time, way.position, np.ones(way.time.size, bool), way.gravity)
    assert survey_lines([still], CONFIG) == []
