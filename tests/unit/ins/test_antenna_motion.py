"""The antenna between IMU epochs, against motions that are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from deepseis_core.constants import WGS84_EARTH_RATE
from deepseis_core.geodesy import geodetic_from_ecef, rotation_enu_ecef
from deepseis_core.rotation import ned_frd_from_enu_flu, quat_from_matrix
from deepseis_core.types import FloatArray, IntArray
from deepseis_ins.antenna_motion import (
    KnotInterpolator,
    Nodes,
    one_sided_error,
    polynomial_weights,
)
from deepseis_ins.strapdown import Trajectory
from deepseis_sim.motion import Motion, Surroundings
from deepseis_sim.motions import Sine, Tilt
from deepseis_sim.site import Site

RATE = 4e6
IMU_STEP = 20_000
SPAN = 80_000
GEODETIC = (0.676, 2.461, 40.0)
LEVER_FLU = np.array([0.05, -0.03, 0.30])
TWO_G = 19.6133


def spans_of(first: float, count: int) -> list[tuple[IntArray, IntArray]]:
    """Return epochs of 120 ms and knots of the 20 ms at their end, for successive spans."""
    begin = round(first * RATE) // SPAN * SPAN
    ends = begin + SPAN * np.arange(1, count + 1)
    epochs = IMU_STEP * np.arange(-24, 1)
    knots = np.arange(-SPAN, 1, 4000)
    return [(end + epochs, end + knots) for end in ends.tolist()]


def true_nodes(site: Site, motion: Motion, samples: IntArray) -> Nodes:
    """Return error-free epochs."""
    now = motion.at(samples / RATE)
    states = site.ecef(now)
    geodetic = geodetic_from_ecef(states.position)
    C_enu_e = rotation_enu_ecef(geodetic[:, 0], geodetic[:, 1])
    C_local = C_enu_e @ site.C_e_enu @ np.broadcast_to(now.C_enu_b, (len(samples), 3, 3))
    velocity = np.einsum("kij,kj->ki", C_enu_e, states.velocity)[:, [1, 0, 2]] * [1, 1, -1]
    trajectory = Trajectory(
        np.ascontiguousarray(geodetic),
        np.ascontiguousarray(velocity),
        np.ascontiguousarray(quat_from_matrix(ned_frd_from_enu_flu(C_local))),
    )
    return Nodes.of(samples, trajectory, LEVER_FLU * [1.0, -1.0, -1.0], site.origin_ecef)


def errors(motion: Motion, interpolator: KnotInterpolator) -> FloatArray:
    """Return errors of the antenna at the knots of a second, (spans, knots, 9)."""
    site = Site(GEODETIC)
    found = []
    for epochs, knots in spans_of(1.5, 50):
        states = site.states(motion, knots / RATE, LEVER_FLU)
        truth = np.hstack([states.position, states.velocity, states.acceleration])
        found.append(interpolator.antenna(true_nodes(site, motion, epochs), knots) - truth)
    return np.array(found)


def shaking(frequency_hz: float) -> Motion:
    """Return two g along an axis."""
    amplitude = TWO_G / (2 * np.pi * frequency_hz) ** 2
    config = Sine(
        amplitude=amplitude, frequency_hz=frequency_hz, azimuth_deg=30.0, start=0.5,
        duration=4.0, ramp=0.5,
    )  # fmt: skip
    return config.build(Surroundings(GEODETIC, 6.0))


@pytest.mark.parametrize(("frequency_hz", "limit"), [(2.0, 1e-7), (10.0, 1e-5)])
def test_two_g_of_shaking_is_followed_to_micrometres_a_second(
    frequency_hz: float, limit: float
) -> None:
    error = errors(shaking(frequency_hz), KnotInterpolator(RATE))
    assert np.abs(error[:, :, 0:3]).max() < 1e-6
    assert np.abs(error[:, :, 3:6]).max() < limit
    # The derivative at the very end is the least certain: (w T)^5 / 6 of 2 g.
    assert np.abs(error[:, :, 6:9]).max() < 1e-3 * TWO_G


@pytest.mark.parametrize("points", [4, 5, 6])
def test_one_sidedness_costs_what_theory_says(points: int) -> None:
    error = np.abs(errors(shaking(10.0), KnotInterpolator(RATE, velocity_points=points)))
    worst = one_sided_error(TWO_G / (2 * np.pi * 10.0), 10.0, 200.0, points)
    last = error[:, -6:, 3:6].max(axis=(0, 1))
    before = error[:, :6, 3:6].max(axis=(0, 1))
    along = np.linalg.norm(last)
    assert 0.5 * worst < along < 1.2 * worst
    assert np.linalg.norm(before) < 0.6 * along


def test_a_tilting_lever_arm_swings() -> None:
    tilt = Tilt(pitch_deg=5.0, roll_deg=3.0, start=1.8, rise=0.5).build(
        Surroundings(GEODETIC, 6.0)
    )
    error = errors(tilt, KnotInterpolator(RATE))
    site = Site(GEODETIC)
    time = np.arange(1.5, 2.5, 1e-3)
    swing = np.abs(site.states(tilt, time, LEVER_FLU).velocity).max()
    assert swing > 0.05
    assert np.abs(error[:, :, 3:6]).max() < 0.01 * swing
    # What moved at the end is what the lever arm moved: noise does not add up in the phase.
    moved = np.trapezoid(error[:, :, 3:6], dx=1e-3, axis=1)
    assert np.abs(np.cumsum(moved, axis=0)).max() < 5e-6


def test_at_rest_the_antenna_stands_still_on_the_turning_earth() -> None:
    still = Tilt(pitch_deg=1.0, start=50.0, rise=0.5).build(Surroundings(GEODETIC, 60.0))
    error = errors(still, KnotInterpolator(RATE))
    assert np.abs(error[:, :, 0:3]).max() < 1e-8
    # ECEF turns with the Earth; at an inertial rate of w the lever arm would move by w l.
    assert np.abs(error[:, :, 3:6]).max() < 1e-3 * WGS84_EARTH_RATE * 0.3


def test_weights_reproduce_polynomials_and_their_derivatives() -> None:
    random = np.random.default_rng(3)
    nodes = np.cumsum(random.uniform(0.004, 0.006, 12))
    knots = np.append(np.linspace(nodes[2], nodes[-1], 9), nodes[-1] + 0.003)
    c = random.normal(size=3)
    weights = polynomial_weights(nodes, knots, 6)
    for order, wanted in enumerate(
        (c[0] + c[1] * knots + c[2] * knots**2, c[1] + 2 * c[2] * knots, 2 * c[2] + 0 * knots)
    ):
        values = weights[order] @ (c[0] + c[1] * nodes + c[2] * nodes**2)
        assert values == pytest.approx(wanted, abs=1e-8)


def test_weights_of_the_same_grid_are_made_once() -> None:
    interpolator = KnotInterpolator(RATE)
    (epochs, knots), (later_epochs, later_knots) = spans_of(1.0, 2)
    first = interpolator.weights(epochs, knots, 6)
    assert interpolator.weights(later_epochs, later_knots, 6) is first
