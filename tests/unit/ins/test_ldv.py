"""The velocimeter: beams, every sensitivity by perturbation, honest over many units."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from unit.ins import loose_runs as runs
from unit.ins.test_measurements import NAV, OMEGA, wrong

from deepseis_core import rotation
from deepseis_core.errors import InputError
from deepseis_core.kalman import chi_square_band
from deepseis_ins import ldv
from deepseis_ins.alignment import earth_rate
from deepseis_ins.ldv_kernels import window_kernel
from deepseis_ins.loose import LooseConfig, LooseFilter
from deepseis_sim.motions import Circle

JANUS = np.radians([-60.0, -120.0])
LEVER = np.array([0.8, -0.2, 0.6])
TRUE = ldv.LdvInstallation.from_angles(
    np.radians([0.1, 0.2, -0.3]), 1e-3, LEVER, [2e-3, 5e-3, 5e-3]
)
CONFIG = ldv.LdvConfig(noise=0.003, lateral_sd=0.01)


def test_beams_give_back_the_velocity_that_they_were_made_of():
    """By the bench's own equation: forward cos e + up sin e."""
    forward, up = np.array([12.0, -3.0]), np.array([0.4, 0.1])
    beams = np.outer(forward, np.cos(JANUS)) + np.outer(up, np.sin(JANUS))
    sd = np.tile([0.01, 0.01], (2, 1))
    found = ldv.LdvRecord.from_beams(np.arange(2.0), beams, sd, JANUS, np.full(2, 300.0))
    assert_allclose(found.velocity, np.stack([forward, -up], axis=1), atol=1e-12)
    # d1 - d2 = 2 v cos 60, -(d1 + d2) = 2 v sin 60: sd sqrt(2) / 1 and sqrt(2) / sqrt(3).
    expected = [0.01**2 * 2.0, 0.01**2 * 2.0 / 3.0, 0.0]
    assert_allclose(found.variance, [expected, expected], atol=1e-15)


def test_beams_in_one_line_are_refused():
    with pytest.raises(InputError, match="cannot be told apart"):
        ldv.beam_matrix(np.radians([-60.0, 120.0]))


def velocity_at_sensor(nav, omega, lever):
    C = rotation.matrix_from_quat(nav.quat_nb)
    over_ground = omega - C.T @ earth_rate(nav.latitude)
    return nav.vel_n + C @ np.cross(over_ground, lever)


def taken(x, e=(0.0, 0.0, 0.0)):
    """Return the measurement of the truth by a filter in error by x, installation by e."""
    C_true = rotation.matrix_from_quat(NAV.quat_nb)
    v_d = (1.0 + TRUE.scale) * TRUE.C_bd.T @ C_true.T @ velocity_at_sensor(NAV, OMEGA, LEVER)
    hat = TRUE.corrected(-np.asarray(e))  # estimate: truth plus error
    nav, omega = wrong(NAV, x), OMEGA + x[9:12]
    C = rotation.matrix_from_quat(nav.quat_nb)
    window = ldv.LdvWindow(
        20, velocity_at_sensor(nav, omega, LEVER), C @ hat.velocity_b(v_d), np.full(3, 1e-6)
    )
    return ldv.ldv_velocity(window, C, omega, nav.latitude, hat, CONFIG)


def test_every_column_of_h_is_what_perturbation_gives():
    """What is left is curvature: phi^2 times 4 m/s, and the lever over the Earth's radius."""
    sizes = np.repeat([1.0, 1.0, 1e-3, 1e-3, 1e-2], 3)
    H = taken(np.zeros(15)).H
    for j, size in enumerate(sizes):
        x = np.zeros(15)
        x[j] = size
        column = (taken(x).z - taken(-x).z) / (2.0 * size)
        assert_allclose(H[:, j], column, rtol=0, atol=5e-6, err_msg=f"state {j}")


