"""The smoother against batch least squares, and against what its errors truly are."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from deepseis_core import kalman
from deepseis_core.errors import InputError
from deepseis_ins.smoother import FilterStep, FixedLagSmoother, between, smooth

PHI = np.array([[1.0, 0.5, 0.125], [0.0, 1.0, 0.5], [0.0, 0.0, 0.9]])
DRIVE = np.diag([0.01, 0.03, 0.2])
START = np.diag([4.0, 1.0, 0.25])
H = np.array([[1.0, 0.0, 0.0]])
R = np.array([[0.3]])
COUNT = 30


def filtered(values, start=START, noise=DRIVE):
    """Filter values of the first state; return the states after them and the steps."""
    x, P, states, steps = np.zeros(3), start.copy(), [], []
    for value in values:
        if states:
            x, P = PHI @ x, PHI @ P @ PHI.T + noise
        got = kalman.update(P, H, R, H @ x - value)
        x = x - got.x
        steps.append(FilterStep(PHI, P, got.x, got.P))
        states.append(x)
        P = got.P
    return np.array(states), steps


def least_squares(values, start, noise):
    """Solve for all states at once; return them and their covariances."""
    n = 3 * len(values)
    rows, sides, weights = [np.eye(3, n)], [np.zeros(3)], [np.linalg.inv(start)]
    for k, value in enumerate(values):
        row = np.zeros((1, n))
        row[:, 3 * k : 3 * k + 3] = H
        rows.append(row), sides.append(np.array([value])), weights.append(np.linalg.inv(R))
        if k:
            row = np.zeros((3, n))
            row[:, 3 * k : 3 * k + 3] = np.eye(3)
            row[:, 3 * k - 3 : 3 * k] = -PHI
            rows.append(row), sides.append(np.zeros(3)), weights.append(np.linalg.inv(noise))
    normal = sum(a.T @ w @ a for a, w in zip(rows, weights, strict=True))
    right = sum(a.T @ w @ b for a, w, b in zip(rows, weights, sides, strict=True))
    P = np.linalg.inv(normal)
    blocks = [P[k : k + 3, k : k + 3] for k in range(0, n, 3)]
    return (P @ right).reshape(-1, 3), np.array(blocks)


def values(seed=1):
    rng = np.random.default_rng(seed)
    return 3.0 * np.sin(np.arange(COUNT) / 4.0) + rng.normal(0.0, 0.5, COUNT)


def test_an_interval_is_the_least_squares_solution_of_all_its_measurements():
    states, steps = filtered(values())
    got = smooth(steps)
    expected, P = least_squares(values(), START, DRIVE)
    assert_allclose(states - got.error, expected, rtol=0, atol=1e-9)
    assert_allclose(got.P, P, rtol=0, atol=1e-9)
    before = np.array([PHI @ x for x in states[:-1]])
    assert_allclose(before - got.error_before[1:], expected[1:], rtol=0, atol=1e-9)


def test_what_is_known_exactly_stays_so_and_does_not_harm():
    """No noise but of the velocity, position and third state known: singular covariances.

    Least squares gets 1e-9 in their place.
    """
    start, noise = np.diag([0.0, 1.0, 0.0]), np.diag([0.0, 0.03, 0.0])
    states, steps = filtered(values(), start, noise)
    got = smooth(steps)
    tiny = 1e-9 * np.eye(3)
    expected, P = least_squares(values(), start + tiny, noise + tiny)
    assert_allclose(states - got.error, expected, rtol=0, atol=1e-5)
    assert_allclose(got.P, P, rtol=0, atol=1e-5)
    assert_allclose((states - got.error)[:, 2], 0.0, atol=1e-12)


def considered(noises, drive=0.3):
    """Filter in which a constant acts on the velocity and is considered; return errors, steps.

    ``noises`` are unit normal: start (4), then a measurement (1) and a drive (3) a step. All is
    linear in them: the filter's errors stand for the filter.
    """
    P, roots = np.diag([4.0, 1.0, 0.25, 1.0]), np.sqrt(np.diag(DRIVE))
    T = np.eye(4)
    T[:3, :3], T[1, 3] = PHI, drive
    Q = np.diag([*np.diag(DRIVE), 0.0])
    H4, error, errors, steps = np.hstack([H, [[0.0]]]), noises[:4] * np.sqrt(np.diag(P)), [], []
    told = iter(noises[4:].reshape(-1, 4))
    for k in range(COUNT):
        now = next(told)
        if k:
            error = T @ error
            error[:3] += roots * now[1:]
            P = T @ P @ T.T + Q
        z = H4 @ error + np.sqrt(R[0]) * now[0]
        after, PHt, S, x = P.copy(), np.empty((4, 1)), np.empty((1, 1)), np.empty(4)
        kalman.innovation_kernel(after, H4, R, z, PHt, S)
        kalman.correct_kernel(after, H4, R, z, PHt, S, 3, x)
        error = error - x
        steps.append(FilterStep(T, P, x, after))
        errors.append(error)
        P = after
    return np.array(errors), steps


def parts(step):
    return step.transition, step.before, step.correction, step.after


def test_covariances_are_those_of_the_errors_even_where_a_parameter_is_considered():
    """Filter and smoother are linear: unit noises one by one give the errors' true covariance."""
    count = 4 + 4 * COUNT
    true = np.zeros((COUNT, 4, 4))
    blind = np.zeros(COUNT)
    for noise in np.eye(count):
        errors, steps = considered(noise)
        got = smooth(steps)
        left = errors - got.error
        true += left[:, :, None] * left[:, None, :]
        cut = [
            FilterStep(T[:3, :3], before[:3, :3], x[:3], after[:3, :3])
            for T, before, x, after in map(parts, steps)
        ]
        alone = smooth(cut)
        blind += (errors[:, 0] - alone.error[:, 0]) ** 2
    assert_allclose(got.P, true, rtol=0, atol=1e-10)
    assert_allclose(got.error[:, 3], 0.0, atol=1e-12)
    filter_variance = np.array([step.after[0, 0] for step in steps])
    assert np.all(got.P[:, 0, 0] <= filter_variance + 1e-12)
    assert got.P[:, 0, 0].sum() < 0.8 * filter_variance.sum()
    # Smoothed without the parameter, as if its effect were white noise, it is not.
    assert np.abs(alone.P[:, 0, 0] / blind - 1.0).max() > 0.05


