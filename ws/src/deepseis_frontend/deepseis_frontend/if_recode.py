"""Recordings whose samples are turned into bytes of a plain format while they are read.

================================ ======================================================
text                             what
================================ ======================================================
``fc32``                         32-bit floats I, Q, little-endian (GNU Radio, UHD)
``f32``                          the same, real
``lane=K/N real2 ...``           N channels side by side in every byte, channel K from 0
================================ ======================================================

Floats become signed bytes: the power of two that brings the recording's r.m.s. to 16 to 32
levels; beyond 127 they are clipped, which Gaussian noise of 32 levels is once in 14 000. What is
not finite becomes 0. A lane's samples become bytes of their levels.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from deepseis_core.errors import InputError
from deepseis_core.if_format import IfFormat

PRESETS: Final[dict[str, str]] = {
    "gnuradio_fc32": "fc32",
    "usrp_fc32": "fc32",
    "nt1065_ch1": "lane=0/4 real2 coding=sign_magnitude",
    "nt1065_ch2": "lane=1/4 real2 coding=sign_magnitude",
    "nt1065_ch3": "lane=2/4 real2 coding=sign_magnitude",
    "nt1065_ch4": "lane=3/4 real2 coding=sign_magnitude",
}
"""Names that stand for a text."""

TOP_RMS: Final = 32.0
"""Levels that the r.m.s. of floats lies below, and above half of it."""
_FLOATS: Final = {"fc32": ("iq8", 2), "f32": ("real8", 1)}
_LANE: Final = re.compile(r"lane=(\d+)/(\d+) +(\S.*)")
_PROBES, _PROBE_BYTES = 8, 65536

Converter = Callable[[NDArray[np.uint8]], NDArray[np.uint8]]


@dataclass(frozen=True)
class Recoding:
    """How raw bytes become bytes of ``format``.

    ``raw_bytes`` of the recording become ``bytes`` of the format; ``is_float`` asks for a scale.
    """

    text: str
    format: IfFormat
    raw_bytes: int
    bytes: int
    is_float: bool
    table: tuple[int, ...] = ()

    def converter(self, scale: float) -> Converter:
        """Return what turns whole groups of raw bytes into those of the format."""
        if self.is_float:
            return lambda raw: _signed_bytes(raw, scale)
        table = np.array(self.table, np.int8).view(np.uint8)
        return lambda raw: table[raw]


def recoding_of(text: str) -> Recoding | None:
    """Return the recoding that a format's text or preset names; None: it is none.

    Raises
    ------
    InputError
        A lane is not there, or its samples are not real ones of 1, 2 or 4 bits.

    Examples
    --------
    >>> recoding_of("usrp_fc32").format.to_text(), recoding_of("iq8")
    ('iq8', None)
    """
    text = " ".join(PRESETS.get(text.strip(), text).split())
    if text in _FLOATS:
        name, components = _FLOATS[text]
        return Recoding(text, IfFormat.from_text(name), 4 * components, components, True)
    match = _LANE.fullmatch(text)
    if match is None:
        return None
    lane, lanes, packing = int(match[1]), int(match[2]), IfFormat.from_text(match[3])
    if not packing.is_real or packing.bits * lanes != 8 or not lane < lanes:
        hint = "such as lane=0/4 real2: 4 channels of 2 bits, the one in the lowest bits"
        raise InputError(f"IF format {text!r}", "does not fit into a byte", hint)
    codes = np.arange(256) >> (lane * packing.bits) & ((1 << packing.bits) - 1)
    levels = packing.level_of_code[codes]
    target = IfFormat.from_text("real8")
    return Recoding(text, target, 1, 1, False, tuple(int(v) for v in levels))


class RecodedFile(io.RawIOBase):
    """A recording as bytes of its recoding's format, to be read like a file of them.

    Parameters
    ----------
    path : path
    recoding : Recoding
    header_bytes : int
        Raw bytes before the first sample.
    scale : float
        Of floats, as `float_scale` tells.
    """

    def __init__(
        self, path: str | Path, recoding: Recoding, header_bytes: int, scale: float
    ) -> None:
        super().__init__()
        self.recoding, self.header_bytes = recoding, header_bytes
        self._convert = recoding.converter(scale)
        self._file = Path(path).open("rb", buffering=0)  # noqa: SIM115 (closed by close)

    def seek(self, position: int, whence: int = 0) -> int:
        """Go to a byte of the format, the first of a group."""
        group, rest = divmod(position, self.recoding.bytes)
        if rest or whence:
            raise ValueError("not at the border of a sample")
        self._file.seek(self.header_bytes + group * self.recoding.raw_bytes)
        return position

    def readinto(self, buffer: Any) -> int:
        """Fill a buffer with whole groups; 0 at the end."""
        groups = len(buffer) // self.recoding.bytes
        raw = bytearray()
        wanted = groups * self.recoding.raw_bytes
        while len(raw) < wanted and (more := self._file.read(wanted - len(raw))):
            raw += more
        whole = len(raw) // self.recoding.raw_bytes * self.recoding.raw_bytes
        out = self._convert(np.frombuffer(raw, np.uint8)[:whole])
        buffer[: out.size] = out.tobytes()
        return int(out.size)

    def close(self) -> None:
        """Close the recording."""
        if not self.closed:
            self._file.close()
        super().close()


def float_scale(path: Path, recoding: Recoding, header_bytes: int) -> float:
    """Return the power of two that brings floats to signed bytes; 1 if they are none.

    Raises
    ------
    InputError
        There is no finite number but 0 in the places looked at.
    """
    if not recoding.is_float:
        return 1.0
    groups = max(0, path.stat().st_size - header_bytes) // recoding.raw_bytes
    each = min(groups, _PROBE_BYTES // recoding.raw_bytes)
    pieces = []
    with path.open("rb") as file:
        for k in range(_PROBES):
            start = (groups - each) * k // (_PROBES - 1)
            file.seek(header_bytes + start * recoding.raw_bytes)
            pieces.append(np.frombuffer(file.read(each * recoding.raw_bytes), "<f4"))
    values = np.concatenate(pieces).astype(np.float64)
    values = values[np.isfinite(values)]
    rms = float(np.sqrt(np.mean(values**2))) if values.size else 0.0
    if not 1e-30 < rms < 1e30:
        raise InputError(path, "holds no 32-bit floats that could be samples", "check the format")
    return 2.0 ** math.floor(math.log2(TOP_RMS / rms))


def _signed_bytes(raw: NDArray[np.uint8], scale: float) -> NDArray[np.uint8]:
    """Scale, round and clip floats.

    Examples
    --------
    >>> values = np.array([0.5, -1.0, 9.0, np.nan], "<f4")
    >>> _signed_bytes(values.view(np.uint8), 32.0).view(np.int8).tolist()
    [16, -32, 127, 0]
    """
    with np.errstate(invalid="ignore"):
        scaled = np.nan_to_num(raw.view("<f4") * np.float32(scale), nan=0.0, posinf=0, neginf=0)
    return np.clip(np.rint(scaled), -127, 127).astype(np.int8).view(np.uint8)
