"""The slow errors of GNSS positions and velocities, learnt while the station stands still.

A single-point position is off by metres that change over minutes: orbits, satellite clocks,
atmosphere. A station that stands still knows where it is, sees that error and takes it off when
it moves. What is left then is noise and what the error has changed since. That change is the
same for many epochs: a filter that takes errors as independent is told a variance so much larger
(`inflation`) that it gives a second of data no more weight than they have.

Positions from carrier phases are off by millimetres that creep. The filter is told their noise
alone and follows them; how far they may have crept, as they say and since they were last compared
with a known place, adds to what it says of its own position (`GnssOffsets.crept`). Taken as noise
it would cost the velocity what it cannot harm: no accelerometer sees a millimetre in a minute.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from deepseis_core.types import FloatArray
from deepseis_ins.fusion_config import FusionConfig
from deepseis_ins.gnss_epochs import RTK

UNKNOWN_SD = 10.0
"""Of the slow error of positions before it is known [m]."""

_GATE = 40.0
"""Of the normalised square of three values: 1e-8 of good ones exceed it."""
_NOISES = 500
"""Values in the mean that tells the noise of precise positions."""
_LEAST, _MOST = 0.02, 9.0
"""Of their noise's variance as a part of the formal one."""


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
    noises: int = 0
    """Values that the noise's share has been told from; 0: it stays as it is."""

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
        P = self.covariance_at(seconds)
        R = self._noise(formal, dt)
        innovation = value - known - self.mean
        if innovation @ np.linalg.solve(P + R + formal, innovation) > _GATE:
            return self
        gain = P @ np.linalg.inv(P + R)
        mean = self.mean + gain @ innovation
        told = self._told(innovation, P, formal, dt) if self.noises else self
        P = P - gain @ P
        return replace(told, mean=mean, covariance=0.5 * (P + P.T), seconds=seconds)

    def _told(
        self, innovation: FloatArray, P: FloatArray, formal: FloatArray, dt: float
    ) -> SlowError:
        """Return the same with a share of noise that agrees better with an innovation."""
        share2 = (innovation**2 - np.diag(P)).sum() / np.diag(formal).sum()
        count = min(self.noises + 1, _NOISES)
        mean = self.noise_share**2 + (share2 - self.noise_share**2) / count
        share = float(np.sqrt(min(max(mean, _LEAST), _MOST)))
        return replace(self, noise_share=share, noises=count)

    def correct(
        self, seconds: float, value: FloatArray, formal: FloatArray, dt: float
    ) -> Correction:
        """Take the slow error off a measurement of something unknown; see `learn`."""
        common = inflation(self.common_s, dt) * self.covariance_at(seconds)
        return Correction(value - self.mean, self._noise(formal, dt) + common)

    def take_off(self, value: FloatArray, formal: FloatArray, dt: float) -> Correction:
        """Take the slow error off, and leave what is unknown of it to `GnssOffsets.crept`."""
        return Correction(value - self.mean, self._noise(formal, dt))

    def refer(self, seconds: float, off: FloatArray, covariance: FloatArray) -> SlowError:
        """Return what is known after a jump: off by so much more, as uncertain as said."""
        return replace(self, mean=self.mean + off, covariance=covariance, seconds=seconds)

    def covariance_at(self, seconds: float) -> FloatArray:
        """Return the covariance of the slow error at a time."""
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


def precise_error(config: FusionConfig, kind: str) -> SlowError:
    """Return what is known of the slow error of a kind of precise positions at the start."""
    against_base = kind.startswith(RTK)
    return SlowError(
        config.precise_noise_share,
        config.rtk_correlation_s if against_base else config.precise_correlation_s,
        config.rtk_growth if against_base else config.precise_growth,
        config.offset_correlation_s,
        config.precise_offset_sd**2 * np.eye(3),
        np.zeros(3),
        noises=round(_NOISES / 10),
    )


def _nothing() -> Mapping[str, Any]:
    return MappingProxyType({})


@dataclass(frozen=True)
class Refused:
    """Precise positions of a kind that have been refused in a row, and the sum of their errors."""

    count: int = 0
    off: FloatArray = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True)
class GnssOffsets:
    """All slow errors, and which precise positions the filter follows.

    Attributes
    ----------
    position, velocity : SlowError
        Of PVT.
    precise : mapping of str to SlowError
        Of precise positions, by their kind.
    kind : str
        Of the precise position last used since the station moved; empty: none.
    used_at : int
        Its sample index.
    refused : mapping of str to Refused
        Precise positions refused since one of their kind was used.
    stated : ndarray, shape (3, 3)
        Covariance of the creeping part, as the one last used says it, ECEF [m^2].
    inherited : mapping of str to ndarray, shape (3, 3)
        Covariance of what a kind was compared with since the station moved, less what it stated
        itself at that moment, ECEF [m^2].
    home : mapping of str to SlowError
        What was known of a kind at rest, where it has been referred to another since.
    """

    position: SlowError
    velocity: SlowError
    precise: Mapping[str, SlowError] = field(default_factory=_nothing)
    kind: str = ""
    used_at: int = -1
    refused: Mapping[str, Refused] = field(default_factory=_nothing)
    stated: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    inherited: Mapping[str, FloatArray] = field(default_factory=_nothing)
    home: Mapping[str, SlowError] = field(default_factory=_nothing)

    @classmethod
    def at_start(cls, config: FusionConfig) -> GnssOffsets:
        """Return what is known before anything has been measured."""
        return cls(position_error(config), velocity_error(config))

    def with_precise(self, kind: str, error: SlowError, **changes: object) -> GnssOffsets:
        """Return the same with another slow error of a kind of precise positions."""
        return replace(self, precise=put(self.precise, kind, error), **changes)  # type: ignore[arg-type]

    def doubted(self, before: GnssOffsets | None) -> GnssOffsets:
        """Return what is left where only what was known ``before`` is believed.

        PVT's slow errors are metres: what hides in a rest is nothing to them.
        """
        return self if before is None else replace(self, precise=before.precise)

    def followed_none(self) -> GnssOffsets:
        """Return the same with no precise position followed."""
        return GnssOffsets(self.position, self.velocity, self.precise)

    def crept(self, seconds: float) -> FloatArray:
        """Return the covariance, ECEF, by which what the filter follows may have crept."""
        if not self.kind:
            return np.zeros((3, 3))
        error = self.precise[self.kind].covariance_at(seconds)
        if self.kind not in self.inherited:
            return self.stated + error
        values, vectors = np.linalg.eigh(self.stated + self.inherited[self.kind])
        return error + (vectors * np.maximum(values, 0.0)) @ vectors.T


def put(mapping: Mapping[str, Any], key: str, value: Any) -> Mapping[str, Any]:
    """Return a mapping with another value of a key; None: without it."""
    items = {**mapping, key: value}
    return MappingProxyType({k: v for k, v in items.items() if v is not None})
