"""Displacement from phases against truth and theory, with satellites that slip and vanish."""

import time
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from unit.pvt.phase_bench import Phases, design, noise_sd

from deepseis_pvt.phase_displacement import PhaseDisplacement
from deepseis_pvt.phase_values import PhaseConfig
from deepseis_pvt.still_reference import ReferenceConfig, StillReference

WHITE = {"loop_bandwidth_hz": 5.0, "phase_floor_sd": 0.0}
"""At 10 Hz noise of such a loop is white."""
FREE = {"bias_walk": 0.0, "bias_rate_sd": 0.0}
FIRM = PhaseConfig(**WHITE, **FREE)


def filter_of(config, *, witnessed=True, **reference):
    return PhaseDisplacement(
        config, StillReference(ReferenceConfig(**reference), witnessed=witnessed)
    )


def circle(start):
    """12 cm at 2 Hz (2 g), and 5 cm up and down at 1 Hz, from ``start`` on."""

    def motion(t):
        if t < start:
            return np.zeros(3)
        turn = 4.0 * np.pi * (t - start)
        return np.array(
            [0.12 * (1.0 - np.cos(turn)), 0.12 * np.sin(turn), 0.05 * np.sin(turn / 2)]
        )

    return motion


def errors(phases, solutions, start):
    """Return the displacements' errors of the epochs from a time on [m]."""
    times = start + np.arange(len(solutions)) * phases.interval
    found = np.array([s.displacement for s in solutions])
    return found - np.array([phases.motion(t) for t in times])


def test_without_noise_motion_and_clock_are_exact():
    phases = Phases(FIRM, motion=circle(2.0), noise=0.0)
    solver = filter_of(FIRM)
    still = phases.run(solver, 2.0, True)
    offset = phases.clock - still[-1].clock
    moving = phases.run(solver, 3.0, False)
    # Biases of 10 km in metres: 2e-12 each.
    assert np.abs(errors(phases, moving, 2.0)).max() < 1e-9
    assert abs(phases.clock - moving[-1].clock - offset) < 1e-9


def test_displacement_scatters_by_dop_times_phase_noise():
    phases = Phases(FIRM, motion=circle(50.0), seed=3)
    solver = filter_of(FIRM)
    phases.run(solver, 50.0, True)
    moving = phases.run(solver, 150.0, False)
    A = design(10)
    theory = noise_sd(FIRM) ** 2 * np.linalg.inv(A.T @ A)
    error = errors(phases, moving, 50.0)
    # 1500 epochs: 1 +- 1/sqrt(3000), at 4 sigma; biases of 500 epochs add 1/500.
    ratio = error.std(axis=0) / np.sqrt(np.diag(theory)[:3])
    assert_allclose(ratio, 1.0, atol=0.08)
    # The biases' part is 1/500 and some; their common error is the clock's datum. The level of
    # noise is learnt from 100 epochs of 6 redundant phases, and never below 1: 3 % at one sigma.
    assert_allclose(moving[-1].covariance[:3, :3], theory[:3, :3], rtol=0.1, atol=1e-9)
    # The clock's change over a second is that of two independent epochs.
    assert_allclose(moving[-1].clock_noise, np.sqrt(2.0 * theory[3, 3]), rtol=0.05)


@pytest.mark.parametrize("still_s", [6.0, 20.0])
def test_errors_are_as_large_as_their_covariance_says(still_s):
    config = PhaseConfig(loop_bandwidth_hz=2.5, phase_floor_sd=0.0, bias_rate_sd=0.0005)
    squares, growth = [], []
    for seed in range(30):
        phases = Phases(config, motion=circle(still_s), rate_hz=5.0, seed=seed)
        solver = filter_of(config)
        rest = phases.run(solver, still_s, True)
        moving = phases.run(solver, 30.0, False)
        away = moving[-1].displacement - phases.motion(phases.time)
        P = moving[-1].covariance[:3, :3]
        squares.append(away @ np.linalg.solve(P, away))
        growth.append(np.trace(P) / np.trace(rest[-1].covariance[:3, :3]))
    # Chi-square of 3 x 30 degrees of freedom: 3 +- sqrt(6/30), at 4 sigma.
    assert abs(np.mean(squares) - 3.0) < 1.8
    # The drift counts: after 30 s it is no longer the noise that matters.
    assert min(growth) > 2.0


