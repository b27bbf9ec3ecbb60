"""Analog loops of orders 1 to 3: transfer functions, and errors under any motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import signal
from scipy.linalg import solve_continuous_lyapunov

from deepseis_core.types import FloatArray
from deepseis_tracking.loop_theory import PHASE_PER_METRE, natural_frequency

_POINTS = 4000


@dataclass(frozen=True)
class AnalogLoop:
    """A loop with the error transfer function ``1 - H(s) = s^N / D(s)``, T table 2.1.

    Parameters
    ----------
    natural_frequency : float
        ``wn`` [rad/s].
    denominator : tuple of float
        ``D(s)`` in units of ``s / wn``, from the highest power down to the constant: ``(1, 1)``,
        ``(1, 2 zeta, 1)`` or ``(1, b3, a3, 1)``. Their number is the order plus 1.
    """

    natural_frequency: float
    denominator: tuple[float, ...]

    @classmethod
    def for_bandwidth(
        cls, order: int, bandwidth_hz: float, damping: float = 0.5**0.5
    ) -> AnalogLoop:
        """Return the loop of table T 2.1; damping 1 is that of T 3.3.3 (of order 2 only)."""
        if order not in (1, 2, 3):
            raise ValueError(f"no loop of order {order}")
        if not (bandwidth_hz > 0.0 and damping > 0.0):
            raise ValueError(f"no loop of {bandwidth_hz} Hz with damping {damping}")
        shape = {1: (1.0, 1.0), 2: (1.0, 2.0 * damping, 1.0), 3: (1.0, 2.4, 1.1, 1.0)}[order]
        return cls(float(natural_frequency(order, bandwidth_hz, damping)), shape)

    @property
    def order(self) -> int:
        """N."""
        return len(self.denominator) - 1

    @property
    def poles(self) -> FloatArray:
        """Coefficients of D(s), highest power first, s in rad/s."""
        return np.array(self.denominator) * self.natural_frequency ** np.arange(self.order + 1)

    @property
    def noise_bandwidth_hz(self) -> float:
        """One-sided, ``integral of |H|^2 df``, from the impulse response of H (Lyapunov)."""
        system = signal.TransferFunction(self.poles[1:], self.poles).to_ss()
        gramian = solve_continuous_lyapunov(system.A, -system.B @ system.B.T)
        return 0.5 * float(np.squeeze(system.C @ gramian @ system.C.T))

    def error_gain(self, frequency_hz: ArrayLike) -> FloatArray:
        """Return ``|1 - H|`` at frequencies: how much of a phase oscillation stays untracked."""
        s = 2j * np.pi * np.asarray(frequency_hz, np.float64)
        return np.abs(s**self.order / np.polyval(self.poles, s))

    def sinusoid_error(self, amplitude: float, frequency_hz: ArrayLike) -> FloatArray:
        """Return the error's amplitude [rad] under a sinusoidal range of an amplitude [m]."""
        return PHASE_PER_METRE * amplitude * self.error_gain(frequency_hz)

    def error(self, time: FloatArray, range_m: FloatArray, derivative: int = 0) -> FloatArray:
        """Return the phase error [rad] while the range, or a derivative of it, moves.

        Parameters
        ----------
        time : ndarray, shape (n,)
            Equally spaced [s]; between, the input is a straight line. At the first one the
            loop is settled on zero.
        range_m : ndarray, shape (n,)
            Range [m], or its derivative [m/s^derivative], along the line of sight. An NCO that
            is advised wrongly has the error of the advice as its range rate, negative.
        derivative : int
            0 range, 1 velocity, 2 acceleration, 3 jerk.
        """
        zeros = self.order - derivative
        numerator = [1.0, *[0.0] * zeros] if zeros > 0 else [1.0]
        poles = np.concatenate([self.poles, np.zeros(max(-zeros, 0))])
        _, out, _ = signal.lsim((numerator, poles), range_m, time, X0=None)
        return PHASE_PER_METRE * np.asarray(out, np.float64)

    def step_error(self, time: FloatArray, step: float, derivative: int) -> FloatArray:
        """Return the phase error [rad] after a step of a derivative of the range at time 0."""
        return self.error(time, np.full(time.size, step), derivative)

    def velocity_step_peak(self, velocity: float) -> float:
        """Return the greatest phase error [rad] after a velocity step [m/s]: any damping, order.

        T 3.22 is its special case of order 2 and damping 1.
        """
        return self.step_peak(velocity, 1)

    def step_peak(self, step: float, derivative: int, duration: float | None = None) -> float:
        """Return the greatest phase error [rad] after a step of a derivative of the range.

        Parameters
        ----------
        step : float
            [m/s^derivative]
        derivative : int
            1 velocity, 2 acceleration, 3 jerk.
        duration : float, optional
            How long the step lasts [s]; default 20 / wn, where all has settled.
        """
        span = 20.0 / self.natural_frequency if duration is None else duration
        time = np.linspace(0.0, span, _POINTS)
        return float(np.abs(self.step_error(time, step, derivative)).max())

    def steady_error(self, derivative: float) -> float:
        """Return the phase error [rad] under a constant N-th derivative [m/s^N], T 3.5."""
        return PHASE_PER_METRE * derivative / self.natural_frequency**self.order

    def noise_growth(
        self, time: FloatArray, density: float, derivative: int, shaping: Sequence[float] = (1.0,)
    ) -> FloatArray:
        """Return sigma [rad] of the error since noise began to drive a derivative of the range.

        ``sqrt(q integral of h(u)^2 du)`` over 0..t, h the impulse response.

        Parameters
        ----------
        time : ndarray, shape (n,)
            From 0 on, equally spaced [s].
        density : float
            ``q`` of the driving white noise, ``E[w(t) w(t')] = q delta(t - t')``.
        derivative : int
            What the (shaped) noise is: 2 an acceleration, 3 a jerk.
        shaping : sequence of float
            Denominator of a filter between: ``(1, 1 / tau)`` makes a Gauss-Markov process.
        """
        zeros = self.order - derivative
        numerator = [1.0, *[0.0] * zeros] if zeros > 0 else [1.0]
        poles = np.concatenate([np.polymul(self.poles, shaping), np.zeros(max(-zeros, 0))])
        _, h = signal.impulse((numerator, poles), T=time)
        squares = np.concatenate([[0.0], np.cumsum((h[1:] ** 2 + h[:-1] ** 2) / 2.0)])
        return PHASE_PER_METRE * np.sqrt(density * squares * (time[1] - time[0]))
