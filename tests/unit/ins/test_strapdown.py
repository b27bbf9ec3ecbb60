"""The mechanisation against the bench, an integrator in ECEF, and the theory of its drifts."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from deepseis_core import geodesy, rotation
from deepseis_core.constants import WGS84_A, WGS84_B, WGS84_EARTH_RATE, WGS84_GM
from deepseis_core.errors import InputError
from deepseis_ins import strapdown_kernels
from deepseis_ins.strapdown import NavState, Strapdown, propagate
from deepseis_sim.drive import Drive
from deepseis_sim.imu import ImuSynthesizer
from deepseis_sim.motion import Kinematics, Surroundings
from deepseis_sim.motions import Circle, Sine, Still
from deepseis_sim.site import Site

EARTH = np.array([0.0, 0.0, WGS84_EARTH_RATE])


class Coning:
    """Axes that circle the vertical at an angle, on top of a motion of the origin."""

    rotates = True
    span = (-1e9, 1e9)

    def __init__(self, angle_deg, f, path):
        self.angle, self.w, self.path = np.radians(angle_deg), 2 * np.pi * f, path

    def at(self, time):
        path = self.path.at(time)
        c, s = np.cos(self.w * time), np.sin(self.w * time)
        C = rotation.matrix_from_rotvec(self.angle * np.stack([c, s, 0 * s], -1))
        tilting, spin = self.w * np.sin(self.angle), self.w * (np.cos(self.angle) - 1)
        omega = np.stack([-tilting * s, tilting * c, spin + 0 * s], -1)
        return Kinematics(path.position, path.velocity, path.acceleration, C, omega)


def mechanise(motion, *, rate_hz, duration, lat_deg=35.0, height=50.0, every=1):
    """Return errors of position (enu), velocity (local enu) and attitude against the motion.

    One of every so many, the last one included.
    """
    site = Site([np.radians(lat_deg), np.radians(139.0), height])
    imu = ImuSynthesizer(motion, site, rate_hz)
    ideal = imu.increments(-1, int(duration * rate_hz) + 1)
    delta_theta, delta_vel = (
        rotation.flu_from_frd(each) for each in (ideal.delta_theta, ideal.delta_vel)
    )
    truth = motion.at(ideal.time_end[::every])
    quat = rotation.quat_from_matrix(rotation.ned_frd_from_enu_flu(truth.C_enu_b))
    quat = np.broadcast_to(quat, (truth.position.shape[0], 4))
    start = NavState(
        *site.origin_geodetic,
        rotation.enu_from_ned(truth.velocity[0]),
        quat[0],
        delta_theta[0],
        delta_vel[0],
        ideal.dt,
    )
    offset = geodesy.geodetic_from_ecef(site.origin_ecef + site.C_e_enu @ truth.position[0])
    start = replace(start, latitude=offset[0], longitude=offset[1], height=offset[2])
    _, ours = propagate(start, delta_theta[1:], delta_vel[1:], ideal.dt)
    kept = slice(every - 1, None, every)
    ecef = geodesy.ecef_from_geodetic(ours.geodetic[kept])
    position = (ecef - site.origin_ecef) @ site.C_e_enu - truth.position[1:]
    velocity = rotation.enu_from_ned(ours.vel_n[kept]) - truth.velocity[1:]
    attitude = rotation.rotvec_from_quat(
        rotation.quat_multiply(ours.quat_nb[kept], rotation.quat_conjugate(quat[1:]))
    )
    return position, velocity, attitude


@pytest.mark.parametrize("lat_deg", [35.0, -85.0])
@pytest.mark.parametrize(("radius", "frequency_hz"), [(0.5, 1.0), (0.12, 2.0)])
@pytest.mark.parametrize(("rate_hz", "limit"), [(100.0, 4e-5), (200.0, 1e-5), (400.0, 4e-6)])
def test_error_free_data_of_2g_give_the_trajectory_back(
    rate_hz, limit, radius, frequency_hz, lat_deg
):
    # The issue asks for 1e-4 m at 200 Hz. What is left there: the second derivative of
    # acceleration, (w T)^3 / 24 of the radius, 0.7 um; the spread of velocity in an interval in
    # v^2 / R, which drifts by (a T)^2 / 24 R t^2 = 0.9 um down and tan(latitude) as much north;
    # and the rounding of the longitude, 1 um.
    motion = Circle(radius=radius, frequency_hz=frequency_hz, start=0.0, duration=120.0)
    position, velocity, attitude = mechanise(
        motion, rate_hz=rate_hz, duration=120.0, lat_deg=lat_deg
    )
    assert np.abs(position).max() < limit
    # Local axes turn against those of the site by radius / 6.4e6 m (times tan of the latitude).
    turn = 2 * radius / 6.35e6 * max(1.0, abs(np.tan(np.radians(lat_deg))))
    assert np.abs(velocity).max() < turn * 4.0 + 1e-7
    assert np.abs(attitude).max() < turn


def test_shaking_upwards_comes_back_too():
    motion = Sine(amplitude=0.5, frequency_hz=1.0, elevation_deg=90.0, start=0.0, duration=60.0)
    position, _, _ = mechanise(motion, rate_hz=200.0, duration=60.0)
    assert np.abs(position).max() < 2e-6


def test_a_drive_through_a_town_comes_back():
    origin = (float(np.radians(35.0)), float(np.radians(139.0)), 50.0)
    motion = Drive(start=2.0, duration=60.0).build(Surroundings(origin, 65.0))
    position, _, _ = mechanise(motion, rate_hz=200.0, duration=65.0)
    # Over some hundred metres with bends, hills and vibration, 10 um as on the table.
    assert np.abs(motion.at(np.array([65.0])).position).max() > 100.0
    assert np.abs(position).max() < 1e-5


def test_coning_errors_shrink_with_the_fourth_power_of_the_interval():
    # 1 degree at 5 Hz while shaken at 2 g. The two-sample formula leaves (w T)^4 / 30 of the
    # coning rate w angle^2 / 2: 1e-7 rad/s at 200 Hz, about the cone's axis.
    motion = Coning(1.0, 5.0, Circle(radius=0.5, frequency_hz=1.0, start=0.0, duration=60.0))
    position, attitude = {}, {}
    for rate_hz in (100.0, 200.0, 400.0):
        p, _, a = mechanise(motion, rate_hz=rate_hz, duration=60.0)
        position[rate_hz], attitude[rate_hz] = np.abs(p).max(), np.abs(a[:, 2]).max()
    coning = 10 * np.pi * np.radians(1.0) ** 2 / 2 * 60
    expected = (10 * np.pi / 200) ** 4 / 30 * coning
    assert_allclose(attitude[200.0], expected, rtol=0.02)
    assert_allclose(attitude[100.0] / attitude[200.0], 16.0, rtol=0.05)
    assert position[200.0] < 3e-4
    assert position[400.0] < position[200.0] / 8


@pytest.mark.parametrize("lat_deg", [0.0, 35.0, 85.0])
def test_an_hour_at_rest_stays_at_rest(lat_deg):
    position, velocity, attitude = mechanise(
        Still(heading_deg=30.0, pitch_deg=5.0, roll_deg=3.0),
        rate_hz=200.0,
        duration=3600.0,
        lat_deg=lat_deg,
        every=100,
    )
    # The vertical channel multiplies an error of 5e-13 m/s^2 (square of the Earth's turn in an
    # interval, 2e-13 g) by cosh(t sqrt(2 g / R)) R / 2g = 1e8 s^2.
    assert np.abs(position[:, :2]).max() < 1e-5
    assert np.abs(position[:, 2]).max() < 1e-4
    assert np.abs(velocity).max() < 3e-7
    assert np.abs(attitude).max() < 1e-11


def test_a_tilt_swings_with_the_period_of_schuler():
    # On the equator the attitude's error turns with the Earth, from east into down, which is
    # all that becomes of it there; the platform swings about it: x'' + ws^2 x = -g psi(t).
    tilt, dt = 1e-5, 0.1
    gravity, radius = geodesy.normal_gravity(0.0), geodesy.meridian_radius(0.0)
    ws = np.sqrt(gravity / radius)
    assert_allclose(2 * np.pi / ws / 60, 84.4, rtol=0.005)
    time = np.arange(1, round(2 * np.pi / ws / dt)) * dt
    start = NavState(0.0, 0.3, 0.0, np.zeros(3), rotation.quat_from_rotvec([0.0, tilt, 0.0]))
    turned = np.tile([WGS84_EARTH_RATE * dt, 0.0, 0.0], (time.size, 1))
    lifted = np.tile([0.0, 0.0, -gravity * dt], (time.size, 1))
    _, ours = propagate(start, turned, lifted, dt)
    # Nose up, what holds the body up seems to push it backwards.
    swing = np.cos(WGS84_EARTH_RATE * time) - np.cos(ws * time)
    expected = -tilt * radius * swing / (1 - (WGS84_EARTH_RATE / ws) ** 2)
    # The height, unstable, is 0.6 m off by then (g tilt^2 / 2), and its Coriolis force swings.
    assert_allclose(ours.geodetic[:, 0] * radius, expected, rtol=0, atol=1e-3 * tilt * radius)


# An integrator in ECEF, with gravity in closed form


def normal_gravity_ecef(point):
    """Gradient of the level ellipsoid's potential, closed form (NIMA TR8350.2, chapter 4)."""
    x, y, z = point
    e2 = WGS84_A**2 - WGS84_B**2
    e = np.sqrt(e2)
    excess = x * x + y * y + z * z - e2
    u2 = excess / 2 + np.sqrt(excess**2 / 4 + e2 * z * z)
    u, v = np.sqrt(u2), np.sqrt(u2 + e2)
    beta, lon = np.arctan2(z * v, u * np.hypot(x, y)), np.arctan2(y, x)
    s, c = np.sin(beta), np.cos(beta)
    w = np.sqrt((u2 + e2 * s * s) / (u2 + e2))

    def q(b):
        return ((1 + 3 * b * b / e2) * np.arctan(e / b) - 3 * b / e) / 2

    slope = 3 * (1 + u2 / e2) * (1 - u / e * np.arctan(e / u)) - 1
    factor = WGS84_EARTH_RATE**2 * WGS84_A**2 / q(WGS84_B)
    along_u = -(WGS84_GM + factor * e * slope * (s * s / 2 - 1 / 6)) / (u2 + e2) / w
    along_beta = factor * q(u) / v * s * c / w
    level = u / (w * v) * c * along_u - s / w * along_beta
    down = np.array([level * np.cos(lon), level * np.sin(lon), 0.0])
    down[2] = s / w * along_u + u / (w * v) * c * along_beta
    return down + WGS84_EARTH_RATE**2 * np.array([x, y, 0.0])


