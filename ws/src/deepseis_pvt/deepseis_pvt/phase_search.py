"""Which satellites' phases contradict the others: the fewest without which the rest agree.

Leaving out the worst residual, then the next, finds one that slipped. Several that slip at once
by the same amount hold together, and the worst residual is then often one that is right.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import combinations
from typing import Final, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

PAUSE_S: Final = 1.0
"""From one search to the next: 300 sets of twelve satellites take some milliseconds [s]."""
MOST: Final = 4
"""Satellites in a set."""

Found = TypeVar("Found")
Mask = NDArray[np.bool_]


class SlipSearch(Generic[Found]):
    """Tries all sets of satellites that may have slipped together.

    Parameters
    ----------
    misfit : callable
        How little what was found agrees.
    """

    def __init__(self, misfit: Callable[[Found], float]) -> None:
        self.misfit = misfit
        self._searched = -math.inf

    def search(
        self, time: float, known: Mask, most: int, fit: Callable[[Mask], Found | None]
    ) -> tuple[Found, Mask] | None:
        """Return what the others give, and which satellites were left out; None if none agree.

        Of sets of one size it is that whose rest agrees best.

        Parameters
        ----------
        time : float
            Of the epoch [s].
        known : ndarray of bool, shape (m,)
            The satellites to choose from.
        most : int
            In a set.
        fit : callable
            What the satellites of a mask give; None if they do not agree.

        Examples
        --------
        >>> level = np.array([5.0, 5.1, 7.0, 4.9, 7.0])
        >>> def mean(good):
        ...     return level[good].mean() if np.ptp(level[good]) < 1.0 else None
        >>> found, out = SlipSearch(abs).search(0.0, np.ones(5, bool), 3, mean)
        >>> float(found), np.flatnonzero(out).tolist()
        (5.0, [2, 4])
        """
        if time - self._searched < PAUSE_S:
            return None
        self._searched = time
        rows = np.flatnonzero(known).tolist()
        for size in range(1, min(most, MOST) + 1):
            agreeing = []
            for chosen in combinations(rows, size):
                out = np.isin(np.arange(len(known)), chosen)
                found = fit(known & ~out)
                if found is not None:
                    agreeing.append((found, out))
            if agreeing:
                return min(agreeing, key=lambda item: self.misfit(item[0]))
        return None
