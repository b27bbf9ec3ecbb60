"""Kernels of the spectral matching: rows of the linear problem, and its solution."""

from __future__ import annotations

import numpy as np
from numba import njit

from deepseis_core.types import FloatArray


@njit(cache=True, nogil=True)
def reversed_responses(
    periods: FloatArray, damping: float, time: FloatArray, step: float, weights: FloatArray
) -> None:
    """Fill in what each sample adds to ``-w^2 u`` of an oscillator at a moment: (m, n).

    ``w^2 / wd exp(-xi w s) sin(wd s) step``, ``s`` before the moment; left at 0 for period 0.
    """
    for i in range(periods.size):
        if periods[i] == 0.0:
            continue
        w = 2.0 * np.pi / periods[i]
        wd = w * np.sqrt(1.0 - damping * damping)
        last = min(int(np.ceil(time[i] / step)) - 1, weights.shape[1] - 1)
        s = time[i] - last * step
        value = np.exp(complex(-damping * w * s, wd * s)) * (w * w / wd * step)
        turn = np.exp(complex(-damping * w * step, wd * step))
        for k in range(last, -1, -1):
            weights[i, k] = value.imag
            value *= turn


@njit(cache=True, nogil=True)
def solve_positive(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solve with a symmetric positive definite matrix (m, m) and a right side (m,).

    Elimination without pivots, in an order that does not depend on the number of threads, as a
    library's would: a seed's bytes hang on it.
    """
    m = right.size
    A, x = matrix.copy(), right.copy()
    for k in range(m):
        for i in range(k + 1, m):
            factor = A[k, i] / A[k, k]
            x[i] -= factor * x[k]
            for j in range(i, m):
                A[i, j] -= factor * A[k, j]
    for k in range(m - 1, -1, -1):
        for j in range(k + 1, m):
            x[k] -= A[k, j] * x[j]
        x[k] /= A[k, k]
    return x
