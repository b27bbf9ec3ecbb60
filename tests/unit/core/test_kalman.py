"""The measurement update against textbook algebra and least squares; transitions, consistency."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import quad_vec
from scipy.linalg import expm

from deepseis_core import kalman
from deepseis_core.errors import InputError


def problem(rng, n=8, m=3):
    """Return a covariance, a sensitivity, a noise covariance and an innovation."""
    root, noise = rng.standard_normal((n, n)), rng.standard_normal((m, m))
    return (
        root @ root.T,
        rng.standard_normal((m, n)),
        noise @ noise.T + 0.1 * np.eye(m),
        rng.standard_normal(m),
    )


def test_update_is_the_weighted_least_squares_of_prior_and_measurement():
    P, H, R, z = problem(np.random.default_rng(1))
    got = kalman.update(P, H, R, z)
    # The information form, which shares no step with the gain's.
    information = np.linalg.inv(P) + H.T @ np.linalg.inv(R) @ H
    assert_allclose(got.P, np.linalg.inv(information), atol=1e-10)
    assert_allclose(got.x, np.linalg.solve(information, H.T @ np.linalg.solve(R, z)), atol=1e-10)
    assert_allclose(got.S, H @ P @ H.T + R, rtol=1e-13)
    assert got.normalised_squared == pytest.approx(z @ np.linalg.solve(got.S, z), rel=1e-12)


def test_covariance_is_symmetric_to_the_bit_and_positive_after_hostile_updates():
    """Measurements 1e8 times better than the prior: the simple form goes negative here."""
    rng = np.random.default_rng(2)
    P = np.diag(np.logspace(6, -6, 8))
    for _ in range(300):
        P = kalman.update(P, rng.standard_normal((3, 8)), 1e-10 * np.eye(3), np.zeros(3)).P
        assert_array_equal(P, P.T)
    assert np.all(np.diag(P) > 0.0)
    assert np.linalg.eigvalsh(P / np.sqrt(np.outer(np.diag(P), np.diag(P)))).min() > -1e-6


def test_considered_states_get_no_gain_and_keep_the_covariance_honest():
    rng = np.random.default_rng(3)
    P, H, R, z = problem(rng)
    estimated = 5
    S = H @ P @ H.T + R
    K = P @ H.T @ np.linalg.inv(S)
    K[estimated:] = 0.0
    A = np.eye(8) - K @ H
    expected = A @ P @ A.T + K @ R @ K.T
    got, PHt, S_got, x = P.copy(), np.empty((8, 3)), np.empty((3, 3)), np.empty(8)
    kalman.innovation_kernel(got, H, R, z, PHt, S_got)
    kalman.correct_kernel(got, H, R, z, PHt, S_got, estimated, x)
    assert_allclose(got, expected, atol=1e-11)
    assert_allclose(x, K @ z, atol=1e-12)
    assert_array_equal(x[estimated:], 0.0)
    assert_allclose(got[estimated:, estimated:], P[estimated:, estimated:], rtol=1e-14)


def test_innovations_of_a_simulated_system_are_white_and_of_the_size_predicted():
    """A random walk measured with noise: the mean normalised square within its 95 % band."""
    rng = np.random.default_rng(4)
    truth, estimate, P, squares = 0.0, 0.0, np.eye(1), []
    for _ in range(2000):
        truth += 0.1 * rng.standard_normal()
        P = P + 0.01
        z = np.array([estimate - (truth + 0.5 * rng.standard_normal())])
        got = kalman.update(P, np.eye(1), 0.25 * np.eye(1), z)
        estimate, P = estimate - got.x[0], got.P
        squares.append(got.normalised_squared)
    low, high = kalman.chi_square_band(1, 2000)
    assert low < np.mean(squares) < high
    # Steady state of the scalar Riccati equation.
    assert P[0, 0] == pytest.approx(0.5 * (-0.01 + np.sqrt(0.01**2 + 4 * 0.01 * 0.25)), rel=1e-6)


@pytest.mark.parametrize("dt", [0.01, 0.05])
def test_discretisation_is_exact_to_second_order(dt):
    rng = np.random.default_rng(5)
    F, Q = rng.standard_normal((4, 4)), np.diag(rng.uniform(0.1, 1.0, 4))
    Phi, Qd = kalman.discretise(F, Q, dt)
    exact = quad_vec(lambda s: expm(F * s) @ Q @ expm(F * s).T, 0.0, dt)[0]
    size = np.linalg.norm(F * dt)
    assert_allclose(Phi, expm(F * dt), atol=size**3)
    assert_allclose(Qd, exact, atol=dt * size**2)


def test_band_of_mean_chi_squares_holds_so_many_of_them():
    """95 % of 4000 means; 4 sigma of that count is 1.4 %."""
    low, high = kalman.chi_square_band(3, 20)
    means = np.random.default_rng(6).chisquare(3, (4000, 20)).mean(axis=1)
    assert np.mean((means > low) & (means < high)) == pytest.approx(0.95, abs=0.014)


def test_limit_is_exceeded_with_the_probability_asked_for():
    # Tabulated: 16.266 for three degrees of freedom and 0.001.
    assert kalman.chi_square_limit(3, 1e-3) == pytest.approx(16.266, abs=5e-4)


@pytest.mark.parametrize("R", [-np.eye(1) * 5.0, np.full((1, 1), np.nan)])
def test_what_is_no_covariance_is_refused(R):
    with pytest.raises(InputError, match="positive definite"):
        kalman.update(np.eye(1), np.eye(1), R, np.zeros(1))


def test_an_innovation_that_is_not_finite_is_refused():
    with pytest.raises(InputError, match="not finite"):
        kalman.update(np.eye(1), np.eye(1), np.eye(1), np.array([np.nan]))
