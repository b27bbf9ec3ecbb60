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

from typing import Final

import numpy as np
from numba import njit

from deepseis_sim.gaussian_noise import BLOCK, F32, U32, U64, fill_block, float_bits, float_from_bits

TILE: Final = BLOCK
"""Samples of one tile."""

SEGMENT_TERMS: Final = 4
"""Coefficients of the phase polynomials: cubic in the fraction of a segment."""

TWO_PI: Final = 2.0 * np.pi


@njit(cache=True, nogil=True, inline="always")
def cubic(coefficients, x):  # type: ignore[no-untyped-def]
    """Evaluate a cubic by Horner's rule."""
    c = coefficients
    return c[0] + x * (c[1] + x * (c[2] + x * c[3]))


@njit(cache=True, nogil=True)
def rotation_table(step_cycles, table_c, table_s, rotor_c, rotor_s):  # type: ignore[no-untyped-def]
    """Fill ``exp(j 2 pi step b)`` for b = 0 .. table size, and return the value after the last.

    The table doubles from one value, in float64: its error is below 1e-14 at 64 values.
    """
    rotor_c[0], rotor_s[0] = 1.0, 0.0
    c, s = np.cos(TWO_PI * step_cycles), np.sin(TWO_PI * step_cycles)
    size = 1
    while size < table_c.size:
        for b in range(size):
            rotor_c[size + b] = rotor_c[b] * c - rotor_s[b] * s
            rotor_s[size + b] = rotor_c[b] * s + rotor_s[b] * c
        c, s = c * c - s * s, 2.0 * c * s
        size *= 2
    for b in range(table_c.size):
        table_c[b] = rotor_c[b]
        table_s[b] = rotor_s[b]
    return c, s


