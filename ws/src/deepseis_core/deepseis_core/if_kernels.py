"""Kernels that unpack, pack and mix IF samples: arrays in, given arrays filled."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[Any]
Bytes = NDArray[np.uint8]
Int8s = NDArray[np.int8]
Int32s = NDArray[np.int32]

SLICE = 16384  # items converted at once, so that what lies between stays in the cache
WORDS = {1: np.uint8, 2: np.uint16, 4: np.uint32, 8: np.uint64}


@njit(cache=True, nogil=True)
def expand(data: Bytes, table: Array, out: Array) -> None:
    """Write the table's word for every byte: the levels of all components in it, at once."""
    for k in range(out.size):
        out[k] = table[data[k]]


@njit(cache=True, nogil=True)
def expand_pair(data: Bytes, table_a: Array, table_b: Array, out_a: Array, out_b: Array) -> None:
    """Write two words for every byte: the first and the second components in it."""
    for k in range(out_a.size):
        out_a[k] = table_a[data[k]]
        out_b[k] = table_b[data[k]]


@njit(cache=True, nogil=True)
def split_flip(data: Bytes, flip: np.uint8, out_a: Bytes, out_b: Bytes) -> None:
    """Deal components out to two arrays, with their top bit flipped or not."""
    for k in range(out_a.size):
        out_a[k] = data[2 * k] ^ flip
        out_b[k] = data[2 * k + 1] ^ flip


@njit(cache=True, nogil=True)
def codes_of(levels: Bytes, code_of_level: Bytes, out: Bytes) -> None:
    """Look up the codes of levels (int8 seen as uint8)."""
    for k in range(levels.size):
        out[k] = code_of_level[levels[k]]


@njit(cache=True, nogil=True)
def codes_of_pair(a: Bytes, b: Bytes, code_of_level: Bytes, out: Bytes) -> None:
    """Look up the codes of two arrays' levels, in turn."""
    for k in range(a.size):
        out[2 * k] = code_of_level[a[k]]
        out[2 * k + 1] = code_of_level[b[k]]


@njit(cache=True, nogil=True)
def deal_flip(a: Bytes, b: Bytes, flip: np.uint8, out: Bytes) -> None:
    """Put the items of two arrays in turn, with their top bit flipped or not."""
    for k in range(a.size):
        out[2 * k] = a[k] ^ flip
        out[2 * k + 1] = b[k] ^ flip


@njit(cache=True, nogil=True)
def squeeze(words: Array, factor: np.uint64, shift: np.uint64, out: Bytes) -> None:
    """Gather the bits of each word's bytes in one byte: one product does it (`gather_factor`)."""
    for k in range(out.size):
        out[k] = np.uint8((np.uint64(words[k]) * factor) >> shift)


def gather_factor(bits: int, lsb_first: bool) -> int:
    """Return the factor that gathers the codes in a word's bytes in its top byte.

    Byte k of the little-endian word holds the k-th code of the stream; multiplied by 2**m it is
    moved by m bits. The other products fall beside the top byte, and no two on the same bit.

    Examples
    --------
    >>> word = 0x02_00_03_01  # codes 1, 3, 0, 2 of two bits
    >>> f"{word * gather_factor(2, True) >> 24 & 255:08b}"
    '10001101'
    >>> f"{word * gather_factor(2, False) >> 24 & 255:08b}"
    '01110010'
    """
    per_byte = 8 // bits
    top = 8 * (per_byte - 1)
    place = range(per_byte) if lsb_first else range(per_byte - 1, -1, -1)
    return sum(1 << (top + bits * place[k] - 8 * k) for k in range(per_byte))


@njit(inline="always")
def saturate(value: np.int32) -> np.int32:
    """Clip to the symmetric range of int8."""
    return np.int32(min(max(value, np.int32(-127)), np.int32(127)))


@njit(cache=True, nogil=True)
def mix_real(
    x: Array,
    phase: np.uint64,
    increment: np.uint64,
    carrier_c: Int32s,
    carrier_s: Int32s,
    shift: int,
    out_i: Int8s,
    out_q: Int8s,
) -> None:
    """Multiply real samples by ``exp(-j phase)``, round, saturate at +-127."""
    bits = np.uint64(54)
    half = np.int32(1 << (shift - 1))
    for n in range(x.size):
        k = (phase + increment * np.uint64(n)) >> bits
        i = np.int32(np.int32(x[n] * carrier_c[k]) + half) >> shift
        q = np.int32(half - np.int32(x[n] * carrier_s[k])) >> shift
        out_i[n] = saturate(i)
        out_q[n] = saturate(q)


