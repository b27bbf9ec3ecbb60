"""Carriers of float32 samples, from a table made afresh for every tile (kernels)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit

from deepseis_core.types import Float32Array, FloatArray

TWO_PI: Final = 2.0 * np.pi

Scratch = tuple[Float32Array, Float32Array, FloatArray, FloatArray]
"""Table of cosines and of sines, and room for the same in float64; shape (group,)."""


@njit(cache=True, nogil=True)
def make_scratch(group: int) -> Scratch:
    """Allocate what `rotation_table` fills."""
    return (
        np.empty(group, np.float32),
        np.empty(group, np.float32),
        np.empty(group, np.float64),
        np.empty(group, np.float64),
    )


@njit(cache=True, nogil=True)
def rotation_table(step: float, scratch: Scratch) -> tuple[float, float]:
    """Fill ``exp(j 2 pi step b)`` for b = 0 .. table size, and return the value after the last.

    The table doubles from one value, in float64: off by less than 1e-14.
    """
    table_c, table_s, exact_c, exact_s = scratch
    exact_c[0], exact_s[0] = 1.0, 0.0
    c, s = np.cos(TWO_PI * step), np.sin(TWO_PI * step)
    size = 1
    while size < table_c.size:
        for b in range(size):
            exact_c[size + b] = exact_c[b] * c - exact_s[b] * s
            exact_s[size + b] = exact_c[b] * s + exact_s[b] * c
        c, s = c * c - s * s, 2.0 * c * s
        size *= 2
    for b in range(table_c.size):
        table_c[b] = exact_c[b]
        table_s[b] = exact_s[b]
    return c, s
