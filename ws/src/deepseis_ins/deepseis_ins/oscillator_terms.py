"""What a shaken oscillator feels: its g-sensitivity, found while shaking and predicted.

An oscillator on the moving body runs fast by ``y = y_0 + Gamma . (f - f_0)``, f being the
specific force in body axes and f_0 that at rest: at 1e-9/g and 2 g, 1 Hz, the phase of all
satellites swings by half a cycle. A Kalman filter of five states, the clock b, its drift at rest d
(a random walk) and c Gamma, takes that apart as soon as the body shakes::

    b(t) = b(s) + d (t - s) + c Gamma . (integral of f - f_0 from s to t)

The clock comes with precise positions: its change is known to millimetres at 50 Hz, so that a
tenth of the first half cycle tells Gamma. Without them the drift of PVT is used, which is
``d + c Gamma . (f - f_0)`` with 0.1 m/s of noise: that takes seconds of shaking. Who knows Gamma
before the first earthquake (each axis turned over in gravity, or an earlier event) gives it as a
setting. It predicts the Doppler that all satellites have in common, ``-f1 Gamma . (f - f_0)``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from deepseis_core.constants import L1_WAVELENGTH, SPEED_OF_LIGHT
from deepseis_core.errors import InputError
from deepseis_core.imu_grades import STANDARD_GRAVITY
from deepseis_core.rotation import flu_from_frd
from deepseis_core.types import FloatArray
from deepseis_ins.antenna_motion import polynomial_weights
from deepseis_ins.fusion_config import FusionConfig
from deepseis_ins.gnss_epochs import Epoch, PreciseEpoch
from deepseis_ins.imu_history import ImuHistory

PER_G = SPEED_OF_LIGHT / STANDARD_GRAVITY
"""From sensitivity [1/g] to c Gamma [m/s per m/s^2]."""
_FIRST = np.array([1e8, 1e4])
"""Sigma of a clock and a drift that are not known yet [m, m/s]."""
_GATE = 6.0
_POINTS = 4
"""IMU epochs in the polynomial that gives forces at an epoch of GNSS."""
_AROUND = 4
"""Rows of IMU data on each side of it."""
_RESTS = 100
"""Epochs in the mean of the force at rest."""
_GAP_S = 2.0
"""Between epochs: after a longer time the clock is not carried on [s]."""


@dataclass(frozen=True)
class OscillatorState:
    """What is known.

    Attributes
    ----------
    x : ndarray, shape (5,)
        Clock [m], drift at rest [m/s], c Gamma [m/s per m/s^2].
    P : ndarray, shape (5, 5)
        Its covariance.
    rest : ndarray, shape (3,) or None
        Specific force at rest [m/s^2]; None before the body has been seen still.
    rests : int
        How many went into it.
    sample_index : int
        Of the last epoch; -1: none.
    clock_at : int
        Of the last clock of a precise position; -1: none.
    """

    x: FloatArray
    P: FloatArray
    rest: FloatArray | None = None
    rests: int = 0
    sample_index: int = -1
    clock_at: int = -1


class OscillatorTerms:
    """Estimates clock, drift and g-sensitivity from what GNSS says of the clock.

    Parameters
    ----------
    config : FusionConfig
    sample_rate_hz : float

    Attributes
    ----------
    state : OscillatorState
        Assign an earlier one to undo what came after it.
    """

    def __init__(self, config: FusionConfig, sample_rate_hz: float) -> None:
        given = np.asarray(config.oscillator_sensitivity or [0.0] * 3, np.float64)
        if given.shape != (3,) or not (np.abs(given) < 1e-6).all():
            raise InputError("oscillator_sensitivity", f"is {given}", "three numbers [1/g], FLU")
        self.config, self.sample_rate_hz = config, sample_rate_hz
        sd = np.array([*_FIRST, *[config.oscillator_sensitivity_sd * PER_G] * 3])
        x = np.concatenate([np.zeros(2), flu_from_frd(given) * PER_G])
        self.state = OscillatorState(x, np.diag(sd**2))

    @property
    def sensitivity(self) -> FloatArray:
        """Gamma [1/g], shape (3,), in the axes of the forces given."""
        return self.state.x[2:] / PER_G

    @property
    def sensitivity_sd(self) -> FloatArray:
        """One sigma of it [1/g], shape (3,)."""
        return np.sqrt(np.diag(self.state.P)[2:]) / PER_G

    def report(self) -> dict[str, str]:
        """Return what is known, forward-left-up [1e-9/g], for diagnostics and later settings."""
        values = flu_from_frd(self.sensitivity), self.sensitivity_sd
        texts = [" ".join(f"{1e9 * v:.4f}" for v in value.tolist()) for value in values]
        return dict(zip(("g_sensitivity_ppb", "g_sensitivity_sd_ppb"), texts, strict=True))

    def take(self, epoch: Epoch, history: ImuHistory, *, still: bool) -> bool:
        """Take what an epoch of GNSS says of the clock, and the IMU data around and before it.

        Returns
        -------
        bool
            Whether it was used: it is a number, and agrees with what is known.
        """
        row = history.number_at(epoch.sample_index)
        begin, end = row - _AROUND, row + _AROUND + 1
        if begin < history.first or end > history.end:
            return False
        force, gained = self._forces(epoch.sample_index, history, still=still)
        if still:
            self.rest_at(force)
        if self.state.rest is None:
            return False
        self.carry(epoch.sample_index, gained)
        if isinstance(epoch, PreciseEpoch):
            return self.clock(epoch.clock_bias, epoch.clock_bias_sd)
        hold = round(self.config.precise_hold_s * self.sample_rate_hz)
        if 0 <= epoch.sample_index - self.state.clock_at <= hold and self.state.clock_at >= 0:
            return False
        return self.drift(epoch.clock_drift, force)

    def _forces(
        self, sample_index: int, history: ImuHistory, *, still: bool
    ) -> tuple[FloatArray, FloatArray | None]:
        """Return the specific force at a sample, and its integral since the last epoch.

        The latter [m/s] is None where it is not known.
        """
        before, row = self.state.sample_index, history.number_at(sample_index)
        first = row - _AROUND
        near = 0 <= before <= sample_index < before + _GAP_S * self.sample_rate_hz
        if near:
            first = min(first, history.number_at(before) - _AROUND)
        if first < history.first:
            near, first = False, row - _AROUND
        rows = first, row + _AROUND + 1
        gained = np.cumsum(history.increments(*rows)[1], axis=0)
        time = (history.indices(*rows) - sample_index) / self.sample_rate_hz
        knots = np.array([0.0, (before - sample_index) / self.sample_rate_hz if near else 0.0])
        value, rate, _ = polynomial_weights(time, knots, _POINTS)
        integral = (value[0] - value[1]) @ gained if near else None
        if still:
            last = slice(-2 * _AROUND - 1, None)
            sums, times = gained[last], time[last]
            return (sums[-1] - sums[0]) / (times[-1] - times[0]), integral
        return rate[0] @ gained, integral

    def rest_at(self, force_b: FloatArray) -> None:
        """Take a specific force at rest [m/s^2]: the mean of many counts."""
        rests = min(self.state.rests + 1, _RESTS)
        rest = force_b if self.state.rest is None else self.state.rest
        rest = rest + (force_b - rest) / rests
        self.state = replace(self.state, rest=rest, rests=rests)

    def carry(self, sample_index: int, gained_b: FloatArray | None) -> None:
        """Carry the state to a sample over the integral of the specific force since [m/s].

        Without it the clock is not known any more.
        """
        state, config = self.state, self.config
        assert state.rest is not None
        since = state.sample_index if state.sample_index >= 0 else sample_index
        dt = (sample_index - since) / self.sample_rate_hz
        F = np.eye(5)
        F[0, 1] = dt
        P, walk2 = state.P.copy(), config.oscillator_walk**2
        if gained_b is None:
            P[0, :], P[:, 0] = 0.0, 0.0
            P[0, 0] = _FIRST[0] ** 2
        else:
            F[0, 2:] = gained_b - state.rest * dt
        P = F @ P @ F.T
        P[0, 0] += config.oscillator_phase_walk**2 * dt + walk2 * dt**3 / 3.0
        P[0, 1] += walk2 * dt**2 / 2.0
        P[1, 0] = P[0, 1]
        P[1, 1] += walk2 * dt
        self.state = replace(state, x=F @ state.x, P=P, sample_index=sample_index)

    def clock(self, clock_bias: float, sd: float) -> bool:
        """Take the clock of a precise position at the time carried to [m]."""
        if not (np.isfinite(clock_bias) and sd > 0.0 and np.isfinite(sd)):
            return False
        self.state = replace(self.state, clock_at=self.state.sample_index)
        return self._update(clock_bias, np.array([1.0, 0.0, 0.0, 0.0, 0.0]), sd)

    def drift(self, drift: float, force_b: FloatArray) -> bool:
        """Take a drift of PVT [m/s] and the specific force at the time carried to [m/s^2]."""
        if not np.isfinite(drift):
            return False
        assert self.state.rest is not None
        h = np.concatenate([[0.0, 1.0], force_b - self.state.rest])
        return self._update(drift, h, self.config.drift_noise)

    def _update(self, value: float, h: FloatArray, sd: float) -> bool:
        state, noise = self.state, sd**2
        P = state.P
        innovation = value - h @ state.x
        variance = h @ P @ h + noise
        if innovation**2 > _GATE**2 * variance:
            # A jump of clock or oscillator, or a bad fix: what it feels does not change by that.
            jumped = int(np.argmax(h != 0.0))
            widened = P.copy()
            widened[jumped, jumped] += innovation**2
            self.state = replace(state, P=widened)
            return False
        gain = P @ h / variance
        kept = np.eye(5) - np.outer(gain, h)
        P = kept @ P @ kept.T + np.outer(gain, gain) * noise
        self.state = replace(state, x=state.x + gain * innovation, P=P)
        return True

    def doppler(self, weights: FloatArray, gained_b: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the Doppler common to all satellites and its rate at m knots [Hz, Hz/s].

        Without the constant part: that of the drift at rest is left to the loops.

        Parameters
        ----------
        weights : ndarray, shape (3, m, n)
            `antenna_motion.KnotInterpolator.weights`.
        gained_b : ndarray, shape (n, 3)
            Sum of the velocity increments at n epochs [m/s].
        """
        if self.state.rest is None:
            return np.zeros(weights.shape[1]), np.zeros(weights.shape[1])
        hz_per_force = self.state.x[2:] / -L1_WAVELENGTH
        force, rate = weights[1] @ gained_b, weights[2] @ gained_b
        return (force - self.state.rest) @ hz_per_force, rate @ hz_per_force
