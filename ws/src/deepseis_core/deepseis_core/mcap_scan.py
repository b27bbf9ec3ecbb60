"""Reads an MCAP file from front to back, whole, cut short or damaged, in bounded memory.

The index at the file's end is not needed: after ``kill -9`` there is none. A file that ends
within a record is *cut*: everything before is given and :attr:`McapScan.cut_at` tells where it
stops. Bytes that contradict themselves (a checksum, an impossible length) are *damage*: an
``InputError``, or, when tolerated, a chunk left out and counted; the scan goes on at the next
place that looks like the beginning of a chunk.

A checksum of zero says in MCAP that none was given, and is what a hole in a file leaves. Writers
give all of their chunks one or none: where another chunk of the file has one that fits, a chunk
without is damage.
"""

from __future__ import annotations

import os
import re
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple

import lz4.frame
import zstandard
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode

from deepseis_core.errors import InputError

MAGIC: Final = b"\x89MCAP0\r\n"
RECORD_LIMIT: Final = 1 << 30  # [bytes] larger ones are damage: ours are some megabytes
MESSAGE_HEAD: Final = struct.Struct("<HIQQ")
RECORD_HEAD: Final = struct.Struct("<BQ")
CHUNK_HEAD: Final = struct.Struct("<QQQII")
CHUNK_TIMES: Final = struct.Struct("<QQ")
LAST_OPCODE: Final = int(Opcode.DATA_END)
ENDS: Final = {(int(Opcode.DATA_END), 4), (int(Opcode.FOOTER), 20)}
"""Opcode and length of what ends the data; a chunk whose opcode is damaged has another length."""
PRIVATE_OPCODE: Final = 0x80  # opcodes from here on are for others' use, and skipped
CHUNK_START: Final = re.compile(
    rb"\x06(?=(.{8}.{28}(?:\x04\x00{3}zstd|\x03\x00{3}lz4|\x00{4})))", re.DOTALL
)
"""Opcode, length, head and compression of a chunk."""
LOGGED_EARLY_NS: Final = 5_000_000_000
"""A message may be logged so much earlier than others of its stamp [ns]."""
RECOVER: Final = "try: deepseis recover BAG"


@dataclass(frozen=True)
class Channel:
    """A topic as one recorder wrote it."""

    id: int
    topic: str
    type_name: str
    schema_encoding: str
    schema: bytes
    encoding: str
    metadata: dict[str, str] = field(default_factory=dict)


class Message(NamedTuple):
    """One message; ``data`` is a view of the chunk that held it."""

    channel: Channel
    log_time_ns: int
    publish_time_ns: int
    sequence: int
    data: memoryview


class _Damage(Exception):  # noqa: N818 (never leaves this module)
    """What contradicts itself in the record at hand."""


_ERRORS = (
    _Damage,
    struct.error,
    IndexError,
    UnicodeDecodeError,
    ValueError,
    RuntimeError,
    OverflowError,
    MemoryError,
    zstandard.ZstdError,
    McapError,
)
"""What the parsers raise on garbage (lz4: RuntimeError)."""


