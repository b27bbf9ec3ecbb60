"""Selection of satellites: volumes, counts, GDOP against brute force and the papers' numbers."""

from itertools import combinations as choices

import numpy as np
import pytest
from numpy.testing import assert_allclose

from deepseis_core import selection
from deepseis_core.constants import NS_PER_S
from deepseis_core.ephemeris import pack
from deepseis_core.errors import InputError
from deepseis_core.gps_time import GpsTime
from deepseis_core.propagation import line_of_sight
from deepseis_core.selection import select
from deepseis_sim.sky import broadcast_ephemerides


def sky(epochs, satellites, seed=1):
    """Return random directions above the horizon, east-north-up, and their elevations."""
    rng = np.random.default_rng(seed)
    azimuth = rng.uniform(0.0, 2 * np.pi, (epochs, satellites))
    up = rng.uniform(np.sin(np.radians(10.0)), 1.0, (epochs, satellites))
    flat = np.sqrt(1.0 - up**2)
    unit = np.stack([flat * np.sin(azimuth), flat * np.cos(azimuth), up], -1)
    return unit, np.arcsin(up)


def gdop(unit):
    """Return GDOP by matrix inversion."""
    H = np.column_stack([unit, np.ones(len(unit))])
    return np.sqrt(np.trace(np.linalg.inv(H.T @ H)))


def volume(unit):
    """Return a tetrahedron's volume as the paper has it."""
    A, B, C, D = unit
    return abs((A - B) @ np.cross(C - B, D - B)) / 6.0


@pytest.mark.parametrize("n", [5, 7, 9, 11])
def test_each_rule_finds_what_trying_everything_finds(n):
    unit, elevation = sky(20, n, seed=n)
    for u, el in zip(unit, elevation, strict=True):
        fours = [list(four) for four in choices(range(n), 4)]
        with_highest = [four for four in fours if int(np.argmax(el)) in four]
        best = {
            "highest": max(with_highest, key=lambda f: volume(u[f])),
            "volume": max(fours, key=lambda f: volume(u[f])),
            "gdop": min(fours, key=lambda f: gdop(u[f])),
            "all": list(range(n)),
        }
        for rule, expected in best.items():
            got = select(u[None], el[None], rule)
            assert np.flatnonzero(got.chosen[0]).tolist() == sorted(expected), rule
            assert_allclose(got.gdop[0], gdop(u[expected]), rtol=1e-6)


def test_evaluations_are_those_of_the_paper():
    unit, elevation = sky(5, 9)
    assert set(select(unit, elevation, "highest").evaluations) == {56}
    assert set(select(unit, elevation, "volume").evaluations) == {126}
    assert selection.combinations(9, "gdop") == 126


def test_volume_and_gdop_are_one_thing_but_for_the_numerator():
    """GDOP^2 = trace(adj(H^T H)) / (6 V)^2."""
    unit = sky(1, 4)[0][0]
    H = np.column_stack([unit, np.ones(4)])
    adjugate = np.linalg.inv(H.T @ H) * np.linalg.det(H.T @ H)
    expected = np.sqrt(np.trace(adjugate)) / (6.0 * volume(unit))
    assert select(unit[None], np.ones((1, 4))).gdop[0] == pytest.approx(expected, rel=1e-9)


def test_a_day_under_gps_is_near_the_best_four():
    """Every two minutes at 38.7 north: within 10 % in >= 86 % (highest) and >= 95 % (free)."""
    start = GpsTime(2399, 345600 * NS_PER_S)
    packed = pack(broadcast_ephemerides("", start))
    site = np.array([-3.87e6, 3.14e6, 3.97e6])
    # Orbits of hours ago are good enough for directions.
    seconds = np.arange(0, 86400, 120)
    sight = line_of_sight(packed, start.week, start.tow_ns + seconds * NS_PER_S, site)
    shares = {}
    best = select(sight.unit, sight.elevation, "gdop").gdop
    for rule in ("highest", "volume"):
        got = select(sight.unit, sight.elevation, rule)
        shares[rule] = np.mean(got.gdop <= 1.1 * best)
        assert np.all(got.chosen.sum(axis=1) == 4)
    print(shares, sight.elevation.shape)
    assert shares["highest"] >= 0.86
    assert shares["volume"] >= 0.95
    assert np.all(select(sight.unit, sight.elevation, "all").gdop <= best)


def test_low_and_missing_satellites_are_left_out():
    unit, elevation = sky(1, 8)
    elevation[0, 2] = np.radians(9.0)
    unit[0, 5] = np.nan
    for rule in selection.RULES:
        assert not select(unit, elevation, rule).chosen[0, [2, 5]].any()


@pytest.mark.parametrize("n", [0, 1, 3])
def test_too_few_are_all_taken_and_have_no_gdop(n):
    unit, elevation = sky(2, n)
    got = select(unit, elevation)
    assert got.chosen.sum() == 2 * n
    assert np.isinf(got.gdop).all()


def test_a_plane_of_satellites_has_no_gdop():
    azimuth = np.radians([0.0, 90.0, 180.0, 270.0])
    cone = np.stack([np.sin(azimuth), np.cos(azimuth), np.ones(4)], 1)[None] / np.sqrt(2.0)
    assert np.isinf(select(cone, np.full((1, 4), 0.8)).gdop[0])


def test_bad_input_is_refused():
    unit, elevation = sky(2, 5)
    with pytest.raises(InputError, match="rule"):
        select(unit, elevation, "best")
    with pytest.raises(InputError, match="shapes"):
        select(unit, elevation[:, :4])
