"""Motions against their own derivatives, SciPy, and the numbers of the papers."""

import time as clock

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation
from scipy.special import betainc

from deepseis_core.errors import InputError
from deepseis_core.yaml_config import fill, parse_yaml
from deepseis_sim.motion import Surroundings
from deepseis_sim.motions import (
    MOTION_KINDS,
    Circle,
    JerkSegment,
    Offset,
    Profile,
    Sine,
    Still,
    Tilt,
    sum_of,
)
from deepseis_sim.motions_shapes import smooth_step

AROUND = Surroundings((0.6, 2.4, 10.0), 60.0)
G = 9.80665
TWO_TILTS = (Tilt(pitch_deg=40.0, rise=3.0), Tilt(roll_deg=-50.0, heading_deg=30.0, rise=4.0))
MOTIONS = {
    "circle": Circle(duration=20.0),
    "sine": Sine(azimuth_deg=300.0, elevation_deg=20.0, duration=20.0),
    "offset": Offset(east=-1.0, north=2.0, up=0.3),
    "offset and back": Offset(north=0.2, rise=1.0, duration=2.0),
    "profile": Profile(elevation_deg=30.0, start=22.0),
    "sum": sum_of([Still(heading_deg=20.0), Circle(start=21.0), Offset(up=0.1)], AROUND),
}
# Weights of the central first derivative of eighth order, h = 1.
STENCIL = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}


def slope(function, time, h=2.0**-9):
    """Differentiate; h^8/630 of the ninth derivative off, below 1e-9 of 0.5 m at 2 Hz."""
    return (
        sum(w * (function(time + k * h) - function(time - k * h)) for k, w in STENCIL.items()) / h
    )


@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
def test_velocity_and_acceleration_are_the_derivatives(motion):
    time = np.linspace(19.5, 44.0, 5003)
    edges = np.array([22.0, 24.0, 27.0, 29.0])  # of the profile: its jerk jumps there
    time = time[np.abs(time[:, None] - edges).min(axis=1) > 4.1 * 2.0**-9]
    now = motion.at(time)
    scale = np.abs(now.acceleration).max()
    # Where a ramp begins or ends the fifth derivative jumps, and the stencil is off by a few
    # h^4 of that jump: 1e-7 of the acceleration.
    assert_allclose(slope(lambda t: motion.at(t).position, time), now.velocity, atol=1e-7 * scale)
    assert_allclose(
        slope(lambda t: motion.at(t).velocity, time), now.acceleration, atol=2e-6 * scale
    )


@pytest.mark.parametrize(
    ("name", "edge"),
    [(name, edge) for name, motion in MOTIONS.items() for edge in motion.span if edge < 1e9],
)
def test_nothing_jumps_where_it_begins_or_ends(name, edge):
    motion = MOTIONS[name]
    before, after = (motion.at(np.array([edge + side * 1e-7])) for side in (-1, 1))
    # At most what the profile's jerk of 245 m/s^3 makes of 0.1 us.
    assert_allclose(after.position, before.position, atol=1e-12)
    assert_allclose(after.velocity, before.velocity, atol=245 * 1e-14)
    assert_allclose(after.acceleration, before.acceleration, atol=245 * 1.1e-7)


def test_ramps_start_with_zero_jerk_and_snap():
    late = np.array([1e-3, 2e-3])
    acceleration = MOTIONS["offset"].at(20.0 + late).acceleration[:, 1]
    assert_allclose(acceleration[1] / acceleration[0], 8.0, rtol=0.01)  # it grows as t^3


def test_the_step_is_the_incomplete_beta_function():
    x = np.linspace(-0.2, 1.2, 1401)
    value, rate, curve = smooth_step(x)
    assert_allclose(value, betainc(5, 5, np.clip(x, 0, 1)), atol=1e-13)
    assert_allclose(rate[1:-1], np.gradient(value, x)[1:-1], atol=1e-4)
    assert_allclose(curve[1:-1], np.gradient(rate, x)[1:-1], atol=1e-3)
    assert smooth_step(np.array([1.0, 7.0]))[0].tolist() == [1.0, 1.0]


