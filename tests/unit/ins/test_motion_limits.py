"""False switches: innovations, tail probabilities, and a day of rest."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import chi2, norm

from deepseis_core.imu_errors import ImuErrors
from deepseis_core.imu_grades import GRADES, STANDARD_GRAVITY
from deepseis_core.noise_processes import first_order
from deepseis_core.types import MotionKind
from deepseis_ins.motion_limits import make_limits
from deepseis_ins.motion_noise import noise_of_grade
from deepseis_ins.motion_rules import FastRule
from deepseis_ins.motion_state import MotionConfig, MotionDetector

RATE = 200.0
STATIC, MOVING = MotionKind.STATIC, MotionKind.MOVING


def rest(grade, count, seed=1):
    vel = np.tile([0.0, 0.0, STANDARD_GRAVITY / RATE], (count, 1))
    made = ImuErrors(GRADES[grade], RATE, seed).apply(0, np.zeros((count, 3)), vel)
    return made.delta_theta * RATE, made.delta_vel * RATE


@pytest.mark.parametrize("grade", ["span-fsas", "stim300", "mti-g"])
def test_innovations_are_independent_and_normal_however_the_bias_drifts(grade):
    noise = noise_of_grade(GRADES[grade], RATE)
    rule = FastRule(MotionConfig(longest_window=60.0), RATE, noise)
    limits = rule.limits
    for level in (limits.mean, limits.triad, limits.energy, limits.triad_energy):
        level[:] = np.inf
    limits.clip[:] = np.inf
    count = rule._ring.shape[0] - 1
    rule.feed(0, np.hstack(rest(grade, count)))
    innovations = np.diff(rule._ring[: count + 1, :6], axis=0)[1:]
    for j in range(6):
        # Steps of increments, a quarter of a sigma with SPAN-FSAS, rule out a test of the shape.
        assert abs(np.mean(innovations[:, j] ** 2) - 1) < 4 * np.sqrt(2 / count) + 0.01
        expected = 2 * norm.sf(3.0) * count
        beyond = np.sum(np.abs(innovations[:, j]) > 3.0)
        assert abs(beyond - expected) < 5 * np.sqrt(expected)
        for lag in (1, 10, 100):
            rho = np.mean(innovations[lag:, j] * innovations[:-lag, j])
            # Their remainders, which are carried over, leave 1 % between neighbours.
            assert abs(rho) < 4 / np.sqrt(count) + 0.01
        # Sums over 2 s are where a drift would show.
        sums = innovations[: count // 400 * 400, j].reshape(-1, 400).sum(axis=1) / 20
        n = sums.size
        assert chi2.ppf(1e-4, n) < np.sum(sums**2) < chi2.isf(1e-4, n)


def test_limits_leave_the_tail_probabilities_asked_for():
    noise = noise_of_grade(GRADES["mti-g"], RATE)
    limits = make_limits(noise, RATE, 8.0, 5.0, 0.02)
    per_second = 8 * RATE * (np.sum(1 / limits.strides) + np.sum(1 / limits.energy_strides))
    assert_allclose(limits.probability[1] * per_second * 86400, 0.02)
    deflection = np.sqrt(limits.mean[1] / limits.lengths[:, None])
    assert_allclose(2 * norm.sf(deflection), limits.probability[1], rtol=1e-6)
    # Coloured noise: the variance of a mean over n is greater by the colour, n at most.
    coloured = make_limits(replace(noise, colour=np.full(6, 4.0)), RATE, 8.0, 5.0, 0.02)
    ratio = coloured.mean / limits.mean
    assert_allclose(ratio[1, :, 0], np.minimum(limits.lengths, 4))


def test_false_switches_are_as_many_as_the_closed_form_allows():
    # With so low limits that there are many: an hour, 2000 of them at most. Windows overlap, and
    # every switch is followed by 5 s in which there cannot be another.
    noise = noise_of_grade(GRADES["mti-g"], RATE)
    rate_per_day = 24 * 60.0
    config = MotionConfig(false_switches_per_day=rate_per_day, quiet_time=0.5)
    detector = MotionDetector(config, RATE, GRADES["mti-g"])
    data = np.random.default_rng(2).standard_normal((round(3600 * RATE), 6)) * noise.sigma
    switches = sum(d.state == MOVING for d in detector.push(0, data[:, :3], data[:, 3:]))
    assert 60 / 5 < switches < 60 + 3 * np.sqrt(60)


@pytest.mark.parametrize("hours", [1, pytest.param(24, marks=pytest.mark.slow)])
def test_no_false_switch_in_a_day_of_rest(hours):
    # A day is 17e6 samples of six axes, here with the bias drift that is the worst of all grades;
    # benchmarks/bench_motion_state.py has the others, by the full model of the sensor.
    unit = GRADES["stim300"]
    noise = noise_of_grade(unit, RATE)
    triads = np.repeat([unit.gyros.instability, unit.accelerometers.instability], 3)
    times = np.repeat([unit.gyros.correlation_time, unit.accelerometers.correlation_time], 3)
    decay = np.exp(-0.05 / times)  # 20 times a second will do
    drive, state = triads * np.sqrt(1 - decay**2), np.zeros(6)
    rng, chunk, bias = np.random.default_rng(11), 72_000, np.empty((7200, 6))
    detector = MotionDetector(MotionConfig(), RATE, unit)
    decisions = []
    for first in range(0, round(hours * 3600 * RATE), chunk):
        first_order(state, decay, drive, rng.standard_normal((chunk // 10, 6)), bias)
        data = rng.standard_normal((chunk, 6))
        data *= noise.sigma
        data += np.repeat(bias, 10, axis=0)
        decisions += detector.push(first, data[:, :3], data[:, 3:])
    assert [d.state for d in decisions] == [STATIC]
    assert detector.decided_through == hours * 3600 * 200 - 1
