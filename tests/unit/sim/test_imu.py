"""Increments against inertial-frame kinematics, closed-form gravity, and their own sums."""

import itertools

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from deepseis_core import geodesy
from deepseis_core.constants import WGS84_A, WGS84_B, WGS84_EARTH_RATE, WGS84_GM
from deepseis_core.errors import InputError
from deepseis_sim.imu import ImuSynthesizer
from deepseis_sim.motion import Kinematics
from deepseis_sim.motions import Circle, Still
from deepseis_sim.site import Site

TOKYO = Site(np.radians([35.7, 139.8, 0.0]))


class Tumble:
    """Coning at f Hz about the vertical and, in closed form, shaking along three axes."""

    rotates = True
    span = (-1e9, 1e9)

    def __init__(self, angle=0.2, f=1.3, amplitude=(0.3, -0.2, 0.1)):
        self.angle, self.w, self.amplitude = angle, 2 * np.pi * f, np.array(amplitude)

    def position(self, time):
        """Evaluate in the precision of ``time``."""
        return self.amplitude * np.sin(self.w * time[..., None] * [1, 2, 3] + [0, 1, 2])

    def rotvec(self, time):
        return self.angle * np.stack([np.cos(self.w * time), np.sin(self.w * time), 0 * time], -1)

    def at(self, time):
        w = self.w * np.array([1, 2, 3])
        phase = time[:, None] * w + [0, 1, 2]
        c, s = np.cos(self.w * time), np.sin(self.w * time)
        tilting = self.w * np.sin(self.angle)
        spin = self.w * (np.cos(self.angle) - 1) + 0 * time
        return Kinematics(
            self.amplitude * np.sin(phase),
            self.amplitude * w * np.cos(phase),
            -self.amplitude * w**2 * np.sin(phase),
            Rotation.from_rotvec(self.rotvec(time)).as_matrix(),
            np.stack([-tilting * s, tilting * c, spin], -1),
        )


class Displaced(Still):
    """At rest far from the origin of the tangent frame."""

    def at(self, time):
        position = np.tile([20e3, -30e3, 500.0], (time.size, 1))
        return Kinematics(position, 0 * position, 0 * position)


def normal_gravitation(point):
    """Attraction of the level ellipsoid from its closed potential, no series, no Somigliana.

    NIMA TR8350.2, equations 4-5 to 4-16, without the centrifugal terms; ECEF [m, m/s^2].
    """
    x, y, z = point
    e2 = WGS84_A**2 - WGS84_B**2
    e = np.sqrt(e2)
    excess = x * x + y * y + z * z - e2
    u2 = excess / 2 + np.sqrt(excess**2 / 4 + e2 * z * z)
    u, v = np.sqrt(u2), np.sqrt(u2 + e2)
    beta = np.arctan2(z * v, u * np.hypot(x, y))
    s, c = np.sin(beta), np.cos(beta)
    w = np.sqrt((u2 + e2 * s * s) / (u2 + e2))

    def q(b):
        return ((1 + 3 * b * b / e2) * np.arctan(e / b) - 3 * b / e) / 2

    slope = 3 * (1 + u2 / e2) * (1 - u / e * np.arctan(e / u)) - 1
    factor = WGS84_EARTH_RATE**2 * WGS84_A**2 / q(WGS84_B)
    along_u = -(WGS84_GM + factor * e * slope * (s * s / 2 - 1 / 6)) / (u2 + e2) / w
    along_beta = factor * q(u) / v * s * c / w
    level = u / (w * v) * c * along_u - s / w * along_beta
    lon = np.arctan2(y, x)
    height = s / w * along_u + u / (w * v) * c * along_beta
    return np.array([level * np.cos(lon), level * np.sin(lon), height])


def inertial_force_and_rate(motion, site, t):
    """Return specific force and rate, body axes, by differentiating in an inertial frame.

    Stencils of sixth order in extended precision: 6e6 m carry 4e-13 m, over steps of 4 ms
    1e-7 m/s^2; truncation (w h)^6 / 560 of 60 m/s^2 is less.
    """
    step, long = np.longdouble(2.0**-8), np.longdouble
    times = long(t) + step * np.arange(-3, 4)
    angle = long(WGS84_EARTH_RATE) * times
    c, s, zero = np.cos(angle), np.sin(angle), 0 * angle
    turn = np.stack([np.stack([c, -s, zero], -1), np.stack([s, c, zero], -1)], -2)
    turn = np.concatenate([turn, np.broadcast_to([[[0, 0, 1]]], (7, 1, 3))], axis=1)
    ecef = site.origin_ecef + np.einsum(
        "ij,mj->mi", site.C_e_enu.astype(long), motion.position(times)
    )
    inertial = np.einsum("mij,mj->mi", turn, ecef)
    second = np.array([2, -27, 270, -490, 270, -27, 2]) / (180 * step**2)
    first = np.array([-1, 9, -45, 0, 45, -9, 1]) / (60 * step)
    acceleration = (second @ inertial).astype(float)
    C_enu_b = Rotation.from_rotvec(motion.rotvec(times.astype(float))).as_matrix()
    C_ib = turn.astype(float) @ site.C_e_enu @ C_enu_b
    now = C_ib[3]
    gravitation = turn[3].astype(float) @ normal_gravitation(ecef[3].astype(float))
    spin = now.T @ np.einsum("m,mij->ij", first.astype(float), C_ib)
    return now.T @ (acceleration - gravitation), np.array([spin[2, 1], spin[0, 2], spin[1, 0]])


