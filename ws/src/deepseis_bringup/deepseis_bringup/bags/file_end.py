"""The end of a finished MCAP file: whether its index is sound, and of how many messages."""

from __future__ import annotations

import os
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final

from mcap.opcode import Opcode

from deepseis_core.mcap_scan import MAGIC, RECORD_HEAD

FOOTER_HEAD: Final = RECORD_HEAD.pack(Opcode.FOOTER, 20)
FOOTER: Final = struct.Struct("<9sQQI")
PIECE: Final = 1 << 20


@dataclass(frozen=True)
class FileEnd:
    """What stands behind a file's data.

    Attributes
    ----------
    is_sound : bool
        It is complete, and fits its checksum if it gives one.
    message_count : int or None
        As its statistics say, if it has any.
    """

    is_sound: bool
    message_count: int | None = None


def file_end(file: Path) -> FileEnd:
    """Look at the end of an MCAP file."""
    with file.open("rb") as stream:
        size = stream.seek(0, os.SEEK_END)
        footer_at = size - FOOTER.size - len(MAGIC)
        if footer_at < len(MAGIC):
            return FileEnd(is_sound=False)
        stream.seek(footer_at)
        footer = stream.read(FOOTER.size)
        head, start, _, checksum = FOOTER.unpack(footer)
        if head != FOOTER_HEAD or stream.read() != MAGIC or start > footer_at:
            return FileEnd(is_sound=False)
        if not start:  # there is no index
            return FileEnd(is_sound=True)
        if checksum and checksum != _checksum(stream, start, footer_at, footer):
            return FileEnd(is_sound=False)
        return FileEnd(True, _stated_count(stream, start, footer_at))


def _checksum(stream: BinaryIO, start: int, end: int, footer: bytes) -> int:
    """Return the checksum of the index and of the footer up to its own."""
    stream.seek(start)
    crc, left = 0, end - start
    while left and (piece := stream.read(min(PIECE, left))):
        crc, left = zlib.crc32(piece, crc), left - len(piece)
    return zlib.crc32(footer[:-4], crc)


def _stated_count(stream: BinaryIO, place: int, end: int) -> int | None:
    while place < end:
        stream.seek(place)
        opcode, length = RECORD_HEAD.unpack(stream.read(RECORD_HEAD.size))
        if opcode == Opcode.STATISTICS and length >= 8:
            return int.from_bytes(stream.read(8), "little")
        place += RECORD_HEAD.size + length
    return None
