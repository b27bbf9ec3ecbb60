"""Kernels of the displacement from carrier phases: residuals, fits with unknown clock, updates.

The filter's state has a bias and its rate for every satellite, ``slots`` of each; what is free in
an epoch (clock, or displacement and clock) is no state: it is solved for with nothing known
beforehand, and the state learns from what it leaves over. With innovations ``y = A x + H b + v``
and ``S = H P H' + R``::

    C = (A' S^-1 A)^-1,   x = C A' S^-1 y,   M = S^-1 - S^-1 A C A' S^-1
    b <- b + P H' M y,    P <- P - P H' M H P

which is the limit of a Kalman filter with an infinite variance of x, and stays regular there.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from deepseis_core.atmosphere import klobuchar_point, saastamoinen_point
from deepseis_core.constants import SPEED_OF_LIGHT as C_LIGHT
from deepseis_core.ephemeris import CLOCK
from deepseis_core.geodesy import geodetic_point
from deepseis_core.types import FloatArray, IntArray
from deepseis_pvt.spp_kernels import line_of_sight, look_angles

RESIDUAL, ELEVATION, EAST, NORTH, UP = range(5)
"""Columns that `phase_residuals` fills: phase less its model [m], elevation [rad], and what a
displacement east, north, up adds to the phase [m/m]."""


@njit(cache=True, nogil=True)
def phase_residuals(
    antenna: FloatArray, satellites: FloatArray, phase: FloatArray, klobuchar: FloatArray,
    tow: float, troposphere: bool, ionosphere: bool, out: FloatArray,
) -> None:  # fmt: skip
    """Fill the phases' residuals against a surveyed antenna.

    Parameters
    ----------
    antenna : ndarray, shape (3,)
        ECEF [m].
    satellites : ndarray, shape (m, 12)
        States at the moments of transmission, as of `core.ephemeris.satellite_states`.
    phase : ndarray, shape (m,)
        L1C times the wavelength [m].
    klobuchar, tow
        Ionosphere's eight parameters; GPS seconds of week.
    troposphere, ionosphere : bool
        Whether to remove these delays; the ionosphere advances the phase.
    out : ndarray, shape (m, 5)
        Filled: see ``RESIDUAL`` and following.
    """
    lat, lon, height = geodetic_point(antenna[0], antenna[1], antenna[2])
    turned = np.empty(6)
    for i in range(len(phase)):
        distance = line_of_sight(antenna[0], antenna[1], antenna[2], satellites[i], turned)
        ex = (turned[0] - antenna[0]) / distance
        ey = (turned[1] - antenna[1]) / distance
        ez = (turned[2] - antenna[2]) / distance
        elevation, azimuth = look_angles(lat, lon, ex, ey, ez)
        model = distance - C_LIGHT * satellites[i, CLOCK]
        if troposphere and elevation > 0.0:
            model += saastamoinen_point(lat, height, elevation, 0.7)
        if ionosphere and elevation > 0.0:
            model -= klobuchar_point(
                klobuchar[:4], klobuchar[4:], lat, lon, elevation, azimuth, tow
            )
        out[i, RESIDUAL] = phase[i] - model
        out[i, ELEVATION] = elevation
        flat = np.cos(elevation)
        out[i, EAST] = -flat * np.sin(azimuth)
        out[i, NORTH] = -flat * np.cos(azimuth)
        out[i, UP] = -np.sin(elevation)


@njit(cache=True, nogil=True)
def propagate(
    state: FloatArray, P: FloatArray, members: IntArray, walk: float, rate_variance: FloatArray,
    memory: float, dt: float,
) -> None:  # fmt: skip
    """Let the biases drift for ``dt`` seconds: a random walk, and rates that are forgotten.

    ``members`` are the slots in use, ``walk`` [m^2/s] the walk's spectral density; rates are
    first-order Gauss-Markov, of ``rate_variance`` [m^2/s^2] in each slot, correlated over
    ``memory`` [s], which ``dt`` is short of.
    """
    slots = len(rate_variance)
    keep = np.exp(-dt / memory)
    for i in members:
        state[i] += dt * state[slots + i]
        state[slots + i] *= keep
        for j in members:
            both = P[i, slots + j] + P[slots + i, j]
            P[i, j] += dt * (both + dt * P[slots + i, slots + j])
    for i in members:
        for j in members:
            P[i, slots + j] = keep * (P[i, slots + j] + dt * P[slots + i, slots + j])
    for i in members:
        for j in members:
            P[slots + j, i] = P[i, slots + j]
            P[slots + i, slots + j] *= keep * keep
        P[i, i] += walk * dt
        P[slots + i, slots + i] += rate_variance[i] * (1.0 - keep * keep)


@njit(cache=True, nogil=True)
def invert(N: FloatArray, out: FloatArray) -> bool:
    """Invert a symmetric positive definite matrix by Cholesky; False if it is not one."""
    n = len(N)
    L = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            rest = N[i, j]
            for k in range(j):
                rest -= L[i, k] * L[j, k]
            if i == j:
                if not rest > 1e-13 * N[i, i]:
                    return False
                L[i, i] = np.sqrt(rest)
            else:
                L[i, j] = rest / L[j, j]
    for c in range(n):
        for i in range(c, n):
            rest = 1.0 if i == c else 0.0
            for k in range(c, i):
                rest -= L[i, k] * out[k, c]
            out[i, c] = rest / L[i, i]
        for i in range(n - 1, c - 1, -1):
            rest = out[i, c]
            for k in range(i + 1, n):
                rest -= L[k, i] * out[k, c]
            out[i, c] = rest / L[i, i]
    for i in range(n):
        for c in range(i + 1, n):
            out[i, c] = out[c, i]
    return True


@njit(cache=True, nogil=True)
def _weights(
    P: FloatArray, slot: IntArray, A: FloatArray, R: FloatArray, C: FloatArray, G: FloatArray,
    M: FloatArray,
) -> bool:  # fmt: skip
    """Fill C, the gain G = C A' S^-1 of x, and M; False if singular (kernel)."""
    m, p = A.shape
    S, weight = np.empty((m, m)), np.empty((m, m))
    for i in range(m):
        for j in range(m):
            S[i, j] = P[slot[i], slot[j]]
        S[i, i] += R[i]
    if not invert(S, weight):
        return False
    WA, N = np.zeros((m, p)), np.zeros((p, p))
    for i in range(m):
        for a in range(p):
            for j in range(m):
                WA[i, a] += weight[i, j] * A[j, a]
    for a in range(p):
        for b in range(p):
            for i in range(m):
                N[a, b] += A[i, a] * WA[i, b]
    if not invert(N, C):
        return False
    for a in range(p):
        for i in range(m):
            G[a, i] = 0.0
            for b in range(p):
                G[a, i] += C[a, b] * WA[i, b]
    for i in range(m):
        for j in range(m):
            M[i, j] = weight[i, j]
            for a in range(p):
                M[i, j] -= WA[i, a] * G[a, j]
    return True


