"""What a node did not wait for in real time, by the sample: enough to do the same again."""

from __future__ import annotations


class MissLog:
    """Collects blocks that lacked something, as runs.

    Examples
    --------
    >>> log = MissLog()
    >>> for sample in (160_000, 240_000, 320_000, 800_000):
    ...     log.note("aiding", sample, 80_000)
    >>> log.note("imu", 800_000, 80_000)
    >>> log.take()
    {'aiding': '160000-399999 800000-879999', 'imu': '800000-879999'}
    >>> log.take()
    {}
    """

    def __init__(self) -> None:
        self._runs: dict[str, list[tuple[int, int]]] = {}

    def note(self, what: str, sample: int, count: int) -> None:
        """Note that the samples from one on were worked through without something."""
        runs = self._runs.setdefault(what, [])
        if runs and sample == runs[-1][1]:
            runs[-1] = runs[-1][0], sample + count
        else:
            runs.append((sample, sample + count))

    def take(self) -> dict[str, str]:
        """Return what came since the last call: first and last samples of each run."""
        found = {
            what: " ".join(f"{begin}-{end - 1}" for begin, end in runs)
            for what, runs in sorted(self._runs.items())
        }
        self._runs.clear()
        return found