@njit(cache=True, nogil=True)
def mix_complex(
    x: Array,
    y: Array,
    phase: np.uint64,
    increment: np.uint64,
    carrier_c: Int32s,
    carrier_s: Int32s,
    shift: int,
    out_i: Int8s,
    out_q: Int8s,
) -> None:
    """Multiply ``x + jy`` by ``exp(-j phase)``, round, saturate at +-127."""
    bits = np.uint64(54)
    half = np.int32(1 << (shift - 1))
    for n in range(x.size):
        k = (phase + increment * np.uint64(n)) >> bits
        c, s = carrier_c[k], carrier_s[k]
        i = np.int32(x[n] * c + y[n] * s + half) >> shift
        q = np.int32(y[n] * c - x[n] * s + half) >> shift
        out_i[n] = saturate(i)
        out_q[n] = saturate(q)


@njit(cache=True, nogil=True)
def scale_round(x: Array, factor: int, shift: int, out: Int8s) -> None:
    """Scale by ``factor / 2**shift``, round, saturate at +-127."""
    half = np.int32(1 << (shift - 1))
    for n in range(x.size):
        out[n] = saturate(np.int32(x[n] * factor + half) >> shift)


@dataclass(frozen=True)
class Codec:
    """Tables of one packing; see :func:`make_codec`."""

    bits: int
    swap: bool
    complex: bool
    by_byte: bool
    flip: int
    whole: Array
    first: Array
    second: Array
    code_of_level: Bytes
    gather: int
    wide: Wide | None

    def unpack(self, data: Bytes, i: Array, q: Array | None) -> None:
        """Fill the planar levels from exactly the bytes that hold them."""
        if not self.complex:
            self._unpack_real(data, i)
        elif q is None:
            raise TypeError("I/Q samples need two arrays to be unpacked into")
        else:
            self._unpack_pair(data, *((q, i) if self.swap else (i, q)))

    def _unpack_real(self, data: Bytes, out: Array) -> None:
        if self.wide is not None:
            out[:] = self.wide.decode(data)
        else:
            self._expand(data, self.whole, out)

    def _unpack_pair(self, data: Bytes, a: Array, b: Array) -> None:
        if self.wide is not None:
            words = self.wide.decode(data)
            a[:], b[:] = words[0::2], words[1::2]
        elif self.by_byte:
            self._expand(np.ascontiguousarray(data[0::2]), self.whole, a)
            self._expand(np.ascontiguousarray(data[1::2]), self.whole, b)
        elif self.bits == 8:
            self._split8(data, a, b)
        else:
            self._expand_pair(data, a, b)

    def _expand(self, data: Bytes, table: Array, out: Array) -> None:
        if self.bits == 8 and self.flip == 0:
            out[:] = data.view(np.int8)
            return
        per = table.itemsize
        whole = out.size // per
        expand(data, table, out[: whole * per].view(table.dtype))
        if out.size % per:
            out[whole * per :] = table[data[whole : whole + 1]].view(np.int8)[: out.size % per]

    def _expand_pair(self, data: Bytes, a: Array, b: Array) -> None:
        per = self.first.itemsize
        whole = a.size // per
        view = self.first.dtype
        end = whole * per
        expand_pair(data, self.first, self.second, a[:end].view(view), b[:end].view(view))
        for out, table in ((a, self.first), (b, self.second)):
            if out.size % per:
                out[end:] = table[data[whole : whole + 1]].view(np.int8)[: out.size % per]

    def _split8(self, data: Bytes, a: Array, b: Array) -> None:
        if self.flip >= 0:
            split_flip(data, np.uint8(self.flip), a.view(np.uint8), b.view(np.uint8))
        else:
            self._expand(data[0::2], self.whole, a)
            self._expand(data[1::2], self.whole, b)

    def pack(self, i: Array, q: Array | None, data: Bytes) -> None:
        """Fill zeroed bytes from planar levels."""
        if self.complex and (q is None or q.size != i.size):
            raise TypeError("I/Q samples are packed from two arrays of one length")
        parts = [i] if q is None else ([q, i] if self.swap else [i, q])
        if self.wide is not None:
            stream, count = data.view(np.uint16), len(parts)
            for k, part in enumerate(parts):
                for start in range(0, part.size, SLICE):
                    words = self.wide.encode(part[start : start + SLICE])
                    stream[count * start + k : count * (start + SLICE) : count] = words
            return
        levels = [_to_int8(part).view(np.uint8) for part in parts]
        if self.by_byte and len(levels) == 2:
            for k, part in enumerate(levels):
                data[k::2] = self._squeeze(self._codes([part]))
        else:
            data[:] = self._squeeze(self._codes(levels))

    def _codes(self, levels: list[Bytes]) -> Bytes:
        """Return the codes in the order of the stream, filled up to whole bytes with zeros."""
        per_byte, count = 8 // self.bits, len(levels) * levels[0].size
        codes = np.empty(-(-count // per_byte) * per_byte, np.uint8)
        codes[count:] = 0
        if self.bits == 8 and self.flip >= 0 and len(levels) == 2:
            deal_flip(*levels, np.uint8(self.flip), codes)
        elif len(levels) == 2:
            codes_of_pair(*levels, self.code_of_level, codes)
        else:
            codes_of(*levels, self.code_of_level, codes)
        return codes

    def _squeeze(self, codes: Bytes) -> Bytes:
        """Combine codes into bytes."""
        if self.bits == 8:
            return codes
        per_byte = 8 // self.bits
        out = np.empty(codes.size // per_byte, np.uint8)
        shift = np.uint64(8 * (per_byte - 1))
        squeeze(codes.view(f"<u{per_byte}"), np.uint64(self.gather), shift, out)
        return out


@dataclass(frozen=True)
class Wide:
    """Words of 16 bits."""

    byte_order: str
    coding: str
    positive: int

    def decode(self, data: Bytes) -> NDArray[np.int16]:
        """Levels of the words."""
        words = np.ascontiguousarray(data).view(f"{self.byte_order}u2").astype(np.uint16)
        if self.coding == "offset_binary":
            words ^= np.uint16(0x8000)
        elif self.coding == "sign_magnitude":
            magnitude = (words & 0x7FFF).astype(np.int16)
            return np.where(words >> 15 == self.positive, magnitude, -magnitude).astype(np.int16)
        return words.view(np.int16)

    def encode(self, levels: Array) -> NDArray[np.uint16]:
        """Words of the levels, in the file's byte order."""
        low = -32767 if self.coding == "sign_magnitude" else -32768
        if levels.dtype != np.int16:
            levels = np.floor(np.asarray(levels, np.float64) + 0.5)
        levels = np.clip(levels, low, 32767).astype(np.int16)
        words = levels.view(np.uint16)
        if self.coding == "offset_binary":
            words = words ^ np.uint16(0x8000)
        elif self.coding == "sign_magnitude":
            sign = np.where(levels < 0, 1 - self.positive, self.positive).astype(np.uint16)
            words = np.abs(levels).astype(np.uint16) | (sign << np.uint16(15))
        return words.astype(f"{self.byte_order}u2", copy=False).view(np.uint16)


def make_codec(
    level_of_code: NDArray[np.int8] | None,
    *,
    bits: int,
    coding: str,
    positive: int,
    order: str,
    components: str,
    by_byte: bool,
) -> Codec:
    """Make the tables of a packing: what each byte unpacks to, what each level packs to."""
    wide = None
    empty = np.zeros(0, np.uint8)
    whole = first = second = code_of_level = empty
    if level_of_code is None:
        wide = Wide("<" if order == "lsb_first" else ">", coding, positive)
    else:
        shifts = np.arange(0, 8, bits, dtype=np.uint8)
        order_shift = shifts if order == "lsb_first" else shifts[::-1].copy()
        byte = np.arange(256, dtype=np.uint8)[:, None]
        levels = level_of_code[(byte >> order_shift[None, :]) & np.uint8((1 << bits) - 1)]
        whole = _as_words(levels)
        if bits < 8:
            first, second = _as_words(levels[:, 0::2]), _as_words(levels[:, 1::2])
        code_of_level = _nearest_codes(level_of_code)
    flips = {"twos_complement": 0, "offset_binary": 0x80}
    return Codec(
        bits=bits,
        swap=components == "qi",
        complex=components != "real",
        by_byte=by_byte,
        flip=flips.get(coding, -1),
        whole=whole,
        first=first,
        second=second,
        code_of_level=code_of_level,
        gather=gather_factor(bits, order == "lsb_first") if bits <= 8 else 0,
        wide=wide,
    )


def _as_words(levels: NDArray[np.int8]) -> Array:
    """View the levels of each byte as one machine word."""
    return np.ascontiguousarray(levels).view(WORDS[levels.shape[1]]).ravel()


def _nearest_codes(level_of_code: NDArray[np.int8]) -> Bytes:
    """Code of the level nearest to each int8 value, indexed by the value's bits as uint8."""
    value = np.arange(256, dtype=np.uint8).view(np.int8).astype(np.float64)
    distance = np.abs(value[:, None] + 0.25 - level_of_code.astype(np.float64)[None, :])
    return np.argmin(distance, axis=1).astype(np.uint8)


def _to_int8(levels: Array) -> NDArray[np.int8]:
    if levels.dtype == np.int8:
        return np.ascontiguousarray(levels)
    rounded = np.floor(np.asarray(levels, np.float64) + 0.5)
    return np.clip(rounded, -128, 127).astype(np.int8)
