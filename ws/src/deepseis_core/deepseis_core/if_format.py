"""How IF samples are packed into bytes: a description that is data, not a branch elsewhere.

A descriptor has a compact text, which travels in every ``IfBlock``::

    iq8                                        int8 I, Q, I, Q, ...
    real1 positive=0 order=lsb_first           1 bit, 0 is +1, first sample in bit 0
    iq2 coding=sign_magnitude order=msb_first
    real16 scale=0.125                         int16, little-endian, reaching int8 times 0.125

=========== =========================================================================
key         meaning
=========== =========================================================================
coding      ``bipolar`` (1 bit only), ``sign_magnitude``, ``offset_binary``,
            ``twos_complement``
positive    which value of the (sign) bit is positive, 0 or 1
order       ``lsb_first`` or ``msb_first``: where in the byte the first component is; of
            16 bits the first byte (``lsb_first`` is little-endian)
levels      ``odd``: codes stand for ..., -3, -1, 1, 3, ... (no zero, no bias);
            ``integer``: for themselves
interleave  ``sample``: I and Q alternate; ``byte``: whole bytes of I and of Q alternate
scale       factor from levels to int8 baseband, where mixing or 16 bits need one
inverted    (a word alone) high-side mixing has mirrored the spectrum
=========== =========================================================================

Samples start on a byte boundary (of I, with ``interleave=byte``); bits left over at the end of
a recording are padding.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from deepseis_core import if_kernels
from deepseis_core.errors import InputError

COMPONENTS: Final = ("real", "iq", "qi")
BITS: Final = (1, 2, 4, 8, 16)
CODINGS: Final = ("bipolar", "sign_magnitude", "offset_binary", "twos_complement")
ORDERS: Final = ("lsb_first", "msb_first")
LEVELS: Final = ("odd", "integer")
INTERLEAVES: Final = ("sample", "byte")
HINT: Final = "such as 'iq8' or 'real2 coding=sign_magnitude order=msb_first'"

PRESETS: Final[dict[str, str]] = {
    "int8_real": "real8",
    "int8_iq": "iq8",
    "int16_real": "real16",
    "int16_iq": "iq16",
    "pocketsdr_i8": "real8",
    "pocketsdr_iq8": "iq8",
    "rtlsdr": "iq8 coding=offset_binary",
    "hackrf": "iq8",
    "usrp_sc16": "iq16",
    "usrp_sc8": "iq8",
    "limesdr_sc16": "iq16",
    "nt1065": "real2 coding=sign_magnitude order=lsb_first",
    "sxnsr": "real2 coding=twos_complement order=lsb_first",
    "snappergps": "real1 positive=0 order=lsb_first",
    "gps_sdr_sim_1bit": "iq1 positive=1 order=msb_first",
    "independent_sim": "iq1 positive=1 order=msb_first",
}
"""Names that :meth:`IfFormat.from_text` takes in place of a descriptor."""


@dataclass(frozen=True)
class IfFormat:
    """Descriptor of the packing; the module explains its fields.

    Examples
    --------
    >>> IfFormat.from_text("iq2 order=msb_first").to_text()
    'iq2 coding=sign_magnitude order=msb_first'
    >>> IfFormat.from_text("snappergps").bytes_for(12)
    2
    """

    components: str = "iq"
    bits: int = 8
    coding: str = ""
    order: str = "lsb_first"
    positive: int = -1
    levels: str = ""
    interleave: str = "sample"
    scale: float = 0.0
    inverted: bool = False

    def __post_init__(self) -> None:
        """Fill in what depends on the number of bits, then refuse what makes no sense."""
        check = _Checker(self)
        check.one_of("components", COMPONENTS)
        check.one_of("bits", BITS)
        for name, value in _canonical(self).items():
            object.__setattr__(self, name, value)
        check.one_of("coding", CODINGS)
        check.one_of("order", ORDERS)
        check.one_of("positive", (0, 1))
        check.one_of("levels", LEVELS)
        check.one_of("interleave", INTERLEAVES)
        check.that(
            (self.coding == "bipolar") == (self.bits == 1), "bipolar coding is that of one bit"
        )
        check.that(
            self.positive == 0 or self.coding in ("bipolar", "sign_magnitude"),
            "positive is for codings with a sign bit",
        )
        check.that(self.levels == "odd" or self.bits > 1, "one bit has odd levels")
        check.that(self.levels == "integer" or self.bits < 8, "odd levels need 1, 2 or 4 bits")
        check.that(math.isfinite(self.scale) and self.scale >= 0, "scale is a positive number")

    @classmethod
    def from_text(cls, text: str) -> IfFormat:
        """Read a descriptor's text, or the name of one of :data:`PRESETS`.

        Raises
        ------
        InputError
            Where the text is not a descriptor.
        """
        return _parse(text if isinstance(text, str) else repr(text))

    def to_text(self) -> str:
        """Write the canonical text: equal formats have equal texts."""
        words = [f"{self.components}{self.bits}"]
        if self.bits == 1:
            words.append(f"positive={self.positive}")
        elif self.bits < 8 or self.coding != "twos_complement":
            words.append(f"coding={self.coding}")
            if self.coding == "sign_magnitude" and self.positive == 1:
                words.append("positive=1")
        if self.bits < 8 or self.order != "lsb_first":
            words.append(f"order={self.order}")
        if self.bits in (2, 4) and self.levels != "odd":
            words.append(f"levels={self.levels}")
        if self.interleave != "sample":
            words.append(f"interleave={self.interleave}")
        if self.scale:
            words.append(f"scale={self.scale!r}")
        return " ".join([*words, "inverted"] if self.inverted else words)

    def with_scale(self, scale: float) -> IfFormat:
        """Return this format with a fixed factor to int8 baseband."""
        return replace(self, scale=scale)

    @property
    def is_real(self) -> bool:
        """Whether samples are real, not I and Q."""
        return self.components == "real"

    @cached_property
    def bytes_per_unit(self) -> int:
        """Bytes of the smallest group that holds whole samples."""
        both = 1 if self.is_real else 2
        if self.interleave == "byte":
            return both
        return max(1, both * self.bits // 8)

    @cached_property
    def samples_per_unit(self) -> int:
        """Samples in ``bytes_per_unit`` bytes: reading starts at a multiple of it."""
        return self.bytes_per_unit * 8 // (self.bits * (1 if self.is_real else 2))

    def bytes_for(self, sample_count: int) -> int:
        """Bytes that hold so many samples, padding at the end included."""
        return -(-sample_count // self.samples_per_unit) * self.bytes_per_unit

    def samples_in(self, byte_count: int) -> int:
        """Whole samples in so many bytes (a cut unit at the end does not count)."""
        return byte_count // self.bytes_per_unit * self.samples_per_unit

    @property
    def dtype(self) -> type[np.int8] | type[np.int16]:
        """Type of unpacked components."""
        return np.int16 if self.bits == 16 else np.int8

    @cached_property
    def level_of_code(self) -> NDArray[np.int8]:
        """Level of every code (up to 8 bits), indexed by the code."""
        code = np.arange(1 << self.bits, dtype=np.int64)
        half = 1 << (self.bits - 1)
        if self.coding == "offset_binary":
            value = code - half
        elif self.coding == "twos_complement":
            value = np.where(code >= half, code - 2 * half, code)
        else:  # sign and magnitude; one bit is a sign alone
            magnitude = code % half
            magnitude = 2 * magnitude + 1 if self.levels == "odd" else magnitude
            return np.where(code // half == self.positive, magnitude, -magnitude).astype(np.int8)
        return (2 * value + 1 if self.levels == "odd" else value).astype(np.int8)

    @property
    def max_level(self) -> int:
        """Largest magnitude a component can take."""
        if self.bits == 16:
            return 32767 if self.coding == "sign_magnitude" else 32768
        return int(np.abs(self.level_of_code.astype(np.int64)).max())

    @cached_property
    def _codec(self) -> if_kernels.Codec:
        return if_kernels.make_codec(
            self.level_of_code if self.bits <= 8 else None,
            bits=self.bits,
            coding=self.coding,
            positive=self.positive,
            order=self.order,
            components=self.components,
            by_byte=self.interleave == "byte",
        )

    def unpack(
        self,
        data: NDArray[np.uint8],
        out_i: NDArray[Any],
        out_q: NDArray[Any] | None = None,
    ) -> None:
        """Unpack the first ``out_i.size`` samples of ``data`` into planar levels.

        Parameters
        ----------
        data : ndarray of uint8
            Packed samples, from a unit's border on.
        out_i, out_q : ndarray of :attr:`dtype`, shape (n,), contiguous
            Filled with the levels; ``out_q`` is left out for real samples.

        Raises
        ------
        InputError
            Where ``data`` is shorter than ``bytes_for(n)``.
        """
        needed = self.bytes_for(out_i.size)
        if data.size < needed:
            raise InputError(
                f"{out_i.size} samples of {self.to_text()}",
                f"take {needed} bytes, here are {data.size}",
            )
        self._codec.unpack(data[:needed], out_i, None if self.is_real else out_q)

    def pack(self, i: NDArray[Any], q: NDArray[Any] | None = None) -> NDArray[np.uint8]:
        """Pack planar levels; what is no level becomes the nearest (the upper one at a tie)."""
        data = np.zeros(self.bytes_for(i.size), np.uint8)
        self._codec.pack(i, None if self.is_real else q, data)
        return data


class _Checker:
    """Raises ``InputError`` in the words of the descriptor."""

    def __init__(self, subject: IfFormat) -> None:
        self.subject = subject

    def one_of(self, name: str, choices: tuple[Any, ...]) -> None:
        """Require that a field has one of the values."""
        value = getattr(self.subject, name)
        known = ", ".join(map(str, choices))
        self.that(value in choices, f"{name} {value!r} is not one of {known}")

    def that(self, condition: bool, reason: str) -> None:
        """Require a condition."""
        if not condition:
            raise InputError("IF format", reason, HINT)


def _canonical(given: IfFormat) -> dict[str, Any]:
    """Values of the fields that follow from others, so that equal packings compare equal."""
    default_coding = {1: "bipolar", 2: "sign_magnitude"}.get(given.bits, "twos_complement")
    coding, positive = given.coding or default_coding, given.positive
    if positive == -1:
        positive = 1 if given.bits == 1 and coding in ("bipolar", "offset_binary") else 0
    if given.bits == 1 and coding in CODINGS:
        coding = "bipolar"
    order = "lsb_first" if given.bits == 8 and given.order in ORDERS else given.order
    one_way = (given.bits >= 8 or given.is_real) and given.interleave in INTERLEAVES
    return {
        "coding": coding,
        "positive": positive,
        "levels": given.levels or ("odd" if given.bits < 8 else "integer"),
        "order": order,
        "interleave": "sample" if one_way else given.interleave,
        "scale": float(given.scale),
    }


_CONVERT: Final[dict[str, type]] = {
    item.name: {"str": str, "int": int, "float": float}.get(str(item.type), str)
    for item in fields(IfFormat)
    if item.name not in ("components", "bits", "inverted")
}


@lru_cache(maxsize=256)
def _parse(text: str) -> IfFormat:
    words = PRESETS.get(text.strip(), text).split()
    what = f"IF format {text!r}" if len(text) < 80 else "IF format"
    head = words[0] if words else ""
    components = head.rstrip("0123456789")
    digits = head[len(components) :]
    if components not in COMPONENTS or digits not in map(str, BITS):
        names = ", ".join(PRESETS)
        raise InputError(what, "is neither a descriptor nor a known name", f"{HINT}, or {names}")
    values: dict[str, Any] = {"components": components, "bits": int(digits)}
    for word in words[1:]:
        key, equals, value = word.partition("=")
        if key in values or (key not in _CONVERT and word != "inverted"):
            raise InputError(what, f"{word!r} is unknown or given twice", HINT)
        try:
            values[key] = True if word == "inverted" else _CONVERT[key](value)
        except ValueError:
            raise InputError(what, f"{key} cannot be {value!r}", HINT) from None
        if word != "inverted" and not (equals and value):
            raise InputError(what, f"{key} has no value", HINT)
    try:
        return IfFormat(**values)
    except InputError as error:
        raise InputError(what, error.reason, error.hint) from None
