"""A vehicle's kinematics against finite differences, its road against the ellipsoid."""

import time

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad, solve_ivp
from scipy.spatial.transform import Rotation

from deepseis_core.geodesy import (
    ecef_from_enu,
    ecef_from_geodetic,
    geodetic_from_ecef,
    rotation_enu_ecef,
)
from deepseis_sim.road import PEAK, Bend, bend_of, smooth_ramp, trace, turning_loop
from deepseis_sim.speed_programme import Stretch, plan_speed
from deepseis_sim.vehicle_path import Ride, lay_road, vehicle_motion, vibration_lines

ORIGIN = (np.radians(38.7), np.radians(141.0), 40.0)
BENDS = [Bend(150.0), bend_of(1.2, 40.0), Bend(60.0), bend_of(-0.8, 60.0), Bend(300.0)]


def ride_along(bends=BENDS, *, speed=15.0, stops=(), **ride):
    settings = Ride(**ride)
    road = lay_road(bends, 0.4, lambda d, p: 0.04 * d + 2.0 * np.sin(d / 80.0), ORIGIN)
    lengths = np.diff(road.arc(np.cumsum([b.length for b in bends])), prepend=0.0)
    stretches = [
        Stretch(
            float(length),
            min(speed, np.sqrt(2.5 / b.peak_curvature)) if b.turn else speed,
            7.0 if k in stops else 0.0,
        )
        for k, (length, b) in enumerate(zip(lengths, bends, strict=True))
    ]
    programme = plan_speed(stretches, settings.acceleration, 5.0)
    return vehicle_motion(road, programme, settings, ORIGIN, 3)


@pytest.fixture(scope="module")
def motion():
    return ride_along([*BENDS, *turning_loop(9.0), Bend(50.0)], stops=(2, 4))


@pytest.fixture(scope="module")
def times(motion):
    return np.linspace(-3.0, motion.span[1] + 3.0, 30001)


def difference(motion, times, what, h=1e-4):
    return (getattr(motion.at(times + h), what) - getattr(motion.at(times - h), what)) / (2.0 * h)


def test_ramp_is_the_integral_of_its_weight():
    for u in (0.1, 0.37, 0.9):
        assert_allclose(smooth_ramp(u), quad(lambda x: PEAK * np.sin(np.pi * x) ** 4, 0, u)[0])


def test_traced_curve_is_the_integral_of_its_curvature():
    bends = [Bend(30.0), bend_of(1.0, 25.0), bend_of(-2.0, 30.0)]
    ends = np.cumsum([b.length for b in bends])

    def slope(s, state):
        k = min(int(np.searchsorted(ends, s, side="right")), 2)
        u = (s - ends[k] + bends[k].length) / bends[k].length
        bent = PEAK * np.sin(np.pi * u) ** 4 * bends[k].turn / bends[k].length
        return [np.cos(state[2]), np.sin(state[2]), bent]

    solved = solve_ivp(slope, (0.0, ends[-1]), [0, 0, 0.3], rtol=1e-10, atol=1e-10, max_step=1.0)
    assert_allclose(trace(bends, 0.3)[1][-1], solved.y[:2, -1], atol=1e-7)


def test_turning_loop_comes_back_the_other_way():
    loop = turning_loop(9.0)
    assert_allclose(sum(b.turn for b in loop), np.pi, rtol=1e-12)
    assert_allclose(trace(loop)[1][-1], 0.0, atol=1e-8)
    assert min(1.0 / b.peak_curvature for b in loop) == pytest.approx(9.0)


def test_velocity_and_acceleration_are_derivatives(motion, times):
    # h^2/6 times the third derivative: jerk below 30 m/s^3, its second derivative (vibration at
    # 15 Hz) below 3e3 m/s^5.
    at = motion.at(times)
    assert_allclose(difference(motion, times, "position"), at.velocity, atol=3e-7)
    assert_allclose(difference(motion, times, "velocity"), at.acceleration, atol=1e-5)


