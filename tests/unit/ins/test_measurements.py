"""Every sensitivity against perturbation of what is predicted, and signs by hand."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from deepseis_core import geodesy, rotation
from deepseis_core.constants import WGS84_EARTH_RATE
from deepseis_core.errors import InputError
from deepseis_ins import measurements as ms
from deepseis_ins.strapdown import NavState

NAV = NavState(
    0.62, 2.44, 50.0, np.array([3.0, -2.0, 1.0]), rotation.quat_from_euler([0.3, -0.5, 2.0])
)
LEVER = np.array([1.5, -0.8, -2.2])
OMEGA = np.array([0.4, -0.9, 0.6])
C_NE = geodesy.rotation_ned_ecef(NAV.latitude, NAV.longitude)


def wrong(nav, x):
    """Return a state that is in error by x."""
    M = geodesy.meridian_radius(nav.latitude) + nav.height
    N = geodesy.transverse_radius(nav.latitude) + nav.height
    return replace(
        nav,
        latitude=nav.latitude + x[0] / M,
        longitude=nav.longitude + x[1] / (N * np.cos(nav.latitude)),
        height=nav.height - x[2],
        vel_n=nav.vel_n + x[3:6],
        quat_nb=rotation.quat_multiply(rotation.quat_from_rotvec(-x[6:9]), nav.quat_nb),
    )


def antenna(nav, omega):
    """Return position and velocity of the antenna, ECEF, by plain vector algebra in ECEF."""
    C_en = geodesy.rotation_ned_ecef(nav.latitude, nav.longitude).T
    C_eb = C_en @ rotation.matrix_from_quat(nav.quat_nb)
    earth = np.array([0.0, 0.0, WGS84_EARTH_RATE])
    place = geodesy.ecef_from_geodetic([nav.latitude, nav.longitude, nav.height])
    lever = C_eb @ LEVER
    return place + lever, C_en @ nav.vel_n + np.cross(C_eb @ omega - earth, lever)


POSITION, VELOCITY = antenna(NAV, OMEGA)
C_REF = rotation.matrix_from_quat(NAV.quat_nb)


def taken(kind, x):
    """Return the measurement that a filter in error by x makes of the truth."""
    nav, cov = wrong(NAV, x), np.eye(3)
    if kind == "position":
        return ms.gnss_position(nav, POSITION, cov, LEVER)
    if kind == "velocity":
        return ms.gnss_velocity(nav, OMEGA + x[9:12], VELOCITY, cov, LEVER)
    if kind == "zero_velocity":
        return ms.zero_velocity(nav, 0.01)
    return ms.zero_angle(nav, C_REF, 0.01)


@pytest.mark.parametrize("kind", ["position", "velocity", "zero_velocity", "zero_angle"])
def test_every_column_of_h_is_what_perturbation_gives(kind):
    """1 m, 1 m/s, 1 mrad, 1 mrad/s; what is left is curvature: v / R, lever / R, phi^2."""
    sizes = np.repeat([1.0, 1.0, 1e-3, 1e-3, 1e-2], 3)
    H = taken(kind, np.zeros(15)).H
    for j, size in enumerate(sizes):
        x = np.zeros(15)
        x[j] = size
        column = (taken(kind, x).z - taken(kind, -x).z) / (2.0 * size)
        # Position turns the axes along which velocity and attitude are compared: v / R = 6e-7.
        assert_allclose(H[:, j], column, rtol=0, atol=3e-6, err_msg=f"state {j}")


@pytest.mark.parametrize("kind", ["position", "velocity", "zero_angle"])
def test_a_filter_that_is_right_finds_nothing(kind):
    assert_allclose(taken(kind, np.zeros(15)).z, 0.0, atol=1e-8)


def test_zero_angle_is_the_error_less_that_of_the_reference():
    """The reference itself 2 mrad wrong: zeta = phi - e, and D says so."""
    phi, e = np.array([1e-3, -2e-3, 3e-3]), np.array([0.0, 2e-3, 0.0])
    nav = wrong(NAV, np.hstack([np.zeros(6), phi, np.zeros(6)]))
    got = ms.zero_angle(nav, rotation.matrix_from_rotvec(-e) @ C_REF, 1e-4)
    assert_allclose(got.z, got.H[:, 6:9] @ phi + got.D @ e, atol=5e-6)


def test_covariances_are_turned_into_north_east_down():
    along_up = np.outer(C_NE[2], C_NE[2])
    got = ms.gnss_position(NAV, POSITION, along_up, LEVER)
    assert_allclose(got.R, np.diag([0.0, 0.0, 1.0]), atol=1e-14)
    sd = np.array([1.0, 2.0, 3.0])
    assert_allclose(ms.zero_velocity(NAV, sd).R, np.diag(sd**2))


def test_noise_of_the_rate_reaches_the_velocity_across_the_lever_arm():
    got = ms.gnss_velocity(NAV, OMEGA, VELOCITY, np.zeros((3, 3)), LEVER, rate_sd=0.01)
    lever_n = C_REF @ LEVER
    assert_allclose(got.R @ lever_n, 0.0, atol=1e-12)
    assert np.trace(got.R) == pytest.approx(2.0 * (0.01 * np.linalg.norm(LEVER)) ** 2)


def test_an_antenna_south_of_the_imu_is_where_it_is():
    level = replace(NAV, quat_nb=np.array([0.0, 0.0, 0.0, 1.0]))
    imu = geodesy.ecef_from_geodetic([NAV.latitude, NAV.longitude, NAV.height])
    got = ms.gnss_position(level, imu, np.eye(3), [-2.0, 0.0, 0.0])
    assert_allclose(got.z, [-2.0, 0.0, 0.0], atol=1e-8)
    assert_array_equal(got.H[:, :3], np.eye(3))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: ms.gnss_position(NAV, [1.0, 2.0], np.eye(3), LEVER), "shape"),
        (lambda: ms.gnss_position(NAV, POSITION * np.nan, np.eye(3), LEVER), "not finite"),
        (lambda: ms.gnss_velocity(NAV, OMEGA, VELOCITY, np.eye(2), LEVER), "covariance"),
        (lambda: ms.gnss_velocity(NAV, [np.nan] * 3, VELOCITY, np.eye(3), LEVER), "rate"),
        (lambda: ms.zero_velocity(NAV, 0.0), "positive"),
        (lambda: ms.zero_angle(NAV, np.ones((3, 3)), 0.1), "rotation"),
    ],
)
def test_bad_input_is_refused(call, message):
    with pytest.raises(InputError, match=message):
        call()
