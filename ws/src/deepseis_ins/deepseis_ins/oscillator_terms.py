"""What a shaken oscillator feels: its g-sensitivity, found while shaking and predicted.

An oscillator on the moving body runs fast by ``y = y_0 + Gamma . (f - f_0)``, f being the
specific force in body axes and f_0 that at rest: at 1e-9/g and 2 g, 1 Hz, the phase of all
satellites swings by half a cycle. The drift of PVT shows c y. A Kalman filter of four states, the
drift at rest (a random walk) and c Gamma, takes both apart as soon as the body shakes; Gamma then
predicts the Doppler that all satellites have in common, ``-f1 Gamma . (f - f_0)``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from deepseis_core.constants import L1_WAVELENGTH, SPEED_OF_LIGHT
from deepseis_core.imu_grades import STANDARD_GRAVITY
from deepseis_core.types import FloatArray, Pvt
from deepseis_ins.antenna_motion import polynomial_weights
from deepseis_ins.fusion_config import FusionConfig
from deepseis_ins.imu_history import ImuHistory

_FIRST_SD = 1e4
"""Of a drift that is not known yet [m/s]."""
_GATE = 6.0
_POINTS = 4
"""IMU epochs in the polynomial that gives the force at an epoch of PVT."""
_AROUND = 4
"""Rows of IMU data on each side of it."""
_RESTS = 100
"""Epochs in the mean of the force at rest."""


@dataclass(frozen=True)
class OscillatorState:
    """What is known.

    Attributes
    ----------
    x : ndarray, shape (4,)
        Drift at rest [m/s], c Gamma [m/s per m/s^2].
    P : ndarray, shape (4, 4)
        Its covariance.
    rest : ndarray, shape (3,) or None
        Specific force at rest [m/s^2]; None before the body has been seen still.
    rests : int
        How many went into it.
    seconds : float or None
        Time of the last drift [s].
    """

    x: FloatArray
    P: FloatArray
    rest: FloatArray | None = None
    rests: int = 0
    seconds: float | None = None


class OscillatorTerms:
    """Estimates drift and g-sensitivity from drifts of PVT.

    Parameters
    ----------
    config : FusionConfig

    Attributes
    ----------
    state : OscillatorState
        Assign an earlier one to undo what came after it.
    """

    def __init__(self, config: FusionConfig) -> None:
        self.config = config
        sd = config.oscillator_sensitivity_sd * SPEED_OF_LIGHT / STANDARD_GRAVITY
        self.state = OscillatorState(np.zeros(4), np.diag([_FIRST_SD**2, *[sd**2] * 3]))

    @property
    def sensitivity(self) -> FloatArray:
        """Gamma [1/g], shape (3,), in the axes of the forces given."""
        return self.state.x[1:] * (STANDARD_GRAVITY / SPEED_OF_LIGHT)

    @property
    def sensitivity_sd(self) -> FloatArray:
        """One sigma of it [1/g], shape (3,)."""
        return np.sqrt(np.diag(self.state.P)[1:]) * (STANDARD_GRAVITY / SPEED_OF_LIGHT)

    def take(self, pvt: Pvt, history: ImuHistory, sample_rate_hz: float, *, still: bool) -> bool:
        """Take the drift of a PVT, and the force from the IMU data around it; see `update`."""
        row = history.number_at(pvt.sample_index)
        begin, end = row - _AROUND, row + _AROUND + 1
        if begin < history.first or end > history.end:
            return False
        gained = np.cumsum(history.increments(begin, end)[1], axis=0)
        time = (history.indices(begin, end) - pvt.sample_index) / sample_rate_hz
        if still:
            force = (gained[-1] - gained[0]) / (time[-1] - time[0])
            self.rest_at(force)
        else:
            force = (polynomial_weights(time, np.zeros(1), _POINTS)[1] @ gained)[0]
        return self.update(pvt.sample_index / sample_rate_hz, pvt.clock_drift, force)

    def rest_at(self, force_b: FloatArray) -> None:
        """Take a specific force at rest [m/s^2]: the mean of many counts."""
        rests = min(self.state.rests + 1, _RESTS)
        rest = force_b if self.state.rest is None else self.state.rest
        rest = rest + (force_b - rest) / rests
        self.state = replace(self.state, rest=rest, rests=rests)

    def update(self, seconds: float, drift: float, force_b: FloatArray) -> bool:
        """Take one drift.

        Parameters
        ----------
        seconds : float
            Time; not before that of the last one [s].
        drift : float
            Of the receiver's clock times c [m/s].
        force_b : ndarray, shape (3,)
            Specific force then [m/s^2].

        Returns
        -------
        bool
            Whether it was used: it is a number, and agrees with what is known.
        """
        state = self.state
        if state.rest is None or not np.isfinite(drift):
            return False
        elapsed = 0.0 if state.seconds is None else seconds - state.seconds
        P = state.P.copy()
        P[0, 0] += self.config.oscillator_walk**2 * elapsed
        h = np.concatenate([[1.0], force_b - state.rest])
        innovation = drift - h @ state.x
        noise = self.config.drift_noise**2
        variance = h @ P @ h + noise
        if innovation**2 > _GATE**2 * variance:
            # A jump of the oscillator, or a bad fix: what it feels does not change by that.
            P[0, 0] += innovation**2
            self.state = replace(state, P=P, seconds=seconds)
            return False
        gain = P @ h / variance
        kept = np.eye(4) - np.outer(gain, h)
        P = kept @ P @ kept.T + np.outer(gain, gain) * noise
        self.state = replace(state, x=state.x + gain * innovation, P=P, seconds=seconds)
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
        hz_per_force = self.state.x[1:] / -L1_WAVELENGTH
        force, rate = weights[1] @ gained_b, weights[2] @ gained_b
        return (force - self.state.rest) @ hz_per_force, rate @ hz_per_force