@pytest.mark.skipif(np.finfo(np.longdouble).eps > 1e-18, reason="no extended precision here")
def test_increments_of_a_tumbling_body_are_integrals_of_inertial_kinematics():
    motion, imu = Tumble(), ImuSynthesizer(Tumble(), TOKYO, 100.0)
    node, weight = np.polynomial.legendre.leggauss(4)
    for k in (0, 17, 54, 377):
        ours = imu.increments(k, 1)
        values = [inertial_force_and_rate(motion, TOKYO, (k + 0.5 + 0.5 * x) / 100) for x in node]
        force, rate = (
            np.average(each, axis=0, weights=weight) for each in zip(*values, strict=True)
        )
        # Noise of the differences, for a Coriolis acceleration of 7e-4 m/s^2. In a height of
        # 0.1 m the plumb line leaves the ellipsoid's normal by 1e-9 m/s^2.
        assert_allclose(ours.delta_vel[0] * 100, force, rtol=0, atol=1e-6)
        # Truncation (w h)^6 / 140 of 1.6 rad/s.
        assert_allclose(ours.delta_theta[0] * 100, rate, rtol=0, atol=1e-9)


@pytest.mark.parametrize("lat_deg", [0.0, 45.0, -90.0])
def test_at_rest_it_feels_normal_gravity_and_the_earths_rate(lat_deg):
    lat = np.radians(lat_deg)
    imu = ImuSynthesizer(Still(), Site([lat, 1.0, 0.0]), 200.0)  # forward is east
    one = imu.increments(1234, 1)
    # NIMA TR8350.2, table 3.4 and equation 4-1.
    gravity = {0.0: 9.7803253359, 45.0: 9.8061977695, -90.0: 9.8321849379}[lat_deg]
    assert_allclose(one.delta_vel[0] * 200, [0, 0, gravity], rtol=0, atol=1e-9)
    rate = 7.292115e-5 * np.array([0.0, np.cos(lat), np.sin(lat)])
    assert_allclose(one.delta_theta[0] * 200, rate, rtol=0, atol=1e-18)
    assert one.time_end[0] == 1235 / 200
    assert one.dt == 1 / 200


def test_gravity_points_along_the_normal_where_the_body_is():
    imu = ImuSynthesizer(Displaced(), TOKYO, 100.0)
    point = geodesy.ecef_from_enu([20e3, -30e3, 500.0], TOKYO.origin_ecef)
    lat, lon, height = geodesy.geodetic_from_ecef(point)
    up = TOKYO.C_e_enu.T @ geodesy.rotation_enu_ecef(lat, lon)[2]
    expected = up * geodesy.normal_gravity(lat, height)
    assert np.abs(up[:2]).min() > 3e-3
    assert_allclose(imu.increments(0, 1).delta_vel[0] * 100, expected, rtol=0, atol=1e-12)


def test_excess_gravity_is_felt_upwards_where_the_body_is():
    def anomaly(position):
        return 1e-3 + 1e-6 * position[:, 0]

    plain = ImuSynthesizer(Displaced(), TOKYO, 100.0).increments(5, 3)
    more = ImuSynthesizer(Displaced(), TOKYO, 100.0, gravity=anomaly).increments(5, 3)
    up = plain.delta_vel / np.linalg.norm(plain.delta_vel, axis=1, keepdims=True)
    gained = (more.delta_vel - plain.delta_vel) * 100
    assert_allclose(gained, 21e-3 * up, rtol=0, atol=1e-12)


