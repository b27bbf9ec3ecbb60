"""The shaken oscillator's filter: its transition by perturbation, honest over many oscillators."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from deepseis_core.kalman import chi_square_band
from deepseis_ins.fusion_config import FusionConfig
from deepseis_ins.oscillator_terms import PER_G, OscillatorTerms

CONFIG = FusionConfig(oscillator_walk=0.03, oscillator_phase_walk=1e-3)
RATE = 1000.0
REST = np.array([0.1, -0.2, -9.8])
FIVE = np.array([1.0, 1.0, *[1e-9 * PER_G] * 3])


def clock_of(x, force, seconds, steps=2000):
    """Integrate ``db/dt = d + c Gamma . (f - f_0)`` plainly; return clock and drift at rest."""
    dt = seconds / steps
    moments = (np.arange(steps) + 0.5) * dt
    rates = x[1] + (force(moments) - REST) @ x[2:]
    return np.array([x[0] + dt * rates.sum(), x[1], *x[2:]])


def test_every_column_of_the_transition_is_that_of_a_perturbed_integration():
    def force(t):
        return REST + np.stack([5.0 * np.sin(3.0 * t), 2.0 * t, -(t**2)], axis=-1)

    seconds, steps = 0.8, 2000
    moments = (np.arange(steps) + 0.5) * seconds / steps
    gained = force(moments).sum(axis=0) * seconds / steps
    for j in range(5):
        x = np.zeros(5)
        x[j] = FIVE[j]
        found = []
        for sign in (1.0, -1.0):
            terms = OscillatorTerms(CONFIG, RATE)
            terms.rest_at(REST)
            terms.state = replace(terms.state, x=sign * x, sample_index=0)
            terms.carry(round(seconds * RATE), gained)
            found.append(terms.state.x)
        expected = (clock_of(x, force, seconds) - clock_of(-x, force, seconds)) / 2.0
        assert_allclose((found[0] - found[1]) / 2.0, expected, rtol=1e-9, atol=1e-15)


def test_every_column_of_h_is_what_perturbation_gives():
    """Of a clock and of a drift; the innovation is linear in the state."""
    force = REST + np.array([3.0, -1.0, 2.0])
    for j in range(5):
        x = np.zeros(5)
        x[j] = FIVE[j]
        true = x[0], x[1] + (force - REST) @ x[2:]
        for kind, value in enumerate(true):
            # A filter that is sure of the state, and right, learns nothing.
            terms = OscillatorTerms(CONFIG, RATE)
            terms.rest_at(REST)
            terms.state = replace(terms.state, x=x, P=np.diag(FIVE**2) * 1e-6, sample_index=0)
            assert terms.clock(value, 1e-3) if kind == 0 else terms.drift(value, force)
            assert_allclose(terms.state.x, x, rtol=0, atol=1e-15)


UNITS, SECONDS, STEP = 40, 12.0, 0.02
CLOCK_SD = 2e-3


def flown(seed):
    """Return error, covariance and normalised squares of a unit that shakes after 4 s."""
    rng, sd = np.random.default_rng([seed, 3]), CONFIG.oscillator_sensitivity_sd * PER_G
    x = np.array([100.0 * rng.standard_normal(), 30.0, *(sd * rng.standard_normal(3))])
    terms, squares = OscillatorTerms(CONFIG, RATE), []
    terms.rest_at(REST)
    q_b, q_d = CONFIG.oscillator_phase_walk**2, CONFIG.oscillator_walk**2
    cross = q_d * STEP**2 / 2.0
    Q = np.array([[q_b * STEP + q_d * STEP**3 / 3.0, cross], [cross, q_d * STEP]])
    noise = np.linalg.cholesky(Q)
    shaking = np.array([15.0, 9.0, 4.0])
    for k in range(1, round(SECONDS / STEP) + 1):
        t = k * STEP
        shaken = shaking * np.sin(6.0 * t + np.arange(3)) * (t > 4.0)
        x[0] += STEP * (x[1] + shaken @ x[2:])
        x[:2] += noise @ rng.standard_normal(2)
        terms.carry(round(t * RATE), (REST + shaken) * STEP)
        # Clocks at 50 Hz; every tenth epoch has a drift of PVT in its place.
        if k % 10:
            value, h, noise_sd = x[0], np.array([1.0, 0, 0, 0, 0]), CLOCK_SD
        else:
            value, h = x[1] + shaken @ x[2:], np.array([0.0, 1.0, *shaken])
            noise_sd = CONFIG.drift_noise
        value += noise_sd * rng.standard_normal()
        variance = h @ terms.state.P @ h + noise_sd**2
        if k > 50:
            squares.append((value - h @ terms.state.x) ** 2 / variance)
        used = terms.clock(value, noise_sd) if k % 10 else terms.drift(value, REST + shaken)
        assert used or k < 50
    return terms.state.x - x, terms.state.P, squares


@pytest.fixture(scope="module")
def units():
    return [flown(seed) for seed in range(UNITS)]


def test_errors_and_innovations_are_as_large_as_it_says(units):
    """NEES of five states and NIS of clocks and drifts: 95 % in all."""
    nees = np.mean([e @ np.linalg.solve(P, e) for e, P, _ in units])
    low, high = chi_square_band(5, UNITS, 1.0 - 0.05 / 2.0)
    assert low < nees < high
    squares = np.concatenate([found for _, _, found in units])
    low, high = chi_square_band(1, squares.size, 1.0 - 0.05 / 2.0)
    assert low < squares.mean() < high
