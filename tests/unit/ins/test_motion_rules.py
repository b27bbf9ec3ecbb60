"""The rule of the thesis on data whose variances are known exactly."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import chi2

from deepseis_core.imu_errors import ImuErrors
from deepseis_core.imu_grades import GRADES, STANDARD_GRAVITY
from deepseis_core.types import MotionKind
from deepseis_ins.motion_noise import noise_of_grade
from deepseis_ins.motion_state import MotionConfig, MotionDetector

RATE = 200.0
STATIC, MOVING, UNKNOWN = MotionKind.STATIC, MotionKind.MOVING, MotionKind.UNKNOWN
THESIS = MotionConfig(policy="thesis")


def rest(grade, count, seed=1):
    vel = np.tile([0.0, 0.0, STANDARD_GRAVITY / RATE], (count, 1))
    made = ImuErrors(GRADES[grade], RATE, seed).apply(0, np.zeros((count, 3)), vel)
    return made.delta_theta * RATE, made.delta_vel * RATE


def changes(decisions):
    return [(d.state, d.since, d.decided) for d in decisions]


def block(variance, count=200):
    """A window whose sample variance is just this, to rounding."""
    wave = np.where(np.arange(count) % 2, 1.0, -1.0)
    return wave * np.sqrt(variance * (count - 1) / count)


def thesis_windows(amounts, axis=5, first=0):
    limits = (1e-6, 2e-6, 3e-6, 1e-2, 2e-2, 3e-2)
    config = replace(THESIS, thresholds=limits)
    data = np.zeros((200 * len(amounts), 6))
    data[:, axis] = np.concatenate([block(a * limits[axis]) for a in amounts])
    detector = MotionDetector(config, RATE)
    return changes(detector.push(first, data[:, :3], data[:, 3:])), detector


@pytest.mark.parametrize("axis", range(6))
def test_thesis_one_window_is_motion_and_three_are_stillness(axis):
    amounts = [0.5, 0.5, 1.01, 0.99, 0.99, 1.01, 0.99, 0.99, 0.99, 0.99, 1.01]
    made, detector = thesis_windows(amounts, axis)
    assert made == [(MOVING, 400, 599), (STATIC, 1799, 1799), (MOVING, 2000, 2199)]
    assert_allclose(detector.report().variance[axis], 1.01 * detector.report().threshold[axis])
    assert thesis_windows([0.5] * 3, axis)[0] == [(STATIC, 599, 599)]


def test_thesis_variance_equal_to_its_threshold_is_motion():
    # 3.41: still is below. Here both are exact: 1, -1, .. of an even count has n / (n - 1).
    config = replace(THESIS, thresholds=(200 / 199,) * 6)
    detector = MotionDetector(config, RATE)
    data = np.tile([[1.0] * 3, [-1.0] * 3], (100, 1))
    assert [d.state for d in detector.push(0, 0 * data, data)] == [MOVING]


def test_thesis_windows_lie_on_whole_seconds_of_the_imu():
    data = np.zeros((1000, 6))
    data[399, 3] = 1.0
    config = replace(THESIS, thresholds=(1e-6,) * 6)
    made = MotionDetector(config, RATE).push(77, data[:, :3], data[:, 3:])
    assert changes(made)[0] == (MOVING, 400, 599)
    # Sample 0 begins 0.25 s after a second.
    made = MotionDetector(config, RATE, origin=3.25).push(77, data[:, :3], data[:, 3:])
    assert changes(made)[0] == (MOVING, 350, 549)


def test_thesis_thresholds_are_twice_the_rms_of_variances_at_rest():
    omega, force = rest("mti-g", 12_000)
    config = replace(THESIS, calibration_time=60.0)
    detector = MotionDetector(config, RATE, GRADES["mti-g"])
    assert [d.state for d in detector.push(0, omega, force)] == [STATIC]
    variances = np.hstack([omega, force]).reshape(60, 200, 6).var(axis=1, ddof=1)
    expected = 2 * np.sqrt(np.mean(variances**2, axis=0))
    assert_allclose(detector.report().threshold, expected, rtol=1e-12)
    of_grade = MotionDetector(THESIS, RATE, GRADES["mti-g"]).calibration.thresholds
    # 60 windows of 200 samples know a variance to 1.3 %.
    assert_allclose(expected, of_grade, rtol=0.06)


@pytest.mark.parametrize("grade", ["span-fsas", "stim300", "mti-g"])
def test_thesis_rule_has_no_false_switch_in_a_day_either(grade):
    # Twice the variance of 200 samples: chi-square of 199 degrees of freedom above 398.
    limits = MotionDetector(THESIS, RATE, GRADES[grade]).calibration.thresholds
    sigma = noise_of_grade(GRADES[grade], RATE).sigma
    tail = chi2.sf(199 * limits / sigma**2, 199)
    assert tail.sum() * 86400 < 1e-6
    omega, force = rest(grade, 400_000)
    made = MotionDetector(THESIS, RATE, GRADES[grade]).push(0, omega, force)
    assert [d.state for d in made] == [STATIC]


def test_thesis_gaps():
    data = np.random.default_rng(1).normal(0, 1e-3, (4000, 3))
    config = replace(THESIS, thresholds=(2e-6,) * 6)
    detector = MotionDetector(config, RATE)
    made = detector.push(0, data[:1000], data[:1000])
    assert detector.push(1010, data[:390], data[:390]) == []
    made += detector.push(1450, data[:1550], data[:1550])
    assert changes(made) == [(STATIC, 599, 599), (UNKNOWN, 1400, 1599), (STATIC, 2199, 2199)]
    made = detector.push(10**12 + 5000, data[:10], data[:10])
    assert changes(made) == [(UNKNOWN, 3000, 3199)]
    assert detector.decided_through == 10**12 + 4999