class McapScan:
    """One pass over an MCAP file; the attributes grow while :meth:`messages` runs.

    Parameters
    ----------
    path : path
        The file.
    tolerant : bool
        Leave damaged chunks out and count them in ``damaged_chunks`` instead of raising.

    Attributes
    ----------
    channels : dict
        Topics met so far, by channel number.
    metadata : dict
        Metadata records met so far, by name.
    attachments : list
        Attachment records met so far.
    cut_at : int or None
        Byte where a file that was cut short stops making sense.
    """

    def __init__(self, path: str | Path, *, tolerant: bool = False) -> None:
        self.path = Path(path)
        self.tolerant = tolerant
        self.profile = ""
        self.channels: dict[int, Channel] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self.attachments: list[records.Attachment] = []
        self.cut_at: int | None = None
        self.damaged_chunks = 0
        self._damage: set[int] = set()
        self._schemas: dict[int, records.Schema] = {}
        self._passed: list[tuple[int, int]] = []
        self._has_checksums: bool | None = None
        _require_mcap(self.path)

    def messages(
        self, wanted: Callable[[Channel], bool] | None = None, *, since_ns: int = 0
    ) -> Iterator[Message]:
        """Yield the messages of the wanted channels in the order of the file.

        Parameters
        ----------
        wanted : callable, optional
            Tells of a channel; all if not given.
        since_ns : int, optional
            Log time [ns]: chunks that end before are passed over without being read, once a
            wanted channel is known.

        Raises
        ------
        InputError
            At damage, naming the byte.
        """
        with self.path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            file.seek(len(MAGIC))
            trusted = len(MAGIC)  # everything before has been read, or found to be damaged
            while True:
                start = file.tell()
                head = file.read(RECORD_HEAD.size)
                opcode, length = RECORD_HEAD.unpack(head.ljust(RECORD_HEAD.size, b"\0"))
                if (opcode, length) in ENDS and length <= size - file.tell():
                    if self._damage and self._found_chunk(file, trusted, size):
                        continue
                    return
                unknown = _is_unknown(opcode, length)
                is_short = len(head) < RECORD_HEAD.size
                if is_short or unknown or length > size - file.tell():
                    if self._found_chunk(file, trusted, size):
                        continue
                    if not is_short:
                        self._require_cut(file, start, 255 if unknown and opcode else opcode)
                    self.cut_at = start
                    return
                try:
                    if length > RECORD_LIMIT:
                        file.seek(length, os.SEEK_CUR)
                        raise _Damage("its length is impossible")
                    if since_ns and opcode == Opcode.CHUNK and self._knows(wanted):
                        _, end_ns = CHUNK_TIMES.unpack(file.read(CHUNK_TIMES.size))
                        file.seek(-CHUNK_TIMES.size, os.SEEK_CUR)
                        if end_ns < since_ns:
                            self._passed.append((file.tell(), length))
                            file.seek(length, os.SEEK_CUR)
                            continue
                    yield from self._record(opcode, file.read(length), wanted)
                    trusted = file.tell() if opcode == Opcode.CHUNK else trusted
                except _ERRORS as error:
                    self._damaged(opcode, start, error)
                    trusted = start + 1
                    behind = file.tell()
                    swallowed = _next_chunk(file, trusted, size, behind)
                    file.seek(behind if swallowed is None else swallowed)

    def _found_chunk(self, file: BinaryIO, at: int, size: int) -> bool:
        """Go on at the next chunk from a place on, if there is one and damage is tolerated."""
        place = _next_chunk(file, at, size) if self.tolerant else None
        if place is None:
            return False
        self._note_damage(at)
        file.seek(place)
        return True

    def _gives_checksums(self) -> bool:
        """Tell whether some chunk has a checksum that fits; it is looked for once."""
        if self._has_checksums is None:
            with self.path.open("rb") as file:
                self._has_checksums = any(map(_fits_its_checksum, _chunks_with_checksum(file)))
        return self._has_checksums

    def _note_damage(self, at: int) -> None:
        """Count damage between chunks, unless it is that of the chunk before."""
        self.damaged_chunks += at - 1 not in self._damage
        self._damage.add(at)

    def _knows(self, wanted: Callable[[Channel], bool] | None) -> bool:
        return any(wanted is None or wanted(channel) for channel in self.channels.values())

    def _read_passed(self) -> None:
        """Read what was declared in chunks that were passed over."""
        passed, self._passed = self._passed, []
        with self.path.open("rb") as file:
            for place, length in passed:
                file.seek(place)
                for _ in self._chunk(file.read(length), lambda _channel: False):
                    pass

    def _require_cut(self, file: BinaryIO, start: int, opcode: int) -> None:
        """Tell a record that the end cuts, or a tail never written, from garbage."""
        if opcode == 0:
            file.seek(start)
            while piece := file.read(1 << 20):
                if piece.strip(b"\0"):
                    opcode = 255
                    break
        if opcode <= LAST_OPCODE or self.tolerant:
            self.cut_at = start
            return
        raise InputError(self.path, f"is damaged at byte {start}: no MCAP record there", RECOVER)

    def _damaged(self, opcode: int, start: int, error: BaseException) -> None:
        if self.tolerant:
            self.damaged_chunks += 1
            self._damage.add(start)
            return
        name = Opcode(opcode).name.lower() if opcode <= LAST_OPCODE else "record"
        reason = str(error) or type(error).__name__
        raise InputError(
            self.path, f"is damaged at byte {start}: {name}: {reason}", RECOVER
        ) from None

    def _record(
        self, opcode: int, data: bytes, wanted: Callable[[Channel], bool] | None
    ) -> Iterator[Message]:
        if opcode == Opcode.CHUNK:
            yield from self._chunk(data, wanted)
        elif opcode == Opcode.MESSAGE:
            yield from self._message(memoryview(data), wanted)
        elif opcode == Opcode.METADATA:
            found = records.Metadata.read(_stream(data))
            self.metadata[found.name] = found.metadata
        elif opcode == Opcode.ATTACHMENT:
            self.attachments.append(records.Attachment.read(_stream(data)))
        elif opcode == Opcode.HEADER:
            self.profile = records.Header.read(_stream(data)).profile
        else:
            self._definition(opcode, data)

    def _definition(self, opcode: int, data: bytes | memoryview) -> None:
        if opcode == Opcode.SCHEMA:
            schema = records.Schema.read(_stream(data))
            self._schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = records.Channel.read(_stream(data))
            schema = self._schemas.get(channel.schema_id) or records.Schema(0, b"", "", "")
            self.channels[channel.id] = Channel(
                id=channel.id,
                topic=channel.topic,
                type_name=schema.name,
                schema_encoding=schema.encoding,
                schema=bytes(schema.data),
                encoding=channel.message_encoding,
                metadata=dict(channel.metadata),
            )

    def _chunk(self, data: bytes, wanted: Callable[[Channel], bool] | None) -> Iterator[Message]:
        content, is_checked = _decompress(data)
        if is_checked:
            self._has_checksums = True
        elif self._gives_checksums() and zlib.crc32(content):
            raise _Damage("its checksum is zero, other chunks have one")
        position = 0
        while position < len(content):
            opcode, length = RECORD_HEAD.unpack_from(content, position)
            position += RECORD_HEAD.size
            if length > len(content) - position:
                raise _Damage("a record is longer than its chunk")
            record = content[position : position + length]
            position += length
            if opcode == Opcode.MESSAGE:
                yield from self._message(record, wanted)
            else:
                self._definition(opcode, record)

    def _message(
        self, record: memoryview, wanted: Callable[[Channel], bool] | None
    ) -> Iterator[Message]:
        number, sequence, log_time, publish_time = MESSAGE_HEAD.unpack_from(record)
        if number not in self.channels and self._passed:
            self._read_passed()
        channel = self.channels.get(number)
        if channel is None:
            raise _Damage(f"a message of the undeclared channel {number}")
        if wanted is None or wanted(channel):
            yield Message(channel, log_time, publish_time, sequence, record[MESSAGE_HEAD.size :])