def test_noise_that_loops_share_over_epochs_does_not_make_biases_too_sure():
    """Errors of a loop of 0.4 Hz at 10 Hz: a calibration of 50 s holds 40 of them, not 500."""
    config = PhaseConfig(loop_bandwidth_hz=0.4, phase_floor_sd=0.0, **FREE)
    white = PhaseConfig(**WHITE, **FREE)
    coloured, independent = (filter_of(c) for c in (config, white))
    for solver, c in ((coloured, config), (independent, white)):
        Phases(c).run(solver, 50.0, True)
    scale = (noise_sd(config) / noise_sd(white)) ** 2
    ratio = np.trace(coloured.P[:10, :10]) / np.trace(independent.P[:10, :10]) / scale
    assert_allclose(ratio, 10.0 / (2.0 * 0.4), rtol=0.01)


@pytest.mark.parametrize("told", [True, False])
@pytest.mark.parametrize("cycles", [0.5, 1.0, -20.0])
def test_a_slip_in_mid_quake_does_not_move_the_antenna(told, cycles):
    config = PhaseConfig()
    phases = Phases(config, motion=circle(20.0), drift=0.0)
    solver = filter_of(config)
    phases.run(solver, 20.0, True)
    before = phases.run(solver, 5.0, False)[-1]
    phases.bias[4] += cycles * 0.1903
    at_once = solver.solve(phases.epoch(slipped=(4,) if told else ()), False)
    assert not at_once.used[4]
    assert bool(at_once.refused[4]) != told
    after = phases.run(solver, 5.0, False)
    assert all(s.used.all() for s in after), "it is calibrated anew, and back"
    error = errors(phases, [at_once, *after], 25.0)
    assert (np.abs(error) < 5.0 * np.sqrt(np.diag(after[0].covariance)[:3])).all()
    # It comes back with what the solution knows without it, and with its own noise.
    assert np.trace(after[0].common[:3, :3]) > 1.03 * np.trace(before.common[:3, :3])
    assert solver.counts["slips_found"] == (0 if told else 1)


@pytest.mark.parametrize("slipped", [(0, 1), (0, 1, 2), (3, 6, 8)])
@pytest.mark.parametrize("cycles", [0.5, 1.0])
def test_slips_of_several_at_once_that_nobody_marks_do_not_move_the_antenna(slipped, cycles):
    """By the same amount they hold together: the worst residual is often one that is right."""
    config = PhaseConfig()
    phases = Phases(config, motion=circle(20.0), drift=0.0)
    solver = filter_of(config)
    phases.run(solver, 20.0, True)
    phases.run(solver, 5.0, False)
    phases.bias[list(slipped)] += cycles * 0.1903
    at_once = solver.solve(phases.epoch(), False)
    assert np.flatnonzero(at_once.refused).tolist() == list(slipped)
    after = phases.run(solver, 5.0, False)
    assert all(s.used.all() for s in after)
    error = errors(phases, [at_once, *after], 25.0)
    assert (np.abs(error) < 5.0 * np.sqrt(np.diag(after[0].covariance)[:3])).all()
    assert solver.counts["slips_found"] == len(slipped)
    assert solver.counts["contradictions"] == 0


def test_satellites_come_and_go_and_the_solution_stays():
    config = PhaseConfig()
    phases = Phases(config, motion=circle(20.0), drift=0.0, seed=5)
    solver = filter_of(config)
    phases.run(solver, 20.0, True)
    found = []
    for k in range(10):
        found += phases.run(solver, 1.0, False, lost=(k, (k + 1) % 10))
        phases.bias[k] += 7.0  # a new arc of the one that returns
        found.append(solver.solve(phases.epoch(slipped=(k,)), False))
        found += phases.run(solver, 0.2, False)
    error = errors(phases, found, 20.0)
    last = found[-1]
    assert (np.abs(error) < 5.0 * np.sqrt(np.diag(last.covariance)[:3])).all()
    assert last.used.all()
    # All have been calibrated on others' solutions by now: that shows in the covariance.
    assert np.trace(last.common[:3, :3]) > 3.0 * np.trace(found[0].common[:3, :3])


def test_a_satellite_away_without_a_slip_goes_on_where_it_was():
    phases = Phases(FIRM, motion=circle(5.0), noise=0.0)
    solver = filter_of(FIRM)
    phases.run(solver, 5.0, True)
    phases.run(solver, 3.0, False, lost=(2,))
    assert phases.run(solver, 0.1, False)[0].used[2]
    phases.run(solver, 1.0, False, lost=(2,))
    phases.lock[2] = 0.1  # the mark of the slip came in an epoch that was lost
    assert not phases.run(solver, 0.1, False)[0].used[2]


