"""IF blocks to complex baseband: planar int8 I and Q, the same however the stream is cut.

The sample with absolute index n is multiplied by ``exp(-j 2 pi f_IF n / fs)``. The carrier's
phase is ``n * increment`` in units of 2**-64 cycle, modulo one cycle: an integer function of n,
so it never drifts and knows nothing of blocks. A mirrored spectrum is undone by conjugation
afterwards. In the result a satellite's Doppler is positive when it approaches.

I/Q samples of up to 8 bits at IF 0 are only unpacked. All else is multiplied by a scale and
rounded to int8. Requantising adds noise of 1/12 per component: with an r.m.s. of at least
16 levels it costs less than 0.002 dB of C/N0, the table of 1024 phases 0.0001 dB.
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deepseis_core import if_kernels
from deepseis_core.errors import InputError
from deepseis_core.if_format import IfFormat
from deepseis_core.types import IfBlock

Int8Array = NDArray[np.int8]

FULL_SCALE = 127
TABLE_SIZE = 1024  # phases of the carrier; the kernels take the top 10 bits of the phase
HALF_STEP = 1 << 53  # rounds the phase to the nearest of the table
FACTOR_BITS = 14  # carrier amplitudes below 2**14: two products of int16 stay within int32
RMS_LOW = 16.0  # [levels] chosen r.m.s. of a baseband component: between this and twice it


def phase_increment(intermediate_frequency_hz: float, sample_rate_hz: float) -> int:
    """Return the carrier's phase step a sample in 2**-64 cycle, modulo one cycle.

    Examples
    --------
    >>> phase_increment(1.0, 4.0) == 2**62
    True
    """
    ratio = Fraction(intermediate_frequency_hz) / Fraction(sample_rate_hz)
    return round(ratio * 2**64) % 2**64


class Baseband:
    """Converter of one stream; holds no state but a scale taken from the first block if need be.

    Parameters
    ----------
    format : IfFormat
        Packing. With ``scale`` given, baseband is level times scale (and carrier); else of
        formats with up to 4 bits the largest level becomes 127, of wider ones the scale is the
        power of two that brings the first block's r.m.s. to 16..32 levels (:attr:`pinned_format`
        tells it, so that other consumers get the same).
    sample_rate_hz, intermediate_frequency_hz : float
        As in the block.

    Examples
    --------
    >>> block = IfBlock(0, 2, 4e6, 0.0, "iq8", np.array([1, 2, 255, 254], np.uint8))
    >>> i, q = Baseband.for_block(block).convert(block)
    >>> i.tolist(), q.tolist()
    ([1, -1], [2, -2])
    """

    def __init__(
        self, format: IfFormat, sample_rate_hz: float, intermediate_frequency_hz: float
    ) -> None:
        if not (math.isfinite(sample_rate_hz) and sample_rate_hz > 0):
            raise InputError("sample rate", f"{sample_rate_hz} Hz is not a positive number")
        if not math.isfinite(intermediate_frequency_hz):
            raise InputError("intermediate frequency", f"{intermediate_frequency_hz} is no number")
        self.format = format
        self.sample_rate_hz = sample_rate_hz
        self.intermediate_frequency_hz = intermediate_frequency_hz
        self._text = format.to_text()
        self._increment = phase_increment(intermediate_frequency_hz, sample_rate_hz)
        self._mixes = format.is_real or self._increment != 0
        self._scale = format.scale or self._fixed_scale()
        self._prepare()

    @classmethod
    def for_block(cls, block: IfBlock) -> Baseband:
        """Make the converter that suits a block and those after it."""
        packing = IfFormat.from_text(block.format)
        return cls(packing, block.sample_rate_hz, block.intermediate_frequency_hz)

    @property
    def scale(self) -> float:
        """Factor from levels to baseband; 0 while it waits for the first block."""
        return self._scale

    @property
    def pinned_format(self) -> IfFormat:
        """The format with the scale that was taken from the first block written into it."""
        pinned = self._scale and not self._fixed_scale()
        return self.format.with_scale(self._scale) if pinned else self.format

    @property
    def amplitude(self) -> float:
        """Baseband amplitude of a carrier of amplitude 1 level (real ones halve, as cos does)."""
        return self._scale / 2 if self.format.is_real else self._scale

    def convert(self, block: IfBlock) -> tuple[Int8Array, Int8Array]:
        """Unpack a block and mix it to baseband.

        Parameters
        ----------
        block : IfBlock
            Of this converter's format, rate and IF; any part of the stream, in any order.

        Returns
        -------
        tuple of ndarray of int8, shape (sample_count,)
            In-phase and quadrature components, in -128..127 when only unpacked, else -127..127.

        Raises
        ------
        InputError
            Where the block is of another stream or its bytes do not fit its sample count.
        """
        self._require(block)
        count = block.sample_count
        x = np.empty(count, self.format.dtype)
        y = None if self.format.is_real else np.empty(count, self.format.dtype)
        self.format.unpack(block.data, x, y)
        if not self._scale:
            self._scale = self._scale_for(x, y)
            self._prepare()
        i, q = self._mix(block.sample_index, x, y)
        if self.format.inverted:
            np.negative(np.maximum(q, -FULL_SCALE, out=q), out=q)
        return i, q

    def _require(self, block: IfBlock) -> None:
        given = (block.format, block.sample_rate_hz, block.intermediate_frequency_hz)
        own = (self._text, self.sample_rate_hz, self.intermediate_frequency_hz)
        same = given[1:] == own[1:] and (
            given[0] == own[0] or IfFormat.from_text(given[0]) == self.format
        )
        if not same:
            raise InputError(
                f"IF block at sample {block.sample_index}",
                f"is {given[0]}, {given[1]} Hz, IF {given[2]} Hz in a stream of "
                f"{own[0]}, {own[1]} Hz, IF {own[2]} Hz",
                "one stream has one format",
            )
        expected = self.format.bytes_for(block.sample_count)
        if block.sample_count < 0 or block.data.size != expected:
            raise InputError(
                f"IF block at sample {block.sample_index}",
                f"{block.sample_count} samples of {self._text} take {expected} bytes, "
                f"it has {block.data.size}",
            )

    def _fixed_scale(self) -> float:
        """Scale that follows from the format alone, or 0."""
        packing = self.format
        if packing.scale:
            return packing.scale
        if packing.bits <= 8 and not self._mixes:
            return 1.0
        if packing.bits <= 4:
            both = 1.0 if packing.is_real else math.sqrt(2.0)
            return FULL_SCALE / (packing.max_level * both)
        return 0.0

    def _scale_for(self, x: NDArray[Any], y: NDArray[Any] | None) -> float:
        power = float(np.mean(np.square(x, dtype=np.float64))) if x.size else 0.0
        if y is None:
            power /= 2
        elif y.size:
            power = (power + float(np.mean(np.square(y, dtype=np.float64)))) / 2
        if power == 0:
            return 1.0
        return 2.0 ** math.ceil(math.log2(RMS_LOW / math.sqrt(power)))

    def _prepare(self) -> None:
        """Make the carrier's table: scale times cos and sin, in units of 2**-shift."""
        scale = self._scale or 1.0
        self._shift = min(max(FACTOR_BITS - math.ceil(math.log2(scale)), 1), 30)
        amplitude = math.ldexp(scale, self._shift)
        if amplitude >= 2**15:
            raise InputError(f"IF format {self._text}", f"scale {scale} is too large")
        angle = 2 * np.pi * np.arange(TABLE_SIZE) / TABLE_SIZE
        self._carrier_c = np.round(amplitude * np.cos(angle)).astype(np.int32)
        self._carrier_s = np.round(amplitude * np.sin(angle)).astype(np.int32)

    def _mix(
        self, sample_index: int, x: NDArray[Any], y: NDArray[Any] | None
    ) -> tuple[Int8Array, Int8Array]:
        if not self._mixes and self._scale == 1.0 and x.dtype == np.int8 and y is not None:
            return x, y
        i, q = np.empty(x.size, np.int8), np.empty(x.size, np.int8)
        if not self._mixes and y is not None:
            factor = int(self._carrier_c[0])
            if_kernels.scale_round(x, factor, self._shift, i)
            if_kernels.scale_round(y, factor, self._shift, q)
            return i, q
        phase = np.uint64((sample_index * self._increment + HALF_STEP) % 2**64)
        step = np.uint64(self._increment)
        table = (self._carrier_c, self._carrier_s, self._shift)
        if y is None:
            if_kernels.mix_real(x, phase, step, *table, i, q)
        else:
            if_kernels.mix_complex(x, y, phase, step, *table, i, q)
        return i, q
