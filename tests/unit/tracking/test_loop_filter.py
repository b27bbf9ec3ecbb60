"""Loop design: the bandwidth is that of the loop that runs, found here by simulating it."""

import numpy as np
import pytest

from deepseis_tracking import loop_filter
from deepseis_tracking.channel_kernel import filter_carrier
from deepseis_tracking.channel_state import STATE
from deepseis_tracking.loop_filter import design_loop, discrete_noise_bandwidth


def run_loop(gains, period, errors, ramp_hz=0.0, chirp=0.0):
    """The channel's own filter on discriminator noise; NCO phase error at mid-epoch, cycles."""
    states = np.zeros(1, STATE)
    state = states[0]
    phase, truth = 0.0, 0.0
    lag = np.empty(len(errors))
    for k, noise in enumerate(errors):
        t = k * period
        frequency = float(state["nco_hz"])
        middle = ramp_hz * (t + period / 2) + 0.5 * chirp * (t + period / 2) ** 2
        # mean over the epoch of the quadratic's curvature: chirp T^2 / 24
        truth = middle + chirp * period**2 / 24
        lag[k] = phase + frequency * period / 2 - truth
        error = -lag[k] + noise
        filter_carrier(state, error, gains.k1, gains.k2, gains.k3, period)
        phase += frequency * period
    return lag


CASES = [
    (1, 1.0, 0.02),
    (2, 8.0, 0.02),
    (2, 15.0, 0.02),
    (3, 8.0, 0.02),
    (3, 15.0, 0.02),
    (2, 18.0, 0.001),
]


@pytest.mark.parametrize(("order", "bandwidth", "period"), CASES)
def test_noise_through_the_running_filter_has_the_bandwidth_asked_for(order, bandwidth, period):
    gains = design_loop(order, bandwidth, period)
    rng = np.random.default_rng(order)
    count = 60_000
    lag = run_loop(gains, period, rng.normal(0, 0.01, count))[1000:]
    # Bn counts the phase averaged over the epoch; the mid-epoch phase has a little less noise:
    # compute both from the same covariance.
    matrix, drive = loop_filter.transition(gains.k1, gains.k2, gains.k3, period)
    keep = list(range(order + 1))
    matrix, drive = matrix[np.ix_(keep, keep)], drive[keep]
    cov = loop_filter.solve_discrete_lyapunov(matrix, np.outer(drive, drive))
    middle = cov[0, 0] + cov[0, 1] * period + cov[1, 1] * period**2 / 4
    # 4 sigma of a variance estimate from about count * 2 Bn T independent values
    tolerance = 4 * np.sqrt(2 / (count * min(1.0, 2 * bandwidth * period)))
    assert np.var(lag) / (0.01**2 * middle) == pytest.approx(1.0, abs=tolerance)
    assert gains.noise_bandwidth_hz == pytest.approx(bandwidth, rel=1e-6)
    assert middle / (2 * period) == pytest.approx(bandwidth, rel=0.08)


def test_the_continuous_limit_is_the_printed_table():
    # Thesis table 2.1: Bn = 0.53 wn (order 2), 0.7845 wn (order 3); Bn T small.
    for order, factor in ((2, 0.53), (3, 0.7845)):
        gains = design_loop(order, 1.0, 1e-4)
        assert gains.natural_frequency * factor == pytest.approx(1.0, rel=2e-3)


@pytest.mark.parametrize(("order", "bandwidth"), [(2, 8.0), (2, 15.0), (3, 8.0), (3, 15.0)])
def test_a_frequency_step_leaves_no_phase_error(order, bandwidth):
    lag = run_loop(design_loop(order, bandwidth, 0.02), 0.02, np.zeros(2000), ramp_hz=1.5)
    assert abs(lag[-1]) < 1e-9


def test_a_chirp_leaves_the_theoretical_lag_in_order_two_and_none_in_order_three():
    period, chirp = 0.02, 2.0
    gains = design_loop(2, 8.0, period)
    lag = run_loop(gains, period, np.zeros(600), chirp=chirp)
    # k2 e = chirp T in the steady state: the integrator must climb chirp * T each epoch.
    assert lag[-1] == pytest.approx(-chirp * period / gains.k2, rel=1e-6)
    lag = run_loop(design_loop(3, 8.0, period), period, np.zeros(900), chirp=chirp)
    assert abs(lag[-1]) < 1e-6


def test_the_analog_constants_are_wider_than_they_say():
    assert design_loop(2, 8.0, 0.02, realised=False).noise_bandwidth_hz > 1.25 * 8.0


def test_an_unstable_loop_has_no_bandwidth():
    assert discrete_noise_bandwidth(1000.0, 0.0, 0.0, 0.02) == np.inf
    with pytest.raises(ValueError, match="no order-2 loop"):
        design_loop(2, 1000.0, 0.02)
