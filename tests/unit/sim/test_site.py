"""From motions to ECEF: against SciPy, pyrtklib, closed forms and finite differences."""

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from deepseis_core.errors import InputError
from deepseis_core.gps_time import GpsTime
from deepseis_core.rotation import matrix_from_rotvec
from deepseis_sim.constellation import visible_satellites
from deepseis_sim.motion import Kinematics, Surroundings
from deepseis_sim.motions import Circle, Offset, Profile, Sine, Still, Tilt, sum_of
from deepseis_sim.nominal_constellation import nominal_constellation
from deepseis_sim.signal_model import SignalModel
from deepseis_sim.site import Site, angular_acceleration, orientation_xyzw

PLACE = (np.deg2rad(38.7292), np.deg2rad(141.0217), 40.0)
AROUND = Surroundings(PLACE, 60.0)
LEVER = np.array([0.4, -0.7, 1.1])
SECOND = {1: 8 / 5, 2: -1 / 5, 3: 8 / 315, 4: -1 / 560}  # weights of the second derivative
FIRST = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}


@dataclass(frozen=True)
class Swing:
    """Turns to and fro about an axis of the body, with a closed form for everything."""

    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    amplitude: float = 0.6
    rate: float = 9.0
    rotates: bool = True
    span: tuple[float, float] = (0.0, np.inf)

    def at(self, time):
        angle = self.amplitude * np.sin(self.rate * time)
        speed = self.amplitude * self.rate * np.cos(self.rate * time)
        C = matrix_from_rotvec(angle[:, None] * np.array(self.axis))
        return Kinematics(*np.zeros((3, time.size, 3)), C, speed[:, None] * np.array(self.axis))


@dataclass(frozen=True)
class Spin:
    """Turns about up for ever."""

    rate: float = 2.0
    rotates: bool = True
    span: tuple[float, float] = (0.0, np.inf)

    def at(self, time):
        about_up = np.outer(time, [0.0, 0.0, self.rate])
        omega = np.broadcast_to([0.0, 0.0, self.rate], (time.size, 3))
        return Kinematics(*np.zeros((3, time.size, 3)), matrix_from_rotvec(about_up), omega)


def differences(function, time, h):
    """Return first and second derivative to eighth order."""
    ahead = {k: (function(time + k * h), function(time - k * h)) for k in FIRST}
    first = sum(w * (ahead[k][0] - ahead[k][1]) for k, w in FIRST.items()) / h
    now = 2.0 * function(time)
    second = sum(w * (sum(ahead[k]) - now) for k, w in SECOND.items()) / h**2
    return first, second


def test_tangent_frame_is_rtklibs():
    pyrtklib = pytest.importorskip("pyrtklib")
    ecef, enu, back = pyrtklib.Arr1Ddouble(3), pyrtklib.Arr1Ddouble(3), pyrtklib.Arr1Ddouble(3)
    place = pyrtklib.Arr1Ddouble(3)
    for k in range(3):
        place[k], enu[k] = PLACE[k], (100.0, -2000.0, 30.0)[k]
    pyrtklib.pos2ecef(place, ecef)
    pyrtklib.enu2ecef(place, enu, back)
    site = Site(PLACE)
    assert_allclose(site.origin_ecef, [ecef[k] for k in range(3)], atol=2e-9)
    offset = np.array([[100.0, -2000.0, 30.0]])
    states = site.ecef(Kinematics(offset, offset, offset))
    expected = [back[k] for k in range(3)]
    assert_allclose(states.position[0] - site.origin_ecef, expected, atol=2e-9)
    assert_allclose(states.velocity[0], expected, rtol=1e-13)
    assert_allclose(states.acceleration[0], expected, rtol=1e-13)


SHAKEN_AND_TILTED = (
    Still(heading_deg=250.0, roll_deg=4.0),
    Circle(start=1.0),
    Tilt(roll_deg=10.0, start=2.0, rise=0.5),
    Tilt(pitch_deg=9.0, start=2.1),
)


@pytest.mark.parametrize(
    "motion",
    [Swing(axis=(0.6, 0.0, 0.8)), sum_of(SHAKEN_AND_TILTED, AROUND)],
    ids=["swing", "circle and tilts"],
)
def test_a_point_off_the_origin_moves_as_its_position_says(motion):
    def point(t):
        now = motion.at(t)
        turned = Rotation.from_matrix(np.broadcast_to(now.C_enu_b, (t.size, 3, 3))).apply(LEVER)
        return now.position + turned

    time, site = np.linspace(0.5, 5.0, 1501), Site(PLACE)
    h = 2.0**-8
    edges = np.array([1.0, 2.0, 2.1, 2.5, 3.0, 4.1])  # where the fifth derivative of a ramp jumps
    time = time[np.abs(time[:, None] - edges).min(axis=1) > 4.1 * h]
    velocity, acceleration = differences(point, time, h)
    states = site.states(motion, time, LEVER)
    assert_allclose(states.velocity @ site.C_e_enu, velocity, atol=1e-9)
    # Rounding of the positions, 2e-16 m / h^2, is 2e-11 m/s^2; the stencil's own error dominates.
    assert_allclose(states.acceleration @ site.C_e_enu, acceleration, atol=1e-6)
    assert_array_equal(states.position, site.trajectory(motion, LEVER)(time))
    assert_allclose(
        (states.position - site.origin_ecef) @ site.C_e_enu, point(time), atol=3e-9
    )  # coordinates of 4e6 m


def test_a_spinning_body_pulls_inwards_only():
    time = np.linspace(0.0, 50.0, 1001)
    states = Site(PLACE).states(Spin(), time, LEVER)
    radius = np.hypot(*LEVER[:2])
    assert_allclose(np.linalg.norm(states.velocity, axis=1), 2.0 * radius, rtol=1e-12)
    assert_allclose(np.linalg.norm(states.acceleration, axis=1), 4.0 * radius, atol=1e-10)


