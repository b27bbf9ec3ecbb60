"""The model of errors against perturbation of the mechanisation, column by column."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import logm

from deepseis_core import geodesy, rotation
from deepseis_core.imu_grades import ImuGrade, grade_named
from deepseis_ins import error_state as es
from deepseis_ins import error_state_kernels, loose_kernels
from deepseis_ins.strapdown import NavState, propagate

FAST = NavState(
    np.radians(52.0), np.radians(13.0), 3000.0,
    np.array([1800.0, -1300.0, 400.0]), rotation.quat_from_euler([0.4, -0.7, 2.1]),
)  # fmt: skip
SHAKEN = replace(FAST, vel_n=np.array([12.0, -7.0, 2.0]))
SIZES = np.repeat([3e3, 10.0, 1e-2, 1e-3, 1.0], 3)
"""Of perturbations: large against rounding, small against what is curved: to the third order."""


def moved(nav, x):
    """Return a state that is in error by x."""
    M = geodesy.meridian_radius(nav.latitude) + nav.height
    N = geodesy.transverse_radius(nav.latitude) + nav.height
    turn = rotation.quat_from_rotvec(-x[es.ATT])
    return replace(
        nav,
        latitude=nav.latitude + x[0] / M,
        longitude=nav.longitude + x[1] / (N * np.cos(nav.latitude)),
        height=nav.height - x[2],
        vel_n=nav.vel_n + x[es.VEL],
        quat_nb=rotation.quat_multiply(turn, nav.quat_nb),
    )


def difference(estimate, truth):
    """Return the errors of position, velocity, attitude."""
    M = geodesy.meridian_radius(truth.latitude) + truth.height
    N = geodesy.transverse_radius(truth.latitude) + truth.height
    turn = rotation.quat_multiply(estimate.quat_nb, rotation.quat_conjugate(truth.quat_nb))
    return np.hstack(
        [
            (estimate.latitude - truth.latitude) * M,
            (estimate.longitude - truth.longitude) * N * np.cos(truth.latitude),
            truth.height - estimate.height,
            estimate.vel_n - truth.vel_n,
            -rotation.rotvec_from_quat(turn),
        ]
    )


def after(nav, x, theta, vel, dt, matrices=None):
    """Return where increments lead that an IMU with biases and matrix errors measured."""
    ends = np.zeros((2, 3, 3)) if matrices is None else matrices
    force_ref = (
        -geodesy.normal_gravity(nav.latitude, nav.height)
        * (rotation.matrix_from_quat(nav.quat_nb)[2])
    )
    measured_vel = vel + (vel - force_ref * dt) @ ends[0].T + x[es.ACCEL] * dt
    measured_theta = theta + theta @ ends[1].T + x[es.GYRO] * dt
    return propagate(moved(nav, x), measured_theta, measured_vel, dt)[0]


def perturbed(nav, theta, vel, dt):
    """Return the transition matrix, shape (9, 15), by central differences."""
    truth, columns = after(nav, np.zeros(15), theta, vel, dt), []
    for j, size in enumerate(SIZES):
        x = np.zeros(15)
        x[j] = size
        plus = difference(after(nav, x, theta, vel, dt), truth)
        minus = difference(after(nav, -x, theta, vel, dt), truth)
        columns.append((plus - minus) / (2.0 * size))
    return np.stack(columns, axis=-1)


def test_every_element_of_f_is_that_of_the_mechanisation():
    """At 2 km/s the terms in v / R show; 1 % is what the flattening does to radii, neglected."""
    dt = 0.1
    rng = np.random.default_rng(1)
    force_b = rng.normal(0.0, 10.0, 3)
    Phi = np.eye(15)
    Phi[:9] = perturbed(FAST, np.zeros((1, 3)), force_b[None] * dt, dt)
    expected = logm(Phi).real[:9] / dt
    middle = propagate(FAST, np.zeros((1, 3)), force_b[None] * dt / 2, dt / 2)[0]
    force_n = rotation.quat_rotate(middle.quat_nb, force_b)
    F = es.dynamics(middle, force_n, ImuGrade())[:9]
    for rows in (es.POS, es.VEL, es.ATT):
        for columns in (es.POS, es.VEL, es.ATT, es.GYRO, es.ACCEL):
            block, want = F[rows, columns], expected[rows, columns]
            # An element that is really zero is compared with its block's largest; latitude is
            # rounded to a nanometre; and the axes turn within dt at w = 6e-4, which leaves
            # w dt^2 / 12 of the force where F itself has nothing.
            floor = 3e-3 * abs(block).max() + 1e-11
            if rows == es.POS:
                floor += 2e-9 / SIZES[columns][0] / dt
            if not block.any():
                floor += 6e-4 * dt**2 / 12 * 20.0
            assert_allclose(block, want, rtol=1e-2, atol=floor, err_msg=f"{rows} {columns}")


@pytest.mark.parametrize("term", ["earth", "transport", "centripetal", "gravity"])
def test_f_has_the_terms_that_print_gets_wrong(term):
    """Thesis 2.18 and 2.19 as corrected: values from the closed formulas."""
    lat, h = FAST.latitude, FAST.height
    v_n, v_e, v_d = FAST.vel_n
    M = geodesy.meridian_radius(lat) + h
    N = geodesy.transverse_radius(lat) + h
    w, tan, cos, sin = 7.292115e-5, np.tan(lat), np.cos(lat), np.sin(lat)
    F = es.dynamics(FAST, np.zeros(3), ImuGrade())
    g = geodesy.normal_gravity(lat, h)
    expected = {
        "earth": (F[4, 0], 2 * w * (v_n * cos - v_d * sin) / M + v_n * v_e / (M * N * cos**2)),
        "transport": (F[4, 2], (v_e * v_d + v_e * v_n * tan) / N**2),
        "centripetal": (F[4, 4], (v_d + v_n * tan) / N),
        "gravity": (F[5, 2], -(v_e**2 / N**2 + v_n**2 / M**2 - 2 * g / np.sqrt(M * N))),
    }
    assert_allclose(*expected[term], rtol=1e-9)


def carried(nav, theta, vel, dt, U, B, *, step, grade):
    """Return the cross-covariance with constants after increments, by the filter's kernels."""
    x = np.hstack([nav.latitude, nav.longitude, nav.height, nav.vel_n, nav.quat_nb, np.zeros(7)])
    force_ref = (
        -geodesy.normal_gravity(nav.latitude, nav.height)
        * (rotation.matrix_from_quat(nav.quat_nb)[2])
    )
    pending, P, U = np.zeros(loose_kernels.PENDING_SIZE), np.zeros((15, 15)), U.copy()
    loose_kernels.begin_kernel(x, pending)
    count = len(theta)
    loose_kernels.propagate_kernel(
        x, np.zeros(6), pending, P, U, B, es.noise_model(grade, force_ref),
        np.zeros((0, 36)), step, theta, vel, np.full(count, dt),
        np.empty((count, 3)), np.empty((count, 3)), np.empty((count, 4)),
    )  # fmt: skip
    return U, P