def test_angular_rate_is_that_of_the_attitude(motion, times):
    h = 1e-4
    before, after = (Rotation.from_matrix(motion.at(times + d).C_enu_b) for d in (-h, h))
    turned = (before.inv() * after).as_rotvec() / (2.0 * h)
    assert_allclose(turned, motion.at(times).omega_b, atol=1e-6)
    assert np.abs(turned[:, 2]).max() > 0.3  # the loop


def test_attitude_is_orthogonal(motion, times):
    C = motion.at(times).C_enu_b
    assert_allclose(C.transpose(0, 2, 1) @ C, np.broadcast_to(np.eye(3), C.shape), atol=1e-14)
    assert_allclose(np.linalg.det(C), 1.0, atol=1e-14)


def test_acceleration_is_smooth_in_time(motion):
    """Its steps over 1 ms shrink with the step: no edges anywhere, stops included."""
    t = np.arange(0.0, motion.span[1] + 2.0, 1e-3)
    acceleration = motion.at(t).acceleration
    jerk = np.diff(acceleration, axis=0) / 1e-3
    assert np.abs(jerk).max() < 60.0  # vibration: 0.2 m/s^2 at 2 pi 15 Hz is 19 RMS
    assert np.abs(np.diff(jerk, axis=0)).max() < 60.0 * 2.0 * np.pi * 15.0 * 1e-3


def test_body_rests_before_at_stops_and_after(motion):
    begin, end = motion.span
    times = np.array([-100.0, 0.0, begin, end, end + 1.0, end + 1e6])
    at = motion.at(times)
    assert not at.velocity[:3].any()
    assert_allclose(at.velocity, 0.0, atol=1e-12)
    assert_allclose(at.acceleration, 0.0, atol=1e-9)
    assert_allclose(at.omega_b, 0.0, atol=1e-12)
    assert_allclose(at.position[0], 0.0, atol=1e-8)
    stop = motion.programme.arrivals[2] + 3.5
    assert not motion.at(np.array([stop])).velocity.any()


def test_speed_is_that_of_the_programme(times):
    motion = ride_along(stops=(2,), vibration=0.0)
    at = motion.at(times)
    speed = np.linalg.norm(at.velocity, axis=1)
    assert_allclose(speed, motion.programme.at(times)[:, 1], atol=1e-5)  # arc length of the spline
    assert speed.max() == pytest.approx(15.0, abs=1e-4)
    forward = np.einsum("mji,mj->mi", at.C_enu_b, at.velocity)
    assert_allclose(forward[:, 1:], 0.0, atol=1e-12)


def test_accelerations_keep_their_limits(times):
    motion = ride_along(stops=(2,), vibration=0.0)
    at = motion.at(times)
    body = np.einsum("mji,mj->mi", at.C_enu_b, at.acceleration)
    assert np.abs(body[:, 0]).max() == pytest.approx(2.5, abs=1e-3)
    assert np.abs(body[:, 1]).max() <= 2.5 * 1.01  # the radius holds in plan, the curve in space


def test_body_leans_out_of_the_bend_against_the_local_vertical():
    motion = ride_along(vibration=0.0, lean_deg=4.0)
    t = np.linspace(*motion.span, 2001)
    at = motion.at(t)
    origin = ecef_from_geodetic(np.array(ORIGIN))
    place = geodetic_from_ecef(ecef_from_enu(at.position, origin))
    up = np.einsum(
        "ij,mj->mi", rotation_enu_ecef(*ORIGIN[:2]), rotation_enu_ecef(*place[:, :2].T)[:, 2]
    )
    roll = np.arcsin(np.einsum("mi,mi->m", at.C_enu_b[:, :, 1], up))
    left = np.einsum("mi,mi->m", at.C_enu_b[:, :, 1], at.acceleration)
    assert np.abs(roll).max() > np.radians(0.8)
    # roll and acceleration are taken on either side of the lean: 1 - cos(1 deg), and the grade
    assert_allclose(roll, np.radians(4.0) * left / 9.80665, atol=2e-4)


