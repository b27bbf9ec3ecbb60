"""How much satellites' biases creep, told while the antenna rests.

Settings say what biases of real satellites do at worst. At rest the antenna's place is known, so
the differences of a satellite's phase residual over a second show its bias' walk, and those over
eight seconds its rate, less the clock that all share and the phases' noise. Before anything has
been seen the settings count; they are worth `PRIOR` differences.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np

from deepseis_core.types import FloatArray, IntArray

PRIOR: Final = np.array([30.0, 10.0])
"""Differences, short and long, that the settings are worth [-]."""
MEMORY: Final = 600.0
"""Rest that is remembered [s]."""
LONG: Final = 8
"""Seconds of the long differences."""
LEAST, MOST = 0.01, 9.0
"""Of the levels [-]."""
FEWEST: Final = 4
"""Satellites that a difference of all needs."""


@dataclass(frozen=True)
class _Second:
    """Means over a second: by slot residual, variance of its noise and arc; NaN: not all of it."""

    number: int
    mean: FloatArray
    noise: FloatArray
    arc: IntArray


class CreepLevel:
    """Follows how biases creep, as variances over those of the settings.

    Parameters
    ----------
    walk : float
        Random walk of biases [m^2/s].
    rate : float
        Variance of their rates at the zenith [m^2/s^2].
    memory : float
        Correlation time of rates [s].
    slots : int
        Satellites at most.

    Attributes
    ----------
    walk_level, rate_level : float
        [-]
    """

    def __init__(self, walk: float, rate: float, memory: float, slots: int) -> None:
        self.walk, self.rate, self.memory, self.slots = walk, rate, memory, slots
        self.walk_level = self.rate_level = 1.0
        self._sums: FloatArray = np.zeros((2, 2))
        self._seconds: deque[_Second] = deque(maxlen=LONG + 1)
        self._arc: IntArray = np.zeros(slots, np.int64)
        self._growth: FloatArray = np.ones(slots)
        self._begin(-1)

    def _begin(self, number: int) -> None:
        self._number, self._epochs = number, 0
        self._sum, self._noise = np.zeros(self.slots), np.zeros(self.slots)
        self._count: IntArray = np.zeros(self.slots, np.int64)

    @property
    def known(self) -> tuple[FloatArray, float, float]:
        """What rest has told so far; to be set back to."""
        return self._sums.copy(), self.walk_level, self.rate_level

    @known.setter
    def known(self, known: tuple[FloatArray, float, float]) -> None:
        self._sums, self.walk_level, self.rate_level = known[0].copy(), *known[1:]

    def breaks(self, slots: IntArray) -> None:
        """Take account of biases that begin anew."""
        self._arc[slots] += 1
        self._count[slots] = -(10**6)

    def moved(self) -> None:
        """Take account of an antenna whose place is not known: rest begins anew."""
        self._seconds.clear()
        self._begin(-1)

    def push(
        self, time: float, slot: IntArray, residual: FloatArray, noise: FloatArray,
        growth: FloatArray, shared: float,
    ) -> None:  # fmt: skip
        """Take an epoch of an antenna at rest.

        Parameters
        ----------
        time : float
            [s]
        slot : ndarray of int64, shape (m,)
            Satellites.
        residual, noise : ndarray, shape (m,)
            Phases less geometry and place [m], variance of their noise [m^2].
        growth : ndarray, shape (m,)
            Of the rates' variance with elevation [-].
        shared : float
            Neighbouring epochs that have one noise [-].
        """
        number = int(np.floor(time + 1e-6))
        if number != self._number:
            self._finish(shared)
            self._begin(number)
        self._epochs += 1
        self._sum[slot] += residual
        self._noise[slot] += noise
        self._count[slot] += 1
        self._growth[slot] = growth

    def _finish(self, shared: float) -> None:
        """End a second: compare it with the one before, and with that eight before."""
        if self._epochs == 0:
            return
        whole = self._count == self._epochs
        n = float(self._epochs)
        mean = np.where(whole, self._sum / n, np.nan)
        noise = self._noise / n * min(1.0, max(1.0, shared) / n)
        now = _Second(self._number, mean, noise, self._arc.copy())
        self._seconds.append(now)
        self._sums *= np.exp(-1.0 / MEMORY)
        # Means of n samples of a walk over neighbouring seconds differ by this of a second's.
        walked = (2.0 * n * n + 1.0) / (3.0 * n * n)
        for before in self._seconds:
            apart = now.number - before.number
            if apart == 1:
                known = self.rate_level * self.rate * self._growth
                self._compare(0, now, before, np.full(self.slots, self.walk * walked), known, 1.0)
            elif apart == LONG:
                x = LONG / self.memory
                rated = 2.0 * self.memory**2 * (x - 1.0 + np.exp(-x)) * self.rate * self._growth
                known = np.full(self.slots, self.walk_level * self.walk * (LONG - 1.0 + walked))
                self._compare(1, now, before, rated, known, 1.0 / LONG)
        share, weight = self._sums.T
        levels = np.clip((PRIOR + share) / (PRIOR + weight), LEAST, MOST)
        self.walk_level, self.rate_level = levels.tolist()

    def _compare(
        self, kind: int, now: _Second, before: _Second, creep: FloatArray, known: FloatArray,
        independent: float,
    ) -> None:  # fmt: skip
        both = np.isfinite(now.mean) & np.isfinite(before.mean) & (now.arc == before.arc)
        chosen = np.flatnonzero(both)
        if len(chosen) < FEWEST or not np.any(creep > 0.0):
            return
        difference = (now.mean - before.mean)[chosen]
        noise = (now.noise + before.noise)[chosen] + known[chosen]
        expected = creep[chosen] + noise
        weight = 1.0 / expected
        lever = weight / weight.sum()
        own = difference - lever @ difference
        shown = own**2 / (1.0 - lever) - noise
        trust = independent * (creep[chosen] / expected) ** 2
        self._sums[kind] += (trust * shown / creep[chosen]).sum(), trust.sum()
