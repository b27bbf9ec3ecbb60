"""The groups of tables: what they compute, against theory, and that no row stays empty."""

import numpy as np
import pytest

from deepseis_bringup.accept import jamming as accept_jamming
from deepseis_bringup.accept import static as accept_static
from deepseis_bringup.accept.bandwidth import (
    arctangent_slope,
    best_bandwidths,
    jamming_formula,
    simulated,
)
from deepseis_bringup.accept.jammed_loops import first_beyond
from deepseis_bringup.accept.jamming import code_overlap_db
from deepseis_bringup.accept.outside_recording import Carried, CarriedImu
from deepseis_bringup.accept.scene import Work
from deepseis_bringup.accept.tables import Acceptance, Goal, Row
from deepseis_bringup.accept.tracking import GROUPS
from deepseis_core.ca_code import ca_code
from deepseis_core.geodesy import ecef_from_geodetic
from deepseis_ins.truth_motion import Trajectory
from deepseis_sim.site import Site


@pytest.fixture
def work(tmp_path):
    return Work(tmp_path, True, Acceptance("x", "X"))


def assert_filled(acceptance):
    assert acceptance.rows
    for row in acceptance.rows:
        assert isinstance(row.ours, str) or np.isfinite(row.ours), row
        assert all((row.table, row.scenario, row.quantity, row.unit)), row


def test_a_goal_near_a_value_has_the_values_unit():
    goal = Goal.near(37.74, 0.05)
    assert goal.met(37.7)
    assert not goal.met(37.68)
    assert not goal.met(float("nan"))


def test_what_did_not_come_out_misses_its_goal_and_says_so():
    row = Row("table", "scene", "lag", "ms", float("nan"), 56.5, Goal.at_most(56.5))
    assert row.met is False
    assert row.cells()[4:] == ["56.5", "nothing came out", "<= 56.5", "", "no"]


def test_every_group_is_a_function_of_its_own_module():
    assert len({group.__module__ for group in GROUPS}) >= 6


def test_the_formula_gives_the_papers_table_to_a_twentieth_of_a_decibel():
    rows = [row for row in jamming_formula() if row.unit == "dB"]
    assert [row.met for row in rows] == [True, True, True]


def test_best_bandwidths_are_simulated_as_the_formulas_say(work):
    best_bandwidths(work)
    assert_filled(work.acceptance)
    assert [row for row in work.acceptance.rows if row.met is False] == []


@pytest.mark.parametrize("cn0_dbhz", [31.0, 33.0])
def test_noise_flattens_the_arctangent_and_a_steady_stress_shows_it(cn0_dbhz):
    """Order 3 under a constant jerk: what the discriminator shows is the slope times the error."""
    t = (np.arange(40_000 * 4) + 0.5) * 1e-3 / 4
    jerk = 20.0
    _, strong = simulated(25.0, jerk * t**3 / 6.0, 60.0, seed=5)
    _, weak = simulated(25.0, jerk * t**3 / 6.0, cn0_dbhz, seed=5)
    # The noise of 15 deg over 38 s of a 25 Hz loop leaves the mean good to 0.3 deg, of 2.
    assert strong / weak == pytest.approx(arctangent_slope(cn0_dbhz), abs=0.15)


def test_the_codes_lines_hold_all_of_its_power():
    chips = ca_code(19).astype(float)
    lines = np.abs(np.fft.fft(chips) / chips.size) ** 2
    assert lines.sum() == pytest.approx(1.0)
    # Over the main lobe sinc^2 holds 90.3 %: lines scatter about it by 1 / sqrt(2046).
    for prn in (1, 7, 19, 31):
        share = 10 ** (code_overlap_db(prn, 2.046e6) / 10) * 2.0
        assert share == pytest.approx(0.903, abs=4 * 0.903 / np.sqrt(2046))


def test_a_noisy_crossing_is_neither_the_first_nor_the_last_spike():
    rng = np.random.default_rng(3)
    level = np.linspace(20.0, 50.0, 3001)
    error = level + 0.5 * rng.standard_normal(level.size)
    assert first_beyond(level, error, 35.0) == pytest.approx(35.0, abs=0.5)
    assert np.isnan(first_beyond(level, error, 60.0))


def test_the_receiver_sees_the_formulas_noise_under_a_jammer(work, monkeypatch):
    """Two levels about 31 dB: C/N0 is 28.8 dB-Hz at 31.03 dB by the formula."""
    monkeypatch.setattr(accept_jamming, "LEVELS", np.array([30.0, 32.0]))
    monkeypatch.setattr(accept_jamming, "EQUIVALENT", ((28.8, 31.03, "conventional"),))
    rows, _ = accept_jamming._measured(work, accept_jamming.KINDS[0])
    assert [row.met for row in rows] == [True, True]


def test_heading_is_held_by_zero_angle_alone_and_no_filter_boasts():
    station = accept_static.Station(120)
    held = {name: station.run(name, 2) for name in accept_static.CONSTRAINTS}
    for run in held.values():
        assert np.isfinite(run.error).all()
        # One unit: each of nine errors, at the end, within four sigma; a single-point position is
        # off by more, slowly, than its formal sigma of noise says.
        assert np.all(np.abs(run.error[-1, 3:]) < 4.0 * run.sd[-1, 3:])
    start = accept_static.SURVEY_DEG
    assert held["zero velocity"].sd[-1, 8] > 1.1 * start
    assert held["zero velocity and zero angle"].sd[-1, 8] < 1.03 * start
    for name in accept_static.CONSTRAINTS[1:]:
        assert np.all(held[name].sd[-1, 3:6] < 0.2 * held["loose"].sd[-1, 3:6])


def test_the_antenna_that_a_body_carries_moves_as_it_was_told():
    site = Site([0.62, 2.44, 50.0])
    t = np.arange(0.0, 4.0, 2e-3)
    circle = 0.12 * np.column_stack([np.cos(12.0 * t) - 1.0, np.sin(12.0 * t), 0.0 * t])
    antenna = ecef_from_geodetic(site.origin_geodetic) + circle @ site.C_e_enu.T
    imu = CarriedImu()
    motion = Carried(Trajectory(t, antenna), site, imu)
    inside = t[50:-50]
    back = site.states(motion, inside, imu.lever_arm)
    np.testing.assert_allclose(back.position, antenna[50:-50], rtol=0, atol=1e-6)
    size = np.linalg.norm(back.acceleration, axis=1)
    np.testing.assert_allclose(size, 0.12 * 144.0, rtol=1e-4)
    # The forward axis points to its heading.
    east, north, _ = motion.C_enu_b[:, 0]
    assert np.degrees(np.arctan2(east, north)) == pytest.approx(imu.heading_deg)
