"""The kernel that makes IF samples: noise, plus a code-modulated carrier per satellite, quantised.

Samples are made in tiles of :data:`TILE` on the absolute sample grid, so that a sample does not
depend on where a chunk begins. Within a tile carrier and code phase are straight lines between
their values at its ends (at 50 g the sagitta is 2e-5 cycle at 4 MHz). Within a group of samples
the carrier is one table of ``exp(j 2 pi w b)``, made afresh for every tile and satellite by
doubling, turned by an anchor that is advanced in float64; and the chips are the bits of one
32-bit window of the code, shifted by the whole part of a fixed-point code phase. Nothing in the
inner loop is a branch, a gather, or longer than 32 bits.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepseis_core.types import Float32Array, FloatArray, IntArray
from deepseis_sim import gaussian_noise as noise
from deepseis_sim.carrier_table import TWO_PI, Scratch, make_scratch, rotation_table
from deepseis_sim.gaussian_noise import F32, U32, U64, float_bits, float_from_bits
from deepseis_sim.jammer_kernel import Jammers, add_jammers, make_held

TILE: Final = noise.BLOCK
"""Samples of one tile."""

CHIP: Final = float(1 << 27)
"""Units of the fixed-point code phase in a chip: 32 chips fill 32 bits."""

fill_noise = noise.fill_block


class Signals(NamedTuple):
    """The satellites: rows of every array.

    ``phase`` [cycles] and ``code`` [chips], shape (n, n_segments, 4), are cubics in the fraction
    of a segment, from segment ``first_segment`` on; code counts from the beginning of code
    period ``period`` (n, n_segments), and that from the beginning of ``bits`` (n, n_bits), one
    each 20 periods, 1 where the signal is inverted. ``amplitude`` (n, n_segments) is in standard
    deviations of the noise per component. ``windows`` (n, 1023) holds the code's 32 chips from
    each chip on, the first in bit 0, set where the chip is -1. ``inverse_step`` (n_segments,) is
    the inverse of the quantiser's step, in the same standard deviations.
    """

    first_segment: int
    phase: FloatArray
    code: FloatArray
    period: IntArray
    bits: NDArray[np.uint8]
    amplitude: FloatArray
    windows: NDArray[np.uint32]
    inverse_step: Float32Array


class Sampling(NamedTuple):
    """The front end.

    ``increment`` is the step of the IF's phase [2**-64 cycle], ``sign`` -1 where the spectrum is
    mirrored. ``group`` samples share a window: ``(group - 1)`` times the chips a sample takes
    must stay below 31. Levels are ``2 floor(x) + 1`` if ``odd``, else whole, at most ``limit``.
    """

    tiles_per_segment: int
    increment: np.uint64
    sign: float
    group: int
    seed: np.uint64
    noise: bool
    odd: bool
    limit: np.float32


@njit(cache=True, nogil=True, inline="always")
def cubic(coefficients: FloatArray, x: float) -> float:
    """Evaluate a cubic by Horner's rule."""
    c = coefficients
    return c[0] + x * (c[1] + x * (c[2] + x * c[3]))


@njit(cache=True, nogil=True)
def add_group(
    out_i: Float32Array,
    out_q: Float32Array,
    table_c: Float32Array,
    table_s: Float32Array,
    anchor_c: Any,
    anchor_s: Any,
    fraction: Any,
    step: Any,
    window: Any,
) -> None:
    """Add one satellite to a group of samples.

    ``fraction + b * step`` is the code phase of sample b, in units of 1 / CHIP, from the first
    chip of ``window``; a set bit turns the carrier's sign.
    """
    for b in range(out_i.size):
        chip = U32(U32(fraction + U32(U32(b) * step)) >> U32(27))
        sign = U32(U32(window << U32(U32(31) - chip)) & U32(0x80000000))
        c, s = table_c[b], table_s[b]
        i = anchor_c * c - anchor_s * s
        q = anchor_c * s + anchor_s * c
        out_i[b] += float_from_bits(U32(float_bits(i) ^ sign))
        out_q[b] += float_from_bits(U32(float_bits(q) ^ sign))