def test_four_satellites_are_solved_and_three_are_not():
    phases = Phases(PhaseConfig(), count=5, motion=circle(10.0), drift=0.0)
    solver = filter_of(PhaseConfig())
    phases.run(solver, 10.0, True)
    four = phases.run(solver, 1.0, False, lost=(1,))
    assert (
        np.abs(errors(phases, four, 10.0)) < 5.0 * np.sqrt(np.diag(four[0].covariance)[:3])
    ).all()
    assert phases.run(solver, 0.1, False, lost=(1, 3))[-1] is None
    assert phases.run(solver, 0.1, False)[-1].used.all(), (
        "biases outlive an epoch without solution"
    )


def test_all_lost_at_once_goes_on_from_a_place_that_is_not_known():
    phases = Phases(FIRM, motion=circle(10.0), noise=0.0)
    solver = filter_of(FIRM)
    phases.run(solver, 10.0, True)
    assert {s.datum for s in phases.run(solver, 0.6, False)} == {0}
    every = tuple(range(10))
    for lost in (1, 2):
        assert phases.run(solver, 0.2, False, lost=every) == [None, None]
        phases.bias += 3.0 * np.arange(10.0)
        assert solver.solve(phases.epoch(slipped=every), False) is None
        pulling_in = phases.run(solver, FIRM.datum_lock_s, False)
        assert pulling_in == [None] * 3, "phases that have just locked are not trusted"
        start = phases.time + phases.interval
        moving = phases.run(solver, 1.0, False)
        assert {s.datum for s in moving} == {lost}
        away = errors(phases, moving, start)
        assert np.abs(away - away[0]).max() < 1e-9
        assert np.abs(away[0]).max() > 0.001
    assert solver.counts["afloat"] == 2


def test_a_rest_after_a_loss_of_all_has_the_surveyed_place_again():
    phases = Phases(PhaseConfig(), motion=circle(10.0), drift=0.0)
    solver = filter_of(PhaseConfig())
    phases.run(solver, 10.0, True)
    assert solver.solve(phases.epoch(slipped=tuple(range(10))), False) is None
    assert phases.run(solver, 1.0, False)[-1].datum == 1
    phases.motion = lambda t: np.zeros(3)
    reference = solver.reference.config
    afloat = phases.run(solver, 0.9 * reference.settle_s, True)
    assert {s.datum for s in afloat} == {1}
    back = phases.run(solver, 10.0, True)[-1]
    # Where it has come to rest nobody knows: the surveyed place again, and it is said how surely.
    assert (back.datum, back.calibrated) == (0, True)
    sd = np.sqrt(np.diag(back.covariance)[:3])
    assert (sd >= reference.lost_sd).all()
    assert (np.abs(back.displacement) < 3.0 * sd).all()


def test_without_enough_satellites_there_is_no_new_place():
    phases = Phases(FIRM, count=5, motion=circle(10.0), noise=0.0)
    solver = filter_of(FIRM)
    phases.run(solver, 10.0, True)
    solver.solve(phases.epoch(slipped=tuple(range(5))), False)
    assert phases.run(solver, 2.0, False, lost=(0,)) == [None] * 20
    assert solver.datum == 0


def test_unexpected_noise_is_seen_in_the_residuals_and_owned_up_to():
    config = PhaseConfig(**WHITE, **FREE)
    phases = Phases(config, motion=circle(20.0), noise=3.0, drift=0.0)
    solver = filter_of(config)
    phases.run(solver, 20.0, True)
    assert_allclose(solver.noise_level, 9.0, rtol=0.25)
    moving = phases.run(solver, 10.0, False)
    error = errors(phases, moving, 20.0)
    last = moving[-1]
    sd = np.sqrt(np.diag(last.covariance - last.common)[:3])
    assert_allclose(error.std(axis=0) / sd, 1.0, atol=0.3)
    assert all(s.used.all() for s in moving)


