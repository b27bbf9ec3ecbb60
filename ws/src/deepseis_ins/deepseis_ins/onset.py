"""Onset of shaking: ratio of short-term to long-term average, sample by sample.

Both averages are of the squared acceleration, recursive: ``s += (x^2 - s) / n`` (P. D. Withers et
al., "A comparison of select trigger algorithms for automated global seismic phase and event
detection", Bull. Seismol. Soc. Am. 88, 95-106, 1998). While an event lasts the long one stands
still, so that strong shaking does not pass for quiet.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deepseis_core.config import check, setting
from deepseis_core.errors import InputError
from deepseis_core.types import FloatArray


@dataclass(frozen=True)
class OnsetConfig:
    """Settings of `OnsetDetector`."""

    short_s: float = setting(0.2, "short-term average [s]", low=0.01, high=60.0)
    long_s: float = setting(10.0, "long-term average [s]", low=0.1, high=3600.0)
    onset_ratio: float = setting(25.0, "of their squares, that begins an event [-]", low=1.1)
    end_ratio: float = setting(4.0, "below which it ends [-]", low=1.0)
    least_acceleration: float = setting(
        0.02, "short-term r.m.s. below which nothing begins [m/s^2]", low=0.0
    )
    quiet_s: float = setting(5.0, "so long must it be quiet for an end [s]", low=0.1)


@dataclass(frozen=True)
class Trigger:
    """A beginning or an end: number of the sample in the block, and the ratio there."""

    row: int
    began: bool
    ratio: float


class OnsetDetector:
    """Follows accelerations.

    Parameters
    ----------
    config : OnsetConfig
    rate_hz : float
        Samples a second.

    Attributes
    ----------
    active : bool
        An event lasts.
    """

    def __init__(self, config: OnsetConfig, rate_hz: float) -> None:
        try:
            check(config)
        except ValueError as error:
            raise InputError("onset", str(error)) from None
        if config.long_s <= config.short_s:
            raise InputError("onset", "long_s is not longer than short_s")
        self.config = config
        self.short_n = max(1, round(config.short_s * rate_hz))
        self.long_n = max(2, round(config.long_s * rate_hz))
        self.quiet_n = max(1, round(config.quiet_s * rate_hz))
        self.active = False
        self._short = self._long = 0.0
        self._count, self._quiet = 0, 0

    def push(self, acceleration: FloatArray) -> tuple[FloatArray, list[Trigger]]:
        """Take accelerations, shape (n, 3) [m/s^2].

        Returns
        -------
        ratio : ndarray, shape (n,)
            Short over long; zero until a long-term average has been seen.
        triggers : list of Trigger
        """
        square = (np.asarray(acceleration, np.float64) ** 2).sum(axis=1)
        ratio, triggers = np.zeros(len(square)), []
        for row, value in enumerate(square.tolist()):
            ratio[row] = self._take(value)
            if (trigger := self._decide(row, float(ratio[row]))) is not None:
                triggers.append(trigger)
        return ratio, triggers

    def _take(self, square: float) -> float:
        self._count += 1
        self._short += (square - self._short) / self.short_n
        if not self.active:
            self._long += (square - self._long) / self.long_n
        if self._count < self.long_n or self._long <= 0.0:
            return 0.0
        return self._short / self._long

    def _decide(self, row: int, ratio: float) -> Trigger | None:
        config = self.config
        if not self.active:
            strong = self._short > config.least_acceleration**2
            if not (strong and ratio > config.onset_ratio):
                return None
            self.active, self._quiet = True, 0
            return Trigger(row, True, ratio)
        self._quiet = self._quiet + 1 if ratio < config.end_ratio else 0
        if self._quiet < self.quiet_n:
            return None
        self.active = False
        return Trigger(row, False, ratio)
