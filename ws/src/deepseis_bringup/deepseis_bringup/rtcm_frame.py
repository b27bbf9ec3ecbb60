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
