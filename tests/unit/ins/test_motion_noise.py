"""Noise learnt from a still, and stills that were none."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.io import loadmat
from scipy.signal import lfilter

from deepseis_core.imu_errors import ImuErrors
from deepseis_core.imu_grades import GRADES, STANDARD_GRAVITY
from deepseis_core.types import MotionKind
from deepseis_ins.motion_noise import calibrate, noise_of_grade
from deepseis_ins.motion_state import MotionConfig, MotionDetector

RATE = 200.0
STATIC, MOVING = MotionKind.STATIC, MotionKind.MOVING
CALIBRATING = MotionConfig(calibration_time=10.0)


def rest(grade, count, seed=1):
    vel = np.tile([0.0, 0.0, STANDARD_GRAVITY / RATE], (count, 1))
    made = ImuErrors(GRADES[grade], RATE, seed).apply(0, np.zeros((count, 3)), vel)
    return np.hstack([made.delta_theta, made.delta_vel]) * RATE


@pytest.mark.parametrize("grade", ["span-fsas", "stim300", "mti-g", "fog"])
def test_a_still_shows_the_noise_of_the_grade(grade):
    found = calibrate(rest(grade, 12_000), RATE, 200)
    assert found.problem == ""
    # 12 000 samples, and the median of 60 windows of them: 1 %.
    assert_allclose(found.noise.sigma, noise_of_grade(GRADES[grade], RATE).sigma, rtol=0.04)
    assert_allclose(found.noise.colour, 1.0)
    assert calibrate(rest(grade, 12_000), RATE, 200, noise_of_grade(GRADES[grade], RATE)).noise


def test_stills_are_seldom_taken_for_motion():
    refused = 0
    for grade in ("span-fsas", "stim300", "mti-g"):
        expected = noise_of_grade(GRADES[grade], RATE)
        for seed in range(100):
            refused += calibrate(rest(grade, 2000, seed), RATE, 200, expected).noise is None
    assert refused <= 3


def disturbed(kind):
    data, time = rest("mti-g", 2000), np.arange(2000) / RATE
    if kind == "one window":
        data[1000:1020, 4] += 0.3 * (-1.0) ** np.arange(20)
    elif kind == "means":
        data[1000:, 3] += 0.1
    elif kind == "lasts":
        data[:, 3] += 0.1 * np.sin(2 * np.pi * 0.7 * time)
    elif kind == "vibration":
        data[:, 3:] += 0.1 * np.sin(2 * np.pi * 23.0 * time)[:, None]
    elif kind == "missing":
        data[77, 3:] = np.nan
    elif kind == "always the same":
        data[:, 5] = 9.81
    return data


@pytest.mark.parametrize(
    "kind", ["one window", "means", "lasts", "vibration", "missing", "always the same"]
)
def test_what_was_no_still_is_noticed_and_named(kind):
    found = calibrate(disturbed(kind), RATE, 200, noise_of_grade(GRADES["mti-g"], RATE))
    assert found.noise is None
    assert kind in found.problem
    assert found.problem.startswith("accelerometer")


def test_the_detector_tries_again_until_the_station_is_still():
    data = rest("mti-g", 8000)
    data[:3000, 3] += np.sin(np.arange(3000) / 30.0)
    detector = MotionDetector(CALIBRATING, RATE)
    made = detector.push(0, data[:, :3], data[:, 3:])
    assert [d.state for d in made] == [MOVING, STATIC]
    assert made[0].since == 0
    assert "accelerometer x" in made[0].cause
    assert made[1].decided == 4999
    assert made[1].since == 4999


def test_motion_after_a_still_of_ones_own_is_noticed_as_with_the_grade():
    data = rest("stim300", 4000)
    data[3000:, 4] += 0.02 * STANDARD_GRAVITY
    for grade in (None, GRADES["stim300"]):
        detector = MotionDetector(CALIBRATING, RATE, grade)
        made = detector.push(0, data[:, :3], data[:, 3:])
        assert [d.state for d in made[:2]] == [STATIC, MOVING]
        assert made[0].decided == 1999
        assert 3000 <= made[1].decided < 3010
        assert made[1].since <= 3000


def test_coloured_noise_is_not_motion():
    # A sensor with a low-pass filter at 10 Hz: colour 2 rate / (2 pi 10) = 6.4 at most.
    rng, decay = np.random.default_rng(3), np.exp(-2 * np.pi * 10.0 / RATE)
    data = lfilter([1 - decay], [1, -decay], rng.standard_normal((400_000, 6)), axis=0)
    detector = MotionDetector(replace(CALIBRATING, calibration_time=60.0), RATE)
    made = detector.push(0, data[:, :3], data[:, 3:])
    assert [d.state for d in made] == [STATIC]
    assert_allclose(detector.calibration.noise.colour, (1 + decay) / (1 - decay), rtol=0.3)


def test_a_real_unit_at_rest_stays_still(shared_data):
    # VN-310, 50 Hz, 33 s on a fixed antenna mount, no grade known.
    file = shared_data / "gnss_ins/instinct_tckf_static/vn310-imu.csv"
    data = np.genfromtxt(file, delimiter=",", skip_header=1, usecols=range(13, 19))
    for policy in ("fast", "thesis"):
        config = replace(CALIBRATING, policy=policy)
        made = MotionDetector(config, 50.0).push(0, data[:, 3:], data[:, :3])
        assert [d.state for d in made] == [STATIC]


def test_people_in_a_parked_car_are_noticed(shared_data):
    data = loadmat(shared_data / "gnss_ins/psins/insgpseo_tc.mat")["imu"][:, :6] * RATE
    detector = MotionDetector(CALIBRATING, RATE)
    made = detector.push(0, data[:, :3], data[:, 3:])
    # The first still is none, later ones are; it drives off after 70 s.
    assert "no still" in made[0].cause
    assert [d.state for d in made] == [MOVING, STATIC] * (len(made) // 2) + [MOVING]
    assert made[-1].since < 70 * RATE
