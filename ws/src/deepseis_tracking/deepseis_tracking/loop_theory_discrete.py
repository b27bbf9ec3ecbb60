"""The discrete loop that is really used: its errors under noise, motion and oscillator.

At 20 ms the analog formulas are 25 to 240 % off (decision 0006). Here the loop of `loop_filter` is
taken as it is: it measures the mean phase error of an integration and corrects the next one.
Linear: the discriminator's limits and cycle slips are those of `loop_theory_simulation`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from deepseis_core.constants import L1_HZ
from deepseis_core.types import FloatArray
from deepseis_tracking.loop_filter import LoopGains, design_loop, transition
from deepseis_tracking.loop_theory import OCXO, PHASE_PER_METRE, discriminator_noise, thermal_noise

_POINTS = 6000  # over 6 decades: 0.3 % apart, a twentieth of a lobe at the upper end


@dataclass(frozen=True)
class DiscreteLoop:
    """A loop of `loop_filter` at an integration time [s]."""

    gains: LoopGains
    period: float

    @classmethod
    def design(
        cls, order: int, bandwidth_hz: float, period: float, *, realised: bool = True
    ) -> DiscreteLoop:
        """Return the loop of a bandwidth; ``realised=False``: by the papers' analog constants."""
        return cls(design_loop(order, bandwidth_hz, period, realised=realised), period)

    @property
    def noise_bandwidth_hz(self) -> float:
        """The realised one; infinite if the loop is unstable."""
        return self.gains.noise_bandwidth_hz

    def error_response(self, frequency_hz: ArrayLike) -> NDArray[np.complex128]:
        """Return mean phase errors of integrations per phase oscillation of the signal.

        ``sin(pi f T) / (pi f T) (1 + m (z I - A)^-1 b)`` at ``z = exp(2 pi i f T)``, of the phase
        at the integration's middle. The loop's true error (over an integration) and its
        discriminator's output without noise are the same number. Infinite if the loop is unstable.
        """
        if not np.isfinite(self.noise_bandwidth_hz):
            return np.full(np.shape(frequency_hz), np.inf, np.complex128)
        frequency = np.atleast_1d(np.asarray(frequency_hz, np.float64))
        matrix, drive, measure = self._system()
        z = np.exp(2j * np.pi * frequency * self.period)[:, None, None]
        resolvent = z * np.eye(len(drive)) - matrix
        replica = np.linalg.solve(
            resolvent, np.broadcast_to(drive[:, None], (z.size, drive.size, 1))
        )
        response = (1.0 + np.asarray(measure @ replica, np.complex128)[:, 0]) * np.sinc(
            frequency * self.period
        )
        return np.asarray(response.reshape(np.shape(frequency_hz)), np.complex128)

    def _system(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """State matrix, input, and what is measured, of the states that the order has."""
        gains = self.gains
        matrix, drive = transition(gains.k1, gains.k2, gains.k3, self.period)
        keep = np.arange(gains.order + 1)
        measure = np.array([-1.0, -self.period / 2.0, 0.0, 0.0])
        return matrix[np.ix_(keep, keep)], drive[keep], measure[keep]

    def sinusoid_error(
        self, amplitude: float, frequency_hz: ArrayLike, elevation: float = 0.0
    ) -> FloatArray:
        """Return the error's amplitude [rad] under level sinusoidal motion, a circle too.

        Parameters
        ----------
        amplitude : float
            Of the motion, or radius [m].
        elevation : float
            Of the satellite, in whose azimuth the motion goes [rad].
        """
        size = PHASE_PER_METRE * amplitude * np.cos(elevation)
        return size * np.abs(self.error_response(frequency_hz))

    def motion_error(self, range_m: FloatArray) -> FloatArray:
        """Return mean phase errors [rad] of integrations under any motion, from rest.

        Parameters
        ----------
        range_m : ndarray, shape (n,)
            Change of range, averaged over each integration [m].
        """
        matrix, drive, measure = self._system()
        state, out = np.zeros(drive.size), np.empty(range_m.size)
        for k, theta in enumerate(np.asarray(range_m, np.float64) * PHASE_PER_METRE):
            out[k] = theta + measure @ state
            state = matrix @ state + drive * theta
        return out

    def steady_error(self, derivative: float) -> float:
        """Return the phase error [rad] under a constant N-th derivative of range [m/s^N].

        ``(2 pi / lambda) (d^N R / dt^N) T / k_N`` with the highest gain; ``k1`` of order 1
        standing alone: ``1 / k1``.
        """
        gains = self.gains
        last = {1: gains.k1, 2: gains.k2 / self.period, 3: gains.k3 / self.period}[gains.order]
        return PHASE_PER_METRE * derivative / last

    def thermal_noise(self, cn0_dbhz: ArrayLike) -> FloatArray:
        """Return the true phase error by thermal noise [rad], averaged over integrations."""
        return thermal_noise(self.noise_bandwidth_hz, cn0_dbhz, self.period)

    def discriminator_noise(self, cn0_dbhz: ArrayLike) -> FloatArray:
        """Return what the discriminator shows of thermal noise [rad]."""
        return discriminator_noise(cn0_dbhz, self.period, bandwidth_hz=self.noise_bandwidth_hz)

    def oscillator_noise(self, h: Sequence[float] = OCXO) -> float:
        """Return the true phase error by the oscillator's noise [rad].

        ``sqrt(integral of f1^2 / f^2 S_y(f) |error response|^2 df)`` over f > 0, S_y one-sided:
        `allan_noise` for the loop as it is. Infinite for a loop of order 1 with random-walk noise.

        Parameters
        ----------
        h : sequence of three float
            ``h_0, h_-1, h_-2`` of fractional frequency.
        """
        if self.gains.order == 1 and h[2] > 0.0:
            return np.inf
        h_0, h_1, h_2 = h

        corner = self.gains.natural_frequency / (2.0 * np.pi)
        f = np.geomspace(1e-4 * corner, 20.0 / self.period, _POINTS)
        noise = h_0 + h_1 / f + h_2 / f**2
        power = np.trapezoid(noise / f * np.abs(self.error_response(f)) ** 2, np.log(f))
        return float(L1_HZ * np.sqrt(power))
