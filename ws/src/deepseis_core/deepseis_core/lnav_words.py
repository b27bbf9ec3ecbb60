"""GPS LNAV words: parity, and one table of bit fields that encoder and decoder share.

Bits are numbered as in the standard, 1 to 300 of a subframe. As a signal, logic 0 is +1.

References
----------
IS-GPS-200, 20.3: parity 20.3.5.2, TLM and HOW 20.3.3, subframes 1 to 3 tables 20-I and 20-III,
subframe 4 page 18 figure 20-1 sheet 8.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepseis_core.constants import GPS_PI

BitArray = NDArray[np.uint8]

SUBFRAME_BITS = 300
SUBFRAME_S = 6
PREAMBLE = 0b10001011
IONO_PAGE_ID = 56  # "SV ID" of subframe 4 page 18

# Data bits that enter each of the six parity bits, and the bit of the word before (29 or 30).
_PARITY = (
    (29, (1, 2, 3, 5, 6, 10, 11, 12, 13, 14, 17, 18, 20, 23)),
    (30, (2, 3, 4, 6, 7, 11, 12, 13, 14, 15, 18, 19, 21, 24)),
    (29, (1, 3, 4, 5, 7, 8, 12, 13, 14, 15, 16, 19, 20, 22)),
    (30, (2, 4, 5, 6, 8, 9, 13, 14, 15, 16, 17, 20, 21, 23)),
    (30, (1, 3, 5, 6, 7, 9, 10, 14, 15, 16, 17, 18, 21, 22, 24)),
    (29, (3, 5, 6, 8, 9, 10, 11, 13, 15, 19, 22, 23, 24)),
)
_MASKS = np.array(
    [sum(1 << (24 - bit) for bit in bits) | 1 << (54 - last) for last, bits in _PARITY], np.int64
)  # over the 26 bits D29* D30* d1 ... d24


@dataclass(frozen=True)
class Field:
    """A number in a subframe: first bit and length of its parts, sign, unit of the last bit."""

    name: str
    parts: tuple[tuple[int, int], ...]
    exponent: int = 0
    signed: bool = False
    semicircles: bool = False

    @property
    def size(self) -> int:
        """Length [bits]."""
        return sum(length for _, length in self.parts)

    @property
    def unit(self) -> float:
        """Value of the last bit, radians for semicircles."""
        return 2.0**self.exponent * (GPS_PI if self.semicircles else 1.0)


def unsigned(name: str, exponent: int, *parts: tuple[int, int]) -> Field:
    """Return an unsigned field."""
    return Field(name, parts, exponent)


def _s(name: str, exponent: int, *parts: tuple[int, int]) -> Field:
    return Field(name, parts, exponent, signed=True)


def _angle(name: str, exponent: int, *parts: tuple[int, int]) -> Field:
    return Field(name, parts, exponent, signed=True, semicircles=True)


HANDOVER = (unsigned("tow_count", 0, (31, 17)), unsigned("subframe_id", 0, (50, 3)))
SUBFRAME_FIELDS: dict[int, tuple[Field, ...]] = {
    1: (
        unsigned("week", 0, (61, 10)),
        unsigned("l2_code", 0, (71, 2)),
        unsigned("ura", 0, (73, 4)),
        unsigned("health", 0, (77, 6)),
        unsigned("iodc", 0, (83, 2), (211, 8)),
        unsigned("l2p_flag", 0, (91, 1)),
        _s("tgd", -31, (197, 8)),
        unsigned("toc", 4, (219, 16)),
        _s("af2", -55, (241, 8)),
        _s("af1", -43, (249, 16)),
        _s("af0", -31, (271, 22)),
    ),
    2: (
        unsigned("iode", 0, (61, 8)),
        _s("crs", -5, (69, 16)),
        _angle("delta_n", -43, (91, 16)),
        _angle("m0", -31, (107, 8), (121, 24)),
        _s("cuc", -29, (151, 16)),
        unsigned("eccentricity", -33, (167, 8), (181, 24)),
        _s("cus", -29, (211, 16)),
        unsigned("sqrt_a", -19, (227, 8), (241, 24)),
        unsigned("toe", 4, (271, 16)),
        unsigned("fit_interval_flag", 0, (287, 1)),
    ),
    3: (
        _s("cic", -29, (61, 16)),
        _angle("omega0", -31, (77, 8), (91, 24)),
        _s("cis", -29, (121, 16)),
        _angle("i0", -31, (137, 8), (151, 24)),
        _s("crc", -5, (181, 16)),
        _angle("omega", -31, (197, 8), (211, 24)),
        _angle("omega_dot", -43, (241, 24)),
        unsigned("iode", 0, (271, 8)),
        _angle("i_dot", -43, (279, 14)),
    ),
}
PAGE_FIELDS = (unsigned("data_id", 0, (61, 2)), unsigned("page_id", 0, (63, 6)))
IONO_FIELDS = (
    _s("alpha0", -30, (69, 8)),
    _s("alpha1", -27, (77, 8)),
    _s("alpha2", -24, (91, 8)),
    _s("alpha3", -24, (99, 8)),
    _s("beta0", 11, (107, 8)),
    _s("beta1", 14, (121, 8)),
    _s("beta2", 16, (129, 8)),
    _s("beta3", 16, (137, 8)),
    _s("a1", -50, (151, 24)),
    _s("a0", -30, (181, 24), (211, 8)),
    unsigned("tot", 12, (219, 8)),
    unsigned("week_t", 0, (227, 8)),
    _s("leap_s", 0, (241, 8)),
    unsigned("week_lsf", 0, (249, 8)),
    unsigned("day_lsf", 0, (257, 8)),
    _s("leap_lsf_s", 0, (271, 8)),
)


def get_raw(bits: BitArray, field: Field) -> int:
    """Return a field's integer from the 300 logic bits of a subframe, D30* taken off."""
    packed = int.from_bytes(np.packbits(bits).tobytes(), "big")
    n_bits = -(-bits.size // 8) * 8
    value = 0
    for first, length in field.parts:
        part = packed >> (n_bits - first + 1 - length) & ((1 << length) - 1)
        value = value << length | part
    if field.signed and value >> (field.size - 1):
        value -= 1 << field.size
    return value


def put_raw(bits: BitArray, field: Field, value: int) -> None:
    """Write a field's integer; raise ``ValueError`` where it does not fit."""
    low, high = (
        (-(1 << (field.size - 1)), (1 << (field.size - 1)) - 1)
        if field.signed
        else (0, (1 << field.size) - 1)
    )
    if field.semicircles:  # angles wrap
        value = (value - low) % (1 << field.size) + low
    if not low <= value <= high:
        raise ValueError(f"{field.name} does not fit into {field.size} bits")
    shift = field.size
    for first, length in field.parts:
        shift -= length
        for i in range(length):
            bits[first - 1 + i] = value >> (shift + length - 1 - i) & 1


def get_fields(bits: BitArray, fields: tuple[Field, ...]) -> dict[str, float]:
    """Return the values of fields, in SI units and radians, from data bits."""
    return {field.name: get_raw(bits, field) * field.unit for field in fields}


@njit(cache=True, nogil=True)
def parity_bits(data26: int, masks: NDArray[np.int64]) -> int:
    """Return D25 ... D30 of a word from the 26 bits D29* D30* d1 ... d24 (kernel)."""
    parity = 0
    for i in range(6):
        x = data26 & masks[i]
        x ^= x >> 16
        x ^= x >> 8
        x ^= x >> 4
        x ^= x >> 2
        x ^= x >> 1
        parity = parity << 1 | (x & 1)
    return parity


@njit(cache=True, nogil=True)
def _subframe_words(bits: BitArray, masks: NDArray[np.int64], data: BitArray) -> int:
    """Take D30* off ten received words; return a mask of failed ones, bit 0 = word 1 (kernel).

    ``bits`` has the true polarity. Word 1 follows D29* = D30* = 0, as every word 10 ends so.
    """
    failed = 0
    last = 0  # D29* D30*
    for word in range(10):
        packed = 0
        for i in range(30):
            packed = packed << 1 | bits[30 * word + i]
        source = packed >> 6
        if last & 1:
            source ^= 0xFFFFFF
        if parity_bits(last << 24 | source, masks) != packed & 0x3F:
            failed |= 1 << word
        for i in range(24):
            data[30 * word + i] = source >> (23 - i) & 1
        for i in range(24, 30):
            data[30 * word + i] = bits[30 * word + i]
        last = packed & 3
    return failed


def remove_parity(bits: BitArray) -> tuple[BitArray, int]:
    """Check a subframe and take the D30* inversion off its data bits.

    Parameters
    ----------
    bits : ndarray of uint8, shape (300,)
        Logic bits as transmitted, true polarity.

    Returns
    -------
    data : ndarray of uint8, shape (300,)
        Data bits d1 ... d24 of each word; the parity bits as they came.
    failed : int
        Words whose parity is wrong: bit 0 is word 1.
    """
    data = np.zeros(SUBFRAME_BITS, np.uint8)
    return data, int(_subframe_words(bits, _MASKS, data))


@njit(cache=True, nogil=True)
def _close_words(bits: BitArray, masks: NDArray[np.int64]) -> None:
    """Turn data bits into transmitted words in place: t bits, parity, D30* (kernel)."""
    last = 0
    for word in range(10):
        source = 0
        for i in range(24):
            source = source << 1 | bits[30 * word + i]
        parity = parity_bits(last << 24 | source, masks)
        if word == 1 or word == 9:
            # Bits 23 and 24 are free and make D29 = D30 = 0: d24 enters both, d23 only D30.
            for choice in range(4):
                trial = (source & ~3) | choice
                parity = parity_bits(last << 24 | trial, masks)
                if parity & 3 == 0:
                    source = trial
                    break
        packed = (source ^ (0xFFFFFF if last & 1 else 0)) << 6 | parity
        for i in range(30):
            bits[30 * word + i] = packed >> (29 - i) & 1
        last = packed & 3


def add_parity(data: BitArray) -> BitArray:
    """Return the 300 bits to transmit for data bits; inverse of `remove_parity`."""
    bits = data.copy()
    _close_words(bits, _MASKS)
    return bits