@pytest.mark.parametrize(
    ("radius", "frequency_hz", "acceleration_g", "jerk_g", "printed_jerk_g"),
    [(0.50, 1.0, 2.01, 12.6, 13), (0.12, 2.0, 1.93, 24.3, 25)],
)
def test_circles_of_the_thesis(radius, frequency_hz, acceleration_g, jerk_g, printed_jerk_g):
    """Table 5.1; it prints jerks for exactly 2 g: 12.57 and 25.1."""
    motion = Circle(radius=radius, frequency_hz=frequency_hz, start=10.0, duration=20.0)
    time = np.linspace(12.0, 28.0, 2001)[1:-1]
    now = motion.at(time)
    jerk = slope(lambda t: motion.at(t).acceleration, time)
    assert_allclose(np.linalg.norm(now.position, axis=1), radius, rtol=1e-12)
    assert_allclose(np.linalg.norm(now.acceleration, axis=1) / G, acceleration_g, atol=0.005)
    assert_allclose(np.median(np.linalg.norm(jerk, axis=1)) / G, jerk_g, atol=0.05)
    assert jerk_g * 2.0 / acceleration_g == pytest.approx(printed_jerk_g, abs=0.5)
    whole = motion.at(np.linspace(0.0, 40.0, 40001)).acceleration
    assert np.linalg.norm(whole, axis=1).max() < 1.025 * acceleration_g * G  # in the ramps
    assert motion.span == (10.0, 30.0)
    assert not np.any(motion.at(np.array([-3.0, 0.0, 10.0, 30.0, 1e5])).position)


def test_shake_table_of_the_thesis_reaches_half_a_g():
    now = Sine().at(np.linspace(23.0, 25.0, 4001))
    assert np.abs(now.position).max() == pytest.approx(0.03, rel=1e-5)
    assert np.abs(now.acceleration).max() / G == pytest.approx(0.483, abs=0.001)
    assert not np.any(now.position[:, 2])
    up = Sine(elevation_deg=90.0).at(np.linspace(23.0, 25.0, 401)).position
    assert np.abs(up[:, :2]).max() < 1e-17
    north = Sine(azimuth_deg=0.0).at(np.array([24.0 + 1 / 8])).position[0]
    assert_allclose(north, [0.0, 0.03, 0.0], atol=1e-15)


def test_high_g_profile_of_the_doppler_aided_paper():
    motion = Profile(azimuth_deg=0.0)
    time = np.linspace(25.0, 80.0, 55001)
    now = motion.at(time)
    assert motion.at(np.array([37.0, 80.0])).velocity[:, 1].tolist() == [2450.0, 2450.0]
    assert np.abs(now.acceleration).max() == 490.0
    # The acceleration is piecewise linear: the trapezium is exact for the velocity, and off by
    # h^2/12 of the acceleration's change, here none, for the position.
    acceleration = np.interp(time, [30, 32, 35, 37], [0, 490.0, 490.0, 0])
    velocity = cumulative_trapezoid(acceleration, time, initial=0)
    assert_allclose(now.velocity[:, 1], velocity, atol=1e-8)
    assert_allclose(
        now.position[:, 1], cumulative_trapezoid(velocity, time, initial=0), atol=1e-6 * 490
    )
    assert motion.span == (30.0, np.inf)
    assert Profile(segments=tuple(JerkSegment(1.0, j) for j in (1, -1, -1, 1))).span == (
        30.0,
        34.0,
    )


def test_rounding_leaves_no_acceleration_after_the_last_segment():
    there_and_back = [(0.1, 0.3), (0.3, -0.1), (0.3, -0.1), (0.1, 0.3)]
    profile = Profile(segments=tuple(JerkSegment(d, j) for d, j in there_and_back)).build(AROUND)
    now = profile.at(np.array([40.0, 1e6]))
    assert not np.any(now.acceleration)
    assert not np.any(now.velocity)
    assert profile.span == (30.0, pytest.approx(30.8))


def test_offset_stays_or_goes_back():
    late = np.array([22.0, 1e6])
    assert Offset(east=1.0, up=-2.0).at(late).position.tolist() == [[1.0, 0.0, -2.0]] * 2
    assert not np.any(Offset(east=1.0, duration=10.0).at(np.array([30.0, 1e6])).position)
    assert Offset(east=1.0, duration=10.0).at(np.array([25.0])).position[0, 0] == 1.0
    assert (Offset().span, Offset(duration=9.0).span) == ((20.0, 22.0), (20.0, 29.0))


