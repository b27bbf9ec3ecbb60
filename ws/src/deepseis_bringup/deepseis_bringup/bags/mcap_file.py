"""Writes one MCAP file so that whoever is killed loses a quarter of a second, not the file.

Messages are gathered into chunks; a thread compresses, checks and writes them when they are
full or ``flush_interval`` old, so that the caller's part is one copy of the bytes. Compression
(zstd) and file access release the interpreter.

What is written goes to the file whole or not at all: a write that fails, on a full disk, is taken
back to the end of the chunk before. A *patient* file then keeps what it has, tries again every
second, and drops messages, counting them, once ``PENDING_BYTES`` wait.
"""

from __future__ import annotations

import fcntl
import os
import struct
import threading
import time
import zlib
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import zstandard
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode

from deepseis_core.errors import DiskError, InputError
from deepseis_core.mcap_scan import MAGIC, MESSAGE_HEAD, RECORD_HEAD, Channel

COMPRESSIONS: Final = ("zstd", "none")
ZSTD_LEVEL: Final = 1  # 260-700 MB/s on IF samples; higher levels gain 2 %
CHUNK_BYTES: Final = 4 << 20
PENDING_BYTES: Final = 64 << 20  # a disk slower than the stream holds the caller back from here
FLUSH_INTERVAL: Final = 0.2  # [s]
RETRY_SECONDS: Final = 1.0  # between attempts to write to a disk that was full [s]


@dataclass
class _Chunk:
    """Messages on their way to the file."""

    born: float
    start_ns: int = 2**63
    end_ns: int = 0
    data: bytearray = field(default_factory=bytearray)
    packed: bytes | bytearray | None = None
    index: dict[int, list[tuple[int, int]]] = field(default_factory=dict)


