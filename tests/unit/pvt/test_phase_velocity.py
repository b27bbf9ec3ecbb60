"""Steps between epochs by carrier phase, on the bench's observations of a moving antenna."""

from dataclasses import replace

import numpy as np
import pytest

from deepseis_bringup.survey.survey_gnss import _Solver, survey_gnss
from deepseis_core.types import Lli
from deepseis_pvt.phase_velocity import phase_step
from deepseis_sim.bench import Bench
from deepseis_sim.bench_streams import ObservationStream
from deepseis_sim.scenario import load_scenario

SECONDS = 120


@pytest.fixture(scope="module")
def bench():
    return Bench(load_scenario("gravity-lines", short=True))


@pytest.fixture(scope="module")
def observations(bench):
    (stream,) = [s for s in bench.streams if isinstance(s, ObservationStream)]
    return list(stream.receiver.epochs(60, SECONDS))


def times(bench, observations):
    return [(o.sample_index + o.sample_fraction) / bench.sample_rate_hz for o in observations]


def orbits(bench):
    return [item.ephemeris for item in bench.model.satellites]


def test_steps_are_those_of_the_antenna_to_millimetres(bench, observations):
    """Carrier noise of 1 mm through a VDOP of about 2, at both ends; code noise is 0.5 m."""
    timed = list(zip(times(bench, observations), observations, strict=True))
    found = survey_gnss(timed, orbits(bench), np.zeros(3))
    truth = bench.model.antenna
    moved = truth(found.steps.end - bench.clock(found.steps.end))[:, :3]
    moved = moved - truth(found.steps.begin - bench.clock(found.steps.begin))[:, :3]
    up = bench.site.C_e_enu[:, 2]
    error = found.steps.up - moved @ up
    assert found.steps.up.size == SECONDS - 1
    assert np.ptp(moved @ up) > 0.2
    assert error.std() < 0.006
    code = np.diff(found.fixes.position_ecef, axis=0) @ up - moved @ up
    assert code.std() > 20.0 * error.std()


def test_a_slip_marked_or_not_does_not_pass_for_movement(bench, observations):
    solver = _Solver(orbits(bench))
    first, second = observations[10:12]
    slipped = replace(
        second,
        carrier_phase_cycles=second.carrier_phase_cycles + 7.0 * (np.arange(len(second.lli)) == 2),
    )
    marked = replace(
        slipped, lli=(np.arange(len(second.lli)) == 2).astype(np.uint8) * np.uint8(Lli.SLIP)
    )
    _, before = solver.solve(first)
    clean, _ = phase_step(before, solver.solve(second)[1])
    for wrong in (slipped, marked):
        step, _ = phase_step(before, solver.solve(wrong)[1])
        assert np.linalg.norm(step - clean) < 0.01


def test_fewer_than_four_kept_phases_give_no_step(bench, observations):
    solver = _Solver(orbits(bench))
    _, before = solver.solve(observations[0])
    _, after = solver.solve(observations[1])
    lost = replace(after, slipped=frozenset(after.satellites[3:]))
    assert phase_step(before, lost) is None
