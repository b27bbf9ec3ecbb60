"""When a watermark holds for a reader: all messages that it counts have arrived.

A watermark may overtake messages on other topics. Where these do not say themselves through which
sample they are complete, the watermark counts them (`event_count`), and the reader waits until it
has received as many. In real time one of the two may die and be started again: then counts begin
anew at one end only and mean nothing, and watermarks hold as they come. So they do from where a
message was lost: a reader that stood still until its queue ran over would lag behind for ever.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping


class CountedInput:
    """Messages on one topic, and the watermarks that count them.

    Parameters
    ----------
    counting : bool
        False: this reader joins a running graph, watermarks hold as they come.

    Attributes
    ----------
    valid_through : int
        Last sample through which everything has arrived.
    """

    def __init__(self, *, counting: bool = True) -> None:
        self.counting = counting
        self.valid_through = -1
        self._received = self._newest = 0
        self._announced: deque[tuple[int, int]] = deque()

    def received(self, sample: int = -1) -> None:
        """Count a message.

        ``sample`` is the one that it is for, where one publisher's messages come in order: they
        do, so behind a watermark that waits for others these are lost.
        """
        self._received += 1
        self._settle()
        if self._announced and self._announced[0][1] < sample:
            self.trust()

    def announced(self, count: int, valid_through: int) -> None:
        """Take a watermark, and how many messages it stands for."""
        self.counting &= count >= self._newest  # less: another process speaks for the one before
        self._newest = count
        self._announced.append((count, valid_through))
        self._settle()

    def trust(self) -> None:
        """Count no longer: watermarks hold as they come."""
        self.counting = False
        self._settle()

    def _settle(self) -> None:
        while self._announced and (not self.counting or self._announced[0][0] <= self._received):
            _, through = self._announced.popleft()
            self.valid_through = max(self.valid_through, through)


class CountedTopics:
    """Topics of one node, each counted in its watermarks.

    Parameters
    ----------
    topics : iterable of str
        Those that are read.
    counting : bool
        As of `CountedInput`.

    Examples
    --------
    >>> pvt = CountedTopics(["positions", "orbits"])
    >>> pvt.announced({"positions": 1, "orbits": 0, "observations": 50}, 100)
    >>> before = pvt.valid_through
    >>> pvt.received("positions")
    >>> before, pvt.valid_through
    (-1, 100)
    """

    def __init__(self, topics: Iterable[str], *, counting: bool = True) -> None:
        self._inputs = {topic: CountedInput(counting=counting) for topic in topics}

    @property
    def valid_through(self) -> int:
        """Last sample through which everything has arrived on all topics."""
        return min(item.valid_through for item in self._inputs.values())

    def received(self, topic: str, sample: int = -1) -> None:
        """Count a message, as `CountedInput.received`."""
        self._inputs[topic].received(sample)

    def announced(self, counts: Mapping[str, int], valid_through: int) -> None:
        """Take a watermark, and for how many messages of each topic it stands."""
        for topic, item in self._inputs.items():
            item.announced(counts[topic], valid_through)