class ShakenFlight:
    """Specific force and rate of a body as sines of time, and their integrals."""

    def __init__(self, up):
        self.mean = np.array([[0.0, 0.0, -up], [0.0, 0.0, 0.0]])
        self.amplitude = np.array([[12.0, -7.0, 5.0], [0.3, 0.2, -0.15]])
        self.w = 2 * np.pi * np.array([[0.8, 1.1, 0.5], [0.9, 0.6, 1.3]])
        self.phase = np.array([[0.0, 1.0, 2.0], [0.5, 1.5, 2.5]])

    def at(self, t):
        return self.mean + self.amplitude * np.cos(self.w * t + self.phase)

    def increments(self, time):
        angle = self.w * time[:, None, None] + self.phase
        sums = self.mean * time[:, None, None] + self.amplitude / self.w * np.sin(angle)
        return np.moveaxis(np.diff(sums, axis=0), 1, 0)


def fly_in_ecef(flight, geodetic, vel_n, quat_nb, duration):
    """Integrate the equations of motion in ECEF; return position, velocity, C_eb at the end."""
    origin = geodesy.ecef_from_geodetic(geodetic)
    C_en = geodesy.rotation_ned_ecef(*geodetic[:2]).T

    def slope(t, y):
        force, rate = flight.at(t)
        velocity, C = y[3:6], y[6:].reshape(3, 3)
        pull = normal_gravity_ecef(origin + y[:3])
        acceleration = C @ force - 2 * np.cross(EARTH, velocity) + pull
        turned = C @ rotation.skew(rate) - rotation.skew(EARTH) @ C
        return np.concatenate([velocity, acceleration, turned.ravel()])

    C_eb = C_en @ rotation.matrix_from_quat(quat_nb)
    y = np.concatenate([np.zeros(3), C_en @ vel_n, C_eb.ravel()])
    end = solve_ivp(slope, (0, duration), y, method="DOP853", rtol=1e-12, atol=1e-9).y[:, -1]
    return origin + end[:3], end[3:6], end[6:].reshape(3, 3)


