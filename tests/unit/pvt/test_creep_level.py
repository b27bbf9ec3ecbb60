"""How biases creep is told at rest: against the walk and rate that they were made with."""

from __future__ import annotations

import numpy as np
import pytest
from unit.pvt.phase_bench import Phases

from deepseis_pvt.creep_level import LEAST, CreepLevel
from deepseis_pvt.phase_displacement import PhaseDisplacement
from deepseis_pvt.phase_values import PhaseConfig
from deepseis_pvt.still_reference import StillReference

CONFIG = PhaseConfig(loop_bandwidth_hz=25.0, phase_floor_sd=0.0)


def filter_of(config: PhaseConfig = CONFIG) -> PhaseDisplacement:
    """Return a filter that is told when the antenna rests."""
    return PhaseDisplacement(config, StillReference(witnessed=True))


@pytest.mark.parametrize("drift", [0.0, 1.0, 2.0])
def test_levels_are_those_of_the_biases(drift: float) -> None:
    solver = filter_of()
    Phases(CONFIG, drift=drift, rate_hz=2.0, seed=2).run(solver, 500.0, True)
    walk, rate = solver.creep.walk_level, solver.creep.rate_level
    if drift == 0.0:
        # The settings' own weight against 500 s: 30 of 4500, 10 of 560 long differences.
        assert walk < 0.1
        assert rate < 0.05
    else:
        # Walk: 4500 squares, most of them noise; rate: 16 correlation times of 10 satellites.
        assert walk == pytest.approx(drift**2, rel=0.35)
        assert rate == pytest.approx(drift**2, rel=0.5)


@pytest.mark.parametrize(("drift", "low", "high"), [(0.0, 0.1, 2.1), (1.0, 0.3, 2.1)])
def test_sigmas_are_honest_with_and_without_creep(drift: float, low: float, high: float) -> None:
    """Normalised errors 20 s after four minutes of rest, 8 draws of three axes."""
    squares = []
    for seed in range(8):
        solver, phases = filter_of(), Phases(CONFIG, drift=drift, rate_hz=2.0, seed=seed)
        phases.run(solver, 240.0, True)
        last = phases.run(solver, 20.0, False)[-1]
        assert last is not None
        d = last.displacement
        squares.append(d @ np.linalg.solve(last.covariance[:3, :3], d) / 3.0)
    # Chi-square of 24: 4 sigma are 1.15. Without creep what is left of the settings (a thirtieth
    # of the rates' variance) makes it less; with nothing learnt it would be 0.02.
    assert low < np.mean(squares) < high


def test_slips_and_motion_are_no_creep() -> None:
    def motion(t: float) -> np.ndarray:
        return np.array([0.1 * np.sin(3.0 * t), 0.0, 0.0]) if 100.0 < t < 200.0 else np.zeros(3)

    solver, phases = filter_of(), Phases(CONFIG, drift=0.0, rate_hz=2.0, motion=motion)
    for seconds, still in ((100.0, True), (100.0, False)):
        for k in range(round(seconds / 10.0)):
            if still and k % 2:
                phases.bias[3] += 0.19
                solver.solve(phases.epoch(slipped=(3,)), still)
            phases.run(solver, 10.0, still)
    assert solver.creep.walk_level < 0.1
    before = solver.creep.walk_level, solver.creep.rate_level
    phases.run(solver, 5.0, False)
    assert (solver.creep.walk_level, solver.creep.rate_level) == before


def test_settings_count_until_something_is_seen() -> None:
    level = CreepLevel(1e-6, 1e-7, 30.0, 32)
    assert (level.walk_level, level.rate_level) == (1.0, 1.0)
    slot = np.arange(3)  # too few to tell a clock from creep
    for k in range(100):
        level.push(0.1 * k, slot, np.zeros(3), np.full(3, 1e-8), np.ones(3), 1.0)
    assert (level.walk_level, level.rate_level) == (1.0, 1.0)
    slot = np.arange(8)
    for k in range(100, 4000):
        level.push(0.1 * k, slot, np.zeros(8), np.full(8, 1e-12), np.ones(8), 1.0)
    assert level.walk_level == LEAST
