"""The bag of a station that runs for months: many files, the oldest of which make room.

A new file is begun after so much of the *stream's* time (stamps, never a clock: a clock that is
set changes nothing) or at a size. Files older than ``keep_h``, or beyond the budget, are deleted,
oldest first. What lies in the window around an event is never deleted. What is said once and
holds for long (the station, ephemerides, the state of motion) is carried over from deleted files
into ``<bag>_head.mcap``, so that what is left can still be replayed.
"""

from __future__ import annotations

import errno
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from deepseis_bringup.bags.mcap_file import McapFile
from deepseis_bringup.bags.mcap_recording import BagWriter, FileFacts, write_metadata_yaml
from deepseis_core.config import setting
from deepseis_core.errors import DiskError, InputError

NS: Final = 1_000_000_000
HEAD: Final = "head"
UNTIMED: Final = frozenset({"/diagnostics"})
"""Topics on which some stamp by the wall clock."""
Latched = dict[tuple[str, str], tuple[int, bytes]]
"""By topic and whom it is about: stamp and message."""


@dataclass(frozen=True)
class ArchiveConfig:
    """How a recording is cut into files, and what is kept of it."""

    split_s: float = setting(0.0, "begin a new file after so much; 0: never [s]", low=0.0)
    split_mb: float = setting(0.0, "begin a new file at this size; 0: never [MB]", low=0.0)
    keep_h: float = setting(0.0, "delete files older than this; 0: never [h]", low=0.0)
    budget_gb: float = setting(0.0, "delete the oldest files beyond this; 0: never [GB]", low=0.0)
    pre_event_s: float = setting(60.0, "always kept before an event's onset [s]", low=0.0)
    post_event_s: float = setting(120.0, "always kept after an event's end [s]", low=0.0)
    sync_s: float = setting(
        5.0, "realtime: a loss of power takes so much at most; 0: up to the system [s]", low=0.0
    )
    min_free_mb: float = setting(
        200.0, "realtime: with less free on the disk, recording pauses [MB]", low=0.0
    )

    @property
    def splits(self) -> bool:
        """Whether there is more than one file."""
        return self.split_s > 0 or self.split_mb > 0

    def complaint(self) -> str:
        """Say what does not fit together, or nothing."""
        if (self.keep_h or self.budget_gb) and not self.splits:
            return "keep_h and budget_gb delete whole files: split_s or split_mb has to be given"
        if self.keep_h and self.keep_h * 3600 < self.pre_event_s:
            return "keep_h is shorter than pre_event_s"
        return ""


@dataclass
class Split:
    """A finished file of a bag (what ``metadata.yaml`` says of it, and more)."""

    path: Path
    channels: dict[int, Any]
    counts: dict[int, int]
    start_ns: int
    end_ns: int
    size: int
    span_ns: tuple[int, int] = (0, 0)
    """First and last stamp of the stream, without topics that may go by another clock."""
    length_ns: int = 0
    number: int = 0
    latched: Latched = field(default_factory=dict)
    """What held when the file began."""


@dataclass(frozen=True)
class DiskState:
    """What is to be said of disk and archive on ``/diagnostics``."""

    free: int
    size: int
    written: int
    files: int
    kept_for_events: int
    deleted: int
    oldest_ns: int
    newest_ns: int
    lost: int
    trouble: str


class DiskGuard:
    """Refuses to write below a watermark of free space; asks the disk twice a second at most.

    Parameters
    ----------
    folder : Path
    least : float
        Watermark [bytes].
    free : callable, optional
        Free bytes of a folder's disk.
    """

    def __init__(
        self, folder: Path, least: float, free: Callable[[Path], int] | None = None
    ) -> None:
        self.folder, self.least, self._free = folder, least, free or free_bytes
        self._asked, self._known = -1e9, 0

    def free(self) -> int:
        """Return the free space, at most half a second old [bytes]."""
        if time.monotonic() - self._asked > 0.5:
            self._known, self._asked = self._free(self.folder), time.monotonic()
        return self._known

    def __call__(self) -> None:
        """Raise ``OSError`` where too little is free."""
        if self.free() < self.least:
            text = f"less than {self.least / 1e6:g} MB are free on the disk"
            raise OSError(errno.ENOSPC, text)


def free_bytes(folder: Path) -> int:
    """Return what a user may still write to a folder's disk [bytes]."""
    facts = os.statvfs(folder)
    return facts.f_bavail * facts.f_frsize