@dataclass
class _Record:
    """A record that stands outside chunks, with what the index says of it."""

    data: bytes
    entry: records.MetadataIndex | records.AttachmentIndex | None = None


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

    Attributes
    ----------
    trouble : OSError or None
        Why nothing is written at present (patient files).
    dropped : list of Dropped
        What was lost that way, one for each time.

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
        self.channels: dict[int, Channel] = {}
        self.counts: dict[int, int] = {}
        self.start_ns, self.end_ns = 2**63 - 1, 0
        self._schemas: dict[tuple[str, bytes], records.Schema] = {}
        self._compressor = (
            zstandard.ZstdCompressor(level=ZSTD_LEVEL) if compression == "zstd" else None
        )
        self._flush_interval = flush_interval
        self._chunk_index: list[records.ChunkIndex] = []
        self._entries: list[records.MetadataIndex | records.AttachmentIndex] = []
        self._open: _Chunk | None = None
        self._queue: deque[_Chunk | _Record] = deque()
        self._pending = 0
        self._closing = False
        self._error: BaseException | None = None
        self.trouble: OSError | None = None
        self.dropped: list[Dropped] = []
        self._patient = patient
        self._sync_interval, self._synced = sync_interval, time.monotonic()
        self._guard: Callable[[], None] | None = None
        self._wake = threading.Condition()
        self._out: list[bytes | bytearray] = []
        self._offset = self._written = 0
        self._put(MAGIC + _bytes(records.Header(profile, library)))
        try:
            self._file = path.open("xb", buffering=0)
            self._commit()
        except OSError as error:
            raise DiskError(path, f"cannot be made: {error.strerror}") from None
        with suppress(OSError):  # tells `recover` that somebody writes; not everywhere possible
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self._guard = guard
        self._thread = threading.Thread(target=self._run, name=f"writes {path.name}", daemon=True)
        self._thread.start()

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
        key = (type_name, schema)
        built = b""
        known = self._schemas.get(key)
        if known is None:
            number = len(self._schemas) + 1
            known = records.Schema(number, schema, schema_encoding, type_name)
            self._schemas[key] = known
            built = _bytes(known)
        number = len(self.channels) + 1
        channel = records.Channel(number, topic, encoding, dict(metadata), known.id)
        self.channels[number] = Channel(
            number, topic, type_name, schema_encoding, schema, encoding, dict(metadata)
        )
        self.counts[number] = 0
        self._submit(_Record(built + _bytes(channel)))
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
                self._drop(log_time_ns)
                return
            count = self.counts[channel] + 1
            chunk = self._open
            if chunk is None:
                chunk = self._open = _Chunk(time.monotonic())
                self._wake.notify()
            chunk.index.setdefault(channel, []).append((log_time_ns, len(chunk.data)))
            chunk.start_ns = min(chunk.start_ns, log_time_ns)
            chunk.end_ns = max(chunk.end_ns, log_time_ns)
            number = count - 1 if sequence is None else sequence
            chunk.data += RECORD_HEAD.pack(Opcode.MESSAGE, MESSAGE_HEAD.size + len(data))
            chunk.data += MESSAGE_HEAD.pack(
                channel, number & 0xFFFFFFFF, log_time_ns, publish_time_ns
            )
            chunk.data += data
            self.counts[channel] = count
            self.start_ns = min(self.start_ns, log_time_ns)
            self.end_ns = max(self.end_ns, log_time_ns)
            if len(chunk.data) >= CHUNK_BYTES:
                self._close_chunk()
            while self._pending > PENDING_BYTES and not (self._error or self.trouble):
                self._wake.wait()

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record."""
        data = _bytes(records.Metadata(name, dict(values)))
        self._submit(_Record(data, records.MetadataIndex(0, len(data), name)))

    def add_attachment(
        self, name: str, data: bytes, media_type: str, create_time_ns: int = 0
    ) -> None:
        """Attach a file."""
        record = records.Attachment(create_time_ns, create_time_ns, name, media_type, data)
        built = _bytes(record)
        entry = records.AttachmentIndex(
            0, len(built), create_time_ns, create_time_ns, len(data), name, media_type
        )
        self._submit(_Record(built, entry))

    def close(self) -> None:
        """Write what is pending and the index."""
        with self._wake:
            self._closing = True
            self._guard = None  # what waits and the index are small
            self._wake.notify_all()
        self._thread.join()
        try:
            self._file.close()
        except OSError as error:
            self._error = self._error or error
        self._require_healthy()

    @property
    def size(self) -> int:
        """Bytes in the file."""
        return self._written

    @property
    def unwritten(self) -> int:
        """Messages that wait to be written."""
        with self._wake:
            waiting = [job for job in (*self._queue, self._open) if isinstance(job, _Chunk)]
            return sum(len(part) for chunk in waiting for part in chunk.index.values())

    def _drop(self, log_time_ns: int) -> None:
        """Count a message that is lost (with the lock held)."""
        assert self.trouble is not None
        if not self.dropped or self.dropped[-1].reason:
            self.dropped.append(Dropped())
        self.dropped[-1].add(log_time_ns)

    def _submit(self, record: _Record) -> None:
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
        try:
            while self._step():
                pass
            self._finish()
        except Exception as error:
            with self._wake:
                self._error = error
                self._wake.notify_all()

    def _step(self) -> bool:
        """Wait for work and do it; False when all is done."""
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
            done = self._closing and not self._queue
        while self._queue:
            try:
                self._write_job(self._queue[0])
            except OSError as error:
                self._wait_for_room(error)
                break
            self._done()
        return not done

    def _done(self) -> None:
        """Take a job that is written from the queue."""
        with self._wake:
            job = self._queue.popleft()
            if isinstance(job, _Chunk):
                self._pending -= len(job.data)
            if self.trouble is not None:
                self._recovered()
            self._wake.notify_all()

    def _wait_for_room(self, error: OSError) -> None:
        """Let a second pass after a failure; fail where that does not help."""
        self._out.clear()
        self._offset = self._written
        with self._wake:
            if not self._patient or self._closing:
                raise error
            self.trouble = error
            self._wake.notify_all()
            self._wake.wait_for(lambda: self._closing, RETRY_SECONDS)

    def _recovered(self) -> None:
        """Note that the disk takes data again, and what was lost (with the lock held)."""
        reason = getattr(self.trouble, "strerror", None) or str(self.trouble)
        self.trouble = None
        if self.dropped and not self.dropped[-1].reason:
            lost = self.dropped[-1]
            lost.reason = reason
            values = {name: str(value) for name, value in vars(lost).items()}
            name = f"not recorded {len(self.dropped)}"
            data = _bytes(records.Metadata(name, values))
            self._queue.append(_Record(data, records.MetadataIndex(0, len(data), name)))

    def _write_job(self, job: _Chunk | _Record) -> None:
        if isinstance(job, _Chunk):
            self._write_chunk(job)
            return
        if job.entry is not None:
            job.entry.offset = self._offset
        self._put(job.data)
        self._commit()
        if job.entry is not None:
            self._entries.append(job.entry)

    def _write_chunk(self, chunk: _Chunk) -> None:
        if chunk.packed is None:
            data = chunk.data
            chunk.packed = data if self._compressor is None else self._compressor.compress(data)
        packed = chunk.packed
        name = b"" if self._compressor is None else b"zstd"
        head = struct.pack(
            f"<QQQII{len(name)}sQ",
            chunk.start_ns,
            chunk.end_ns,
            len(chunk.data),
            zlib.crc32(chunk.data),
            len(name),
            name,
            len(packed),
        )
        start = self._offset
        self._put(RECORD_HEAD.pack(Opcode.CHUNK, len(head) + len(packed)) + head)
        self._put(packed)
        length = self._offset - start
        index_start = self._offset
        offsets = {}
        for number, entries in chunk.index.items():
            offsets[number] = self._offset
            self._put(_bytes(records.MessageIndex(number, entries)))
        self._commit()
        self._chunk_index.append(
            records.ChunkIndex(
                chunk_length=length,
                chunk_start_offset=start,
                compression=name.decode(),
                compressed_size=len(packed),
                message_end_time=chunk.end_ns,
                message_index_length=self._offset - index_start,
                message_index_offsets=offsets,
                message_start_time=chunk.start_ns,
                uncompressed_size=len(chunk.data),
            )
        )

    def _finish(self) -> None:
        """Write the summary: schemas, channels, statistics, indexes, and where they are."""
        self._put(_bytes(records.DataEnd(0)))
        start = self._offset
        ids = {key: schema.id for key, schema in self._schemas.items()}
        channels = [
            records.Channel(c.id, c.topic, c.encoding, c.metadata, ids[c.type_name, c.schema])
            for c in self.channels.values()
        ]
        metadata = [e for e in self._entries if isinstance(e, records.MetadataIndex)]
        attachments = [e for e in self._entries if isinstance(e, records.AttachmentIndex)]
        groups: list[tuple[int, list[records.McapRecord]]] = [
            (Opcode.SCHEMA, list(self._schemas.values())),
            (Opcode.CHANNEL, list(channels)),
            (Opcode.STATISTICS, [self._statistics(len(metadata), len(attachments))]),
            (Opcode.CHUNK_INDEX, list(self._chunk_index)),
            (Opcode.ATTACHMENT_INDEX, list(attachments)),
            (Opcode.METADATA_INDEX, list(metadata)),
        ]
        summary, offsets = b"", b""
        for opcode, members in groups:
            built = b"".join(_bytes(member) for member in members)
            if built:
                where = start + len(summary)
                offsets += _bytes(records.SummaryOffset(opcode, where, len(built)))
            summary += built
        offset_start = start + len(summary)
        footer_head = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offset_start)
        crc = zlib.crc32(footer_head, zlib.crc32(summary + offsets))
        self._put(summary + offsets + footer_head + struct.pack("<I", crc) + MAGIC)
        self._commit()

    def _statistics(self, metadata: int, attachments: int) -> records.Statistics:
        messages = sum(self.counts.values())
        return records.Statistics(
            attachment_count=attachments,
            channel_count=len(self.channels),
            channel_message_counts={k: n for k, n in self.counts.items() if n},
            chunk_count=len(self._chunk_index),
            message_count=messages,
            message_end_time=self.end_ns,
            message_start_time=self.start_ns if messages else 0,
            metadata_count=metadata,
            schema_count=len(self._schemas),
        )

    def _put(self, data: bytes | bytearray) -> None:
        """Add bytes to what `_commit` writes."""
        self._out.append(data)
        self._offset += len(data)

    def _commit(self) -> None:
        """Write what was put, whole or not at all."""
        data = memoryview(b"".join(self._out))
        try:
            if self._guard is not None:
                self._guard()
            while len(data):
                data = data[self._file.write(data) :]
        except OSError:
            with suppress(OSError):
                self._file.truncate(self._written)
                self._file.seek(self._written)
            raise
        self._out.clear()
        self._written = self._offset
        if 0 < self._sync_interval < time.monotonic() - self._synced:
            self._synced = time.monotonic()
            with suppress(OSError):
                os.fdatasync(self._file.fileno())


def _bytes(record: records.McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()
