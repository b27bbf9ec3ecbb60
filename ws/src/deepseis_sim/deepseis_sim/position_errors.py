"""Errors of GNSS positions: white noise and a slow drift (accelerometer-PPP paper, section 2.2).

The paper's tables 1 and 2, with the figures of precise point positioning in motion, lost their
numbers in print. What is left bounds them: smoothed positions good to 0.6 cm horizontally and
1.5 cm vertically; gains over GNSS of 12.9, 15.7 and 10.5 % (filter) and 19.4, 31.5 and 18.7 %
(smoother), east, north, up; a drift that outweighs the noise.

- The smoother's gains and accuracies (0.6 cm taken per axis) make the GNSS errors 0.74, 0.88 and
  1.85 cm.
- Positions once a second and the accelerometers of grade ``accelerometers``, in a filter that
  takes all of the error for white, leave a share of white noise that fits both gains: 0.40, 0.53
  and 0.34 of the variance. Drift slower than some 20 s passes such a filter almost whole, so the
  gains say little of its correlation time.
- 300 s is our choice: that of a residual troposphere and multipath, and a third of the paper's
  15 minutes of waiting for the drift to settle.

This gives 13 / 19 / 13 % and 20 / 28 / 18 %, and 0.59, 0.63 and 1.50 cm. The gains of ten runs of
820 s, as the paper's, scatter by 2.3 and 3.4 % (1 sigma).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from deepseis_core.config import check, setting
from deepseis_core.errors import InputError
from deepseis_core.noise_processes import GaussMarkovNoise, WhiteNoise
from deepseis_core.types import FloatArray

WHITE_STREAM: Final = 70
"""Streams of random numbers."""
DRIFT_STREAM: Final = 71


@dataclass(frozen=True)
class PositionErrorConfig:
    """Settings of the errors of GNSS positions; three values each: east, north, up."""

    white_sd: tuple[float, ...] = setting(
        (0.0047, 0.0064, 0.0107), "white noise of each position [m]", low=0.0, high=100.0
    )
    drift_sd: tuple[float, ...] = setting(
        (0.0057, 0.0060, 0.0150), "Gauss-Markov drift [m]", low=0.0, high=100.0
    )
    correlation_time: tuple[float, ...] = setting(
        (300.0, 300.0, 300.0), "of the drift [s]", low=1e-3, high=1e7
    )


class PositionErrors:
    """Errors of the positions of one run.

    Parameters
    ----------
    config : PositionErrorConfig
    rate_hz : float
        Positions a second. The white noise is that of one position at any rate.
    seed : int
        Same seed, same errors.
    """

    def __init__(self, config: PositionErrorConfig, rate_hz: float, seed: int) -> None:
        try:
            check(config)
        except ValueError as error:
            raise InputError("position errors", str(error)) from None
        values = (config.white_sd, config.drift_sd, config.correlation_time)
        if any(len(item) != 3 for item in values):
            raise InputError("position errors", "need three values each", "east, north, up")
        if not np.isfinite(values).all():
            raise InputError("position errors", "a setting is not a finite number")
        if not 0.0 < rate_hz <= 1e4:
            raise InputError("position errors", f"at {rate_hz:g} Hz", "above 0, up to 10 kHz")
        self._white_sd = np.array(config.white_sd)
        self._white = WhiteNoise(seed, WHITE_STREAM, 3)
        self._drift = GaussMarkovNoise(
            seed, DRIFT_STREAM, config.drift_sd, config.correlation_time, 1.0 / rate_hz
        )

    def __call__(self, first: int, count: int) -> FloatArray:
        """Return the errors of positions ``first .. first + count``, ENU [m], shape (count, 3)."""
        return self._white_sd * self._white(first, count) + self._drift(first, count)

    def drift(self, first: int, count: int) -> FloatArray:
        """Return the drift alone, ENU [m], shape (count, 3)."""
        return self._drift(first, count)
