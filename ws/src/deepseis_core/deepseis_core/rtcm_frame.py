"""RTCM 3: bit fields, frames, and their checksum.

References
----------
RTCM 10403.3, chapter 4 (frame, CRC-24Q); the polynomial is that of Qualcomm, 0x1864CFB.
"""

from __future__ import annotations

from typing import Final

from deepseis_core.errors import InputError

PREAMBLE: Final = 0xD3
MAX_PAYLOAD: Final = 1023
_POLYNOMIAL: Final = 0x1864CFB


def _crc_table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        crc = byte << 16
        for _ in range(8):
            crc <<= 1
            if crc & 0x1000000:
                crc ^= _POLYNOMIAL
        table.append(crc)
    return tuple(table)


_TABLE = _crc_table()


def crc24q(data: bytes) -> int:
    """Return the checksum of bytes.

    Examples
    --------
    >>> f"{crc24q(b'123456789'):06x}"
    'cde703'
    """
    crc = 0
    for byte in data:
        crc = (crc << 8) & 0xFFFFFF ^ _TABLE[(crc >> 16) ^ byte]
    return crc


class Bits:
    """A message being put together, first bit first; a number that does not fit is refused.

    Examples
    --------
    >>> Bits().unsigned(5, 3).signed(-1, 5).payload().hex()
    'bf'
    """

    def __init__(self) -> None:
        self._value, self.size = 0, 0

    def unsigned(self, value: int, size: int) -> Bits:
        """Append an unsigned integer of ``size`` bits."""
        if not 0 <= value < 1 << size:
            raise InputError("RTCM", f"{value} does not fit {size} bits")
        self._value, self.size = self._value << size | value, self.size + size
        return self

    def signed(self, value: int, size: int) -> Bits:
        """Append a two's complement integer of ``size`` bits."""
        half = 1 << (size - 1)
        if not -half <= value < half:
            raise InputError("RTCM", f"{value} does not fit {size} bits with sign")
        return self.unsigned(value & (1 << size) - 1, size)

    def payload(self) -> bytes:
        """Return the bytes, the last one filled up with zeros."""
        pad = -self.size % 8
        return (self._value << pad).to_bytes((self.size + pad) // 8, "big")


def frame(bits: Bits) -> bytes:
    """Return the transport frame of a message: preamble, length, payload, checksum."""
    payload = bits.payload()
    if len(payload) > MAX_PAYLOAD:
        raise InputError("RTCM", f"a message of {len(payload)} bytes is too long")
    body = bytes([PREAMBLE]) + len(payload).to_bytes(2, "big") + payload
    return body + crc24q(body).to_bytes(3, "big")


class Deframer:
    """Finds the frames in a stream of bytes that may be cut or damaged anywhere.

    A checksum that does not fit costs one byte, not a frame's length: a preamble that was none
    hides nothing that follows.

    Attributes
    ----------
    damaged : int
        Preambles whose checksum did not fit.
    skipped : int
        Bytes that belonged to no frame.

    Examples
    --------
    >>> deframer = Deframer()
    >>> whole = frame(Bits().unsigned(1005, 12))
    >>> [item == whole for item in deframer.push(b"noise" + whole[:3])], deframer.skipped
    ([], 5)
    >>> [item == whole for item in deframer.push(whole[3:] + whole)]
    [True, True]
    """

    def __init__(self) -> None:
        self.damaged = self.skipped = 0
        self._rest = bytearray()

    def push(self, data: bytes) -> list[bytes]:
        """Take the next bytes; return the frames that are whole now."""
        rest, found, at = self._rest, list[bytes](), 0
        rest += data
        while True:
            start = rest.find(PREAMBLE, at)
            self.skipped += (len(rest) if start < 0 else start) - at
            at = len(rest) if start < 0 else start
            if len(rest) - at < 3:
                break
            length = int.from_bytes(rest[at + 1 : at + 3], "big")
            end = at + 3 + length + 3
            if length <= MAX_PAYLOAD and end > len(rest):
                break
            whole = bytes(rest[at:end])
            if length <= MAX_PAYLOAD and crc24q(whole) == 0:
                found.append(whole)
                at = end
            else:
                self.damaged += 1
                self.skipped += 1
                at += 1
        del rest[:at]
        return found
