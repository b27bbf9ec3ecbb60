"""A loop at correlator level, without samples or codes: second oracle for the theory of loops.

Unlike the transfer functions it has the discriminator's limits (atan), the signal that is lost
when the phase turns within an integration, the noise's squaring loss, and slips.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit

from deepseis_core.constants import L1_WAVELENGTH
from deepseis_core.types import FloatArray
from deepseis_tracking.discriminators import costas_atan
from deepseis_tracking.loop_filter import LoopGains
from deepseis_tracking.loop_theory import linear

NOISE_STREAM: Final = 60
"""Stream of random numbers."""

TWO_PI: Final = 2.0 * np.pi


@dataclass(frozen=True)
class LoopRun:
    """What a loop did, one value for each integration, shape (n,), phases in rad.

    ``discriminator`` is its output; ``error`` the mean phase of the signal less that of the
    replica, not wrapped: near a multiple of pi after slips. ``doppler_hz`` is the replica's.
    """

    discriminator: FloatArray
    error: FloatArray
    doppler_hz: FloatArray

    def rms(self, first: int = 0) -> float:
        """RMS of the discriminator's output from an integration on."""
        return float(np.sqrt(np.mean(self.discriminator[first:] ** 2)))

    def greatest(self, first: int = 0) -> float:
        """Greatest discriminator output from an integration on."""
        return float(np.abs(self.discriminator[first:]).max())

    @property
    def kept(self) -> int:
        """Integrations until the true error first passes 90 deg, where atan misleads."""
        beyond = np.flatnonzero(np.abs(self.error) > np.pi / 2.0)
        return int(beyond[0]) if beyond.size else self.error.size


def simulate_loop(
    gains: LoopGains, period: float, range_m: FloatArray, cn0_dbhz: float, seed: int = 0
) -> LoopRun:
    """Run a loop on a signal.

    Parameters
    ----------
    gains : LoopGains
        Of `design_loop`, for this period.
    period : float
        Coherent integration T [s].
    range_m : ndarray, shape (n, m)
        Change of the signal's path [m] at m equally spaced moments (the middles of m parts) of
        each of n integrations; what an aided loop sees is the error of its aiding. The loop
        begins locked, with the rate of the first integration.
    cn0_dbhz : float
        Infinite: no noise.
    seed : int
        Same seed, same noise.
    """
    if range_m.ndim != 2 or not range_m.size:
        raise ValueError(f"ranges of shape {range_m.shape}: (integrations, parts) are needed")
    phase = np.ascontiguousarray(range_m, np.float64) / L1_WAVELENGTH
    noise = np.random.default_rng([seed, NOISE_STREAM]).standard_normal((phase.shape[0], 2))
    amplitude = float(np.sqrt(2.0 * linear(cn0_dbhz) * period))
    if not np.isfinite(amplitude):
        noise, amplitude = 0.0 * noise, 1.0
    out = np.empty((3, phase.shape[0]))
    _run((gains.k1, gains.k2, gains.k3), period, phase, amplitude, noise, out)
    return LoopRun(TWO_PI * out[0], TWO_PI * out[1], out[2])


@njit(cache=True, nogil=True)
def _run(
    gains: tuple[float, float, float], period: float, phase: FloatArray, amplitude: float,
    noise: FloatArray, out: FloatArray,
) -> None:  # fmt: skip
    """Fill rows discriminator [cycles], error [cycles], frequency [Hz] (kernel)."""
    k1, k2, k3 = gains
    count, parts = phase.shape
    step = period / parts
    slope = (phase[0, parts - 1] - phase[0, 0]) / ((parts - 1) * step) if parts > 1 else 0.0
    frequency, integrator, acceleration = slope, slope, 0.0
    replica = phase[0, 0] - 0.5 * step * slope
    for k in range(count):
        in_phase, quadrature, error = 0.0, 0.0, 0.0
        for j in range(parts):
            off = phase[k, j] - replica - frequency * (j + 0.5) * step
            in_phase += np.cos(TWO_PI * off)
            quadrature += np.sin(TWO_PI * off)
            error += off
        in_phase = amplitude * in_phase / parts + noise[k, 0]
        quadrature = amplitude * quadrature / parts + noise[k, 1]
        seen = costas_atan(in_phase, quadrature)
        out[0, k], out[1, k], out[2, k] = seen, error / parts, frequency
        replica += frequency * period
        last, before = integrator, acceleration
        acceleration += k3 * seen
        integrator += k2 * seen + 0.5 * period * (before + acceleration)
        frequency = 0.5 * (last + integrator) + k1 * seen


def circle(
    radius: float, frequency_hz: float, elevation: float, duration: float, period: float,
    *, ramp: float = 1.0, parts: int = 20,
) -> FloatArray:  # fmt: skip
    """Return the range's change along a level circle that begins smoothly, for `simulate_loop`.

    Parameters
    ----------
    radius : float
        [m]
    elevation : float
        Of the satellite [rad].
    duration : float
        [s], cut to whole integrations.
    ramp : float
        In which the radius grows as ``x^3 (10 - 15 x + 6 x^2)`` [s].

    Returns
    -------
    ndarray, shape (n, parts)
        [m]
    """
    count = int(duration / period + 1e-9)
    time = (np.arange(count * parts) + 0.5) * period / parts
    x = np.clip(time / ramp, 0.0, 1.0)
    grown = radius * np.cos(elevation) * x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    return (grown * np.sin(TWO_PI * frequency_hz * time)).reshape(count, parts)
