"""What the recorder reads off serialised messages without decoding them, and their order."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from heapq import heappop, heappush


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


class StampOrder:
    """Puts messages that several nodes publish on one topic in order of their stamps.

    Which of two nodes' messages arrives first is chance. They wait here until every node has
    spoken for the time before (its watermark), so the order in the bag is always the same.

    Parameters
    ----------
    members : iterable of str
        Nodes whose watermarks count.

    Examples
    --------
    >>> order = StampOrder(["pvt"])
    >>> order.push("/diagnostics", 7, b"second"); order.push("/diagnostics", 5, b"first")
    >>> order.heard("pvt", 6)
    >>> list(order.due())
    [('/diagnostics', 5, b'first')]
    """

    LIMIT_NS = 2_000_000_000
    """Nothing waits longer than this behind the newest watermark: a node may hang."""

    def __init__(self, members: Iterable[str]) -> None:
        self.through = dict.fromkeys(members, 0)
        self.newest = 0
        self._waiting: list[tuple[int, str, bytes]] = []

    def push(self, topic: str, stamp_ns: int, cdr: bytes) -> None:
        """Take a message."""
        heappush(self._waiting, (stamp_ns, topic, cdr))

    def heard(self, member: str, stamp_ns: int, *, ended: bool = False) -> None:
        """Note a member's watermark."""
        if ended:
            self.through.pop(member, None)
        elif member in self.through:
            self.through[member] = max(stamp_ns, self.through[member])
        self.newest = max(self.newest, stamp_ns)

    def due(self, *, everything: bool = False) -> Iterable[tuple[str, int, bytes]]:
        """Yield what need not wait any longer: topic, stamp and message."""
        slowest = min(self.through.values(), default=self.newest)
        limit = max(slowest, self.newest - self.LIMIT_NS)
        while self._waiting and (everything or self._waiting[0][0] <= limit):
            stamp_ns, topic, cdr = heappop(self._waiting)
            yield topic, stamp_ns, cdr