class Archive(BagWriter):
    """A bag of files that come and go; see the module.

    Files are finished, and old ones deleted, by a thread: the caller only opens the next.

    Parameters
    ----------
    folder, records, **options
        As of `BagWriter`.
    config : ArchiveConfig
    keys : mapping, optional
        Topics (full names) whose last message holds until the next: how to read off the bytes
        whom it is about.
    free : callable, optional
        Free bytes of a folder's disk.

    Raises
    ------
    InputError
        Where the settings contradict each other, or the bag cannot be written.
    """

    def __init__(
        self,
        folder: str | Path,
        records: Mapping[str, Mapping[str, Any]] | None = None,
        *,
        config: ArchiveConfig,
        keys: Mapping[str, Callable[[bytes], str]] | None = None,
        free: Callable[[Path], int] | None = None,
        **options: Any,
    ) -> None:
        if reason := config.complaint():
            raise InputError("archive", reason)
        self.config, self.keys = config, dict(keys or {})
        self.guard = DiskGuard(Path(folder), config.min_free_mb * 1e6, free)
        if options.get("patient"):
            options |= {"guard": self.guard, "sync_interval": config.sync_s}
        self.splits: deque[Split] = deque()
        self.events: list[list[int]] = []
        self.newest_ns = self._began_ns = self._first_ns = 0
        self._latched: Latched = {}
        self._at_begin: Latched = {}
        self._number, self._deleted, self._deleted_bytes, self._lost = 0, 0, 0, 0
        self._not_before = 0.0
        self._fault: BaseException | None = None
        self._head: McapFile | None = None
        self._worker = ThreadPoolExecutor(1, "finishes files")
        self._unfinished: tuple[McapFile, ...] = ()
        self._account = threading.Lock()
        super().__init__(folder, records, **options)

    def write(
        self,
        topic: str,
        type_name: str,
        cdr_bytes: bytes | bytearray | memoryview,
        log_time_ns: int,
        publish_time_ns: int,
    ) -> None:
        """Write a serialised message, into a new file if it is time for one."""
        if self._fault is not None:
            raise self._fault
        if topic not in UNTIMED:
            if self._is_due(log_time_ns):
                self._begin_next(log_time_ns)
            self._began_ns = self._began_ns or log_time_ns
            self._first_ns = min(self._first_ns or log_time_ns, log_time_ns)
            self.newest_ns = max(self.newest_ns, log_time_ns)
        super().write(topic, type_name, cdr_bytes, log_time_ns, publish_time_ns)
        if topic in self.keys:
            data = bytes(cdr_bytes)
            self._latched[topic, self.keys[topic](data)] = log_time_ns, data

    def _is_due(self, now_ns: int) -> bool:
        config = self.config
        if not config.splits or not self._began_ns or self.file.trouble is not None:
            return False
        # A stamp that jumps, either way, ends a file at the latest then.
        late = 0 < config.split_s * NS <= abs(now_ns - self._began_ns)
        large = 0 < config.split_mb * 1e6 <= self.file.size
        return (late or large) and time.monotonic() >= self._not_before

    def _begin_next(self, now_ns: int) -> None:
        done = self.file
        try:
            self.file = self.open_file(str(self._number + 1))
        except InputError:  # no room for a file: go on in this one
            self._not_before = time.monotonic() + 1.0
            return
        self._numbers = {c.topic: number for number, c in self.file.channels.items()}
        span = self._first_ns, self.newest_ns
        longest = round(self.config.split_s * NS) or span[1] - span[0]
        length_ns = min(abs(now_ns - self._began_ns), longest)
        facts = (span, length_ns, self._number, self._at_begin)
        with self._account:
            self._unfinished += (done,)
        self._worker.submit(self._finish, done, facts)
        self._number += 1
        self._at_begin = dict(self._latched)
        self._began_ns = self._first_ns = self.newest_ns = now_ns

    def _finish(self, file: McapFile, about: tuple[tuple[int, int], int, int, Latched]) -> None:
        """Finish a file and make room (in the thread)."""
        try:
            with suppress(InputError):  # a full disk: its messages can be read without its index
                file.close()
            with self._account:
                self._lost += file.unwritten + _dropped(file)
                self._unfinished = tuple(item for item in self._unfinished if item is not file)
            facts = (file.path, file.channels, file.counts, file.start_ns, file.end_ns, file.size)
            self.splits.append(Split(*facts, *about))
            self.make_room()
        except Exception as error:
            self._fault = error

    def keep(self, start_ns: int, end_ns: int) -> None:
        """Protect what is stamped between two times, and the margins around an event."""
        start_ns -= round(self.config.pre_event_s * NS)
        end_ns += round(self.config.post_event_s * NS)
        last = self.events[-1] if self.events else None
        if last is not None and start_ns <= last[1] and last[0] <= end_ns:
            last[0], last[1] = min(last[0], start_ns), max(last[1], end_ns)
        else:
            self.events.append([start_ns, end_ns])

    def is_kept(self, split: Split) -> bool:
        """Tell whether a file holds a part of an event's window."""
        first, last = split.span_ns
        return any(a <= last and first <= b for a, b in list(self.events))

    def make_room(self) -> None:
        """Delete the oldest files that are too old, or one too many for the budget."""
        size = sum(split.size for split in self.splits) + self.file.size
        removed: list[Split] = []
        old = self._too_old()
        for split in [item for item in self.splits if not self.is_kept(item)]:
            if split.number not in old and not 0 < self.config.budget_gb * 1e9 < size:
                break
            removed.append(split)
            size -= split.size
        if removed:
            self._remove(removed)

    def _too_old(self) -> set[int]:
        """Return the numbers of the files behind which ``keep_h`` hours are recorded already.

        What counts is what newer files hold, not how far stamps are apart: a clock of the source
        that leaps ahead makes nothing old.
        """
        keep_ns = self.config.keep_h * 3600 * NS
        held, old = 0, set()
        for split in reversed(self.splits):
            if 0 < keep_ns <= held:
                old.add(split.number)
            held += split.length_ns
        return old

    def _remove(self, removed: list[Split]) -> None:
        """Delete files; the head is written first, so that at no time anything is missing."""
        gone = {split.number for split in removed}
        left = [split for split in self.splits if split.number not in gone]
        try:
            self._write_head(self._carried(left))
        except InputError:
            return  # a full disk: next time
        for split in removed:
            with suppress(OSError):
                split.path.unlink()
            self._deleted += 1
            self._deleted_bytes += split.size
        self.splits = deque(left)

    def _carried(self, left: list[Split]) -> list[tuple[int, str, bytes]]:
        """Return what held where a file begins whose predecessor is gone, and is in no file."""
        begins = [(split.number, split.latched) for split in left]
        begins.append((self._number, self._at_begin))
        found: dict[tuple[int, str, str], bytes] = {}
        before = -1
        for number, latched in begins:
            if number != before + 1:
                found |= {(t, *key): data for key, (t, data) in latched.items()}
            before = number
        return [
            (t, topic, data)
            for (t, topic, _), data in sorted(found.items())
            if not any(split.span_ns[0] <= t <= split.span_ns[1] for split in left)
        ]

    def _write_head(self, messages: list[tuple[int, str, bytes]]) -> None:
        path = self.folder / f"{self.folder.resolve().name}_{HEAD}.mcap"
        draft = path.with_name(f".{path.name}")
        with suppress(OSError):
            draft.unlink()
        file = self._fill_head(draft, messages)
        try:
            os.replace(draft, path)
        except OSError as error:
            raise InputError(path, f"cannot be written: {error.strerror}") from None
        file.path = path
        self._head = file

    def _fill_head(self, draft: Path, messages: list[tuple[int, str, bytes]]) -> McapFile:
        file = self.open_file(HEAD, draft)
        numbers = {c.topic: number for number, c in file.channels.items()}
        try:
            for stamp_ns, topic, data in messages:
                file.write(numbers[topic], stamp_ns, stamp_ns, data)
        finally:
            file.close()
        return file

    def state(self) -> DiskState:
        """Return what is to be said of disk and archive."""
        splits, trouble = list(self.splits), self.file.trouble
        size = sum(split.size for split in splits) + self.file.size
        try:
            free = self.guard.free()
        except OSError:
            free = 0
        return DiskState(
            free=free,
            size=size,
            written=size + self._deleted_bytes,
            files=len(splits) + 1,
            kept_for_events=sum(self.is_kept(split) for split in splits),
            deleted=self._deleted,
            oldest_ns=splits[0].span_ns[0] if splits else self._began_ns,
            newest_ns=self.newest_ns,
            lost=self._dropped_so_far(),
            trouble="" if trouble is None else trouble.strerror or str(trouble),
        )

    def _dropped_so_far(self) -> int:
        """Count messages that are lost, also those of files that are not finished yet."""
        with self._account:
            return self._lost + sum(map(_dropped, (*self._unfinished, self.file)))

    def settle(self) -> None:
        """Wait until the files that are done are finished, and old ones deleted."""
        self._worker.submit(lambda: None).result()

    def close(self) -> None:
        """Finish the files and write ``metadata.yaml``.

        Raises
        ------
        DiskError
            The last messages could not be written.
        """
        if self._closed:
            return
        self._closed = True
        self._worker.shutdown()
        last = self.file
        try:
            last.close()
        except InputError as error:
            raise DiskError(error.what, f"{error.reason}; {self._toll(last)} lost") from None
        files: list[FileFacts] = [*([self._head] if self._head else []), *self.splits, last]
        try:
            write_metadata_yaml(self.folder, files, self.custom)
        except OSError as error:
            raise DiskError(self.folder, f"has no metadata.yaml: {error.strerror}") from None

    def _toll(self, last: McapFile) -> str:
        return f"{self._lost + _dropped(last) + last.unwritten} messages"


def _dropped(file: McapFile) -> int:
    """Count the messages that a file had no room for."""
    return sum(part.count for part in file.dropped)
