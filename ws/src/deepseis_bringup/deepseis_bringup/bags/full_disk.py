"""What a file that waits for room on a full disk has to say: its trouble, and what was lost."""

from __future__ import annotations

from dataclasses import dataclass

from deepseis_bringup.bags.mcap_layout import Single


@dataclass
class Dropped:
    """Messages that a patient file could not take: how many, from when to when, and why."""

    reason: str = ""
    count: int = 0
    start_ns: int = 2**63 - 1
    end_ns: int = 0

    def add(self, log_time_ns: int) -> None:
        """Count a message."""
        self.count += 1
        self.start_ns, self.end_ns = min(self.start_ns, log_time_ns), max(self.end_ns, log_time_ns)


class FullDisk:
    """Keeps account of times in which nothing could be written.

    Attributes
    ----------
    trouble : OSError or None
        Why nothing is written at present.
    dropped : list of Dropped
        What was lost, one for each time.

    Examples
    --------
    >>> disk = FullDisk()
    >>> disk.fails(OSError(28, "No space left on device"))
    >>> disk.drop(1_000)
    >>> disk.drop(2_000)
    >>> disk.takes_again().entry.name
    'not recorded 1'
    >>> disk.dropped
    [Dropped(reason='No space left on device', count=2, start_ns=1000, end_ns=2000)]
    """

    def __init__(self) -> None:
        self.trouble: OSError | None = None
        self.dropped: list[Dropped] = []

    def fails(self, error: OSError) -> None:
        """Note that a write failed."""
        self.trouble = error

    def drop(self, log_time_ns: int) -> None:
        """Count a message that is lost."""
        if not self.dropped or self.dropped[-1].reason:
            self.dropped.append(Dropped())
        self.dropped[-1].add(log_time_ns)

    def takes_again(self) -> Single | None:
        """Note that a write succeeded; return a record of what was lost since the failure."""
        error, self.trouble = self.trouble, None
        if error is None or not self.dropped or self.dropped[-1].reason:
            return None
        lost = self.dropped[-1]
        lost.reason = error.strerror or str(error)
        values = {name: str(value) for name, value in vars(lost).items()}
        return Single.metadata(f"not recorded {len(self.dropped)}", values)
