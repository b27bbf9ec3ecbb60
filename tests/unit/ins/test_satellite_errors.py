"""Slow errors satellite by satellite: learnt beside an open clock, as well known as said."""

import numpy as np
import pytest

from deepseis_core.kalman import chi_square_band
from deepseis_ins.satellite_errors import SatelliteErrors

NAMES = tuple(f"G{k:02d}" for k in range(1, 9))
UNITS, DT, SD, GROWTH, PRIOR = 60, 0.1, 0.5, 0.02, 5.0


def start(correlation_s=0.0):
    return SatelliteErrors(PRIOR, GROWTH, correlation_s, 10.0)


def learnt(seed, seconds=20.0):
    """Return the book, and the true errors at the end; the clock runs away at 30 m/s."""
    rng, book = np.random.default_rng([seed, 9]), start()
    true = PRIOR * rng.standard_normal(8)
    for k in range(round(seconds / DT)):
        true = true + (k > 0) * GROWTH * np.sqrt(DT) * rng.standard_normal(8)
        off = true + SD * rng.standard_normal(8) + 3e4 + 30.0 * k * DT
        book = book.learn(k * DT, NAMES, off, np.full(8, SD**2), DT)
    return book, true


def test_differences_of_satellites_are_as_well_known_as_said():
    """NEES of the seven differences that can be known: 95 %."""
    D = np.eye(8)[1:] - np.eye(8)[0]
    squares = []
    for seed in range(UNITS):
        book, true = learnt(seed)
        e, P = D @ (book.mean - true), D @ book.covariance @ D.T
        squares.append(e @ np.linalg.solve(P, e))
    low, high = chi_square_band(7, UNITS, 0.95)
    assert low < np.mean(squares) < high


def test_variances_leave_the_clock_out():
    """All eight are known to the noise's mean, though what they have in common is not."""
    book, _ = learnt(1)
    _, variance = book.of(20.0, NAMES, 20.0)
    # 0.5 m of white noise against 0.02 m/sqrt(s): a steady state of sqrt(q R dt), some 5 cm.
    steady = np.sqrt(GROWTH**2 * SD**2 * DT)
    from_differences = steady * 7.0 / 8.0
    common = 1.0 / np.tanh(0.5 * 20.0 / 10.0)
    assert variance == pytest.approx(np.full(8, common * from_differences), rel=0.15)
    assert np.diag(book.covariance).min() > 0.5 * PRIOR**2 / 8.0


def test_a_single_satellite_still_has_its_own_error():
    book, _ = learnt(2)
    mean, variance = book.of(20.0, NAMES, DT)
    one, its = book.of(20.0, NAMES[3:4], DT)
    assert one[0] == mean[3]
    assert its[0] == pytest.approx(variance[3])


def test_who_was_never_seen_at_rest_counts_for_little():
    book, _ = learnt(3)
    mean, variance = book.of(20.0, (*NAMES, "G30"), DT)
    assert mean[-1] == 0.0
    assert variance[-1] > 100.0 * variance[:-1].max()
    assert variance[:-1].max() < 1.1 * book.of(20.0, NAMES, DT)[1].max()


def test_a_wild_range_changes_nothing():
    book, true = learnt(4)
    off = true + 3e4
    off[5] += 200.0
    after = book.learn(20.0, NAMES, off, np.full(8, SD**2), DT)
    assert abs(after.mean - book.mean)[5] < 0.2


def test_one_satellite_tells_nothing():
    assert start().learn(0.0, NAMES[:1], np.array([3.0]), np.array([1.0]), DT).names == ()