def test_loops_that_lag_say_so_through_their_discriminators():
    """No residual shows what all phases lag behind alike: 10 mm east at 2 Hz."""
    config = PhaseConfig(**WHITE, **FREE)
    phases, rng = Phases(config, rate_hz=50.0), np.random.default_rng(4)
    solver, sd = filter_of(config), np.full(10, 1.5 * noise_sd(config))

    def solve(size, still):
        epoch = phases.epoch()
        behind = epoch.design[:, 0] * size * np.sin(4.0 * np.pi * phases.time)
        lag = behind + sd * rng.normal(size=10)
        return solver.solve(replace(epoch, residual=epoch.residual - behind, lag=(lag, sd)), still)

    rest = [solve(0.0, True) for _ in range(500)]
    assert (solver.stress == 0.0).all()
    moving = [solve(0.010, False) for _ in range(250)][50:]
    east = np.array([s.displacement[0] for s in moving])
    said = np.sqrt(np.mean([s.covariance[0, 0] for s in moving]))
    assert_allclose(np.sqrt(np.mean(east**2)), 0.010 / np.sqrt(2.0), rtol=0.05)
    assert_allclose(said, 0.010 / np.sqrt(2.0), rtol=0.15)
    assert np.sqrt(moving[-1].covariance[1, 1]) < 0.002
    assert np.sqrt(rest[-1].covariance[0, 0]) < 0.001


def test_an_offset_stays_and_calibration_goes_on_there():
    offset = np.array([0.31, -0.12, 0.05])

    def step(t):
        return offset * np.clip((t - 20.0) / 2.0, 0.0, 1.0)

    config = PhaseConfig(bias_rate_sd=0.0)
    phases = Phases(config, motion=step, drift=0.0)
    solver = filter_of(config, settle_s=5.0)
    phases.run(solver, 20.0, True)
    phases.run(solver, 5.0, False)
    after = phases.run(solver, 60.0, True)
    assert solver.reference.counts["new_references"] == 1
    found = np.mean([s.displacement for s in after[-100:]], axis=0)
    sd = np.sqrt(np.diag(solver.reference.covariance))
    assert (np.abs(found - offset) < 4.0 * sd + 2e-4).all()
    assert (sd < [0.003, 0.003, 0.006]).all()
    assert (np.diag(after[-1].covariance)[:3] > sd**2).all()


@pytest.mark.parametrize("peak", [0.02, 0.3])
def test_without_an_imu_phases_tell_of_motion(peak):
    def motion(t):
        if t < 20.0:
            return np.zeros(3)
        return np.array([peak * np.sin(2.0 * (t - 20.0)), 0.0, 0.0])

    config = PhaseConfig()
    phases = Phases(config, motion=motion, drift=0.0)
    solver = filter_of(config, witnessed=False)
    phases.run(solver, 20.0, True)
    moving = phases.run(solver, 20.0, True)
    assert solver.reference.moved
    error = errors(phases, moving, 20.0)
    assert np.abs(error[:, 0]).max() < 0.006


def test_an_epoch_of_twelve_satellites_takes_less_than_a_millisecond():
    phases = Phases(PhaseConfig(), count=12)
    solver = filter_of(PhaseConfig())
    phases.run(solver, 1.0, True)

    def once(still):
        epochs = [phases.epoch() for _ in range(20)]
        began = time.perf_counter()
        for epoch in epochs:
            solver.solve(epoch, still)
        return (time.perf_counter() - began) / 20

    assert min(once(True) for _ in range(10)) < 1e-3
    assert min(once(False) for _ in range(10)) < 1e-3


def slow_beginning(t):
    """5 mm in 6 s that no accelerometer feels, then rest there [m]."""
    return np.array([0.005 * np.clip((t - 34.0) / 6.0, 0.0, 1.0) ** 2, 0.0, 0.0])


def after_a_slow_beginning(seed, drift, **doubt):
    """Return errors [m] and covariances of the minute after a motion that is noticed at 40 s."""
    config = PhaseConfig(**WHITE, **doubt)
    phases = Phases(config, motion=slow_beginning, drift=drift, seed=seed)
    solver = filter_of(config)
    phases.run(solver, 40.0, True)
    moving = phases.run(solver, 60.0, False)
    covariance = np.array([s.covariance[:3, :3] for s in moving])
    return errors(phases, moving, 40.0), covariance, solver.counts["doubted"]


def test_what_moved_before_it_was_noticed_is_no_drift_of_satellites():
    error, _, doubted = after_a_slow_beginning(1, 0.0)
    without, *_ = after_a_slow_beginning(1, 0.0, doubt_s=0.0)
    assert doubted == 1
    # Half of the 5 mm is believed to be biases' at most. Without doubt they take all of it,
    # and their rates carry it on for half a minute: 1.7 mm/s, damped by their walk.
    assert np.abs(error[:, 0].mean()) < 0.003
    assert np.abs(without[:, 0].mean()) > 0.008


