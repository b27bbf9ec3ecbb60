"""Noise of range rates from loops whose aiding is away, against the loop's own covariance."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov

from deepseis_core.constants import L1_WAVELENGTH
from deepseis_core.loop_noise import FALLBACK_BANDWIDTH_HZ, NCO_NOISE, lone_rate_sd
from deepseis_core.types import Observations, TrackingFlag
from deepseis_tracking.channel import TrackingConfig
from deepseis_tracking.loop_filter import design_loop, transition


def test_the_nco_is_as_noisy_as_the_loops_covariance_says():
    config = TrackingConfig()
    assert config.fallback_bandwidth_hz == FALLBACK_BANDWIDTH_HZ
    period = 1e-3 * config.fallback_ms
    gains = design_loop(config.fallback_order, config.fallback_bandwidth_hz, period)
    matrix, drive = transition(gains.k1, gains.k2, gains.k3, period)
    covariance = solve_discrete_lyapunov(matrix, np.outer(drive, drive))
    factor = np.sqrt(covariance[1, 1]) / config.fallback_bandwidth_hz
    assert factor == pytest.approx(NCO_NOISE, rel=0.01)


def test_only_loops_without_their_aiding_add_to_it():
    flags = [TrackingFlag.PHASE_LOCK | TrackingFlag.AID_MISSED, TrackingFlag.PHASE_LOCK]
    two, single = np.zeros(2), np.zeros(2, np.float32)
    found = lone_rate_sd(
        Observations(
            0, 0.0, 2300, 0, 0, 0.02, ("G01", "G02"), two, two, two, single,
            np.zeros(2, np.uint8), single, single, np.full(2, 0.018, np.float32), single, single,
            np.array(flags, np.uint16),
        )
    )  # fmt: skip
    np.testing.assert_allclose(found, [L1_WAVELENGTH * 2.46, 0.0], rtol=0.01)