def test_every_column_of_d_is_what_perturbation_gives():
    """Scale, pitch and yaw of the installation; e^2 times 4 m/s is left."""
    D = taken(np.zeros(15)).D
    for j in range(3):
        e = np.zeros(3)
        e[j] = 1e-3
        column = (taken(np.zeros(15), e).z - taken(np.zeros(15), -e).z) / 2e-3
        assert_allclose(D[:, j], column, rtol=0, atol=1e-5, err_msg=f"constant {j}")


def test_a_filter_that_is_right_finds_nothing():
    assert_allclose(taken(np.zeros(15)).z, 0.0, atol=1e-12)


def test_the_papers_h_misses_what_pitch_does():
    """Equation 7 has no column for phi: at 20 m/s northward 50 urad of pitch are 1 mm/s."""
    x = np.zeros(15)
    x[7] = 50e-6
    level = replace(NAV, vel_n=np.array([20.0, 0.0, 0.0]), quat_nb=np.array([0.0, 0.0, 0.0, 1.0]))
    C = rotation.matrix_from_quat(wrong(level, x).quat_nb)
    window = ldv.LdvWindow(1, level.vel_n, C @ level.vel_n, np.zeros(3))
    found = ldv.ldv_velocity(window, C, np.zeros(3), level.latitude, ldv.LdvInstallation(), CONFIG)
    assert abs(found.z[2]) == pytest.approx(1e-3, rel=1e-3)
    assert_allclose(found.H @ x, found.z, atol=1e-7)


def test_means_of_a_window_are_those_of_plain_numpy():
    rng = np.random.default_rng(3)
    time = np.arange(9) * 0.005
    vel = rng.standard_normal((9, 3))
    turn = rotation.quat_from_rotvec(0.002 * rng.standard_normal((9, 3)).cumsum(axis=0))
    quat = rotation.quat_multiply(turn, NAV.quat_nb)
    omega, moments = 0.1 * rng.standard_normal((9, 3)), np.array([0.004, 0.015, 0.031])
    velocity_b = rng.standard_normal((3, 3))
    arms = np.array([LEVER, [-1.0, 0.0, 0.4]])
    own, predicted, measured = np.empty((3, 3))
    window_kernel(time, vel, quat, omega, 0.6, moments, velocity_b, arms, own, predicted, measured)
    rows = []
    for t, u in zip(moments, velocity_b, strict=True):
        i = int(np.searchsorted(time, t))
        share = (t - time[i - 1]) / (time[i] - time[i - 1])
        v = vel[i - 1] + share * (vel[i] - vel[i - 1])
        q = quat[i - 1] + share * (quat[i] - quat[i - 1])
        C = rotation.matrix_from_quat(q / np.linalg.norm(q))
        w = omega[i] - C.T @ earth_rate(0.6)
        slip = np.cross(w, arms[0] - arms[1])[1]
        rows.append([v, v + C @ np.cross(w, arms[0]), C @ (u + np.array([0.0, slip, 0.0]))])
    assert_allclose([own, predicted, measured], np.mean(rows, axis=0), atol=1e-12)


# Over many units: a circle of 0.5 m at 1 Hz (3 m/s), GNSS for 20 s, then the velocimeter alone.

UNITS, SECONDS, COVERED = 12, 45, 20
CIRCLE = Circle(radius=0.5, frequency_hz=1.0, start=5.0, duration=100.0)
BEAM_SD = np.array([0.004, 0.003])


@pytest.fixture(scope="module")
def flown():
    ideal = runs.ideal_increments(CIRCLE, SECONDS)
    return [fly(seed, ideal) for seed in range(UNITS)]


