"""The slow errors of GNSS positions and velocities, learnt while the station stands still.

A single-point position is off by metres that change over minutes: orbits, satellite clocks,
atmosphere. A station that stands still knows where it is, sees that error and takes it off when
it moves. What is left then is noise and what the error has changed since. That change is the
same for many epochs: a filter that takes errors as independent is told a variance so much larger
(`inflation`) that it gives a second of data no more weight than they have.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from deepseis_core.types import FloatArray
from deepseis_ins.fusion_config import FusionConfig

UNKNOWN_SD = 10.0
"""Of the slow error of positions before it is known [m]."""

_GATE = 40.0
"""Of the normalised square of three values: 1e-8 of good ones exceed it."""


@dataclass(frozen=True)
class Correction:
    """A measurement without its slow error, and the covariance to be used for it, ECEF."""

    value: FloatArray
    covariance: FloatArray


@dataclass(frozen=True)
class SlowError:
    """One slow error, a random walk: mean, covariance and when (frozen, so that undoing is easy).

    Parameters
    ----------
    noise_share, correlation_s : float
        Noise as a part of the formal sigma, and its correlation time [s].
    growth : float
        Random walk [SI/sqrt(s)].
    common_s : float
        What is not known of the slow error stays the same over this [s].
    covariance : ndarray, shape (3, 3)
        Of the mean.
    """

    noise_share: float
    correlation_s: float
    growth: float
    common_s: float
    covariance: FloatArray
    mean: FloatArray
    seconds: float | None = None

    def learn(
        self, seconds: float, value: FloatArray, known: FloatArray, formal: FloatArray, dt: float
    ) -> SlowError:
        """Return what is known after a measurement of something that is known.

        One that lies outside of what its formal sigma allows changes nothing.

        Parameters
        ----------
        seconds : float
            Time of it [s].
        value, known : ndarray, shape (3,)
            Measurement and what it should be.
        formal : ndarray, shape (3, 3)
            Covariance that came with it.
        dt : float
            Time between measurements [s].
        """
        P = self._covariance_at(seconds)
        R = self._noise(formal, dt)
        innovation = value - known - self.mean
        if innovation @ np.linalg.solve(P + R + formal, innovation) > _GATE:
            return self
        gain = P @ np.linalg.inv(P + R)
        mean = self.mean + gain @ innovation
        P = P - gain @ P
        return replace(self, mean=mean, covariance=0.5 * (P + P.T), seconds=seconds)

    def correct(
        self, seconds: float, value: FloatArray, formal: FloatArray, dt: float
    ) -> Correction:
        """Take the slow error off a measurement of something unknown; see `learn`."""
        common = inflation(self.common_s, dt) * self._covariance_at(seconds)
        return Correction(value - self.mean, self._noise(formal, dt) + common)

    def _covariance_at(self, seconds: float) -> FloatArray:
        elapsed = 0.0 if self.seconds is None else max(seconds - self.seconds, 0.0)
        return self.covariance + self.growth**2 * elapsed * np.eye(3)

    def _noise(self, formal: FloatArray, dt: float) -> FloatArray:
        return self.noise_share**2 * inflation(self.correlation_s, dt) * formal


def inflation(correlation_s: float, dt: float) -> float:
    """Return by what the variance of correlated errors is raised to be taken as independent.

    The mean of many values ``dt`` apart, with the correlation ``exp(-t / tau)``, has the variance
    of that many independent ones times ``coth(dt / 2 tau)``.

    Examples
    --------
    >>> inflation(0.0, 0.1), round(inflation(10.0, 0.1))
    (1.0, 200)
    """
    if correlation_s <= 0.0:
        return 1.0
    return float(1.0 / np.tanh(0.5 * dt / correlation_s))


def position_error(config: FusionConfig) -> SlowError:
    """Return what is known of the position's slow error at the start."""
    return SlowError(
        config.position_noise_share,
        config.position_correlation_s,
        config.position_growth,
        config.offset_correlation_s,
        UNKNOWN_SD**2 * np.eye(3),
        np.zeros(3),
    )


def velocity_error(config: FusionConfig) -> SlowError:
    """Return what is known of the velocity's slow error at the start."""
    return SlowError(
        config.velocity_noise_share,
        config.velocity_correlation_s,
        config.velocity_growth,
        config.offset_correlation_s,
        config.velocity_offset_sd**2 * np.eye(3),
        np.zeros(3),
    )
