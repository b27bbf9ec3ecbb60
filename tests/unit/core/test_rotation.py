"""Rotations against SciPy, and the two sets of axes against plain words."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from deepseis_core import rotation

ROUNDING = 1e-15 * 8  # a few operations on numbers of order one


@pytest.fixture
def quats() -> np.ndarray:
    """Random attitudes, half turns about each axis, none at all and hardly any."""
    some = Rotation.random(300, random_state=1).as_quat(canonical=True)
    special = np.vstack([np.eye(4), [[0.0, np.sqrt(0.5), -np.sqrt(0.5), 0.0]]])
    tiny = Rotation.from_rotvec([[1e-9, -2e-9, 0.0], [1e-5, 0, 3e-5], [0, 1e-200, 0]]).as_quat()
    return np.vstack([some, special, tiny])


def same_rotation(a, b, atol=ROUNDING):
    """Compare quaternions, of which two mean the same."""
    sign = np.sign(np.sum(np.asarray(a) * b, axis=-1, keepdims=True))
    assert_allclose(a * sign, b, rtol=0, atol=atol)


def test_matrices_and_products_are_those_of_scipy(quats):
    ours = rotation.matrix_from_quat(quats)
    assert_allclose(ours, Rotation.from_quat(quats).as_matrix(), rtol=0, atol=ROUNDING)
    other = quats[::-1]
    product = Rotation.from_quat(quats) * Rotation.from_quat(other)
    same_rotation(rotation.quat_multiply(quats, other), product.as_quat())
    matrices = ours @ rotation.matrix_from_quat(other)
    assert_allclose(product.as_matrix(), matrices, rtol=0, atol=ROUNDING)


def test_quaternions_of_matrices_are_precise_for_half_turns_too(quats):
    back = rotation.quat_from_matrix(rotation.matrix_from_quat(quats))
    assert np.all(back[:, 3] >= 0)
    same_rotation(back, quats)


def test_rotation_vectors_are_those_of_scipy(quats):
    theirs = Rotation.from_quat(quats).as_rotvec()
    half_turn = np.abs(quats[:, 3]) < 1e-9  # either sense is right
    ours = rotation.rotvec_from_quat(quats)
    assert_allclose(ours[~half_turn], theirs[~half_turn], rtol=1e-14, atol=ROUNDING)
    same_rotation(rotation.quat_from_rotvec(ours), quats)
    matrices = Rotation.from_quat(quats).as_matrix()
    assert_allclose(rotation.matrix_from_rotvec(theirs), matrices, rtol=0, atol=ROUNDING)


def test_small_rotation_vectors_survive_the_round_trip_with_all_digits():
    vectors = np.array([[1e-3, 0, 0], [0, 3.6e-7, -1e-8], [1e-20, 2e-20, 0], [0, 0, 0]])
    back = rotation.rotvec_from_quat(rotation.quat_from_rotvec(vectors))
    assert_allclose(back, vectors, rtol=1e-15, atol=0)


def test_vectors_turn_as_scipys(quats):
    vectors = np.random.default_rng(2).normal(size=(len(quats), 3))
    turned = Rotation.from_quat(quats).apply(vectors)
    assert_allclose(rotation.quat_rotate(quats, vectors), turned, rtol=0, atol=2 * ROUNDING)
    back = rotation.quat_rotate(rotation.quat_conjugate(quats), turned)
    assert_allclose(back, vectors, rtol=0, atol=4 * ROUNDING)


def test_skew_is_the_cross_product():
    a, b = np.random.default_rng(3).normal(size=(2, 5, 3))
    product = (rotation.skew(a) @ b[..., None])[..., 0]
    assert_allclose(product, np.cross(a, b), rtol=0, atol=1e-15)


def test_euler_angles_are_scipys_zyx(quats):
    attitude = Rotation.from_quat(quats)
    euler = rotation.euler_from_matrix(attitude.as_matrix())
    composed = Rotation.from_euler("ZYX", euler[:, ::-1])
    assert_allclose(composed.as_matrix(), attitude.as_matrix(), rtol=0, atol=ROUNDING)
    ours = rotation.matrix_from_euler(euler)
    assert_allclose(ours, composed.as_matrix(), rtol=0, atol=ROUNDING)
    same_rotation(rotation.quat_from_euler(euler), quats, atol=1e-14)
    assert_allclose(rotation.euler_from_quat(quats[:300]), euler[:300], rtol=0, atol=1e-12)


@pytest.mark.parametrize("pitch", [90.0, -90.0])
def test_nose_straight_up_or_down_all_turning_counts_as_heading(pitch):
    C_nb = Rotation.from_euler("ZYX", [30.0, pitch, 20.0], degrees=True).as_matrix()
    euler = rotation.euler_from_matrix(C_nb)
    expected = [0.0, pitch, 30.0 - np.sign(pitch) * 20.0]
    assert_allclose(np.degrees(euler), expected, rtol=0, atol=1e-6)
    assert_allclose(rotation.matrix_from_euler(euler), C_nb, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("euler_deg", "axis_b", "direction_ned"),
    [
        ((0, 0, 90), (1, 0, 0), (0, 1, 0)),  # heading east: forward points east
        ((0, 90, 0), (1, 0, 0), (0, 0, -1)),  # nose up: forward points up
        ((90, 0, 0), (0, 1, 0), (0, 0, 1)),  # right side down: right points down
        ((0, 0, 90), (0, 1, 0), (-1, 0, 0)),  # heading east: right points south
    ],
)
def test_euler_angles_mean_what_their_names_say(euler_deg, axis_b, direction_ned):
    C_nb = rotation.matrix_from_euler(np.radians(euler_deg))
    assert_allclose(C_nb @ axis_b, direction_ned, rtol=0, atol=1e-15)


def test_topics_axes_describe_the_same_attitude(quats):
    C_nb = rotation.matrix_from_quat(quats)
    C_enu_flu = rotation.enu_flu_from_ned_frd(C_nb)
    arrow_frd = np.array([1.0, -2.0, 3.0])
    by_ned = rotation.enu_from_ned(C_nb @ arrow_frd)
    assert_allclose(C_enu_flu @ rotation.flu_from_frd(arrow_frd), by_ned, rtol=0, atol=1e-14)
    assert_allclose(rotation.ned_frd_from_enu_flu(C_enu_flu), C_nb, rtol=0, atol=0)
    assert_allclose(np.linalg.det(C_enu_flu), 1.0, rtol=0, atol=1e-14)


def test_topics_euler_angles_are_yaw_from_east_and_pitch_nose_down():
    euler = np.radians([[10.0, -20.0, 30.0], [0.0, 5.0, 170.0], [-3.0, 0.0, -100.0]])
    rpy = rotation.rep103_from_euler(euler)
    assert_allclose(np.degrees(rpy[:, 2]), [60.0, -80.0, -170.0], rtol=0, atol=1e-12)
    theirs = Rotation.from_euler("ZYX", rpy[:, ::-1]).as_matrix()
    assert_allclose(rotation.enu_flu_from_euler(euler), theirs, rtol=0, atol=1e-15)
    assert_allclose(rotation.rep103_from_euler(rpy), euler, rtol=0, atol=1e-15)


def test_kernels_equal_the_array_functions(quats):
    vectors = np.random.default_rng(4).normal(size=(len(quats), 3))
    vectors[::2] *= 10.0 ** np.random.default_rng(5).uniform(-9, 0.5, (len(vectors[::2]), 1))
    for left, right, vector in zip(quats, quats[::-1], vectors, strict=True):
        q, p, v = tuple(left), tuple(right), tuple(vector)
        ours = rotation.quat_multiply_kernel(q, p)
        assert_allclose(ours, rotation.quat_multiply(left, right), rtol=0, atol=1e-15)
        ours = rotation.quat_rotate_kernel(q, v)
        assert_allclose(ours, rotation.quat_rotate(left, vector), rtol=0, atol=2e-15 * 10)
        ours = rotation.quat_from_rotvec_kernel(*v)
        assert_allclose(ours, rotation.quat_from_rotvec(vector), rtol=3e-16, atol=3e-16)


@pytest.mark.parametrize("angle", [1e-9, 3.6e-7, 1e-3, 0.0199, 0.0201, 1.0, 3.0])
def test_the_change_of_a_small_rotation_keeps_its_digits(angle):
    change = rotation.quat_change_kernel(0.6 * angle, -0.8 * angle, 0.0)
    half = np.sin(angle / 2)
    expected = [0.6 * half, -0.8 * half, 0.0, -2 * np.sin(angle / 4) ** 2]
    assert_allclose(change, expected, rtol=1e-15)


def test_normalised_quaternions_are_of_unit_length_with_positive_w():
    given = np.array([[0.0, 0.0, 3.0, -4.0], [1e-3, 0.0, 0.0, 1e-3]])
    expected = [[0.0, 0.0, -0.6, 0.8], [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]]
    assert_allclose(rotation.quat_normalise(given), expected, rtol=1e-15)