@njit(cache=True, nogil=True)
def fit(
    P: FloatArray, slot: IntArray, y: FloatArray, A: FloatArray, R: FloatArray,
    x: FloatArray, C: FloatArray, G: FloatArray, residual: FloatArray, normalised: FloatArray,
) -> float:  # fmt: skip
    """Solve one epoch for its free part; the state stays as it is.

    Parameters
    ----------
    P : ndarray, shape (2 slots, 2 slots)
        Covariance of biases and rates.
    slot : ndarray of int64, shape (m,)
        Slots of the satellites.
    y : ndarray, shape (m,)
        Phase residuals less biases [m].
    A : ndarray, shape (m, p)
        What the free part adds to them.
    R : ndarray, shape (m,)
        Variance of the phases' noise [m^2].
    x, C, G : ndarray, shapes (p,), (p, p), (p, m)
        Filled: solution, its covariance, and its gain.
    residual, normalised : ndarray, shape (m,)
        Filled: what the solution leaves over [m], and each satellite's outlier statistic,
        standard normal if it is none.

    Returns
    -------
    float
        Chi-square of m - p degrees of freedom; negative if there is no solution.
    """
    m, p = A.shape
    if m < p:
        return -1.0
    M = np.empty((m, m))
    if not _weights(P, slot, A, R, C, G, M):
        return -1.0
    for a in range(p):
        x[a] = 0.0
        for i in range(m):
            x[a] += G[a, i] * y[i]
    chi_square = 0.0
    for i in range(m):
        residual[i] = y[i]
        for a in range(p):
            residual[i] -= A[i, a] * x[a]
        weighted = 0.0
        for j in range(m):
            weighted += M[i, j] * y[j]
        chi_square += y[i] * weighted
        # A satellite that others do not check leaves nothing over, but for rounding.
        checked = M[i, i] * R[i] > 1e-6
        normalised[i] = weighted / np.sqrt(M[i, i]) if checked else 0.0
    return max(chi_square, 0.0)