@pytest.mark.parametrize("lat_deg", [2.0, -45.0, 85.0])
def test_a_shaken_turning_flight_agrees_with_integration_in_ecef(lat_deg):
    # Over 5 km; Coriolis alone moves it by 10 m. Force up is such that it stays within 50 m of
    # the ellipsoid: the plumb line's curvature, 8e-9 1/s^2 h sin(2 lat), is not mechanised.
    duration, rate_hz = 30.0, 500.0
    geodetic, vel_n = np.array([np.radians(lat_deg), 2.0, 0.0]), np.array([150.0, -120.0, 1.0])
    quat = rotation.quat_from_euler([0.1, -0.2, 2.0])
    flight = ShakenFlight(10.152)
    position, velocity, C_eb = fly_in_ecef(flight, geodetic, vel_n, quat, duration)
    time = np.arange(-1, round(duration * rate_hz) + 1) / rate_hz
    delta_vel, delta_theta = flight.increments(time)
    start = NavState(*geodetic, vel_n, quat, delta_theta[0], delta_vel[0], 1 / rate_hz)
    end, _ = propagate(start, delta_theta[1:], delta_vel[1:], 1 / rate_hz)
    assert abs(end.height) < 50.0
    ours = np.array([end.latitude, end.longitude, end.height])
    C_en = geodesy.rotation_ned_ecef(*ours[:2]).T
    C_nb = rotation.matrix_from_quat(end.quat_nb)
    assert_allclose(geodesy.ecef_from_geodetic(ours), position, rtol=0, atol=2e-5)
    assert_allclose(C_en @ end.vel_n, velocity, rtol=0, atol=3e-6)
    assert_allclose(Rotation.from_matrix(C_en @ C_nb @ C_eb.T).as_rotvec(), 0.0, atol=1e-9)


