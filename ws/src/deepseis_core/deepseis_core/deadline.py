"""Until when real time waits for what is late, counted from the arrival of the samples."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from time import monotonic
from typing import Final

STOOD_STILL_S = 0.1
"""Between two looks: the process itself stood still, and its inputs are still queued [s]."""
MOST_NOTED: Final = 10_000
"""Arrivals kept: minutes of blocks. In lockstep nobody looks; the newest ones say enough."""


class Deadline:
    """Tells through which sample a node has waited long enough.

    Counted from the arrival of samples, never from the node's last step: lateness would add up.

    Parameters
    ----------
    wait_s : float
        How long to wait for whatever belongs to samples that have arrived [s].
    clock : callable, optional
        Seconds, monotonic.

    Attributes
    ----------
    overdue_through : int
        Last sample whose time is up; -1: none.

    Examples
    --------
    >>> now = 0.0
    >>> deadline = Deadline(0.03, clock=lambda: now)
    >>> deadline.arrived(79_999)
    >>> now = 0.02
    >>> deadline.arrived(159_999)
    >>> deadline.look()
    -1
    >>> now = 0.04
    >>> deadline.look()
    79999
    """

    def __init__(self, wait_s: float, *, clock: Callable[[], float] = monotonic) -> None:
        self.wait_s, self.clock = wait_s, clock
        self.overdue_through = -1
        self._due: deque[tuple[int, float]] = deque(maxlen=MOST_NOTED)
        self._looked = clock()

    def arrived(self, through: int) -> None:
        """Note that the samples up to ``through`` are there."""
        self._due.append((through, self.clock()))

    def look(self) -> int:
        """Return the last sample whose time is up; to be called often."""
        now = self.clock()
        if now - self._looked > STOOD_STILL_S:
            again = [(through, now) for through, _ in self._due]
            self._due = deque(again, MOST_NOTED)
        self._looked = now
        while self._due and now - self._due[0][1] > self.wait_s:
            through, _ = self._due.popleft()
            self.overdue_through = max(self.overdue_through, through)
        return self.overdue_through
