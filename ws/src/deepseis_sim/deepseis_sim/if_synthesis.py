"""IF samples of a sky of satellites: amplitudes, automatic gain, quantiser, packing.

The signal model, in units of the noise's standard deviation per component (design, section 1)::

    complex   s[n] = sum A D C exp(j(2 pi f_IF n / fs + phi)) + w_I + j w_Q,   A = sqrt(2 CN0 / fs)
    real      s[n] = sum A D C cos(2 pi f_IF n / fs + phi) + w,                A = 2 sqrt(CN0 / fs)

so that C/N0 is carrier power over the noise's power density, with all of the noise inside the
sampled bandwidth (fs, or fs/2 for real samples). Quantising then costs its known part: 1.96 dB
with 1 bit, 0.55 dB with 2, 0.05 dB with 4.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from deepseis_core.baseband import phase_increment
from deepseis_core.ca_code import ca_code
from deepseis_core.constants import CA_LENGTH, CA_RATE_CPS
from deepseis_core.errors import InputError
from deepseis_core.if_format import IfFormat
from deepseis_core.types import FloatArray
from deepseis_sim.agc import FollowingGain
from deepseis_sim.if_kernel import TILE, Sampling, Signals, synthesise
from deepseis_sim.jammer import JammerBank, JammerConfig

OPTIMUM_STEP: Final = {1: 1.596, 2: 0.9957, 4: 0.3352, 8: 0.03076, 16: 1 / 4096}
"""Quantiser step per standard deviation that distorts a normal variable least (J. Max,
"Quantizing for minimum distortion", IRE Trans. IT-6, 1960, table 2); 16 bits: 8 sigma fit."""

SEGMENT: Final = 0.01
"""Wanted length of one phase polynomial [s]; the real one is a whole number of tiles."""

LOWEST_RATE_HZ: Final = 1.0e6
"""Sample rate below which a group of samples would span more chips than a window holds."""


@dataclass(frozen=True)
class SignalSegments:
    """Phases of every satellite over a span of segments; the synthesis' input.

    Attributes
    ----------
    first_segment : int
        Number of the first segment, counted from sample 0.
    carrier_phase_cycles, code_phase_chips : ndarray, shape (n_satellites, n_segments, 4)
        Cubics in the fraction of the segment. Code phase counts from the beginning of
        ``code_period``.
    code_period : ndarray of int64, shape (n_satellites, n_segments)
        Code periods since the first data bit began.
    cn0_dbhz : ndarray, shape (n_satellites, n_segments)
        Minus infinity: no signal.
    bits : ndarray of uint8, shape (n_satellites, n_bits)
        Data bits (1 inverts the signal), one each 20 code periods.
    """

    first_segment: int
    carrier_phase_cycles: FloatArray
    code_phase_chips: FloatArray
    code_period: NDArray[np.int64]
    cn0_dbhz: FloatArray
    bits: NDArray[np.uint8]


def chip_windows(prn: int) -> NDArray[np.uint32]:
    """Return the 32 chips of a C/A code from each of its 1023 chips on, the first in bit 0.

    Examples
    --------
    >>> f"{chip_windows(1)[0] & 0x3FF:010b}"[::-1]  # octal 1440 (IS-GPS-200, table 3-Ia)
    '1100100000'
    """
    chips = (np.asarray(ca_code(prn)) < 0).astype(np.uint32)
    windows = np.zeros(CA_LENGTH, np.uint32)
    for k in range(32):
        windows |= np.roll(chips, -k) << np.uint32(k)
    return windows


class IfSynthesizer:
    """Makes the packed IF samples of one front end.

    Parameters
    ----------
    format : IfFormat
    sample_rate_hz, intermediate_frequency_hz : float
    prn : sequence of int
        Satellites, in the order of the segments' first axis.
    seed : int
        Of the noise.
    noise : bool, optional
        False leaves the bare signal, for tests.
    mean_cn0_dbhz : sequence of float, optional
        C/N0 of the satellites for which a fixed gain is set; none: noise alone. Jammers do not
        change it.
    jammers : sequence of JammerConfig, optional
    agc_s : float, optional
        Above zero the gain follows the expected power with this time constant (`agc`).
    carriers_hz : callable, optional
        For that: sum of the satellites' C/N0 [Hz] at seconds since the start, shape (m,); else
        that of ``mean_cn0_dbhz``.

    Attributes
    ----------
    segment_samples : int
        Length of a segment: the phase polynomials belong to multiples of it.
    """

    def __init__(
        self,
        format: IfFormat,
        sample_rate_hz: float,
        intermediate_frequency_hz: float,
        prn: Sequence[int],
        *,
        seed: int = 0,
        noise: bool = True,
        mean_cn0_dbhz: Sequence[float] = (),
        jammers: Sequence[JammerConfig] = (),
        agc_s: float = 0.0,
        carriers_hz: Callable[[FloatArray], FloatArray] | None = None,
    ) -> None:
        if not sample_rate_hz >= LOWEST_RATE_HZ:
            raise InputError("sample rate", f"{sample_rate_hz} Hz is below 1 MHz")
        self.format = format
        self.sample_rate_hz = float(sample_rate_hz)
        self.tiles_per_segment = max(1, round(SEGMENT * sample_rate_hz / TILE))
        self.segment_samples = self.tiles_per_segment * TILE
        self._windows = np.array([chip_windows(p) for p in prn], np.uint32).reshape(-1, CA_LENGTH)
        self._sampling = Sampling(
            tiles_per_segment=self.tiles_per_segment,
            increment=np.uint64(phase_increment(intermediate_frequency_hz, sample_rate_hz)),
            sign=-1.0 if format.inverted else 1.0,
            group=64 if 63 * CA_RATE_CPS / sample_rate_hz < 30 else 16,
            seed=np.uint64(seed & (2**64 - 1)),
            noise=noise,
            odd=format.levels == "odd",
            limit=np.float32(min(format.max_level, 32767 if format.bits == 16 else 127)),
        )
        self._jammers = JammerBank(
            jammers,
            sample_rate_hz,
            intermediate_frequency_hz,
            mirrored=format.inverted,
            real=format.is_real,
            seed=seed,
        )
        self._fixed_hz = float(np.sum(10.0 ** (np.asarray(mean_cn0_dbhz, np.float64) / 10.0)))
        self._carriers_hz = carriers_hz
        self._gain = None
        if agc_s > 0.0:
            self._gain = FollowingGain(self._power, self.segment_span, agc_s)

    @property
    def segment_span(self) -> float:
        """Length of a segment [s]."""
        return self.segment_samples / self.sample_rate_hz

    def amplitude(self, cn0_dbhz: FloatArray) -> FloatArray:
        """Return the amplitude that has a C/N0, in units of the noise per component."""
        cn0 = 10.0 ** (np.asarray(cn0_dbhz, np.float64) / 10.0)
        return np.sqrt((4.0 if self.format.is_real else 2.0) * cn0 / self.sample_rate_hz)

    def step(self, first: int, count: int) -> FloatArray:
        """Return the quantiser's step in segments, in units of the noise per component."""
        if self._gain is None:
            power = np.full(count, self._total(self._fixed_hz))
        else:
            power = self._gain(first, count)
        return OPTIMUM_STEP[self.format.bits] * np.sqrt(np.where(power > 0.0, power, 1.0))

    def _total(self, carriers_hz: Any) -> Any:
        """Return the power per component of noise and of carriers over the noise's density."""
        share = (2.0 if self.format.is_real else 1.0) * carriers_hz / self.sample_rate_hz
        return float(self._sampling.noise) + share

    def _power(self, time: FloatArray) -> FloatArray:
        carriers = self._fixed_hz if self._carriers_hz is None else self._carriers_hz(time)
        return np.asarray(self._total(carriers + self._jammers.power_hz(time)))

    def levels(
        self, segments: SignalSegments, start: int, count: int
    ) -> tuple[NDArray[Any], NDArray[Any]]:
        """Make the quantised samples ``start .. start + count``.

        Parameters
        ----------
        segments : SignalSegments
            Covering these samples.
        start, count : int
            First sample index, number of samples.

        Returns
        -------
        tuple of ndarray of int8 or int16, shape (count,)
            I and Q levels; real samples are the first.
        """
        first, last = start // TILE, -(-(start + count) // TILE)
        shape, count_of = (last - first) * TILE, segments.cn0_dbhz.shape[1]
        out_i, out_q = np.empty(shape, self.format.dtype), np.empty(shape, self.format.dtype)
        signals = Signals(
            segments.first_segment,
            segments.carrier_phase_cycles,
            segments.code_phase_chips,
            segments.code_period,
            segments.bits,
            self.amplitude(segments.cn0_dbhz),
            self._windows,
            (1.0 / self.step(segments.first_segment, count_of)).astype(np.float32),
        )
        number = np.arange(segments.first_segment, segments.first_segment + count_of)
        jammers = self._jammers.at((number + 0.5) * self.segment_span)
        synthesise(first, signals, jammers, self._sampling, out_i, out_q)
        part = slice(start - first * TILE, start - first * TILE + count)
        return out_i[part], out_q[part]

    def packed(self, segments: SignalSegments, start: int, count: int) -> NDArray[np.uint8]:
        """Make the samples ``start .. start + count`` in the front end's bytes."""
        i, q = self.levels(segments, start, count)
        return self.format.pack(i, None if self.format.is_real else q)