def fly(seed, ideal):
    """Return a run, and error and covariance of its installation at the end."""
    unit, drawn = runs.Unit("span-fsas", CIRCLE, SECONDS, seed, ideal), []
    rng = np.random.default_rng([seed, 8])
    prior = np.array([2e-3, 5e-3, 5e-3])
    error = prior * rng.standard_normal(3)
    hat = TRUE.corrected(-error)

    def told(loose, time, _C_ref, noise):
        if not drawn:
            loose.refer_constants(prior)
            drawn.append(True)
        if time <= COVERED and abs(time - round(time)) < 1e-9:
            yield from runs.gnss(unit, loose, time, noise)
        yield lambda: measured(unit, loose, time, hat, noise)

    run = runs.fly(unit, SECONDS, told, seed=seed, rate_hz=5)
    estimate, covariance = run.filter.take_constants()
    return run, error - estimate, covariance


def measured(unit, loose, time, hat, noise):
    """Measure the true velocity of the sensor, noisy in its own axes."""
    truth = unit.motion.at(np.array([time]))
    C = runs.C_TRUE
    velocity = rotation.enu_from_ned(truth.velocity[0])  # the same exchange either way
    omega = C.T @ earth_rate(runs.LAT)
    v_b = C.T @ velocity + np.cross(omega - C.T @ earth_rate(runs.LAT), LEVER)
    sd = np.hypot([BEAM_SD[0], 0.0, BEAM_SD[1]], [CONFIG.noise, CONFIG.lateral_sd, CONFIG.noise])
    v_d = (1.0 + TRUE.scale) * TRUE.C_bd.T @ v_b + sd * noise.standard_normal(3)
    nav = loose.nav
    C_hat = rotation.matrix_from_quat(nav.quat_nb)
    window = ldv.LdvWindow(
        1,
        velocity_at_sensor(nav, loose.omega_ib_b, LEVER),
        C_hat @ hat.velocity_b(v_d),
        np.array([*BEAM_SD**2, 0.0]),
    )
    return ldv.ldv_velocity(window, C_hat, loose.omega_ib_b, nav.latitude, hat, CONFIG)


def test_errors_and_innovations_are_as_large_as_the_filter_says(flown):
    """NEES of 15 states and of the installation at the end, NIS of the velocimeter: 95 %."""
    ends = [run.at(SECONDS) for run, _, _ in flown]
    nees = np.mean([x @ np.linalg.solve(P, x) for x, P in ends])
    low, high = chi_square_band(15, UNITS, 1.0 - 0.05 / 3.0)
    assert low < nees < high
    constants = np.mean([e @ np.linalg.solve(P, e) for _, e, P in flown])
    low, high = chi_square_band(3, UNITS, 1.0 - 0.05 / 3.0)
    assert low < constants < high
    squares = np.concatenate([run.squares(ldv.NAME) for run, _, _ in flown])
    low, high = chi_square_band(3, squares.size, 1.0 - 0.05 / 3.0)
    assert low < squares.mean() < high


def test_without_gnss_the_position_errs_as_much_as_it_says(flown):
    """25 s of the velocimeter alone: position grows, and stays within 3.9 sigma."""
    for run, _, _ in flown:
        x, P = run.at(SECONDS)
        assert np.all(np.abs(x[:3]) < 3.9 * np.sqrt(np.diag(P)[:3]))
        assert np.all(np.diag(P)[:3] > np.diag(run.at(COVERED)[1])[:3])


def test_constants_begin_anew_independent_of_the_states():
    loose = LooseFilter(
        LooseConfig(), runs.grade_named("span-fsas"), NAV,
        attitude_sd=[1e-3] * 3, position_sd=[1.0] * 3, velocity_sd=[0.1] * 3,
    )  # fmt: skip
    loose.refer_constants([1e-3, 2e-3, 3e-3])
    estimate, covariance = loose.take_constants()
    assert_allclose(estimate, 0.0)
    assert_allclose(covariance, np.diag([1e-6, 4e-6, 9e-6]))
    before = loose.P
    loose.update(taken(np.zeros(15)))
    assert np.trace(loose.take_constants()[1]) < np.trace(covariance)
    assert np.trace(loose.P) < np.trace(before)
