"""Automatic gain: what the quantiser's step follows.

The gain follows the *expected* power (what the settings say of noise, satellites and jammers),
through a first-order low-pass, segment by segment. A real gain control measures that power; at the
bandwidths of a front end its estimate is good to a percent within some milliseconds, so that the
difference is small, and this one is a function of time alone.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from deepseis_core.types import FloatArray

_BLOCK = 1000


class FollowingGain:
    """Low-pass of a power over segments; it has settled at the first one.

    ``p[k] = p[k - 1] + (1 - exp(-T / tau)) (P[k] - p[k - 1])``, ``p[0] = P[0]``. Going forward it
    goes on from what it gave last; asked for earlier segments it begins again: the answer depends
    on the segment alone.

    Parameters
    ----------
    power : callable
        Power at seconds since the start, shape (m,).
    span : float
        Length T of a segment [s].
    time_constant_s : float
        tau [s].

    Examples
    --------
    >>> gain = FollowingGain(lambda time: 1.0 + 3.0 * (time > 0.02), 0.01, 1e-9)
    >>> gain(0, 2).tolist(), gain(2, 2).tolist()
    ([1.0, 1.0], [4.0, 4.0])
    """

    def __init__(
        self, power: Callable[[FloatArray], FloatArray], span: float, time_constant_s: float
    ) -> None:
        self._power, self._span = power, span
        self._weight = float(-np.expm1(-span / time_constant_s))
        self._first, self._values = 0, np.empty(0)

    def __call__(self, first: int, count: int) -> FloatArray:
        """Return the followed power at segments ``first .. first + count``."""
        if first < self._first:
            self._first, self._values = 0, np.empty(0)
        while (end := self._first + self._values.size) < first + count:
            more = self._follow(end, min(_BLOCK, first + count - end))
            kept = self._values[min(first - self._first, self._values.size) :]
            self._values = np.append(kept, more)
            self._first = end - kept.size
        return self._values[first - self._first :][:count].copy()

    def _follow(self, first: int, count: int) -> FloatArray:
        """Go on by some segments."""
        number = np.arange(first, first + count, dtype=np.float64)
        power = self._power((number + 0.5) * self._span)
        out = np.empty(count)
        followed = float(self._values[-1]) if first else float(power[0])
        for k, now in enumerate(power.tolist()):
            followed += self._weight * (now - followed)
            out[k] = followed
        return out
