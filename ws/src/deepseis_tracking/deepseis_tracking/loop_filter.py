r"""Loop filters of orders 1 to 3, designed for the bandwidth they really have.

A loop that measures the mean phase error of one integration and corrects the frequency of the
next is a discrete system. At 20 ms the analog constants of thesis table 2.1 (order 2: ``Bn = 0.53
wn``, ``a2 = 1.414``; order 3: ``Bn = 0.7845 wn``, ``a3 = 1.1``, ``b3 = 2.4``) make an order-2 loop
of "4 Hz" 25 % wider than it says, of "8 Hz" 64 %, and "15 Hz" is really 51 Hz. `design_loop` keeps
their damping and scales ``wn`` until the discrete noise bandwidth is the one asked for.

The discrete loop, error ``e_k`` in cycles over integration ``k`` of length ``T``::

    e_k     = theta_k - (phi_k + f_k T / 2)            mean phase error
    phi_k+1 = phi_k + f_k T
    a_k+1   = a_k + k3 e_k                             bilinear integrators
    s_k+1   = s_k + k2 e_k + T (a_k + a_k+1) / 2
    f_k+1   = (s_k + s_k+1) / 2 + k1 e_k
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_discrete_lyapunov
from scipy.optimize import brentq

from deepseis_core.types import FloatArray


@dataclass(frozen=True)
class LoopGains:
    """Gains of the discrete loop above: k1 [1/s], k2 [1/s], k3 [1/s^2]; wn [rad/s]."""

    order: int
    k1: float
    k2: float
    k3: float
    natural_frequency: float
    noise_bandwidth_hz: float


def analog_natural_frequency(order: int, bandwidth_hz: float) -> float:
    """Natural frequency for a one-sided noise bandwidth by thesis table 2.1 [rad/s]."""
    return {1: 4.0, 2: 1 / 0.53, 3: 1 / 0.7845}[order] * bandwidth_hz


def _gains(order: int, wn: float, period: float) -> tuple[float, float, float]:
    if order == 1:
        return wn, 0.0, 0.0
    if order == 2:
        return 1.414 * wn, wn * wn * period, 0.0
    return 2.4 * wn, 1.1 * wn * wn * period, wn**3 * period


def transition(k1: float, k2: float, k3: float, period: float) -> tuple[FloatArray, FloatArray]:
    """State matrix and error input of the loop with state ``[phi, f, s, a]``."""
    measure = np.array([-1.0, -period / 2, 0.0, 0.0])
    accel = np.array([0.0, 0.0, 0.0, 1.0]) + k3 * measure
    slope = np.array([0.0, 0.0, 1.0, 0.0]) + k2 * measure
    slope = slope + period / 2 * (np.array([0.0, 0.0, 0.0, 1.0]) + accel)
    frequency = (np.array([0.0, 0.0, 1.0, 0.0]) + slope) / 2 + k1 * measure
    matrix = np.array([[1.0, period, 0.0, 0.0], frequency, slope, accel])
    slope_in = k2 + period / 2 * k3
    drive = np.array([0.0, slope_in / 2 + k1, slope_in, k3])
    return matrix, drive


def discrete_noise_bandwidth(k1: float, k2: float, k3: float, period: float) -> float:
    """One-sided noise bandwidth [Hz] of the NCO phase averaged over the integration.

    White discriminator noise of variance ``s**2`` gives NCO phase variance ``2 Bn T s**2``, the
    discrete form of ``sigma**2 = Bn / CN0 (...)`` (thesis 3.2). ``inf`` if the loop is unstable.
    """
    matrix, drive = transition(k1, k2, k3, period)
    keep = [0, 1] + ([2] if k2 > 0 else []) + ([3] if k3 > 0 else [])
    matrix, drive = matrix[np.ix_(keep, keep)], drive[keep]
    if np.abs(np.linalg.eigvals(matrix)).max() >= 1:
        return np.inf
    cov = solve_discrete_lyapunov(matrix, np.outer(drive, drive))
    mean_variance = cov[0, 0] + cov[0, 1] * period + cov[1, 1] * period**2 / 3
    return float(mean_variance / (2 * period))


def design_loop(
    order: int, bandwidth_hz: float, period: float, *, realised: bool = True
) -> LoopGains:
    """Gains for a one-sided noise bandwidth.

    Parameters
    ----------
    order : int
        1, 2 or 3.
    bandwidth_hz : float
        One-sided noise bandwidth ``Bn`` [Hz].
    period : float
        Coherent integration ``T`` [s].
    realised : bool
        True: ``Bn`` is that of the discrete loop. False: the analog constants as printed, for
        comparison with the papers.

    Raises
    ------
    ValueError
        No stable loop of this order has that bandwidth at this period.
    """
    wn = analog_natural_frequency(order, bandwidth_hz)

    def excess(candidate: float) -> float:
        bandwidth = discrete_noise_bandwidth(*_gains(order, candidate, period), period)
        return min(bandwidth, 1e3 * bandwidth_hz) - bandwidth_hz

    if realised:
        low, high = wn * 0.05, wn * 1.5
        if excess(low) > 0 or excess(high) < 0:
            raise ValueError(
                f"no order-{order} loop has {bandwidth_hz} Hz at {period * 1e3:g} ms integration"
            )
        wn = float(brentq(excess, low, high, xtol=1e-9))
    k1, k2, k3 = _gains(order, wn, period)
    return LoopGains(order, k1, k2, k3, wn, discrete_noise_bandwidth(k1, k2, k3, period))
