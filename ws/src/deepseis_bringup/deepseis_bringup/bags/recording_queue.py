"""What the recorder reads off serialised messages without decoding them, and their order."""

from __future__ import annotations

import re
import struct
from collections import deque
from collections.abc import Container, Iterable, Iterator
from dataclasses import dataclass, field
from heapq import heappop, heappush
from typing import Final

from deepseis_core.status_names import OURS

SATELLITE: Final = re.compile(r"[A-Z]\d\d")


def stamp_of_cdr(cdr: bytes) -> int:
    r"""UTC [ns] of the header every message of ours begins with.

    Examples
    --------
    >>> stamp_of_cdr(b"\0\1\0\0" + struct.pack("<iI", 2, 5))
    2000000005
    """
    sec, nanosec = struct.unpack_from("<iI" if cdr[1] & 1 else ">iI", cdr, 4)
    return int(sec) * 1_000_000_000 + int(nanosec)


def if_block_end(cdr: bytes) -> int:
    """Last sample index of a serialised ``IfBlock`` (little endian)."""
    frame_length = struct.unpack_from("<I", cdr, 12)[0]
    at = 16 + frame_length
    at = 4 + (at - 4 + 7) // 8 * 8
    index, count = struct.unpack_from("<qI", cdr, at)
    return int(index + count - 1)


def about_whom(cdr: bytes) -> str:
    """Name whom a latched message is about: an ephemeris' satellite, else nobody in particular.

    Only texts that begin a message's own fields count, and only short ones.
    """
    at = _behind_text(12, cdr)
    if len(cdr) < at + 8 or struct.unpack_from("<I", cdr, at)[0] != 4:
        return ""
    text = _text(cdr, at)
    return text if SATELLITE.fullmatch(text) else ""


def event_span(cdr: bytes) -> tuple[int, int]:
    """Return onset and last report of a serialised ``SeismicEvent`` [ns UTC]."""
    at = _behind_text(_behind_text(12, cdr), cdr)
    sec, nanosec = struct.unpack_from("<iI", cdr, at)
    onset_ns, last_ns = int(sec) * 1_000_000_000 + int(nanosec), stamp_of_cdr(cdr)
    return min(onset_ns, last_ns), max(onset_ns, last_ns)


def speaker_of(cdr: bytes, members: Container[str]) -> str:
    """Name the flow member that published a diagnostic, an ephemeris or a request.

    Diagnostics carry its name ("deepseis: pvt", "deepseis: KOBE/pvt"), the others their
    satellite's. Empty: it is none of ours.
    """
    at = _behind_text(12, cdr)
    (count,) = struct.unpack_from("<I", cdr, at)
    text = _text(cdr, at)
    if text.startswith("G") and count == 4:
        own = f"trackers_{text.lower()}"
        return own if own in members else "trackers"
    name = status_name(cdr)
    return name.removeprefix(OURS).rpartition("/")[2] if name.startswith(OURS) else ""


def status_name(cdr: bytes) -> str:
    """Return the name of a diagnostic's first status; empty where it has none."""
    at = _behind_text(12, cdr)
    (count,) = struct.unpack_from("<I", cdr, at)
    return _text(cdr, at + 8) if count else ""  # behind the count and the level


def _behind_text(at: int, cdr: bytes) -> int:
    return (at + 4 + int(struct.unpack_from("<I", cdr, at)[0]) + 3) // 4 * 4


def _text(cdr: bytes, at: int) -> str:
    (size,) = struct.unpack_from("<I", cdr, at)
    return cdr[at + 4 : at + 3 + size].decode(errors="replace")


@dataclass
class _Member:
    """How far a node has spoken: stamps of its watermarks, with the messages it had published."""

    through_ns: int = 0
    received: int = 0
    announced: deque[tuple[int, int]] = field(default_factory=deque)

    def settle(self) -> None:
        """Believe the watermarks whose messages have all arrived."""
        while self.announced and self.announced[0][1] <= self.received:
            self.through_ns = max(self.through_ns, self.announced.popleft()[0])


class StampOrder:
    """Puts messages that several nodes publish on one topic in order of their stamps.

    Which of two nodes' messages arrives first is chance. They wait here until every node has
    spoken for the time before (its watermark) and what it said has arrived (its count), so the
    order in the bag is always the same.

    Parameters
    ----------
    members : iterable of str
        Nodes whose watermarks count.
    limit_ns : int, optional
        Nothing waits longer than this behind the newest watermark (realtime: a node may hang).

    Examples
    --------
    >>> order = StampOrder(["pvt"])
    >>> order.push("/diagnostics", "pvt", 7, b"second")
    >>> order.push("/diagnostics", "pvt", 5, b"first")
    >>> order.heard("pvt", 6, 2)
    >>> list(order.due())
    [('/diagnostics', 5, b'first')]
    """

    ENDED = 1 << 63

    def __init__(self, members: Iterable[str], limit_ns: int = 0) -> None:
        self.members = {name: _Member() for name in members}
        self.limit_ns, self.newest = limit_ns, 0
        self._waiting: list[tuple[int, str, bytes]] = []

    def push(self, topic: str, member: str, stamp_ns: int, cdr: bytes) -> None:
        """Take a message."""
        heappush(self._waiting, (stamp_ns, topic, cdr))
        if member in self.members:
            self.members[member].received += 1
            self.members[member].settle()

    def heard(self, member: str, stamp_ns: int, count: int, *, ended: bool = False) -> None:
        """Note a member's watermark, before which it had published ``count`` such messages."""
        self.newest = max(self.newest, stamp_ns)
        if member in self.members:
            self.members[member].announced.append((self.ENDED if ended else stamp_ns, count))
            self.members[member].settle()

    def due(self, *, everything: bool = False) -> Iterator[tuple[str, int, bytes]]:
        """Yield what need not wait any longer: topic, stamp and message."""
        limit = min((m.through_ns for m in self.members.values()), default=self.newest)
        if self.limit_ns:
            limit = max(limit, self.newest - self.limit_ns)
        while self._waiting and (everything or self._waiting[0][0] <= limit):
            stamp_ns, topic, cdr = heappop(self._waiting)
            yield topic, stamp_ns, cdr
