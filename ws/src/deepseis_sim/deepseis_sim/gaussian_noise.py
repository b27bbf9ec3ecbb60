"""Gaussian noise that is a function of (seed, sample index): any chunking gives the same samples.

A counter-based generator: every block of :data:`BLOCK` samples has three 32-bit keys, drawn
from (seed, block number) by SplitMix64 [1]_; within the block two rounds of a multiply-xorshift
hash [2]_ of the counter give 64 bits a sample, and the Box-Muller transform turns these into an
independent pair of unit normal values. All of it is straight 32-bit arithmetic that a compiler
turns into vector instructions; logarithm, sine and cosine are minimax polynomials whose errors
(1.4e-6, 5e-7 and 7e-6) are far below what the statistics of any run could show.

References
----------
.. [1] G. L. Steele, D. Lea, C. H. Flood, "Fast splittable pseudorandom number generators",
   OOPSLA 2014.
.. [2] C. Wellons, "Prospecting for Hash Functions", 2018: the constants of lowbias32.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from deepseis_core.types import Float32Array

BLOCK: Final = 1024
"""Samples that share one set of keys; noise is made in whole blocks."""

U32: Final = np.uint32
U64: Final = np.uint64
F32: Final = np.float32

LN_0, LN_1, LN_2, LN_3 = F32(0.40546540), F32(0.66668530), F32(-0.22225065), F32(0.09819928)
LN_4, LN_5, LN_6 = F32(-0.04890363), F32(0.03057137), F32(-0.01740803)
SIN_1, SIN_3, SIN_5, SIN_7 = F32(1.5707907), F32(-0.6458918), F32(0.07943326), F32(-0.00433271)
COS_0, COS_2, COS_4, COS_6 = F32(0.9999933), F32(-1.2334845), F32(0.25258023), F32(-0.01909573)
LN_TWO: Final = F32(0.6931471805599453)


@intrinsic
def float_bits(_: Any, value: Any) -> Any:
    """Return the bits of a float32 as uint32 (inside kernels)."""
    return types.uint32(types.float32), _bitcast_to_int


@intrinsic
def float_from_bits(_: Any, bits: Any) -> Any:
    """Return the float32 that has these bits (inside kernels)."""
    return types.float32(types.uint32), _bitcast_to_float


def _bitcast_to_int(_: Any, builder: Any, __: Any, args: Any) -> Any:
    return builder.bitcast(args[0], ir.IntType(32))


def _bitcast_to_float(_: Any, builder: Any, __: Any, args: Any) -> Any:
    return builder.bitcast(args[0], ir.FloatType())


@njit(cache=True, nogil=True)
def split_mix(state: Any) -> Any:
    """Scramble 64 bits (the output function of SplitMix64)."""
    z = U64(state)
    z = U64(U64(z ^ U64(z >> U64(30))) * U64(0xBF58476D1CE4E5B9))
    z = U64(U64(z ^ U64(z >> U64(27))) * U64(0x94D049BB133111EB))
    return U64(z ^ U64(z >> U64(31)))


@njit(cache=True, nogil=True, inline="always")
def hash_32(x: Any, key: Any) -> Any:
    """Scramble 32 bits under a key; a bijection."""
    x = U32(x ^ U32(x >> U32(16)))
    x = U32(x * U32(0x7FEB352D))
    x = U32(U32(x ^ U32(x >> U32(15))) ^ key)
    x = U32(x * U32(0x846CA68B))
    return U32(x ^ U32(x >> U32(16)))


@njit(cache=True, nogil=True, inline="always")
def normal_pair(x: Any, y: Any) -> Any:
    """Turn two 32-bit words into two independent unit normal values (Box-Muller).

    The radius comes from the upper 31 bits of ``x`` (largest value 6.6), the angle from ``y``
    within a half turn, and the lowest bit of ``x`` chooses the half.
    """
    u = F32(F32(np.int32(x >> U32(1))) * F32(2.0**-31) + F32(2.0**-32))
    bits = float_bits(u)
    exponent = F32(np.int32(bits >> U32(23)) - np.int32(127))
    m = float_from_bits(U32(U32(bits & U32(0x7FFFFF)) | U32(0x3F800000))) - F32(1.5)
    log_m = LN_0 + m * (LN_1 + m * (LN_2 + m * (LN_3 + m * (LN_4 + m * (LN_5 + m * LN_6)))))
    radius = np.sqrt(max(F32(0.0), F32(-2.0) * (exponent * LN_TWO + log_m)))
    t = F32(np.int32(y)) * F32(2.0**-31)
    t2 = t * t
    sine = t * (SIN_1 + t2 * (SIN_3 + t2 * (SIN_5 + t2 * SIN_7)))
    cosine = COS_0 + t2 * (COS_2 + t2 * (COS_4 + t2 * COS_6))
    half = U32(x << U32(31))
    return float_from_bits(U32(float_bits(radius * cosine) ^ half)), radius * sine


@njit(cache=True, nogil=True)
def fill_block(seed: Any, block: Any, out_i: Float32Array, out_q: Float32Array) -> None:
    """Write the noise of one block into two float32 arrays of :data:`BLOCK` values."""
    state = U64(U64(seed) + U64(U64(block) * U64(0x9E3779B97F4A7C15)))
    first, second = split_mix(state), split_mix(U64(state ^ U64(0xD1B54A32D192ED03)))
    key_0, key_1 = U32(first), U32(first >> U64(32))
    key_2, key_3 = U32(second), U32(second >> U64(32))
    for n in range(out_i.size):
        x = hash_32(U32(U32(U32(n) * U32(0x9E3779B9)) + key_0), key_1)
        y = hash_32(U32(x + key_2), key_3)
        out_i[n], out_q[n] = normal_pair(x, y)


def gaussian_noise(seed: int, start: int, count: int) -> NDArray[np.complex64]:
    """Make complex noise of unit variance per component for samples ``start .. start + count``.

    Parameters
    ----------
    seed : int
        Any 64 bits.
    start, count : int
        Sample index of the first value, and how many.

    Returns
    -------
    ndarray of complex64, shape (count,)

    Examples
    --------
    >>> whole = gaussian_noise(1, 0, 3000)
    >>> bool((gaussian_noise(1, 1500, 100) == whole[1500:1600]).all())
    True
    """
    first, last = start // BLOCK, -(-(start + count) // BLOCK)
    out_i = np.empty((max(last - first, 0), BLOCK), np.float32)
    out_q = np.empty_like(out_i)
    for k in range(last - first):
        fill_block(np.uint64(seed & (2**64 - 1)), np.uint64(first + k), out_i[k], out_q[k])
    offset = start - first * BLOCK
    values = out_i.ravel()[offset : offset + count] + 1j * out_q.ravel()[offset : offset + count]
    return values.astype(np.complex64)
