"""What a node did not wait for in real time: written down, and done again in a replay.

What came out of a block depends on what was there when it was worked through. Of every input
that was not waited for, the log says through which sample it was there, and nothing beyond that
is used for the block, though it may have arrived: so a replay can do the same.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final

EVER: Final = 2**63 - 1
"""A sample that never comes."""

Run = tuple[int, int, int]
"""First sample of some blocks, the first after them, and the last that an input was there for."""


class MissLog:
    """Collects blocks that lacked something, as runs.

    Examples
    --------
    >>> log = MissLog()
    >>> for sample in (160_000, 240_000, 800_000):
    ...     log.note("aiding", sample, 80_000, 159_999)
    >>> log.note("imu", 800_000, 80_000, -1)
    >>> log.take()
    {'aiding': '160000-319999@159999 800000-879999@159999', 'imu': '800000-879999@-1'}
    >>> log.take()
    {}
    """

    def __init__(self) -> None:
        self._runs: dict[str, list[Run]] = {}

    def note(self, what: str, sample: int, count: int, through: int) -> None:
        """Note that a block was worked through with an input that went only to ``through``."""
        runs = self._runs.setdefault(what, [])
        if runs and (sample, through) == runs[-1][1:]:
            runs[-1] = runs[-1][0], sample + count, through
        else:
            runs.append((sample, sample + count, through))

    def take(self) -> dict[str, str]:
        """Return what came since the last call: first and last samples of each run."""
        found = {
            what: " ".join(f"{begin}-{end - 1}@{through}" for begin, end, through in runs)
            for what, runs in sorted(self._runs.items())
        }
        self._runs.clear()
        return found


class MissScript:
    """The misses of a recorded run of a node, asked for in order of the sample.

    Parameters
    ----------
    entries : iterable of str
        Each an input's name and its runs, as `MissLog.take` gives them.

    Examples
    --------
    >>> script = MissScript(["aiding 160000-319999@159999", "aiding 320000-399999@239999"])
    >>> script.limit("aiding", 80_000), script.limit("imu", 0) == EVER
    (159999, True)
    >>> script.through("aiding", 240_000), script.at(320_000)
    (159999, {'aiding': 239999})
    >>> script.at(400_000)
    {}
    """

    def __init__(self, entries: Iterable[str] = ()) -> None:
        self._runs: dict[str, list[Run]] = {}
        for entry in entries:
            what, *runs = entry.split()
            self._runs.setdefault(what, []).extend(map(_run, runs))
        for found in self._runs.values():
            found.sort()
        self._place = dict.fromkeys(self._runs, 0)

    def __bool__(self) -> bool:
        """Return whether anything was missed."""
        return bool(self._runs)

    def through(self, what: str, sample: int) -> int | None:
        """Return how far an input was there for the block at a sample; None: far enough."""
        run = self._next(what, sample)
        return run[2] if run is not None and run[0] <= sample else None

    def at(self, sample: int) -> dict[str, int]:
        """Return all that the block at a sample lacked, and how far each was there."""
        found = {what: self.through(what, sample) for what in self._runs}
        return {what: through for what, through in found.items() if through is not None}

    def limit(self, what: str, sample: int) -> int:
        """Return how much of an input may be handed on before the next block that lacked it."""
        run = self._next(what, sample)
        return EVER if run is None else run[2]

    def _next(self, what: str, sample: int) -> Run | None:
        """Return the first run that ends after a sample; samples do not decrease."""
        runs = self._runs.get(what)
        if runs is None:
            return None
        place = self._place[what]
        while place < len(runs) and runs[place][1] <= sample:
            place += 1
        self._place[what] = place
        return runs[place] if place < len(runs) else None


class Inputs:
    """How far each input of a block is there, and what of it the block may use.

    Parameters
    ----------
    script : MissScript
        Of the run that is replayed; empty otherwise.
    """

    def __init__(self, script: MissScript | None = None) -> None:
        self.script = script or MissScript()

    def lacking(
        self, sample: int, needed: Mapping[str, int], there: Mapping[str, int]
    ) -> list[str]:
        """Name what a block has to wait for."""
        return [
            what
            for what, through in needed.items()
            if there[what] < min(through, self._scripted(what, sample))
        ]

    def missed(
        self, sample: int, needed: Mapping[str, int], there: Mapping[str, int]
    ) -> dict[str, int]:
        """Return what a block goes without if it waits no longer, and how far each is there."""
        found = {what: min(there[what], self._scripted(what, sample)) for what in needed}
        return {what: through for what, through in found.items() if through < needed[what]}

    def _scripted(self, what: str, sample: int) -> int:
        through = self.script.through(what, sample)
        return EVER if through is None else through


def _run(text: str) -> Run:
    samples, _, through = text.partition("@")
    first, _, last = samples.partition("-")
    return int(first), int(last) + 1, int(through)
