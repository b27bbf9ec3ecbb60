"""Credits: how far a source may run ahead of its slowest consumer."""

from __future__ import annotations

from collections.abc import Iterable


class CreditWindow:
    """Window of blocks that may be under way at once, at least D + 3 blocks.

    Parameters
    ----------
    members : iterable of str
        Everybody who must acknowledge; none: the window never closes.
    blocks : int
        Size of the window [blocks].

    Examples
    --------
    >>> window = CreditWindow(["pvt"], blocks=2)
    >>> window.send(0, 99); window.send(100, 199); window.is_open()
    False
    >>> window.acknowledge("pvt", 99); window.is_open()
    True
    """

    def __init__(self, members: Iterable[str], blocks: int) -> None:
        self.consumed = dict.fromkeys(members, -1)
        self.blocks = blocks
        self._ends: list[int] = []

    def send(self, first: int, last: int) -> None:
        """Note a block that has been sent."""
        del first
        self._ends.append(last)

    def acknowledge(self, member: str, consumed_through: int) -> None:
        """Note a member's progress."""
        if consumed_through > self.consumed[member]:
            self.consumed[member] = consumed_through
            slowest = min(self.consumed.values())
            while self._ends and self._ends[0] <= slowest:
                self._ends.pop(0)

    def is_open(self) -> bool:
        """Tell whether another block may be sent."""
        return not self.consumed or len(self._ends) < self.blocks

    def slowest(self) -> list[str]:
        """Members that hold the window closed."""
        if not self._ends:
            return []
        return sorted(m for m, done in self.consumed.items() if done < self._ends[0])
