"""What a shaken oscillator feels: its g-sensitivity, found while shaking and predicted.

An oscillator on the moving body runs fast by ``y = y_0 + Gamma . (f - f_0)``, f being the
specific force in body axes and f_0 that at rest: at 1e-9/g and 2 g, 1 Hz, the phase of all
satellites swings by half a cycle. The drift of PVT shows c y. A Kalman filter of four states, the
drift at rest (a random walk) and c Gamma, takes both apart as soon as the body shakes; Gamma then
predicts the Doppler that all satellites have in common, ``-f1 Gamma . (f - f_0)``.
"""

from __future__ import annotations

import numpy as np

from deepseis_core.constants import L1_WAVELENGTH, SPEED_OF_LIGHT
from deepseis_core.imu_grades import STANDARD_GRAVITY
from deepseis_core.types import FloatArray, Pvt
from deepseis_ins.antenna_motion import LEVER_POINTS, polynomial_weights
from deepseis_ins.fusion_config import FusionConfig
from deepseis_ins.imu_history import ImuHistory

_FIRST_SD = 1e4
"""Of a drift that is not known yet [m/s]."""
_GATE = 6.0
_AROUND = 4
"""Rows of IMU data on each side of an epoch."""
_RESTS = 100
"""Epochs in the mean of the force at rest."""


class OscillatorTerms:
    """Estimates drift and g-sensitivity from drifts of PVT.

    Parameters
    ----------
    config : FusionConfig

    Attributes
    ----------
    rest : ndarray, shape (3,) or None
        Specific force at rest [m/s^2]; None before the body has been seen still.
    """

    def __init__(self, config: FusionConfig) -> None:
        self.config = config
        self.rest: FloatArray | None = None
        sensitivity = config.oscillator_sensitivity_sd * SPEED_OF_LIGHT / STANDARD_GRAVITY
        self._x = np.zeros(4)
        self._P = np.diag([_FIRST_SD**2, *[sensitivity**2] * 3])
        self._seconds: float | None = None
        self._rests = 0

    @property
    def sensitivity(self) -> FloatArray:
        """Gamma [1/g], shape (3,), in the axes of the forces given."""
        return self._x[1:] * (STANDARD_GRAVITY / SPEED_OF_LIGHT)

    @property
    def sensitivity_sd(self) -> FloatArray:
        """One sigma of it [1/g], shape (3,)."""
        return np.sqrt(np.diag(self._P)[1:]) * (STANDARD_GRAVITY / SPEED_OF_LIGHT)

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
            force = (polynomial_weights(time, np.zeros(1), LEVER_POINTS)[1] @ gained)[0]
        return self.update(pvt.sample_index / sample_rate_hz, pvt.clock_drift, force)

    def rest_at(self, force_b: FloatArray) -> None:
        """Take a specific force at rest [m/s^2]: the mean of many counts."""
        self._rests = min(self._rests + 1, _RESTS)
        rest = force_b if self.rest is None else self.rest
        self.rest = rest + (force_b - rest) / self._rests

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
        if self.rest is None or not np.isfinite(drift):
            return False
        elapsed = 0.0 if self._seconds is None else seconds - self._seconds
        self._seconds = seconds
        self._P[0, 0] += self.config.oscillator_walk**2 * max(elapsed, 0.0)
        h = np.concatenate([[1.0], force_b - self.rest])
        innovation = drift - h @ self._x
        variance = h @ self._P @ h + self.config.drift_noise**2
        if innovation**2 > _GATE**2 * variance:
            # A jump of the oscillator, or a bad fix: what it feels does not change by that.
            self._P[0, 0] += innovation**2
            return False
        gain = self._P @ h / variance
        self._x = self._x + gain * innovation
        rest = np.eye(4) - np.outer(gain, h)
        self._P = rest @ self._P @ rest.T + np.outer(gain, gain) * self.config.drift_noise**2
        return True

    def doppler(self, force_b: FloatArray) -> FloatArray:
        """Return the Doppler common to all satellites [Hz], shape (m,), of forces, (m, 3).

        Without the constant part: that of the drift at rest is left to the loops.
        """
        if self.rest is None:
            return np.zeros(len(force_b))
        return (force_b - self.rest) @ self._x[1:] / -L1_WAVELENGTH

    def doppler_rate(self, force_rate_b: FloatArray) -> FloatArray:
        """Return its derivative [Hz/s], shape (m,), of that of the force [m/s^3], (m, 3)."""
        return force_rate_b @ self._x[1:] / -L1_WAVELENGTH
