"""Backward recursion of the fixed-interval smoother (numba)."""

from __future__ import annotations

import numpy as np
from numba import njit

from deepseis_core.types import FloatArray

RANK = 1e-13
"""Of a correlation matrix: directions whose variance is below this share are known exactly."""


@njit(cache=True, nogil=True)
def _inverse(P: FloatArray) -> FloatArray:
    """Return the pseudo-inverse of a covariance, whatever its units."""
    n = P.shape[0]
    scale = np.zeros(n)
    for i in range(n):
        if P[i, i] > 0.0:
            scale[i] = 1.0 / np.sqrt(P[i, i])
    C = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            C[i, j] = 0.5 * (P[i, j] + P[j, i]) * scale[i] * scale[j]
    values, vectors = np.linalg.eigh(C)
    limit = RANK * values[n - 1]
    weighted = np.zeros((n, n))
    for j in range(n):
        if values[j] > limit:
            for i in range(n):
                weighted[i, j] = scale[i] * vectors[i, j] / np.sqrt(values[j])
    return weighted @ weighted.T


@njit(cache=True, nogil=True)
def gain_kernel(after: FloatArray, transition: FloatArray, before: FloatArray) -> FloatArray:
    """Return ``A = P Phi^T (P-)^-1`` from a step, ``P``, to the next, ``P- = before``."""
    return (after @ transition.T) @ _inverse(before)


@njit(cache=True, nogil=True)
def gains_kernel(transition, before, after, gain):  # type: ignore[no-untyped-def]
    """Fill the gain of every step but the last, shape (k, n, n); the last one's is zero."""
    count = before.shape[0]
    for k in range(count - 1):
        gain[k] = gain_kernel(after[k], transition[k + 1], before[k + 1])
    gain[count - 1] = 0.0


@njit(cache=True, nogil=True)
def backward_kernel(gain, before, after, correction, error, P):  # type: ignore[no-untyped-def]
    """Fill errors, shape (k, n), and covariances, (k, n, n), from the last step to the first."""
    last = before.shape[0] - 1
    n = before.shape[1]
    error[last] = 0.0
    P[last] = after[last]
    for k in range(last - 1, -1, -1):
        A = gain[k]
        error[k] = A @ (correction[k + 1] + error[k + 1])
        gained = A @ (P[k + 1] - before[k + 1]) @ A.T
        for i in range(n):
            for j in range(n):
                P[k, i, j] = after[k, i, j] + 0.5 * (gained[i, j] + gained[j, i])
