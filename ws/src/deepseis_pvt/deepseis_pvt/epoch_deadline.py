"""Real time: until when an epoch waits for the integrations that belong to it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from time import monotonic
from typing import Final

from deepseis_core.deadline import Deadline

PATIENCE: Final = 4
"""Deadlines that an epoch waits for satellites whose integrations keep coming."""


class EpochDeadline:
    """Counts from the arrival of the samples, and knows who has spoken lately.

    Where integrations of the late satellites keep coming, it is rather this process that has not
    read them yet, or a tracker that catches up: then the epoch waits `PATIENCE` times as long, and
    as long as it takes where nobody is ahead: late positions are better than none.

    Parameters
    ----------
    wait_s : float
        Deadline for satellites that are silent, and for other inputs [s].
    clock : callable, optional
        Seconds, monotonic.
    """

    def __init__(self, wait_s: float, *, clock: Callable[[], float] = monotonic) -> None:
        self.wait_s, self.clock = wait_s, clock
        self._silent = Deadline(wait_s, clock=clock)
        self._coming = Deadline(PATIENCE * wait_s, clock=clock)
        self._heard: dict[str, float] = {}

    def arrived(self, through: int) -> None:
        """Note that the samples up to ``through`` are there."""
        self._silent.arrived(through)
        self._coming.arrived(through)

    def heard(self, satellite: str) -> None:
        """Note that integrations of a satellite have come."""
        self._heard[satellite] = self.clock()

    def look(self) -> None:
        """Look at the clock; to be called often."""
        self._silent.look()
        self._coming.look()

    def is_overdue(self, sample: int, late: Iterable[str], newest: int) -> bool:
        """Tell whether the epoch at a sample is not to wait longer for ``late`` inputs.

        ``newest`` is the last sample of any satellite's integrations.
        """
        recent = self.clock() - 0.5 * self.wait_s
        coming = any(self._heard.get(name, recent) > recent for name in late)
        if coming and newest < sample:
            return False
        return sample <= (self._coming if coming else self._silent).overdue_through
