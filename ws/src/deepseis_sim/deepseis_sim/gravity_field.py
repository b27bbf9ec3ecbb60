"""Gravity beyond the normal field: a smooth disturbance over the survey area.

The *gravity disturbance* is gravity minus normal gravity at the same point, along the vertical and
positive down: where it is positive, gravity is stronger and pulls down more. It is a sum of plane
waves in the tangent plane's east and north, each of which fades with height as a harmonic field
above its sources does::

    delta_g = sum_k a cos(k_k . (e, n) + phi_k) exp(-|k_k| u)

Its horizontal part (the deflection of the vertical) is left out: the papers' gravimetry is scalar.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from deepseis_core.config import setting
from deepseis_core.types import FloatArray
from deepseis_sim.motions_shapes import check_settings

GRAVITY_STREAM: Final = 404
"""Stream number of the field's random numbers."""

WAVES: Final = 8
MGAL: Final = 1e-5
"""[m/s^2]"""


@dataclass(frozen=True)
class GravityDisturbance:
    """A disturbance field; callable, as `deepseis_sim.imu.ImuSynthesizer` wants it.

    Attributes
    ----------
    waves : ndarray, shape (2, k)
        Wave vectors, east and north [rad/m].
    phase : ndarray, shape (k,)
        [rad].
    amplitude : float
        Of each wave at the origin's height [m/s^2].
    """

    waves: FloatArray
    phase: FloatArray
    amplitude: float

    def disturbance(self, position: FloatArray) -> FloatArray:
        """Return the disturbance, positive down.

        Parameters
        ----------
        position : ndarray, shape (m, 3)
            Tangent frame: east, north, up [m].

        Returns
        -------
        ndarray, shape (m,)
            [m/s^2].
        """
        if self.amplitude == 0.0:
            return np.zeros(len(position))
        decay = np.exp(-np.multiply.outer(position[:, 2], np.linalg.norm(self.waves, axis=0)))
        # No BLAS: its rounding depends on how many points there are.
        east, north = (np.multiply.outer(position[:, k], self.waves[k]) for k in range(2))
        waves = np.cos(east + north + self.phase)
        return self.amplitude * (waves * decay).sum(axis=1)

    __call__ = disturbance


@dataclass(frozen=True)
class GravityField:
    """Size and scale of the gravity disturbance."""

    amplitude_mgal: float = setting(
        30.0, "twice its RMS over the plane [mGal]; 0: none", low=0.0, high=500.0
    )
    wavelength: float = setting(2500.0, "shortest wavelength [m]", low=100.0, high=1e6)
    longest: float = setting(12000.0, "longest wavelength [m]", low=100.0, high=1e7)

    def build(self, seed: int) -> GravityDisturbance:
        """Draw the field."""
        check_settings("gravity", self)
        rng = np.random.default_rng([seed, GRAVITY_STREAM])
        shares = (np.arange(WAVES) + rng.random(WAVES)) / WAVES
        high, low = 2.0 * np.pi / np.array([self.wavelength, max(self.longest, self.wavelength)])
        number = low * (high / low) ** shares
        direction = rng.uniform(0.0, 2.0 * np.pi, WAVES)
        return GravityDisturbance(
            number * np.array([np.cos(direction), np.sin(direction)]),
            rng.uniform(0.0, 2.0 * np.pi, WAVES),
            MGAL * 0.5 * self.amplitude_mgal * np.sqrt(2.0 / WAVES),
        )