def test_angular_acceleration_of_a_swing_has_a_closed_form():
    swing, time = Swing(), np.linspace(0.0, 3.0, 301) + 1e4
    expected = -0.6 * 81.0 * np.sin(9.0 * time)
    # Rounding of times near 1e4 s (2e-12 s) x 9 rad/s x 49 rad/s^2 is 8e-10.
    assert_allclose(angular_acceleration(swing, time)[:, 2], expected, atol=1e-8)
    assert_array_equal(angular_acceleration(Sine(), time), np.zeros(3))


def test_a_sharp_tilt_is_exact_to_a_micrometre_per_second_squared():
    """10 deg within half a second, the antenna 1 m off, the worst of places: the ramp's edges."""
    tilt = Tilt(pitch_deg=10.0, start=1.0, rise=0.5)
    time = np.sort(np.concatenate([np.linspace(0.99, 1.51, 5201), 1.0 + np.arange(40) * 2.5e-5]))
    x = np.clip((time - 1.0) / 0.5, 0.0, 1.0)
    expected = np.deg2rad(10.0) / 0.5**2 * 2520.0 * (x * (1 - x)) ** 3 * (1 - 2 * x)
    assert_allclose(angular_acceleration(tilt, time)[:, 0], expected, atol=1e-6)


def test_without_rotation_the_lever_arm_only_shifts():
    time, site = np.linspace(0.0, 60.0, 101), Site(PLACE)
    body, antenna = (site.states(Profile(), time, lever) for lever in ((0.0, 0.0, 0.0), LEVER))
    assert_allclose(
        antenna.position - body.position, np.tile(site.C_e_enu @ LEVER, (101, 1)), atol=2e-9
    )
    assert_array_equal(antenna.velocity, body.velocity)
    assert_array_equal(antenna.acceleration, body.acceleration)


def test_a_missing_angular_acceleration_is_not_passed_over():
    site, now = Site(PLACE), Swing().at(np.zeros(1))
    with pytest.raises(ValueError, match=r"Site\.states"):
        site.ecef(now, LEVER)
    assert not np.any(site.ecef(now).acceleration)  # the origin itself needs none


def test_any_cut_gives_the_same_bytes():
    motion = sum_of([Still(heading_deg=77.0), Circle(start=1.0), Tilt(roll_deg=9.0)], AROUND)
    rng, site = np.random.default_rng(3), Site(PLACE)
    time = np.sort(rng.uniform(0.0, 60.0, 1000))
    whole = site.states(motion, time, LEVER)
    cuts = np.sort(rng.choice(1000, 50, replace=False))
    pieces = [site.states(motion, piece, LEVER) for piece in np.split(time, cuts)]
    for part in ("position", "velocity", "acceleration"):
        joined = np.concatenate([getattr(piece, part) for piece in pieces])
        assert_array_equal(joined, getattr(whole, part))


def test_orientation_is_scipys_quaternion_of_continuous_sign():
    time = np.linspace(0.0, 8.0, 801)  # 2.5 turns
    now = Spin().at(time)
    quat = orientation_xyzw(now)
    same = Rotation.from_quat(quat).inv() * Rotation.from_matrix(now.C_enu_b)
    assert same.magnitude().max() < 1e-14
    assert np.linalg.norm(np.diff(quat, axis=0), axis=1).max() < 0.011  # half of 0.02 rad
    assert quat[315, 3] < 0.0  # after one turn it is the opposite quaternion
    before, cut = None, []
    for piece in np.split(time, [1, 2, 300, 301, 500]):
        cut.append(orientation_xyzw(Spin().at(piece), before))
        before = cut[-1][-1]
    assert_array_equal(np.concatenate(cut), quat)


def test_orientation_of_what_does_not_turn_is_one_quaternion():
    now = Still(heading_deg=0.0).at(np.zeros(5))
    assert_allclose(orientation_xyzw(now), [0, 0, np.sqrt(0.5), np.sqrt(0.5)], atol=1e-15)
    assert_array_equal(orientation_xyzw(Offset().at(np.zeros(5))), [0, 0, 0, 1])
    turned = orientation_xyzw(now, previous=np.array([0, 0, -0.7, -0.7]))
    assert_allclose(turned, [0, 0, -np.sqrt(0.5), -np.sqrt(0.5)], atol=1e-15)


def test_the_trajectory_drives_a_signal():
    start, site = GpsTime(2399, 346258 * 10**9), Site(PLACE)
    satellites = visible_satellites(nominal_constellation(start), start, site.origin_ecef)
    sine = Sine(amplitude=0.5, azimuth_deg=0.0, frequency_hz=1.0, start=1.0, duration=9.0)
    time = np.linspace(0.0, 8.0, 81)
    moving = SignalModel(satellites, start, site.trajectory(sine)).delays(time).range
    at_rest = SignalModel(satellites, start, site.trajectory(Still())).delays(time).range
    # Along each line of sight it is the northward displacement times a cosine.
    north = sine.at(time).position[:, 1]
    cosine = north @ (moving - at_rest) / (north @ north)
    assert np.abs(cosine).max() <= 1.0
    assert_allclose(moving - at_rest, np.outer(north, cosine), atol=1e-3)


@pytest.mark.parametrize(
    "origin", [(38.7, 141.0, 40.0), (0.5, 2.0), (np.nan, 0.0, 0.0), (0.5, 2.0, 6.4e6)]
)
def test_a_site_off_the_earth_is_refused(origin):
    with pytest.raises(InputError, match="is no place on Earth"):
        Site(origin)
