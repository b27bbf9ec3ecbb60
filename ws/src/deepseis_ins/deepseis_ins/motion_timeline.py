"""When the station stood still and when it moved, as far as it has been decided.

Decisions count in order of what they are decided through, whenever they arrive. Motion may begin
before it is noticed: it holds from its onset. Stillness never holds from earlier than D before it
was decided: a filter that works D behind the present finds every decision that it needs.
"""

from __future__ import annotations

from bisect import bisect_right, insort

from deepseis_core.types import MotionKind, MotionState


def _order(item: MotionState) -> tuple[int, int, int]:
    return item.valid_through, item.sample_index, item.state


class MotionTimeline:
    """States of motion by sample.

    Parameters
    ----------
    delay : int
        D [samples].
    """

    def __init__(self, delay: int) -> None:
        self.delay = delay
        self._pending: list[MotionState] = []
        self._decisions: list[MotionState] = []
        self._starts, self._states, self._noticed = [-1], [int(MotionKind.UNKNOWN)], [-1]
        self._base = self._starts[0], self._states[0], self._noticed[0]

    def push(self, state: MotionState) -> None:
        """Take a decision, in any order."""
        self._pending.append(state)

    def take(self, through: int, policy: str = "") -> int | None:
        """Let all decisions through a sample count, or only those of a policy.

        Returns
        -------
        int or None
            First sample for which something else holds than before.
        """
        due: list[MotionState] = []
        kept: list[MotionState] = []
        for item in self._pending:
            counts = item.valid_through <= through and policy in ("", item.policy)
            (due if counts else kept).append(item)
        self._pending = kept
        changes = [self._take(item) for item in sorted(due, key=_order)]
        return min((sample for sample in changes if sample is not None), default=None)

    def state(self, sample_index: int) -> int:
        """Return what holds at a sample; UNKNOWN where nobody has decided."""
        return self._states[self._place(sample_index)]

    def noticed(self, sample_index: int) -> int:
        """Return through which sample was decided what holds at a sample."""
        return self._noticed[self._place(sample_index)]

    def lateness(self, sample_index: int) -> int:
        """Return how long what holds at a sample had held when it was decided [samples]."""
        place = self._place(sample_index)
        return max(0, self._noticed[place] - self._starts[place])

    def _place(self, sample_index: int) -> int:
        return max(bisect_right(self._starts, sample_index) - 1, 0)

    def is_still(self, sample_index: int) -> bool:
        """Return whether the station stands still at a sample."""
        return self.state(sample_index) == MotionKind.STATIC

    def forget(self, before: int) -> None:
        """Drop what was decided before a sample; what held then stays."""
        kept = [item for item in self._decisions if item.valid_through >= before]
        if len(kept) < len(self._decisions):
            found = self._place(before)
            self._base = self._starts[found], self._states[found], self._noticed[found]
            self._decisions = kept
            del self._starts[:found], self._states[:found], self._noticed[:found]

    def _take(self, item: MotionState) -> int | None:
        late = bool(self._decisions) and _order(item) < _order(self._decisions[-1])
        insort(self._decisions, item, key=_order)
        if not late:
            return self._apply(item)
        before = list(zip(self._starts, self._states, strict=True))
        self._starts, self._states, self._noticed = ([item] for item in self._base)
        for decision in self._decisions:
            self._apply(decision)
        after = list(zip(self._starts, self._states, strict=True))
        differing = set(before) ^ set(after)
        return min(start for start, _ in differing) if differing else None

    def _apply(self, item: MotionState) -> int | None:
        start = item.sample_index
        if item.state == MotionKind.STATIC:
            start = max(start, item.valid_through - self.delay)
        if self.state(start) == item.state == self._states[-1]:
            return None
        while len(self._starts) > 1 and self._starts[-1] >= start:
            del self._starts[-1], self._states[-1], self._noticed[-1]
        if self._states[-1] != item.state:
            self._starts.append(max(start, self._starts[-1] + 1))
            self._states.append(item.state)
            self._noticed.append(item.valid_through)
        return start
