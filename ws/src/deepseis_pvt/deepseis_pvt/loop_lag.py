"""How far loops make a displacement lag behind, as their discriminators tell it."""

from __future__ import annotations

from typing import Final

import numpy as np

from deepseis_core.types import FloatArray

STRESS_MEMORY: Final = 0.3
"""Over which lags are averaged [s]."""
NOISE_SHOWN: Final = 1.6
"""Variance of a discriminator in a loop of 15 Hz and 20 ms, over that in open loop [-]."""
STRESS_LIMIT: Final = 2.5
"""Lags of a variance beyond so many times that of noise are lags [-]."""


class LoopLag:
    """Mean square of the lag of a displacement, over some tenths of a second.

    All satellites' phases lag alike, so residuals do not show it. Discriminators do: solved as
    phases are, they give the lag, with the noise of an integration.
    """

    def __init__(self) -> None:
        self._square: FloatArray = np.zeros((3, 3))

    def push(
        self, error: FloatArray, sd: FloatArray, G: FloatArray, interval: float
    ) -> FloatArray:
        """Take an epoch's lags; return the covariance of what the displacement lags behind [m^2].

        Parameters
        ----------
        error, sd : ndarray, shape (m,)
            What discriminators say that phases lag behind, and their open-loop sigma [m].
        G : ndarray, shape (3, m)
            What phases add to the displacement.
        interval : float
            Between epochs [s].
        """
        lag = G @ error
        noise = NOISE_SHOWN * float(((G * sd) ** 2).sum())
        weight = min(1.0, interval / STRESS_MEMORY)
        self._square = self._square + weight * (np.outer(lag, lag) - self._square)
        shown = float(np.trace(self._square))
        if shown <= STRESS_LIMIT * noise or noise == 0.0:
            return np.zeros((3, 3))
        return self._square * (1.0 - noise / shown)