def _is_unknown(opcode: int, length: int) -> bool:
    """Tell whether no record begins like this."""
    if opcode in (Opcode.DATA_END, Opcode.FOOTER):
        return (opcode, length) not in ENDS
    return opcode == 0 or LAST_OPCODE < opcode < PRIVATE_OPCODE


def _require_mcap(path: Path) -> None:
    try:
        with path.open("rb") as file:
            magic = file.read(len(MAGIC))
    except IsADirectoryError:
        raise InputError(path, "is a directory", "name an MCAP file or a bag's folder") from None
    except OSError as error:
        raise InputError(path, error.strerror or str(error)) from None
    if not magic:
        raise InputError(path, "is empty")
    if magic != MAGIC:
        raise InputError(path, "is not an MCAP file")


def _stream(data: bytes | memoryview) -> ReadDataStream:
    return ReadDataStream(BytesIO(data))


def _next_chunk(file: BinaryIO, at: int, size: int, begin_by: int | None = None) -> int | None:
    """Return the next place that looks like the beginning of a chunk.

    ``size`` is the file's; it begins before ``begin_by``, if that is given.
    """
    reach, last = 1 << 24, size if begin_by is None else begin_by
    while at < last:
        file.seek(at)
        block = file.read(reach + CHUNK_HEAD.size + RECORD_HEAD.size + 16)
        for match in CHUNK_START.finditer(block):
            (length,) = struct.unpack_from("<Q", match[1])
            end = match.end(1)
            inside = len(match[1]) + int.from_bytes(block[end : end + 8], "little")
            left = size - at - match.start() - RECORD_HEAD.size
            if length == inside <= min(RECORD_LIMIT, left):
                place = at + match.start()
                return place if place < last else None
        at += reach
    return None


def _chunks_with_checksum(file: BinaryIO) -> Iterator[bytes]:
    """Yield the chunks that have a checksum, whether it fits or not, without reading others."""
    size, place = os.fstat(file.fileno()).st_size, len(MAGIC)
    while place < size:
        file.seek(place)
        opcode, length = RECORD_HEAD.unpack(file.read(RECORD_HEAD.size).ljust(9, b"\0"))
        end = place + RECORD_HEAD.size + length
        if (opcode, length) in ENDS:
            return
        if _is_unknown(opcode, length) or end > size:
            place = _next_chunk(file, place + 1, size) or size
            continue
        if opcode == Opcode.CHUNK and CHUNK_HEAD.size <= length <= RECORD_LIMIT:
            head = file.read(CHUNK_HEAD.size)
            if CHUNK_HEAD.unpack(head)[3]:
                yield head + file.read(length - CHUNK_HEAD.size)
        place = end


def _fits_its_checksum(chunk: bytes) -> bool:
    try:
        return _decompress(chunk)[1]
    except _ERRORS:
        return False


def _decompress(data: bytes) -> tuple[memoryview, bool]:
    """Return what a chunk holds, and whether it has a checksum."""
    _, _, size, crc, name_length = CHUNK_HEAD.unpack_from(data)
    start = CHUNK_HEAD.size + name_length
    name = bytes(data[CHUNK_HEAD.size : start]).decode()
    (packed_size,) = struct.unpack_from("<Q", data, start)
    packed = memoryview(data)[start + 8 : start + 8 + packed_size]
    if size > RECORD_LIMIT or len(packed) != packed_size:
        raise _Damage("its lengths are impossible")
    content: bytes | memoryview
    if name == "":
        content = packed
    elif name == "zstd":
        if zstandard.frame_content_size(packed) > RECORD_LIMIT:
            raise _Damage("its lengths are impossible")
        content = zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
    elif name == "lz4":
        content = lz4.frame.decompress(packed)
    else:
        raise _Damage(f"unknown compression {name!r}")
    if len(content) != size or (crc and zlib.crc32(content) != crc):
        raise _Damage("its checksum does not fit")
    return memoryview(content), bool(crc)
