"""The kernel that adds jammers to a tile: a carrier, or filtered noise on a carrier."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepseis_core.types import Float32Array, FloatArray, IntArray
from deepseis_sim import gaussian_noise as noise
from deepseis_sim.carrier_table import TWO_PI, Scratch, rotation_table
from deepseis_sim.gaussian_noise import F32, U64

TILE: Final = noise.BLOCK
TAPS: Final = 64
"""Values of the slower noise that a sample of a band takes."""

LARGEST_FACTOR: Final = 64
"""Most samples for each value of the slower noise."""

NONE: Final = -(2**62)

fill_noise = noise.fill_block


class Jammers(NamedTuple):
    """The jammers: rows of every array.

    ``increment`` is the carrier's step a sample, ``phase`` its phase at sample 0, both in 2**-64
    cycle; ``amplitude`` (n, n_segments) in standard deviations of the noise. ``factor`` is 0 for a
    bare carrier, else the samples for each value of the slower noise, which has ``seed`` and goes
    through ``taps`` (n, LARGEST_FACTOR, TAPS).
    """

    increment: NDArray[np.uint64]
    phase: NDArray[np.uint64]
    amplitude: FloatArray
    factor: IntArray
    taps: NDArray[np.float32]
    seed: NDArray[np.uint64]


class Held(NamedTuple):
    """Two blocks of each jammer's slower noise, (n, 2, BLOCK), and their numbers, (n, 2)."""

    noise_i: Float32Array
    noise_q: Float32Array
    number: IntArray


@njit(cache=True, nogil=True)
def make_held(count: int) -> Held:
    """Allocate room for the noise of so many jammers."""
    shape = (count, 2, TILE)
    number = np.full((count, 2), NONE)
    return Held(np.empty(shape, np.float32), np.empty(shape, np.float32), number)


@njit(cache=True, nogil=True)
def add_tone(
    out_i: Float32Array,
    out_q: Float32Array,
    carrier: tuple[float, float, float],
    scratch: Scratch,
) -> None:
    """Add a carrier: amplitude, phase at the first sample [cycles], increment a sample."""
    table_c, table_s = scratch[0], scratch[1]
    amplitude, phase, rotation = carrier
    turn_c, turn_s = rotation_table(rotation, scratch)
    c, s = amplitude * np.cos(TWO_PI * phase), amplitude * np.sin(TWO_PI * phase)
    for start in range(0, out_i.size, table_c.size):
        anchor_c, anchor_s = F32(c), F32(s)
        for b in range(table_c.size):
            out_i[start + b] += anchor_c * table_c[b] - anchor_s * table_s[b]
            out_q[start + b] += anchor_c * table_s[b] + anchor_s * table_c[b]
        c, s = c * turn_c - s * turn_s, c * turn_s + s * turn_c


@njit(cache=True, nogil=True)
def slow_noise(
    tile: int, factor: int, seed: Any, which: int, held: Held, window: Float32Array
) -> None:
    """Copy the slower noise that a tile needs into ``window``, shape (2, n)."""
    count = TILE // factor + TAPS - 1
    first, n = tile * (TILE // factor) - (TAPS - 1), 0
    while n < count:
        block = (first + n) // TILE
        slot, at = block & 1, first + n - block * TILE
        size = min(TILE - at, count - n)
        if held.number[which, slot] != block:
            fill_noise(seed, U64(block), held.noise_i[which, slot], held.noise_q[which, slot])
            held.number[which, slot] = block
        window[0, n : n + size] = held.noise_i[which, slot, at : at + size]
        window[1, n : n + size] = held.noise_q[which, slot, at : at + size]
        n += size


@njit(cache=True, nogil=True)
def filter_noise(
    window: Float32Array, factor: int, taps: NDArray[np.float32], out: Float32Array
) -> None:
    """Put the slower noise of one component through the low-pass: a whole tile."""
    count = TILE // factor
    total = np.empty(count, np.float32)
    for p in range(factor):
        total[:] = F32(0.0)
        for k in range(0, TAPS, 4):
            h0, h1, h2, h3 = taps[p, k], taps[p, k + 1], taps[p, k + 2], taps[p, k + 3]
            late = window[TAPS - 4 - k : TAPS - 1 - k + count]
            for m in range(count):
                total[m] += (h0 * late[m + 3] + h1 * late[m + 2]) + (
                    h2 * late[m + 1] + h3 * late[m]
                )
        for m in range(count):
            out[m * factor + p] = total[m]


@njit(cache=True, nogil=True)
def add_band(
    out_i: Float32Array,
    out_q: Float32Array,
    band_i: Float32Array,
    band_q: Float32Array,
    carrier: tuple[float, float, float],
    scratch: Scratch,
) -> None:
    """Add complex noise moved to a carrier's frequency; ``carrier`` as in `add_tone`."""
    table_c, table_s = scratch[0], scratch[1]
    amplitude, phase, rotation = carrier
    turn_c, turn_s = rotation_table(rotation, scratch)
    c, s = amplitude * np.cos(TWO_PI * phase), amplitude * np.sin(TWO_PI * phase)
    for start in range(0, out_i.size, table_c.size):
        anchor_c, anchor_s = F32(c), F32(s)
        for b in range(table_c.size):
            i = anchor_c * table_c[b] - anchor_s * table_s[b]
            q = anchor_c * table_s[b] + anchor_s * table_c[b]
            x, y = band_i[start + b], band_q[start + b]
            out_i[start + b] += i * x - q * y
            out_q[start + b] += i * y + q * x
        c, s = c * turn_c - s * turn_s, c * turn_s + s * turn_c


@njit(cache=True, nogil=True)
def add_jammers(
    tile: int,
    row: int,
    jammers: Jammers,
    held: Held,
    out_i: Float32Array,
    out_q: Float32Array,
    scratch: Scratch,
) -> None:
    """Add all jammers to a tile of segment ``row`` of their amplitudes."""
    for j in range(jammers.increment.size):
        amplitude = jammers.amplitude[j, row]
        if amplitude == 0.0:
            continue
        increment = jammers.increment[j]
        start = U64(U64(increment * U64(tile * TILE)) + jammers.phase[j])
        rotation = np.float64(increment) * 2.0**-64
        carrier = (amplitude, np.float64(start) * 2.0**-64, rotation)
        factor = jammers.factor[j]
        if factor == 0:
            add_tone(out_i, out_q, carrier, scratch)
            continue
        window = np.empty((2, TILE + TAPS), np.float32)
        band = np.empty((2, TILE), np.float32)
        slow_noise(tile, factor, jammers.seed[j], j, held, window)
        filter_noise(window[0], factor, jammers.taps[j], band[0])
        filter_noise(window[1], factor, jammers.taps[j], band[1])
        add_band(out_i, out_q, band[0], band[1], carrier, scratch)