def test_doubt_costs_no_more_than_its_covariance_says():
    squares = []
    for seed in range(5):
        error, covariance, doubted = after_a_slow_beginning(seed, 1.0)
        assert doubted == 1
        late = [100, 300, 599]
        squares += [error[k] @ np.linalg.solve(covariance[k], error[k]) / 3.0 for k in late]
    # 5 runs of three axes, three moments each that creep has not made independent; 4 sigma.
    assert 0.3 < np.mean(squares) < 2.1


def test_a_motion_noticed_in_time_casts_no_doubt():
    phases = Phases(FIRM, motion=circle(20.0))
    solver = filter_of(FIRM)
    phases.run(solver, 20.0, True)
    solver.solve(phases.epoch(), False, hidden=1e-4)
    assert solver.counts["doubted"] == 0


def test_an_antenna_that_comes_to_rest_without_phases_has_its_reference_again_less_certain():
    """All loops were lost while it moved: no displacement tells where it is."""
    reference, nothing = StillReference(ReferenceConfig(), witnessed=True), np.zeros((3, 3))
    config = reference.config

    def told(times, still):
        return [reference.decide(t, still, None, nothing, nothing) for t in times]

    assert all(told(np.arange(0.0, 5.0, 0.02), True))
    assert not any(told(np.arange(5.0, 8.0, 0.02), False))
    # A rest that ends too soon counts for nothing.
    assert not any(told(np.arange(8.0, 8.0 + 0.9 * config.settle_s, 0.02), True))
    assert not any(told(np.arange(20.0, 21.0, 0.02), False))
    again = told(np.arange(21.0, 21.0 + config.settle_s + 1.0, 0.02), True)
    assert again.index(True) * 0.02 == pytest.approx(config.settle_s, abs=0.05)
    assert all(again[again.index(True) :])
    np.testing.assert_allclose(reference.covariance, config.lost_sd**2 * np.eye(3))
    assert reference.counts["lost_references"] == 1


def test_a_rest_with_a_hole_is_gathered_anew():
    """Phases that come back have another error: what they say is not averaged with the old."""
    reference, nothing = StillReference(ReferenceConfig(), witnessed=True), 1e-6 * np.eye(3)
    settle = reference.config.settle_s

    def told(begin, duration, place, still=True):
        times = np.arange(begin, begin + duration, 0.02)
        where = None if place is None else np.array([place, 0.0, 0.0])
        return [reference.decide(t, still, where, nothing, 0.1 * nothing) for t in times]

    told(0.0, 2.0, 0.0)
    told(2.0, 2.0, 0.5, still=False)
    assert not any(told(4.0, 0.8 * settle, 0.500))
    told(4.0 + 0.8 * settle, 3.0, None)
    back = 7.0 + 0.8 * settle
    again = told(back, settle + 1.0, 0.501)
    assert again.index(True) * 0.02 == pytest.approx(settle, abs=0.05)
    assert reference.position[0] == pytest.approx(0.501, abs=1e-9)


def test_the_loops_own_phases_give_a_displacement_beside_with_the_same_biases():
    """Held 5 mm north, say, by aiding that lags; noise of 8 Hz in place of 25."""
    config = PhaseConfig(loop_bandwidth_hz=25.0, own_bandwidth_hz=8.0, phase_floor_sd=0.0, **FREE)
    phases = Phases(config, motion=circle(60.0), noise=0.0)
    solver = filter_of(config)
    phases.run(solver, 60.0, True)
    epoch = phases.epoch()
    north = np.array([0.0, 0.005, 0.0])
    solution = solver.solve(replace(epoch, held=epoch.design[:, :3] @ north), False)
    moved, sd = solution.by_loops
    assert_allclose(moved, solution.displacement + north, atol=1e-9)
    both = np.sqrt(np.diag(solution.covariance)[:3]), np.sqrt(np.diag(solution.common)[:3])
    assert (both[1] < sd).all()
    assert_allclose(sd**2 - both[1] ** 2, (both[0] ** 2 - both[1] ** 2) * 8.0 / 25.0, rtol=1e-6)
    assert solver.solve(phases.epoch(), False).by_loops is None