def random_increments(count):
    rng = np.random.default_rng(7)
    return rng.normal(0, 1e-3, (count, 3)), rng.normal([0, 0, -0.05], 0.02, (count, 3))


def somewhere():
    quat = rotation.quat_from_euler([0.3, -0.1, 2.0])
    return NavState(0.6, 2.4, 50.0, np.array([1.0, -2.0, 0.3]), quat)


def test_any_cut_gives_the_same_bytes_and_single_steps_do():
    delta_theta, delta_vel = random_increments(60)
    end, whole = propagate(somewhere(), delta_theta, delta_vel, 0.005)
    strapdown = Strapdown(somewhere())
    strapdown.propagate(delta_theta[:23], delta_vel[:23], 0.005)
    strapdown.state = strapdown.state
    for k in range(23, 40):
        strapdown.step(delta_theta[k], delta_vel[k], 0.005)
    rest = strapdown.propagate(delta_theta[40:], delta_vel[40:], np.full(20, 0.005))
    assert_array_equal(rest.geodetic, whole.geodetic[40:])
    assert_array_equal(rest.vel_n, whole.vel_n[40:])
    assert_array_equal(rest.quat_nb, whole.quat_nb[40:])
    assert_array_equal(whole.quat_nb[-1], end.quat_nb)
    assert_array_equal(end.previous_delta_vel_b, delta_vel[-1])
    assert end.previous_dt == 0.005