@pytest.mark.parametrize("batch", [0.0, 1.0])
def test_a_fixed_lag_gives_what_the_interval_up_to_the_newest_gives(batch):
    _, steps = filtered(values())
    late, smoother, newest = [], FixedLagSmoother(2.0, batch), {}
    for k, step in enumerate(steps):
        for each in smoother.push(0.5 * k, step):
            late.append(each)
            newest[each.time] = k
    for each in smoother.flush():
        late.append(each)
        newest[each.time] = COUNT - 1
    assert [each.time for each in late] == [0.5 * k for k in range(COUNT)]
    for each in late:
        k = round(each.time / 0.5)
        whole = smooth(steps[: newest[each.time] + 1])
        assert_array_equal(each.error, whole.error[k])
        assert_array_equal(each.error_before, whole.error_before[k])
        assert_array_equal(each.P, whole.P[k])
        assert newest[each.time] == COUNT - 1 or newest[each.time] - k >= 4


def test_steps_undone_are_forgotten():
    _, steps = filtered(values())
    _, other = filtered(values(2))
    smoother, straight = FixedLagSmoother(20.0), FixedLagSmoother(20.0)
    for k in range(20):
        smoother.push(float(k), steps[k])
    smoother.rewind(12.0)
    for k in range(12):
        straight.push(float(k), steps[k])
    for each in (smoother, straight):
        for k in range(12, 18):
            each.push(float(k), other[k])
    for one, two in zip(smoother.flush(), straight.flush(), strict=True):
        assert one.time == two.time
        assert_array_equal(one.error, two.error)
        assert_array_equal(one.P, two.P)


def test_what_cannot_be_smoothed_is_refused():
    _, steps = filtered(values())
    with pytest.raises(InputError, match="no steps"):
        smooth([])
    with pytest.raises(InputError, match="above 0"):
        FixedLagSmoother(0.0)
    smoother = FixedLagSmoother(2.0)
    for k in range(5):
        smoother.push(float(k), steps[k])
    with pytest.raises(InputError, match="comes late"):
        smoother.push(3.0, steps[5])
    with pytest.raises(InputError, match="longer lag"):
        smoother.rewind(2.0)
    smoother.rewind(3.0)


def test_between_steps_the_error_is_what_a_smoother_of_finer_steps_finds():
    """White noise of the acceleration: the cubic is exact."""
    fine, dt = 10, 1.0
    rng = np.random.default_rng(4)
    x, P, steps, states = np.zeros(2), np.diag([1.0, 1.0]), [], []
    t = dt / fine
    F = np.array([[1.0, t], [0.0, 1.0]])
    Q = np.array([[t**3 / 3, t**2 / 2], [t**2 / 2, t]])
    for k in range(5 * fine + 1):
        if k:
            x, P = F @ x, F @ P @ F.T + Q
        correction, after = np.zeros(2), P
        if k % fine == 0:
            got = kalman.update(P, np.eye(1, 2), np.eye(1), x[:1] - rng.normal(size=1))
            correction, after = got.x, got.P
        x = x - correction
        steps.append(FilterStep(F, P, correction, after))
        states.append(x)
        P = after
    got = smooth(steps)
    for first in range(0, 5 * fine, fine):
        inside = np.arange(1, fine)
        errors = between(
            got.error[first], got.error_before[first + fine], slice(0, 1), slice(1, 2),
            inside / fine, dt,
        )  # fmt: skip
        assert_allclose(errors, got.error[first + inside], rtol=0, atol=1e-10)
