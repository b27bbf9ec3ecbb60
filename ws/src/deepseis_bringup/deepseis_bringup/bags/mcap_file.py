"""Writes one MCAP file so that whoever is killed loses a quarter of a second, not the file.

Messages are gathered into chunks; a thread compresses, checks and writes them when they are
full or ``flush_interval`` old, so that the caller's part is one copy of the bytes. Compression
(zstd) and file access release the interpreter.

What is written goes to the file whole or not at all: a write that fails, on a full disk, is taken
back to the end of the chunk before. A *patient* file then keeps what it has, tries again every
second, and drops messages, counting them, once ``PENDING_BYTES`` wait.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import zstandard
from mcap import records

from deepseis_bringup.bags.full_disk import Dropped, FullDisk
from deepseis_bringup.bags.mcap_layout import Chunk, Single, Summary, record_bytes
from deepseis_bringup.bags.spilled_bytes import SpilledBytes
from deepseis_bringup.bags.whole_writes import WholeWrites
from deepseis_core.errors import DiskError, InputError
from deepseis_core.mcap_scan import MAGIC, Channel

COMPRESSIONS: Final = ("zstd", "none")
ZSTD_LEVEL: Final = 1  # 260-700 MB/s on IF samples; higher levels gain 2 %
CHUNK_BYTES: Final = 4 << 20
PENDING_BYTES: Final = 64 << 20  # a disk slower than the stream holds the caller back from here
FLUSH_INTERVAL: Final = 0.2  # [s]
RETRY_SECONDS: Final = 1.0  # between attempts to write to a disk that was full [s]


class McapFile:
    """An MCAP file being written.

    Parameters
    ----------
    path : path
        File to be made; it must not exist.
    profile, library : str
        Of the header.
    compression : {'zstd', 'none'}
        Of the chunks.
    flush_interval : float
        Longest stay of a message in memory [s].
    patient : bool
        Wait for room on a full disk instead of failing.
    guard : callable, optional
        Called before each write but those of the end; an ``OSError`` of it counts as the disk's.
    sync_interval : float
        How often the disk is told to keep what it has, against a loss of power; 0: never [s].

    Raises
    ------
    DiskError
        Where the file cannot be made or, from any method, written.
    """

    def __init__(
        self,
        path: Path,
        *,
        profile: str = "ros2",
        library: str = "deepseis",
        compression: str = "zstd",
        flush_interval: float = FLUSH_INTERVAL,
        patient: bool = False,
        guard: Callable[[], None] | None = None,
        sync_interval: float = 0.0,
    ) -> None:
        if compression not in COMPRESSIONS:
            raise InputError("compression", f"{compression!r} is not one of {COMPRESSIONS}")
        self.path = path
        self._summary = Summary(SpilledBytes(path.parent))
        self._compression = "" if compression == "none" else compression
        compressor = zstandard.ZstdCompressor(level=ZSTD_LEVEL)
        self._compress = compressor.compress if self._compression else None
        self._flush_interval, self._patient = flush_interval, patient
        self._open: Chunk | None = None
        self._queue: deque[Chunk | Single] = deque()
        self._pending = 0
        self._closing = False
        self._error: BaseException | None = None
        self._disk = FullDisk()
        self._wake = threading.Condition()
        self._out = WholeWrites(path, sync_interval=sync_interval)
        try:
            self._out.put(MAGIC + record_bytes(records.Header(profile, library)))
            self._out.commit()
        except OSError as error:
            raise DiskError(path, f"cannot be made: {error.strerror}") from None
        self._out.guard = guard
        self._thread = threading.Thread(target=self._run, name=f"writes {path.name}", daemon=True)
        self._thread.start()

    @property
    def channels(self) -> dict[int, Channel]:
        """Topics by number."""
        return self._summary.channels

    @property
    def counts(self) -> dict[int, int]:
        """Messages by number of the topic."""
        return self._summary.counts

    @property
    def start_ns(self) -> int:
        """First log time of a message; 2**63 - 1 before there is one [ns]."""
        return self._summary.start_ns

    @property
    def end_ns(self) -> int:
        """Last log time of a message [ns]."""
        return self._summary.end_ns

    @property
    def size(self) -> int:
        """Bytes in the file."""
        return self._out.written

    @property
    def unwritten(self) -> int:
        """Messages that wait to be written."""
        with self._wake:
            waiting = [job for job in (*self._queue, self._open) if isinstance(job, Chunk)]
            return sum(len(part) for chunk in waiting for part in chunk.index.values())

    @property
    def trouble(self) -> OSError | None:
        """Why nothing is written at present (patient files)."""
        return self._disk.trouble

    @property
    def dropped(self) -> list[Dropped]:
        """What was lost that way, one for each time."""
        return self._disk.dropped

    def add_channel(
        self,
        topic: str,
        type_name: str,
        schema: bytes,
        metadata: Mapping[str, str],
        *,
        schema_encoding: str = "ros2msg",
        encoding: str = "cdr",
    ) -> int:
        """Declare a topic and return its number."""
        number = len(self.channels) + 1
        channel = Channel(
            number, topic, type_name, schema_encoding, schema, encoding, dict(metadata)
        )
        self._submit(Single(self._summary.declare(channel)))
        return number

    def write(
        self,
        channel: int,
        log_time_ns: int,
        publish_time_ns: int,
        data: bytes | bytearray | memoryview,
        sequence: int | None = None,
    ) -> None:
        """Add a message; waits only where the disk is far behind.

        A patient file in trouble drops it where too much waits already.
        """
        with self._wake:
            self._require_healthy()
            if self.trouble is not None and self._pending > PENDING_BYTES:
                self._disk.drop(log_time_ns)
                return
            if self._open is None:
                self._open = Chunk()
                self._wake.notify()
            before = self._summary.count(channel, log_time_ns)
            number = before if sequence is None else sequence
            self._open.add(channel, number, (log_time_ns, publish_time_ns), data)
            if len(self._open.data) >= CHUNK_BYTES:
                self._close_chunk()
            while self._pending > PENDING_BYTES and not (self._error or self.trouble):
                self._wake.wait()

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record."""
        self._submit(Single.metadata(name, values))

    def add_attachment(
        self, name: str, data: bytes, media_type: str, create_time_ns: int = 0
    ) -> None:
        """Attach a file."""
        self._submit(Single.attachment(name, data, media_type, create_time_ns))

    def close(self) -> None:
        """Write what is pending and the index."""
        with self._wake:
            self._closing = True
            self._out.guard = None  # what waits and the index are small
            self._wake.notify_all()
        self._thread.join()
        self._summary.chunks.close()
        try:
            self._out.close()
        except OSError as error:
            self._error = self._error or error
        self._require_healthy()

    def _submit(self, record: Single) -> None:
        with self._wake:
            self._require_healthy()
            self._queue.append(record)
            self._wake.notify()

    def _require_healthy(self) -> None:
        if self._error is not None:
            reason = getattr(self._error, "strerror", None) or self._error
            raise DiskError(self.path, f"cannot be written: {reason}") from self._error

    def _close_chunk(self) -> None:
        """Hand the open chunk to the thread (with the lock held)."""
        if self._open is not None:
            self._queue.append(self._open)
            self._pending += len(self._open.data)
            self._open = None
            self._wake.notify_all()

    def _run(self) -> None:
        """Be the thread: write until the file is closed."""
        try:
            while self._step():
                pass
            self._summary.put(self._out)
            self._out.commit()
        except Exception as error:
            with self._wake:
                self._error = error
                self._wake.notify_all()

    def _step(self) -> bool:
        """Wait for work and do it; False when all is done."""
        done = self._wait_for_work()
        while self._queue:
            try:
                self._write_job(self._queue[0])
            except OSError as error:
                self._wait_for_room(error)
                break
            self._done()
        return not done

    def _wait_for_work(self) -> bool:
        """Return when something is to be written; True: it is the last."""
        with self._wake:
            while not self._queue and not self._closing:
                chunk = self._open
                left = None if chunk is None else chunk.born + self._flush_interval
                if left is not None and left <= time.monotonic():
                    self._close_chunk()
                    break
                self._wake.wait(None if left is None else left - time.monotonic())
            if self._closing:
                self._close_chunk()
            return self._closing and not self._queue

    def _write_job(self, job: Chunk | Single) -> None:
        if isinstance(job, Chunk):
            job.pack(self._compress)
            entry = job.put(self._out, self._compression)
            self._out.commit()
            self._summary.add_chunk(entry)
            return
        if job.entry is not None:
            job.entry.offset = self._out.position
        self._out.put(job.data)
        self._out.commit()
        if job.entry is not None:
            self._summary.entries.append(job.entry)

    def _done(self) -> None:
        """Take a job that is written from the queue."""
        with self._wake:
            job = self._queue.popleft()
            if isinstance(job, Chunk):
                self._pending -= len(job.data)
            if (lost := self._disk.takes_again()) is not None:
                self._queue.append(lost)
            self._wake.notify_all()

    def _wait_for_room(self, error: OSError) -> None:
        """Let a second pass after a failure; fail where that does not help."""
        with self._wake:
            if not self._patient or self._closing:
                raise error
            self._disk.fails(error)
            self._wake.notify_all()
            self._wake.wait_for(lambda: self._closing, RETRY_SECONDS)