def test_intervals_of_changing_length_are_as_good_as_equal_ones():
    motion = Circle(radius=0.5, frequency_hz=1.0, start=0.0, duration=10.0)
    site = Site([0.6, 2.4, 50.0])
    fine = ImuSynthesizer(motion, site, 1000.0).increments(0, 10000)
    lengths = np.tile([3, 7, 5, 5, 4, 6], 10000 // 30 + 1)
    edges = np.concatenate([[0], np.cumsum(lengths)])
    edges = edges[edges < 10000]
    sums = [
        rotation.flu_from_frd(np.add.reduceat(each, edges[:-1], axis=0)[:-1])
        for each in (fine.delta_theta, fine.delta_vel)
    ]
    C_nb = rotation.ned_frd_from_enu_flu(np.eye(3))
    start = NavState(*site.origin_geodetic, np.zeros(3), rotation.quat_from_matrix(C_nb))
    _, ours = propagate(start, *sums, np.diff(edges[:-1]) / 1000)
    ecef = geodesy.ecef_from_geodetic(ours.geodetic)
    enu = (ecef - site.origin_ecef) @ site.C_e_enu
    truth = motion.at(edges[1:-1] / 1000).position
    assert_allclose(enu, truth, rtol=0, atol=1e-5)


def test_the_kernels_earth_is_geodesys():
    for lat in np.linspace(-np.pi / 2, np.pi / 2, 7):
        meridian, transverse, gravity = strapdown_kernels.earth_kernel(np.sin(lat), 1234.0)
        assert_allclose(meridian, geodesy.meridian_radius(lat) + 1234.0, rtol=1e-15)
        assert_allclose(transverse, geodesy.transverse_radius(lat) + 1234.0, rtol=1e-15)
        assert_allclose(gravity, geodesy.normal_gravity(lat, 1234.0), rtol=1e-15)


def test_the_quaternion_keeps_its_length():
    delta_theta, delta_vel = random_increments(20000)
    end, _ = propagate(somewhere(), 30 * delta_theta, delta_vel, 0.005)
    assert_allclose(np.linalg.norm(end.quat_nb), 1.0, rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"latitude": 1.6}, "pole"),
        ({"height": np.nan}, "finite"),
        ({"vel_n": np.zeros(2)}, "finite"),
        ({"quat_nb": np.zeros(4)}, "length 0"),
    ],
)
def test_states_that_are_none_are_refused(change, message):
    with pytest.raises(InputError, match=message):
        Strapdown(replace(somewhere(), **change))


@pytest.mark.parametrize(
    ("delta_theta", "delta_vel", "dt", "message"),
    [
        (np.zeros((2, 3)), np.zeros((3, 3)), 0.005, "of angle"),
        (np.zeros(3), np.zeros(3), 0.005, "shape"),
        (np.zeros((2, 3)), np.full((2, 3), np.nan), 0.005, "finite"),
        (np.zeros((2, 3)), np.zeros((2, 3)), 0.0, "positive"),
        (np.zeros((2, 3)), np.zeros((2, 3)), [0.005, np.nan], "positive"),
        (np.zeros((2, 3)), np.zeros((2, 3)), [0.005] * 3, "one, or 2"),
    ],
)
def test_bad_increments_are_refused_and_leave_the_state_alone(delta_theta, delta_vel, dt, message):
    strapdown = Strapdown(somewhere())
    with pytest.raises(InputError, match=message):
        strapdown.propagate(delta_theta, delta_vel, dt)
    assert strapdown.state.height == 50.0
    assert strapdown.propagate(np.zeros((0, 3)), np.zeros((0, 3)), 0.005).vel_n.shape == (0, 3)