def test_heading_zero_faces_north_and_angles_are_those_of_an_aeroplane():
    def axes(**angles):
        return Still(**angles).at(np.zeros(1)).C_enu_b.T  # forward, left, up

    assert_array_equal(axes(), np.eye(3))  # the default is the neutral attitude
    assert_allclose(axes(heading_deg=0.0), [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], atol=1e-15)
    assert_allclose(axes(pitch_deg=30.0)[0], [np.cos(np.pi / 6), 0, 0.5], atol=1e-15)
    assert axes(roll_deg=10.0)[1, 2] > 0.17  # right side down: the left one goes up
    # About east-north-up axes: counterclockwise yaw, nose-down pitch, the same roll (REP-103).
    expected = Rotation.from_euler("ZYX", [90 - 200, -7, 12], degrees=True).as_matrix()
    assert_allclose(axes(heading_deg=200.0, pitch_deg=7.0, roll_deg=12.0).T, expected, atol=1e-15)


def test_tilt_turns_about_the_tangent_axes_and_stays():
    tilt = Tilt(pitch_deg=2.0, roll_deg=-1.0, heading_deg=5.0, start=3.0, rise=2.0)
    now = tilt.at(np.array([0.0, 3.0, 4.0, 5.0, 1e6]))
    vector = np.deg2rad([2.0, -1.0, -5.0])
    expected = Rotation.from_rotvec(np.outer([0, 0, 0.5, 1, 1], vector)).as_matrix()
    assert_allclose(now.C_enu_b, expected, atol=1e-15)
    assert not np.any(now.position)
    assert_allclose(now.omega_b[2], vector * 630 / 256 / 2.0)  # steepest in the middle
    east, north = np.eye(3)[:2]
    assert (Tilt(pitch_deg=3.0).at(np.array([30.0])).C_enu_b @ north)[0, 2] > 0.0
    assert (Tilt(roll_deg=3.0).at(np.array([30.0])).C_enu_b @ east)[0, 2] < 0.0
    assert (Tilt(heading_deg=3.0).at(np.array([30.0])).C_enu_b @ north)[0, 0] > 0.0
    assert (tilt.rotates, Tilt().rotates, Tilt().span) == (True, False, (0.0, 0.0))


def test_a_sum_adds_translations_and_multiplies_attitudes_from_the_left():
    body = Still(heading_deg=-40.0, pitch_deg=10.0)
    whole = sum_of(
        [body, MOTIONS["circle"], TWO_TILTS[0], MOTIONS["offset"], TWO_TILTS[1]], AROUND
    )
    time = np.linspace(18.0, 30.0, 1201)
    now, circle, offset = whole.at(time), MOTIONS["circle"].at(time), MOTIONS["offset"].at(time)
    for part in ("position", "velocity", "acceleration"):
        assert_array_equal(getattr(now, part), getattr(circle, part) + getattr(offset, part))
    first, second = (tilt.at(time).C_enu_b for tilt in TWO_TILTS)
    assert_allclose(now.C_enu_b, second @ first @ body.at(time).C_enu_b, atol=1e-15)
    assert (whole.rotates, whole.span) == (True, (20.0, 40.0))


def test_the_rate_of_a_sum_is_that_of_its_attitude():
    whole = sum_of([Still(heading_deg=-40.0, pitch_deg=10.0), *TWO_TILTS], AROUND)
    time, h = np.linspace(19.0, 25.0, 601), 1e-3
    early, late = (Rotation.from_matrix(whole.at(time + s * h).C_enu_b) for s in (-1, 1))
    # Off by h^2/6 of the rate's second derivative, 1e-6 rad/s, at less than 3 rad/s^3.
    expected = (early.inv() * late).as_rotvec() / (2 * h)
    assert_allclose(whole.at(time).omega_b, expected, atol=1e-6)


def test_nothing_is_still_and_one_is_itself():
    nothing = sum_of([], AROUND)
    assert (nothing.rotates, nothing.span) == (False, (0.0, 0.0))
    assert_array_equal(nothing.at(np.zeros(2)).position, np.zeros((2, 3)))
    assert_array_equal(nothing.at(np.zeros(2)).C_enu_b, np.eye(3))
    circle = Circle()
    assert sum_of([circle], AROUND) is circle
    assert sum_of([circle, Still()], AROUND).at(np.zeros(2)).C_enu_b.shape == (3, 3)
    assert sum_of([Profile(), circle], AROUND).span == (20.0, np.inf)


