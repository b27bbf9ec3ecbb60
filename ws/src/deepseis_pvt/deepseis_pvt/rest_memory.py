"""What was known at rest some seconds ago: rest that ends in motion has not been rest to its end.

A motion that begins slowly is noticed late, and until then the ground takes along what is said to
stand still: satellites' biases follow it, and their rates carry it on for half a minute.
Therefore what was learnt in the last seconds before a motion is forgotten; what these seconds
say after all, that the ground cannot have moved far without being noticed, is told anew.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Final, Generic, TypeVar

import numpy as np

from deepseis_core.config import setting
from deepseis_core.hidden_motion import doubtful
from deepseis_core.types import FloatArray, IntArray

Known = TypeVar("Known")

STEP_S: Final = 1.0
"""Between what is kept [s]."""


@dataclass(frozen=True)
class DoubtConfig:
    """Settings of what is not believed of a rest that ends."""

    doubt_s: float = setting(
        15.0, "of a rest that ends the last part is not believed: motion is noticed late [s]",
        low=0.0, high=120.0,
    )  # fmt: skip
    hidden_motion_sd: float = setting(
        0.005, "how far it may have moved by then where no IMU tells, one sigma of an axis [m]",
        low=1e-5, high=1.0,
    )  # fmt: skip


class RestMemory(Generic[Known]):
    """Keeps what was known at rest, once a second.

    Parameters
    ----------
    doubt_s : float
        What is not believed of a rest that ends [s].

    Examples
    --------
    >>> memory = RestMemory[str](3.0)
    >>> for t in range(9): memory.keep(float(t), str(t))
    >>> memory.recall(9.5), memory.recall(9.5)
    (('6', '8'), None)
    """

    def __init__(self, doubt_s: float) -> None:
        self.doubt_s = doubt_s
        self._kept: deque[tuple[float, Known]] = deque(maxlen=int(doubt_s / STEP_S) + 2)
        self._begun = 0.0

    def __bool__(self) -> bool:
        """Tell whether anything is kept."""
        return bool(self._kept)

    def due(self, time: float) -> bool:
        """Tell whether something should be kept at a time [s]."""
        return not self._kept or time - self._kept[-1][0] >= STEP_S

    def keep(self, time: float, known: Known) -> None:
        """Keep what is known at a time [s]."""
        if not self._kept:
            self._begun = time
        self._kept.append((time, known))

    def recall(self, time: float) -> tuple[Known, Known] | None:
        """Return what is still believed as a rest ends, and what was known last; forget all.

        Of a rest shorter than twice ``doubt_s`` half is believed. None: there is nothing to doubt.
        """
        back = doubtful(self.doubt_s, time - self._begun)
        found = next((item for at, item in reversed(self._kept) if at <= time - back), None)
        last = self._kept[-1][1] if self._kept else None
        self.clear()
        return None if found is None or last is None or found is last else (found, last)

    def values(self) -> list[Known]:
        """Return all that is kept."""
        return [known for _, known in self._kept]

    def clear(self) -> None:
        """Forget everything."""
        self._kept.clear()


def hold(
    state: FloatArray, P: FloatArray, slot: IntArray, y: FloatArray, A: FloatArray, R: FloatArray,
    sd: float,
) -> None:  # fmt: skip
    """Let biases learn from an antenna that is where it was, but for ``sd`` on each axis.

    Parameters
    ----------
    state, P : ndarray, shapes (n,), (n, n)
        Biases and their rates; changed.
    slot : ndarray of int64, shape (m,)
        Slots of the satellites.
    y : ndarray, shape (m,)
        Phase residuals less biases and place [m].
    A : ndarray, shape (m, 4)
        What displacement and clock add to them.
    R : ndarray, shape (m,)
        Variance of the phases' noise [m^2].
    sd : float
        [m]
    """
    moved, clock = sd * A[:, :3], A[:, 3:]
    W = np.linalg.inv(P[np.ix_(slot, slot)] + np.diag(R) + moved @ moved.T)
    W -= W @ clock @ np.linalg.solve(clock.T @ W @ clock, clock.T @ W)
    gain = P[:, slot] @ W
    state += gain @ y
    P -= gain @ P[slot]
    P[:] = 0.5 * (P + P.T)