def shake(seconds, dt):
    """Return increments of 2 g at 2 Hz and turns of 0.5 rad/s, one gravity on top."""
    time = dt * (np.arange(round(seconds / dt)) + 0.5)[:, None]
    swing = np.sin(2 * np.pi * 2.0 * time + np.array([0.0, 1.0, 2.0]))
    force = 19.6 * swing + rotation.matrix_from_quat(SHAKEN.quat_nb).T @ [0.0, 0.0, -9.81]
    return 0.5 * np.cos(2 * np.pi * 0.7 * time + np.array([0.5, 0.0, 4.0])) * dt, force * dt


@pytest.mark.parametrize("step", [0.02, 0.05])
def test_steps_of_the_covariance_carry_errors_as_the_mechanisation_does(step):
    """Two seconds of 2 g and turning; of each error the effect to 0.5 % of its largest."""
    theta, vel = shake(2.0, 0.005)
    U = np.zeros((15, 21))
    U[:, :15] = np.eye(15)
    U, _ = carried(SHAKEN, theta, vel, 0.005, U, np.zeros((21, 21)), step=step, grade=ImuGrade())
    expected = perturbed(SHAKEN, theta, vel, 0.005)
    for rows in (es.POS, es.VEL, es.ATT):
        for j in range(15):
            want = expected[rows, j]
            # Attitude barely feels position and velocity: 1 / R, and less.
            floor = 5e-3 * abs(want).max() + 1e-9
            assert_allclose(U[rows, j], want, rtol=0, atol=floor, err_msg=f"{rows} {j}")