@njit(cache=True, nogil=True, inline="always")
def chip_window(
    windows: NDArray[np.uint32], bits: NDArray[np.uint8], chip: int, period: int
) -> Any:
    """Return 32 chips times data bits from chip ``chip`` of code period ``period``."""
    window = windows[chip]
    now = bits[period // 20]
    if now:
        window = U32(~window)
    left = 1023 - chip
    if left < 32 and bits[(period + 1) // 20] != now:
        window = U32(window ^ U32(U32(0xFFFFFFFF) << U32(left)))
    return window


@njit(cache=True, nogil=True)
def add_satellite(
    out_i: Float32Array,
    out_q: Float32Array,
    carrier: tuple[float, float, float],
    code: tuple[float, float, int],
    windows: NDArray[np.uint32],
    bits: NDArray[np.uint8],
    scratch: Scratch,
) -> None:
    """Add one satellite to a tile.

    Parameters
    ----------
    out_i, out_q : ndarray of float32, shape (TILE,)
    carrier : tuple
        Amplitude, phase at the first sample [cycles], its increment a sample.
    code : tuple
        Code phase at the first sample [chips] from the beginning of a code period, its increment
        a sample, and that period's number.
    windows, bits : ndarray
        The satellite's rows of `Signals`.
    scratch : tuple of ndarray
        For `rotation_table`.
    """
    table_c, table_s = scratch[0], scratch[1]
    amplitude, phase, rotation = carrier
    start_chips, rate, start_period = code
    turn_c, turn_s = rotation_table(rotation, scratch)
    c, s = amplitude * np.cos(TWO_PI * phase), amplitude * np.sin(TWO_PI * phase)
    step = U32(rate * CHIP)
    group = table_c.size
    for start in range(0, out_i.size, group):
        chips = start_chips + rate * start
        periods = np.int64(chips / 1023.0)
        within = chips - 1023.0 * periods
        chip = int(within)
        fraction = U32(min((within - chip) * CHIP, CHIP - 1.0))
        window = chip_window(windows, bits, chip, start_period + periods)
        part_i, part_q = out_i[start : start + group], out_q[start : start + group]
        add_group(part_i, part_q, table_c, table_s, F32(c), F32(s), fraction, step, window)
        c, s = c * turn_c - s * turn_s, c * turn_s + s * turn_c


@njit(cache=True, nogil=True)
def quantise(x: Float32Array, inverse_step: Any, sampling: Sampling, out: NDArray[Any]) -> None:
    """Write the levels of a tile."""
    limit = sampling.limit
    if sampling.odd:
        for n in range(x.size):
            level = F32(2.0) * np.floor(x[n] * inverse_step) + F32(1.0)
            out[n] = np.int32(min(max(level, -limit), limit))
    else:
        for n in range(x.size):
            level = np.floor(x[n] * inverse_step + F32(0.5))
            out[n] = np.int32(min(max(level, -limit), limit))


@njit(cache=True, nogil=True)
def add_signals(
    tile: int,
    segment: int,
    signals: Signals,
    sampling: Sampling,
    out_i: Float32Array,
    out_q: Float32Array,
    scratch: Scratch,
) -> None:
    """Add all satellites to a tile."""
    length = sampling.tiles_per_segment
    begin, end = (tile - segment * length) / length, (tile - segment * length + 1) / length
    row = segment - signals.first_segment
    if_phase = np.float64(U64(sampling.increment * U64(tile * TILE))) * 2.0**-64
    if_step = np.float64(sampling.increment) * 2.0**-64
    for m in range(signals.phase.shape[0]):
        amplitude = signals.amplitude[m, row]
        if amplitude == 0.0:
            continue
        phase, code = signals.phase[m, row], signals.code[m, row]
        p0, p1 = cubic(phase, begin), cubic(phase, end)
        c0, c1 = cubic(code, begin), cubic(code, end)
        p = sampling.sign * (p0 - np.floor(p0)) + if_phase
        rotation = sampling.sign * (p1 - p0) / TILE + if_step
        carrier = (amplitude, p, rotation)
        chips = (c0, (c1 - c0) / TILE, signals.period[m, row])
        add_satellite(out_i, out_q, carrier, chips, signals.windows[m], signals.bits[m], scratch)


@njit(cache=True, nogil=True)
def synthesise(
    first_tile: int,
    signals: Signals,
    jammers: Jammers,
    sampling: Sampling,
    out_i: NDArray[Any],
    out_q: NDArray[Any],
) -> None:
    """Make whole tiles of quantised IF samples.

    Parameters
    ----------
    first_tile : int
        Number of the first tile; its first sample is ``first_tile * TILE``.
    signals : Signals
        Covering these samples.
    jammers : Jammers
        Their amplitudes are those of the segments of ``signals``.
    sampling : Sampling
    out_i, out_q : ndarray of int8 or int16, shape (n_tiles * TILE,)
    """
    tile_i, tile_q = np.empty(TILE, np.float32), np.empty(TILE, np.float32)
    scratch = make_scratch(sampling.group)
    held = make_held(jammers.increment.size)
    for k in range(out_i.size // TILE):
        tile = first_tile + k
        segment = tile // sampling.tiles_per_segment
        row = segment - signals.first_segment
        if sampling.noise:
            fill_noise(sampling.seed, U64(tile), tile_i, tile_q)
        else:
            tile_i[:] = 0.0
            tile_q[:] = 0.0
        add_signals(tile, segment, signals, sampling, tile_i, tile_q, scratch)
        add_jammers(tile, row, jammers, held, tile_i, tile_q, scratch)
        inverse_step = signals.inverse_step[row]
        quantise(tile_i, inverse_step, sampling, out_i[k * TILE : (k + 1) * TILE])
        quantise(tile_q, inverse_step, sampling, out_q[k * TILE : (k + 1) * TILE])
