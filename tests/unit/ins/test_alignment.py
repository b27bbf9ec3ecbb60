"""Levelling, gyrocompassing and biases at rest against the truth of simulated units."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from deepseis_core import rotation
from deepseis_core.errors import InputError
from deepseis_core.imu_errors import ImuErrors
from deepseis_core.imu_grades import ImuGrade, grade_named
from deepseis_core.kalman import chi_square_band
from deepseis_ins import alignment
from deepseis_sim.imu import ImuSynthesizer
from deepseis_sim.motions import Still
from deepseis_sim.site import Site

SITE = Site([0.62, 2.44, 50.0])
LATITUDE, _, HEIGHT = SITE.origin_geodetic
EULER = np.radians([12.0, -7.0, 141.0])
RATE = 200.0
C_TRUE = rotation.matrix_from_euler(EULER)


@pytest.fixture(scope="module")
def ideal():
    roll, pitch, heading = np.degrees(EULER)
    motion = Still(heading_deg=heading, pitch_deg=pitch, roll_deg=roll)
    return ImuSynthesizer(motion, SITE, RATE).increments(0, 12000)


def still(ideal, grade, seed, seconds):
    """Return the mean of a unit's measurements, and its errors at the end."""
    unit, count = ImuErrors(grade, RATE, seed), round(seconds * RATE)
    got = unit.apply(0, ideal.delta_theta[:count], ideal.delta_vel[:count])
    mean = alignment.still_mean(
        rotation.flu_from_frd(got.delta_theta), rotation.flu_from_frd(got.delta_vel), ideal.dt
    )
    return mean, unit.truth(count - 1, 1)


def phi_of(found):
    return -rotation.rotvec_from_matrix(found.C_nb @ C_TRUE.T)


def test_a_perfect_unit_finds_level_and_north(ideal):
    mean, _ = still(ideal, grade_named("perfect"), 1, 10.0)
    found = alignment.gyrocompassed(mean, LATITUDE, HEIGHT, ImuGrade())
    assert_allclose(phi_of(found), 0.0, atol=1e-9)
    level = alignment.levelled(mean, EULER[2], 0.0, LATITUDE, HEIGHT, ImuGrade())
    assert_allclose(phi_of(level), 0.0, atol=1e-9)


def mean_normalised_square(errors, covariances):
    return np.mean([e @ np.linalg.solve(P, e) for e, P in zip(errors, covariances, strict=True)])


@pytest.mark.parametrize("name", ["span-fsas", "fog", "navigation"])
def test_gyrocompassing_errs_as_it_says(ideal, name):
    """40 units: chi-square of all three angles with their correlations, 95 % band."""
    grade = grade_named(name)
    found = [
        alignment.gyrocompassed(still(ideal, grade, s, 60.0)[0], LATITUDE, HEIGHT, grade)
        for s in range(40)
    ]
    low, high = chi_square_band(3, 40)
    got = mean_normalised_square([phi_of(f) for f in found], [f.covariance for f in found])
    assert low < got < high


@pytest.mark.parametrize("name", ["span-fsas", "mti-g", "stim300"])
def test_levelling_errs_as_it_says(ideal, name):
    grade = grade_named(name)
    found = [
        alignment.levelled(still(ideal, grade, s, 30.0)[0], EULER[2], 0.1, LATITUDE, HEIGHT, grade)
        for s in range(40)
    ]
    low, high = chi_square_band(2, 40)
    errors, P = [phi_of(f)[:2] for f in found], [f.covariance[:2, :2] for f in found]
    assert low < mean_normalised_square(errors, P) < high


@pytest.mark.parametrize("name", ["span-fsas", "mti-g", "stim300"])
def test_bias_of_the_gyroscopes_errs_as_it_says(ideal, name):
    """Sensitivity to gravity counts as bias: the truth is what the unit adds at rest."""
    grade, attitude = grade_named(name), alignment.surveyed(EULER, np.radians(0.05))
    squares = []
    for seed in range(40):
        mean, truth = still(ideal, grade, seed, 30.0)
        got = alignment.gyro_bias(mean, attitude, LATITUDE, grade)
        force_flu = rotation.flu_from_frd(mean.force_b)
        bias = truth.gyro_bias[0] + truth.gyro_g_matrix @ force_flu
        squares.append(np.sum(((got.value - rotation.flu_from_frd(bias)) / got.sd) ** 2))
    low, high = chi_square_band(3, 40)
    assert low < np.mean(squares) < high


def test_a_still_minute_takes_the_turn_on_bias_of_mems_away(ideal):
    """One degree a second of an MTi-G shrinks to its noise: 3 deg/sqrt(h) over a minute."""
    grade = grade_named("mti-g")
    mean, _ = still(ideal, grade, 3, 60.0)
    got = alignment.gyro_bias(mean, alignment.surveyed(EULER, 1e-3), LATITUDE, grade)
    assert np.degrees(got.sd).max() == pytest.approx(3.0 / 60.0 / np.sqrt(60.0), rel=0.1)


def test_wander_within_the_stretch_is_that_of_its_process():
    """Mean against end of a Gauss-Markov process by simulation: 4 sigma of 4000 draws, 9 %."""
    grade = ImuGrade(gyro_instability_deg_per_h=10.0, gyro_correlation_time=60.0)
    rng, dt, count = np.random.default_rng(1), 1.0, 90
    keep, x = np.exp(-dt / 60.0), rng.standard_normal(4000)
    total = np.zeros(4000)
    for _ in range(count):
        x = keep * x + np.sqrt(1 - keep**2) * rng.standard_normal(4000)
        total += x
    got = alignment.gyro_bias(
        alignment.Still(np.zeros(3), np.zeros(3), 90.0), alignment.surveyed(EULER, 0.0), 0.6, grade
    )
    expected = np.std(total / count - x) * grade.gyros.instability
    assert_allclose(got.sd, expected, rtol=0.09 / 2)


def test_surveyed_attitude_is_as_given():
    found = alignment.surveyed(EULER, [1e-3, 2e-3, 3e-3])
    assert_allclose(rotation.euler_from_quat(found.quat_nb), EULER, atol=1e-14)
    assert_allclose(found.sd, [1e-3, 2e-3, 3e-3])


def test_mems_cannot_find_north(ideal):
    mean, _ = still(ideal, grade_named("mti-g"), 1, 10.0)
    with pytest.raises(InputError, match="give the heading"):
        alignment.gyrocompassed(mean, LATITUDE, HEIGHT, grade_named("mti-g"))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: alignment.still_mean(np.zeros((0, 3)), np.zeros((0, 3)), 0.01), "no sample"),
        (lambda: alignment.surveyed([0.0, 0.0], 0.1), "roll, pitch, heading"),
        (
            lambda: alignment.levelled(
                alignment.Still(np.zeros(3), np.array([0.0, 0.0, -12.0]), 1.0),
                0.0, 0.1, 0.6, 0.0, ImuGrade(),
            ),
            "at rest",
        ),
    ],
)  # fmt: skip
def test_bad_input_is_refused(call, message):
    with pytest.raises(InputError, match=message):
        call()