def test_scale_factors_and_misalignments_act_as_in_the_mechanisation():
    """All 18 elements: a percent after 2 s, what a step of 50 ms leaves of the product M f."""
    theta, vel = shake(2.0, 0.005)
    U, _ = carried(
        SHAKEN, theta, vel, 0.005, np.zeros((15, 21)), np.eye(21), step=0.02, grade=ImuGrade()
    )
    size = 1e-4
    for k in range(18):
        matrices = np.zeros(18)
        matrices[k] = size
        plus = after(SHAKEN, np.zeros(15), theta, vel, 0.005, matrices.reshape(2, 3, 3))
        minus = after(SHAKEN, np.zeros(15), theta, vel, 0.005, -matrices.reshape(2, 3, 3))
        want = difference(plus, minus) / (2.0 * size)
        for rows in (es.POS, es.VEL, es.ATT):
            assert_allclose(U[rows, 3 + k], want[rows], rtol=0, atol=1e-2 * abs(want[rows]).max())


def test_noise_at_rest_grows_as_random_walks_do():
    """White force and rate: variances of velocity, position, attitude in closed form."""
    grade = ImuGrade(gyro_walk_deg_per_sqrt_h=0.1, accel_walk_per_sqrt_h=0.03)
    still = replace(SHAKEN, vel_n=np.zeros(3), quat_nb=np.array([0.0, 0.0, 0.0, 1.0]))
    theta, vel = np.zeros((4000, 3)), np.tile([0.0, 0.0, -9.8 * 0.005], (4000, 1))
    _, P = carried(
        still, theta, vel, 0.005, np.zeros((15, 21)), np.zeros((21, 21)), step=0.05, grade=grade
    )
    t, qa, qg = 20.0, grade.accelerometers.walk**2, grade.gyros.walk**2
    assert P[5, 5] == pytest.approx(qa * t, rel=1e-3)  # gravity falls with height: 2 g t^2 / 3 R
    assert P[2, 2] == pytest.approx(qa * t**3 / 3.0, rel=2e-3)
    assert P[8, 8] == pytest.approx(qg * t, rel=1e-4)
    # A tilt's walk pulls on the velocity: g^2 q t^3 / 3.
    assert P[3, 3] == pytest.approx(qa * t + 9.8**2 * qg * t**3 / 3.0, rel=1e-3)


@pytest.mark.parametrize("name", ["span-fsas", "mti-g", "stim300"])
def test_bias_model_keeps_variance_and_drive_and_never_trusts_longer_than_the_truth(name):
    triad = grade_named(name).accelerometers
    model = es.bias_model(triad)
    total = triad.bias**2 + triad.instability**2
    assert_allclose(model.sd**2, total, rtol=1e-12)
    assert_allclose(
        2 * model.sd**2 / model.correlation_time,
        2 * triad.instability**2 / triad.correlation_time,
        rtol=1e-12,
    )
    lag = np.linspace(0.0, 1e4, 500)
    truth = triad.bias**2 + triad.instability**2 * np.exp(-lag / triad.correlation_time)
    assert np.all(total * np.exp(-lag / model.correlation_time[0]) <= truth * (1 + 1e-12))


def test_a_unit_without_wander_keeps_its_bias_for_ever():
    assert np.all(
        np.isinf(es.bias_model(ImuGrade(accel_bias=0.01).accelerometers).correlation_time)
    )


def test_kernels_agree_with_numpy():
    C = np.empty((3, 3))
    error_state_kernels.matrix_kernel(FAST.quat_nb, C)
    assert_allclose(C, rotation.matrix_from_quat(FAST.quat_nb), atol=1e-15)