def test_height_is_over_the_ellipsoid_not_the_tangent_plane():
    road = lay_road([Bend(11000.0)], 0.7, lambda d, p: 0.01 * d, ORIGIN)
    points = ecef_from_enu(road.nodes[:, :3], ecef_from_geodetic(np.array(ORIGIN)))
    height = geodetic_from_ecef(points)[:, 2] - ORIGIN[2]
    plan = np.hypot(*road.nodes[:, :2].T)
    assert_allclose(height, 0.01 * plan, atol=1e-7)
    drop = 110.0 - road.nodes[-1, 2]
    assert drop == pytest.approx(11000.0**2 / (2.0 * 6.372e6), rel=3e-3)  # d^2/2R: 9.5 m


def test_arc_length_is_that_of_the_curve_in_space():
    road = lay_road([Bend(1000.0)], 0.0, lambda d, p: 0.05 * d, ORIGIN)
    assert road.length == pytest.approx(1000.0 * np.hypot(1.0, 0.05), rel=1e-5)
    assert_allclose(np.linalg.norm(road.nodes[:, 3:6], axis=1), 1.0, atol=1e-9)


def test_vibration_has_its_rms_and_band_and_fades():
    lines = vibration_lines(0.3, seed=1)
    t = np.arange(0.0, 400.0, 5e-3)
    wave = np.multiply.outer(t, lines[:, 0])
    heave = -(lines[:, 0] ** 2 * (lines[:, 1] * np.cos(wave) + lines[:, 2] * np.sin(wave)))
    assert np.std(heave.sum(axis=1)) == pytest.approx(0.3, rel=0.01)
    assert lines[:, 0].min() >= 2.0 * np.pi
    assert lines[:, 0].max() <= 30.0 * np.pi
    assert np.hypot(lines[:, 1], lines[:, 2]).max() < 5e-3  # millimetres
    shaken, calm = ride_along(vibration=0.3), ride_along(vibration=0.0)
    fast = np.linspace(shaken.span[0] + 8.0, shaken.span[0] + 10.0, 401)
    slow = np.linspace(shaken.span[0], shaken.span[0] + 2.0, 401)
    rms = [
        np.std(shaken.at(t).acceleration[:, 2] - calm.at(t).acceleration[:, 2])
        for t in (fast, slow)
    ]
    assert 0.1 < rms[0] < 0.4
    assert rms[1] < 0.02


@pytest.mark.parametrize("length", [3.0, 40.0, 400.0])
def test_programme_covers_every_stretch_within_its_limits(length):
    slow, last = Stretch(20.0, 5.0), Stretch(50.0, 9.0)
    stretches = [Stretch(length, 15.0), slow, Stretch(length, 12.0, 4.0), last]
    programme = plan_speed(stretches, 2.0, 1.0)
    ends = np.cumsum([s.length for s in stretches])
    at_ends = programme.at(programme.arrivals)
    assert_allclose(at_ends[:, 0], ends, atol=1e-9)
    assert_allclose(at_ends[[2, 3], 1], 0.0, atol=1e-9)
    t = np.linspace(0.0, programme.span[1] + 1.0, 20001)
    distance, speed, acceleration, _ = programme.at(t).T
    limit = np.array([s.speed for s in stretches])[np.minimum(np.searchsorted(ends, distance), 3)]
    assert (speed <= limit + 1e-6).all()
    assert (speed >= -1e-12).all()
    assert np.abs(acceleration).max() <= 2.0 + 1e-9
    assert_allclose(np.gradient(distance, t), speed, atol=1e-3)


def test_order_of_the_times_changes_nothing(motion):
    t = np.random.default_rng(1).uniform(-5.0, motion.span[1] + 5.0, 1000)
    whole, order = motion.at(t), np.argsort(t)
    sorted_ = motion.at(t[order])
    for name in ("position", "velocity", "acceleration", "C_enu_b", "omega_b"):
        assert np.array_equal(getattr(whole, name)[order], getattr(sorted_, name))


def test_a_million_points_take_seconds_at_most(motion):
    t = np.linspace(0.0, motion.span[1], 100_000)
    motion.at(t[:10])
    begin = time.perf_counter()
    motion.at(t)
    assert time.perf_counter() - begin < 1.0  # 0.1 s on an idle core
