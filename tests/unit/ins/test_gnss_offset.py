"""Slow errors of positions: as well known as said, over many of them."""

import numpy as np
import pytest

from deepseis_core.kalman import chi_square_band
from deepseis_ins.gnss_offset import SlowError, inflation

UNITS, DT = 60, 0.1
FORMAL = np.diag([1.0, 4.0, 9.0])
SHARE, GROWTH, FIRST = 0.2, 0.05, 3.0


def learnt(seed, correlation_s, seconds):
    """Return a unit's error and covariance at the end, and squares of the innovations."""
    rng = np.random.default_rng([seed, 5])
    error = SlowError(SHARE, correlation_s, GROWTH, 10.0, FIRST**2 * np.eye(3), np.zeros(3))
    true, known = FIRST * rng.standard_normal(3), np.array([100.0, -50.0, 7.0])
    sd = SHARE * np.sqrt(np.diag(FORMAL))
    keep = np.exp(-DT / correlation_s) if correlation_s else 0.0
    noise, squares = sd * rng.standard_normal(3), []
    for k in range(round(seconds / DT)):
        if k:
            true = true + GROWTH * np.sqrt(DT) * rng.standard_normal(3)
            noise = keep * noise + np.sqrt(1.0 - keep**2) * sd * rng.standard_normal(3)
        S = error.covariance_at(k * DT) + SHARE**2 * inflation(correlation_s, DT) * FORMAL
        innovation = true + noise - error.mean
        squares.append(innovation @ np.linalg.solve(S, innovation))
        error = error.learn(k * DT, known + true + noise, known, FORMAL, DT)
    return error.mean - true, error.covariance, squares


def test_white_noise_errors_and_innovations_are_as_large_as_it_says():
    """NEES and NIS of a random walk in white noise: 95 % in all."""
    found = [learnt(seed, 0.0, 10.0) for seed in range(UNITS)]
    nees = np.mean([e @ np.linalg.solve(P, e) for e, P, _ in found])
    low, high = chi_square_band(3, UNITS, 1.0 - 0.05 / 2.0)
    assert low < nees < high
    squares = np.concatenate([part for _, _, part in found])
    low, high = chi_square_band(3, squares.size, 1.0 - 0.05 / 2.0)
    assert low < squares.mean() < high


def test_correlated_noise_is_reckoned_with():
    """Inflated variance is exact where the mean is long against the correlation: NEES 95 %."""
    found = [learnt(seed, 0.3, 20.0) for seed in range(UNITS)]
    nees = np.mean([e @ np.linalg.solve(P, e) for e, P, _ in found])
    low, high = chi_square_band(3, UNITS, 0.95)
    assert low < nees < high


def test_inflation_is_the_variance_of_a_mean():
    """Of 40 000 values with correlation exp(-t / tau), by their covariance matrix's sum."""
    tau, n = 0.7, 40_000
    lags = np.arange(n) * DT
    total = n + 2.0 * ((n - np.arange(1, n)) * np.exp(-lags[1:] / tau)).sum()
    assert inflation(tau, DT) == pytest.approx(total / n, rel=1e-3)
