"""The smooth path: it is the spline it says, and its derivatives agree."""

import time

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.interpolate import CubicSpline, make_interp_spline

from deepseis_sim.uniform_spline import UniformSpline

START, STEP = 3.0, 0.01


@pytest.fixture(name="samples")
def _samples():
    return np.random.default_rng(1).standard_normal((60, 3))


@pytest.fixture(name="times")
def _times():
    return np.random.default_rng(2).uniform(START, START + 59 * STEP, 500)


def test_integrated_acceleration_is_scipys_natural_spline_and_its_antiderivatives(samples, times):
    spline = UniformSpline.from_acceleration(START, STEP, samples, velocity=[1.0, 0.0, -2.0])
    reference = CubicSpline(START + STEP * np.arange(60), samples, bc_type="natural")
    position, velocity, acceleration = spline.evaluate(times)
    first = np.array([1.0, 0.0, -2.0])
    # Rounding of times near 3 s over a step of 0.01 s: 1e-13 of the slope.
    assert_allclose(acceleration, reference(times), atol=1e-11)
    assert_allclose(velocity, first + reference.antiderivative(1)(times), atol=1e-13)
    moved = first * (times - START)[:, None] + reference.antiderivative(2)(times)
    assert_allclose(position, moved, atol=1e-14)


def test_interpolated_positions_are_scipys_quintic_at_rest_at_both_ends(samples, times):
    grid = START + STEP * np.arange(60)
    rest = [(1, np.zeros(3)), (2, np.zeros(3))]
    reference = make_interp_spline(grid, samples, k=5, bc_type=(rest, rest))
    spline = UniformSpline.from_positions(START, STEP, samples)
    for order, found in enumerate(spline.evaluate(times)):
        expected = reference(times, order)
        assert_allclose(found, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


@pytest.mark.parametrize("kind", ["from_acceleration", "from_positions"])
def test_all_derivatives_of_position_up_to_the_fourth_are_continuous(samples, kind):
    spline = getattr(UniformSpline, kind)(START, STEP, samples)
    knots = START + STEP * np.arange(1, 59)
    before, after = spline.evaluate(knots - 1e-9), spline.evaluate(knots + 1e-9)
    for low, high, rate in zip(before, after, (*before[1:], None), strict=True):
        moved = 0.0 if rate is None else 2e-9 * rate
        # Over 2 ns the acceleration itself moves by up to 1e-6 of its scale.
        assert_allclose(high - moved, low, rtol=0, atol=1e-5 * np.abs(low).max())
    assert np.isfinite(spline.knots[:, 3]).all()  # the fourth derivative, shared by neighbours


@pytest.mark.parametrize("kind", ["from_acceleration", "from_positions"])
def test_outside_its_knots_it_moves_on_at_the_last_velocity(samples, kind):
    ends = {"end_velocities": [[1.0, 2.0, 3.0]] * 2} if kind == "from_positions" else {}
    spline = getattr(UniformSpline, kind)(START, STEP, samples, **ends)
    end = spline.evaluate([spline.end])
    later = spline.evaluate([spline.end + 7.0, 1e6])
    assert_allclose(later[0][0], end[0][0] + 7.0 * end[1][0], rtol=1e-12)
    assert_allclose(later[1], np.repeat(end[1], 2, axis=0), rtol=1e-12)
    assert not later[2].any()
    earlier = spline.evaluate([START - 2.0])
    first = spline.knots[0]
    assert_allclose(earlier[0][0], first[0] - 2.0 * first[1], rtol=1e-12)
    assert not earlier[2].any()


def test_positions_that_end_at_rest_stay_where_they_are(samples):
    spline = UniformSpline.from_positions(START, STEP, samples)
    position, velocity, _ = spline.evaluate([-1e3, 1e4])
    assert_allclose(position, samples[[0, -1]], rtol=1e-9)
    assert_allclose(velocity * 1e4, 0.0, atol=1e-6)


def test_a_smooth_motion_is_met_to_the_fourth_power_of_the_step():
    """The natural cubic's error is of order h^4 away from the ends."""
    errors = []
    for n in (400, 800):
        t = np.linspace(0.0, 8.0, n + 1)
        bell = np.exp(-((t - 4.0) ** 2) * 4.0) * np.sin(20.0 * t)
        spline = UniformSpline.from_acceleration(0.0, 8.0 / n, bell[:, None])
        fine = np.linspace(0.0, 8.0, 4 * n + 3)
        exact = np.exp(-((fine - 4.0) ** 2) * 4.0) * np.sin(20.0 * fine)
        errors.append(np.abs(spline.evaluate(fine)[2][:, 0] - exact).max())
    assert 14.0 < errors[0] / errors[1] < 18.0


def test_order_and_grouping_of_times_do_not_matter(samples, times):
    spline = UniformSpline.from_acceleration(START, STEP, samples)
    whole = spline.evaluate(times)
    parts = [spline.evaluate(part) for part in np.array_split(times, 7)]
    for i in range(3):
        assert np.array_equal(whole[i], np.concatenate([part[i] for part in parts]))
        assert np.array_equal(whole[i][::-1], spline.evaluate(times[::-1])[i])


def test_two_samples_and_one_axis_are_enough():
    spline = UniformSpline.from_acceleration(0.0, 2.0, [[1.0], [1.0]])
    assert_allclose(np.ravel(spline.evaluate(2.0)), [2.0, 2.0, 1.0])


def test_a_time_that_is_no_number_gives_no_position(samples):
    spline = UniformSpline.from_acceleration(START, STEP, samples)
    assert np.isnan(spline.evaluate([np.nan])[0]).all()


@pytest.mark.parametrize(
    ("step", "samples"),
    [
        (0.01, [[0.0, 0.0]]),
        (0.01, [0.0, 1.0, 2.0]),
        (0.0, [[0.0], [1.0]]),
        (-1.0, [[0.0], [1.0]]),
        (0.01, [[0.0], [np.nan]]),
        (np.inf, [[0.0], [1.0]]),
    ],
)
def test_samples_that_make_no_path_are_refused(step, samples):
    for make in (UniformSpline.from_acceleration, UniformSpline.from_positions):
        with pytest.raises(ValueError, match=r"samples"):
            make(0.0, step, samples)


@pytest.mark.benchmark
def test_millions_of_points_a_second():
    spline = UniformSpline.from_acceleration(0.0, 0.005, np.zeros((200_000, 3)))
    times = np.arange(0.0, 1000.0, 0.0005)
    spline.evaluate(times[:10])
    spent = []
    for _ in range(5):
        began = time.process_time()
        spline.evaluate(times)
        spent.append(time.process_time() - began)
    assert times.size / min(spent) > 3e6