@njit(cache=True, nogil=True)
def add_group(out_i, out_q, table_c, table_s, anchor_c, anchor_s, fraction, step, window):  # type: ignore[no-untyped-def]
    """Add one satellite to a group of samples.

    ``fraction + b * step`` is the code phase in units of 2**-27 chip from the first chip of
    ``window``, whose bit k (set: -1) is the k-th chip.
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
def chip_window(windows, bits, chip, millisecond):  # type: ignore[no-untyped-def]
    """Return 32 chips times data bits from chip ``chip`` of code period ``millisecond``.

    Parameters
    ----------
    windows : ndarray of uint32, shape (1023,)
        The code's 32 chips from each chip on, the first one in bit 0.
    bits : ndarray of uint8
        Data bits (1: the signal is inverted), one each 20 code periods.
    """
    window = windows[chip]
    now = bits[millisecond // 20]
    if now:
        window = U32(~window)
    left = 1023 - chip
    if left < 32 and bits[(millisecond + 1) // 20] != now:
        window = U32(window ^ U32(U32(0xFFFFFFFF) << U32(left)))
    return window


@njit(cache=True, nogil=True)
def add_satellite(out_i, out_q, phase, rotation, code, code_rate, period, amplitude, windows, bits, scratch):  # type: ignore[no-untyped-def]
    """Add one satellite to a tile.

    Parameters
    ----------
    out_i, out_q : ndarray of float32, shape (TILE,)
    phase, rotation : float
        Carrier phase at the tile's first sample [cycles] and its increment a sample.
    code, code_rate : float
        Code phase from the beginning of code period ``period`` [chips], its increment a sample.
    period : int
        Counted from the beginning of ``bits``.
    amplitude : float
    windows, bits : ndarray
        See :func:`chip_window`.
    scratch : tuple of ndarray, shape (group,)
        Two of float32, two of float64.
    """
    table_c, table_s, rotor_c, rotor_s = scratch
    turn_c, turn_s = rotation_table(rotation, table_c, table_s, rotor_c, rotor_s)
    c, s = amplitude * np.cos(TWO_PI * phase), amplitude * np.sin(TWO_PI * phase)
    step = U32(code_rate * 134217728.0)
    group = table_c.size
    for start in range(0, out_i.size, group):
        position = code + code_rate * start
        millisecond = np.int64(position / 1023.0)
        within = position - 1023.0 * millisecond
        chip = min(np.int64(within), 1022)
        fraction = U32(min((within - chip) * 134217728.0, 134217727.0))
        window = chip_window(windows, bits, chip, period + millisecond)
        end = start + group
        add_group(
            out_i[start:end], out_q[start:end], table_c, table_s, F32(c), F32(s),
            fraction, step, window,
        )  # fmt: skip
        c, s = c * turn_c - s * turn_s, c * turn_s + s * turn_c


@njit(cache=True, nogil=True)
def quantise(x, inverse_step, odd, limit, out):  # type: ignore[no-untyped-def]
    """Write levels: odd ones ``2 floor(x) + 1`` or whole ones, cut off at ``limit``."""
    if odd:
        for n in range(x.size):
            level = F32(2.0) * np.floor(x[n] * inverse_step) + F32(1.0)
            out[n] = np.int32(min(max(level, -limit), limit))
    else:
        for n in range(x.size):
            level = np.floor(x[n] * inverse_step + F32(0.5))
            out[n] = np.int32(min(max(level, -limit), limit))


@njit(cache=True, nogil=True)
def synthesise(first_tile, first_segment, tiles_per_segment, phase, code, period, amplitude, windows, bits, carrier, group, seed, noise, levels, out_i, out_q):  # type: ignore[no-untyped-def]
    """Make whole tiles of quantised IF samples.

    Parameters
    ----------
    first_tile : int
        Number of the first tile; its first sample is ``first_tile * TILE``.
    first_segment, tiles_per_segment : int
        Segment number of the polynomials' first row, and a segment's length.
    phase, code : ndarray of float64, shape (n_satellites, n_segments, 4)
        Carrier phase [cycles] and code phase [chips, from the beginning of ``period``] as cubics
        in the fraction of the segment.
    period : ndarray of int64, shape (n_satellites, n_segments)
        Code periods from the beginning of ``bits``.
    amplitude : ndarray of float64, shape (n_satellites, n_segments)
        In units of the noise's standard deviation per component.
    windows : ndarray of uint32, shape (n_satellites, 1023)
    bits : ndarray of uint8, shape (n_satellites, n_bits)
    carrier : tuple (uint64, float)
        Phase increment of the IF [2**-64 cycle], and the sign of the satellites' phase (-1:
        mirrored spectrum).
    group : int
        Samples per group, a power of two; ``(group - 1) * chips per sample`` below 31.
    seed : uint64
    noise : bool
        Whether there is any.
    levels : tuple (float32, bool, float32)
        Inverse step, odd levels or whole ones, largest level.
    out_i, out_q : ndarray of int8 or int16, shape (n_tiles * TILE,)
    """
    increment, sign = carrier
    inverse_step, odd, limit = levels
    tile_i, tile_q = np.empty(TILE, np.float32), np.empty(TILE, np.float32)
    scratch = (
        np.empty(group, np.float32), np.empty(group, np.float32),
        np.empty(group, np.float64), np.empty(group, np.float64),
    )  # fmt: skip
    for k in range(out_i.size // TILE):
        tile = first_tile + k
        if noise:
            fill_block(seed, U64(tile), tile_i, tile_q)
        else:
            tile_i[:], tile_q[:] = 0.0, 0.0
        segment = tile // tiles_per_segment
        x0 = (tile - segment * tiles_per_segment) / tiles_per_segment
        x1 = (tile - segment * tiles_per_segment + 1) / tiles_per_segment
        row = segment - first_segment
        if_phase = np.float64(U64(increment * U64(tile * TILE))) * 2.0**-64
        if_step = np.float64(increment) * 2.0**-64
        for m in range(phase.shape[0]):
            if amplitude[m, row] == 0.0:
                continue
            p0, p1 = cubic(phase[m, row], x0), cubic(phase[m, row], x1)
            c0, c1 = cubic(code[m, row], x0), cubic(code[m, row], x1)
            p = sign * (p0 - np.floor(p0)) + if_phase
            add_satellite(
                tile_i, tile_q, p, sign * (p1 - p0) / TILE + if_step,
                c0, (c1 - c0) / TILE, period[m, row], amplitude[m, row], windows[m], bits[m], scratch,
            )  # fmt: skip
        quantise(tile_i, inverse_step, odd, limit, out_i[k * TILE : (k + 1) * TILE])
        quantise(tile_q, inverse_step, odd, limit, out_q[k * TILE : (k + 1) * TILE])