@njit(cache=True, nogil=True)
def absorb(
    state: FloatArray, P: FloatArray, members: IntArray, slot: IntArray, y: FloatArray,
    A: FloatArray, R: FloatArray,
) -> None:  # fmt: skip
    """Let biases and rates learn from what the free part of an epoch leaves over.

    ``members`` are the slots in use; the rest is as in `fit`.
    """
    m, p = A.shape
    slots = len(state) // 2
    n = len(members)
    C, G, M = np.empty((p, p)), np.empty((p, m)), np.empty((m, m))
    if m <= p or not _weights(P, slot, A, R, C, G, M):
        return
    rows = np.empty(2 * n, np.int64)
    for k in range(n):
        rows[k], rows[n + k] = members[k], slots + members[k]
    PHt, K = np.empty((2 * n, m)), np.zeros((2 * n, m))
    for r in range(2 * n):
        for i in range(m):
            PHt[r, i] = P[rows[r], slot[i]]
    for r in range(2 * n):
        for i in range(m):
            for j in range(m):
                K[r, i] += PHt[r, j] * M[j, i]
    for r in range(2 * n):
        for i in range(m):
            state[rows[r]] += K[r, i] * y[i]
        for q in range(r + 1):
            change = 0.0
            for i in range(m):
                change += K[r, i] * PHt[q, i]
            P[rows[r], rows[q]] -= change
            P[rows[q], rows[r]] = P[rows[r], rows[q]]


@njit(cache=True, nogil=True)
def introduce(
    P: FloatArray, members: IntArray, slot: IntArray, C: FloatArray, G: FloatArray,
    new_slot: IntArray, A: FloatArray, R: FloatArray, rows: FloatArray, block: FloatArray,
) -> None:  # fmt: skip
    """Work out the covariance of biases that are set from this epoch's solution.

    A new bias is ``phase residual - A x``: its error is that of x and the phase's noise. To be
    called with the covariance P that the solution was found with.

    Parameters
    ----------
    members, slot : ndarray of int64, shapes (n,), (m,)
        Slots in use; slots of the satellites that the solution is from.
    C, G : ndarray, shapes (p, p), (p, m)
        Of `fit`.
    new_slot, A, R : ndarray, shapes (k,), (k, p), (k,)
        The new satellites.
    rows : ndarray, shape (k, 2 slots)
        Filled: covariance of each new bias with biases and rates in use.
    block : ndarray, shape (k, k)
        Filled: covariance of the new biases with each other.
    """
    slots = P.shape[0] // 2
    k, p = A.shape
    for a in range(k):
        for n in members:
            for r in (n, slots + n):
                rows[a, r] = 0.0
                for q in range(p):
                    for i in range(len(slot)):
                        rows[a, r] += A[a, q] * G[q, i] * P[slot[i], r]
        for b in range(k):
            block[a, b] = R[a] if a == b else 0.0
            for q in range(p):
                for r in range(p):
                    block[a, b] += A[a, q] * C[q, r] * A[b, r]