@pytest.mark.parametrize("motion", [Circle(start=0.3, duration=5.0), Tumble()])
@pytest.mark.parametrize("clock", [None, lambda t: 2e-6 * t + 1e-7 * np.sin(t)])
def test_any_chunking_gives_the_same_bytes(motion, clock):
    imu = ImuSynthesizer(motion, TOKYO, 333.0, clock=clock)
    whole = imu.increments(-7, 400)
    cuts = [-7, -6, 0, 1, 4, 9, 26, 131, 132, 393]
    parts = [imu.increments(a, b - a) for a, b in itertools.pairwise(cuts)]
    for name in ("time_end", "delta_theta", "delta_vel"):
        joined = np.concatenate([getattr(part, name) for part in parts])
        assert_array_equal(joined, getattr(whole, name))


@pytest.mark.parametrize(
    ("motion", "atol"),
    # Turning at 2.6 rad/s, 50 Hz: 8th order, 1e-12 of 20 m/s^2 x 20 ms; others: rounding.
    [(Circle(start=0.0), 1e-15), (Tumble(), 1e-11)],
)
@pytest.mark.parametrize("rate_hz", [50.0, 200.0])
def test_increments_at_every_rate_sum_up_alike(motion, atol, rate_hz):
    fine = ImuSynthesizer(motion, TOKYO, 1000.0).increments(0, 5000)
    coarse = ImuSynthesizer(motion, TOKYO, rate_hz).increments(0, int(5 * rate_hz))
    ratio = int(1000 / rate_hz)
    for name in ("delta_theta", "delta_vel"):
        sums = getattr(fine, name).reshape(-1, ratio, 3).sum(axis=1)
        assert_allclose(getattr(coarse, name), sums, rtol=0, atol=50 * ratio**0.5 * atol)


def test_shaking_in_a_fixed_attitude_is_integrated_to_rounding():
    motion = Circle(radius=0.5, frequency_hz=1.0, start=0.0, duration=100.0)
    site = Site([0.6, 2.4, 50.0])
    increments = ImuSynthesizer(motion, site, 50.0).increments(0, 1000)
    end = motion.at(np.array([0.0, 20.0]))
    moved, gained = np.diff(end.position, axis=0)[0], np.diff(end.velocity, axis=0)[0]
    earth = WGS84_EARTH_RATE * site.C_e_enu[2]
    lifted = 20.0 * geodesy.normal_gravity(0.6, 50.0)
    total = gained + 2 * np.cross(earth, moved) + [0, 0, lifted]
    # Gravity's direction changes by 0.5 m / 6e6 m on the circle, averaging out over revolutions.
    assert_allclose(increments.delta_vel.sum(axis=0), total, rtol=0, atol=1e-6)


def test_a_clock_that_triggers_the_imu_shifts_and_stretches_its_intervals():
    motion, drift, offset = Circle(start=0.0), 1e-4, 0.002
    perfect = ImuSynthesizer(motion, TOKYO, 1000.0)
    late = ImuSynthesizer(motion, TOKYO, 100.0, clock=lambda t: offset + drift * t)
    ours = late.increments(500, 100)
    assert_allclose(ours.time_end, np.arange(501, 601) / 100, rtol=0, atol=1e-15)
    start, stop = ((1 - drift) * t - offset for t in (5.0, 6.0))
    assert_allclose(
        ours.delta_theta.sum(axis=0) / (stop - start),
        perfect.increments(0, 1).delta_theta[0] * 1000,
        rtol=1e-12,
        atol=0,
    )
    velocity = motion.at(np.array([start, stop])).velocity
    level = ours.delta_vel.sum(axis=0)[:2] - np.diff(velocity, axis=0)[0, :2]
    # What is left is Coriolis: 2 W x 1 m at most.
    assert_allclose(level, 0.0, rtol=0, atol=1.5e-4)


def test_late_samples_are_as_precise_as_early_ones():
    # At 1e5 s a time is rounded to 1.5e-11 s, which would be 3e-9 of an interval.
    imu = ImuSynthesizer(Still(), TOKYO, 200.0, clock=lambda t: 1e-6 * t)
    early, late = imu.increments(0, 1), imu.increments(20_000_000, 1)
    assert_allclose(late.delta_vel, early.delta_vel, rtol=1e-13, atol=1e-17)


@pytest.mark.parametrize("rate_hz", [0.0, -200.0, np.nan, np.inf])
def test_a_rate_that_is_none_is_refused(rate_hz):
    with pytest.raises(InputError, match="rate_hz"):
        ImuSynthesizer(Still(), TOKYO, rate_hz)


def test_no_samples_are_no_samples_and_fewer_are_refused():
    for motion in (Still(), Tumble()):
        imu = ImuSynthesizer(motion, TOKYO, 200.0)
        assert imu.increments(3, 0).delta_vel.shape == (0, 3)
        with pytest.raises(InputError, match="count"):
            imu.increments(3, -1)
