"""What the recorder reads off serialised messages without decoding them."""

from __future__ import annotations

import struct


def stamp_of_cdr(cdr: bytes) -> int:
    r"""UTC [ns] of the header every message of ours begins with.

    Examples
    --------
    >>> stamp_of_cdr(b"\0\1\0\0" + struct.pack("<iI", 2, 5))
    2000000005
    """
    sec, nanosec = struct.unpack_from("<iI" if cdr[1] & 1 else ">iI", cdr, 4)
    return int(sec) * 1_000_000_000 + int(nanosec)


def if_block_end(cdr: bytes) -> int:
    """Last sample index of a serialised ``IfBlock`` (little endian)."""
    frame_length = struct.unpack_from("<I", cdr, 12)[0]
    at = 16 + frame_length
    at = 4 + (at - 4 + 7) // 8 * 8
    index, count = struct.unpack_from("<qI", cdr, at)
    return int(index + count - 1)