def test_parts_that_are_over_and_come_later_add_nothing():
    circles = [Circle(start=20.0 + 50.0 * k, duration=10.0) for k in range(300)]
    whole, time = sum_of([Offset(east=0.4, start=30.0), *circles], AROUND), np.arange(0, 160, 0.01)
    now = whole.at(time)
    for name in ("position", "velocity", "acceleration"):
        parts = [getattr(part.at(time), name) for part in whole.parts[:5]]
        assert_allclose(getattr(now, name), sum(parts), atol=1e-15)
        # To the sign of zero, however a run is cut.
        pieces = [getattr(whole.at(piece), name) for piece in np.split(time, [700, 2500, 2600])]
        assert np.concatenate(pieces).tobytes() == getattr(now, name).tobytes()


def test_any_order_and_any_cut_give_the_same_bytes():
    whole = sum_of(
        [
            Still(heading_deg=33.0),
            *(MOTIONS[k] for k in ("sine", "offset", "profile")),
            *TWO_TILTS,
        ],
        AROUND,
    )
    rng = np.random.default_rng(5)
    time = rng.uniform(-1.0, 60.0, 1000)
    together = whole.at(time)
    cuts = np.sort(rng.choice(1000, 60, replace=False))
    pieces = [whole.at(piece) for piece in np.split(time, cuts)]
    for part in ("position", "velocity", "acceleration", "C_enu_b", "omega_b"):
        joined = np.concatenate([getattr(piece, part) for piece in pieces])
        assert_array_equal(joined, getattr(together, part))


def test_a_circle_gives_a_million_points_a_second():
    time = np.arange(1_000_000) * 1e-3 % 130.0
    best = np.inf
    for _ in range(3):
        begin = clock.perf_counter()
        for k in range(0, time.size, 10_000):
            Circle().at(time[k : k + 10_000])
        best = min(best, clock.perf_counter() - begin)
    assert best < 1.0


@pytest.mark.parametrize(
    ("config", "complaint"),
    [
        (Circle(ramp=60.0), "circle: ramp = 60.0 s is longer than half the duration of 100.0 s"),
        (Circle(frequency_hz=0.0), r"circle: frequency_hz = 0.0 is outside \[0.0001, 100.0\]"),
        (Circle(radius=np.nan), "circle: radius = nan is not a finite number"),
        (Sine(ramp=0.0), "sine: ramp = 0.0 is outside"),
        (Sine(duration=3.0), "sine: ramp = 2.0 s is longer than half"),
        (Sine(start=-1.0), "sine: start = -1.0 is outside"),
        (Offset(rise=2.0, duration=3.0), "offset: rise = 2.0 s is longer than half"),
        (Offset(up=np.inf), "offset: up = inf is not a finite number"),
        (Still(pitch_deg=91.0), "still: pitch_deg = 91.0 is outside"),
        (Tilt(rise=0.0), "tilt: rise = 0.0 is outside"),
        (Profile(segments=()), "profile: segments have no jerk"),
        (Profile(segments=(JerkSegment(2.0, 3.0),)), r"leave an acceleration of 6 m/s\^2"),
        (Profile(segments=(JerkSegment(0.0, 3.0),)), "profile, segment 1: duration = 0.0 is"),
    ],
)
def test_settings_that_make_no_motion_are_refused_in_one_line(config, complaint):
    with pytest.raises(InputError, match=complaint) as refusal:
        sum_of([Still(), config], AROUND)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("kind", MOTION_KINDS.values(), ids=MOTION_KINDS)
def test_defaults_of_every_kind_make_a_motion(kind):
    motion = fill(kind, parse_yaml("{}", "x.yaml")).build(AROUND)
    now = motion.at(np.linspace(-1.0, 60.0, 7))
    assert now.position.shape == now.velocity.shape == now.acceleration.shape == (7, 3)
    assert motion.at(np.empty(0)).position.shape == (0, 3)


def test_segments_are_read_from_yaml():
    text = "segments: [{duration: 1, jerk: 5}, {duration: 1, jerk: -5}]\nazimuth_deg: 10"
    profile = fill(Profile, parse_yaml(text, "x.yaml"))
    assert profile.segments == (JerkSegment(1.0, 5.0), JerkSegment(1.0, -5.0))
    assert np.linalg.norm(profile.at(np.array([99.0])).velocity) == pytest.approx(5.0)
