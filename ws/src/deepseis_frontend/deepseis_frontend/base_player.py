"""When a base's events are due beside the signal, and how far the base is known to be complete."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Final, Protocol

from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import Observations
from deepseis_frontend.base_events import BaseEvent, utc_of

AHEAD_S: Final = 30.0
"""A live base so far ahead of the signal has another time, and is left aside [s]."""


class LiveBase(Protocol):
    """Something that gives events as they come."""

    def take(self) -> list[BaseEvent]:
        """Return what has come since the last call."""
        ...


class BasePlayer:
    """Plays a base by the time of the signal.

    A recorded base is complete to where the signal is. A live one is, in lockstep, complete to its
    newest epoch, and the graph waits for the next one; in real time nobody waits, and an epoch
    that comes late is given as soon as it is there. A live base without an epoch for ``stale_s``
    is lost: the graph goes on without it until it is back.

    Parameters
    ----------
    source : iterable of BaseEvent, or LiveBase
        Recorded events, or what gives live ones.
    clock : SampleClock
        Of the IF samples.
    stale_s : float, optional
        A base without an epoch for so long is lost [s].
    waits : bool, optional
        Lockstep: a live base is waited for.
    now : callable, optional
        The wall clock [s], by which a live base that is waited for is given up.

    Attributes
    ----------
    counts : dict of str to int
        ``epochs`` played; ``late``: played after the graph had gone on; ``dropped``: from before
        the signal, out of order, or far ahead of it; ``lost``: times the base was lost.
    """

    def __init__(
        self,
        source: Iterable[BaseEvent] | LiveBase,
        clock: SampleClock,
        stale_s: float = 5.0,
        *,
        waits: bool = True,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self.clock, self.stale_s, self.waits, self._now = clock, stale_s, waits, now
        self._live = source if hasattr(source, "take") else None
        self._recorded: Iterator[BaseEvent] = iter(()) if self._live else iter(source)  # type: ignore[arg-type]
        self._waiting: deque[BaseEvent] = deque()
        self._heard = self._now()
        self._begin = self._last = self._newest = self._announced = -1
        self._lost = False
        self.counts = dict.fromkeys(("epochs", "late", "dropped", "lost"), 0)

    def begin_at(self, sample: int) -> None:
        """Leave aside what comes before a sample: the graph runs already."""
        self._begin = sample

    def complete_through(self, through: int) -> int:
        """Return how far the base is known where the signal is at a sample; it only grows."""
        self._fetch(through)
        complete = through
        if self._live is not None and self.waits:
            silent = self._now() - self._heard > self.stale_s
            complete = through if silent else min(through, self._newest)
        return max(self._announced, complete)

    def due(self, through: int) -> list[BaseEvent]:
        """Return the events up to a sample that have not been returned yet, in order."""
        self._fetch(through)
        events = list[BaseEvent]()
        while self._waiting and self._sample_of(self._waiting[0]) <= through:
            event = self._waiting.popleft()
            if not isinstance(event, Observations):
                events.append(event)
            elif event.sample_index < max(0, self._begin) or event.sample_index <= self._last:
                self.counts["dropped"] += 1
            else:
                self._last = event.sample_index
                self.counts["epochs"] += 1
                self.counts["late"] += event.sample_index <= self._announced
                events.append(event)
        return events

    def announce(self, through: int) -> None:
        """Note that others have been told that the base is complete through a sample."""
        self._announced = max(self._announced, through)

    def age_s(self, sample: int) -> float:
        """Return how long before a sample the newest epoch was; from sample 0 if there is none."""
        return max(0, sample - max(self._last, 0)) / self.clock.sample_rate_hz

    def look(self, sample: int) -> bool:
        """Return whether the base is lost at a sample, all events up to which have been taken."""
        lost = self.age_s(sample) > self.stale_s
        self.counts["lost"] += lost and not self._lost
        self._lost = lost
        return lost

    def _fetch(self, through: int) -> None:
        if self._live is None:
            while not self._waiting or self._sample_of(self._waiting[-1]) <= through:
                event = next(self._recorded, None)
                if event is None:
                    return
                self._waiting.append(event)
            return
        for event in self._live.take():
            self._heard = self._now()
            sample = self._sample_of(event)
            if not self.waits and sample > through + self._samples(AHEAD_S):
                self.counts["dropped"] += isinstance(event, Observations)
                continue
            if isinstance(event, Observations):
                self._newest = max(self._newest, sample)
            self._waiting.append(event)

    def _samples(self, seconds: float) -> int:
        return round(seconds * self.clock.sample_rate_hz)

    def _sample_of(self, event: BaseEvent) -> int:
        if isinstance(event, Observations):
            return event.sample_index
        return self.clock.sample_at(utc_of(event))
