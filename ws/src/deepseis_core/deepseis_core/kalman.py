"""Kalman filtering that every filter here shares: measurement update, transition, consistency.

The update has Joseph's form and leaves covariances symmetric to the bit. It knows *considered*
parameters as well (S. F. Schmidt, 1966; P. D. Groves, "Principles of GNSS, Inertial, and
Multisensor Integrated Navigation Systems", 2nd ed., section 3.4.5): constants that stand at the
end of the state, get no gain, but whose uncertainty the covariance carries.

Innovations are *prediction minus measurement*, ``z = H x + v`` with ``x`` the error of the
estimate; the error estimated, ``K z``, is taken off.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.special import chdtri, gammaincinv

from deepseis_core.errors import InputError
from deepseis_core.types import FloatArray


@dataclass(frozen=True)
class Correction:
    """What a measurement says about n states.

    Attributes
    ----------
    x : ndarray, shape (n,)
        Estimated error of the states before the measurement.
    P : ndarray, shape (n, n)
        Covariance after it.
    S : ndarray, shape (m, m)
        Covariance of the innovation.
    normalised_squared : float
        ``z S^-1 z``; chi-square with m degrees of freedom if all is as modelled.
    """

    x: FloatArray
    P: FloatArray
    S: FloatArray
    normalised_squared: float


def update(P: FloatArray, H: FloatArray, R: FloatArray, z: FloatArray) -> Correction:
    """Work a measurement of m values in; nothing is considered.

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Covariance of the states' errors.
    H : ndarray, shape (m, n)
    R : ndarray, shape (m, m)
        Covariance of the measurement.
    z : ndarray, shape (m,)
        Prediction minus measurement.

    Raises
    ------
    InputError
        The innovation's covariance is not positive definite.

    Examples
    --------
    Two measurements of the same quality meet half-way:

    >>> update(np.eye(1), np.eye(1), np.eye(1), np.array([0.8])).x
    array([0.4])
    """
    P, H = np.array(P, np.float64), np.ascontiguousarray(H, np.float64)
    R, z = np.ascontiguousarray(R, np.float64), np.ascontiguousarray(z, np.float64)
    if not np.isfinite(z).all():
        raise InputError("measurement", "is not finite")
    PHt, S = np.empty((P.shape[0], z.size)), np.empty((z.size, z.size))
    squared = innovation_kernel(P, H, R, z, PHt, S)
    if not squared >= 0.0:
        raise InputError("measurement", "has a covariance that is not positive definite")
    x = np.zeros(P.shape[0])
    correct_kernel(P, H, R, z, PHt, S, P.shape[0], x)
    return Correction(x, P, S, squared)


@njit(cache=True, nogil=True)
def _cholesky(S: FloatArray, L: FloatArray) -> bool:
    """Fill the lower root of S; False where S is not positive definite."""
    for i in range(S.shape[0]):
        for j in range(i + 1):
            total = S[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i > j:
                L[i, j] = total / L[j, j]
            elif total > 0.0 and total < np.inf:
                L[i, i] = np.sqrt(total)
            else:
                return False
    return True


@njit(cache=True, nogil=True)
def innovation_kernel(P, H, R, z, PHt, S):  # type: ignore[no-untyped-def]
    """Fill ``P H^T``, (n, m), and ``S = H P H^T + R``; return the normalised square of z.

    It is -1 where S is not positive definite.
    """
    n, m = P.shape[0], z.size
    PHt[:] = 0.0
    for j in range(m):
        for k in range(n):
            factor = H[j, k]
            if factor != 0.0:
                for i in range(n):
                    PHt[i, j] += P[k, i] * factor
    for i in range(m):
        for j in range(i + 1):
            total = 0.5 * (R[i, j] + R[j, i])
            for k in range(n):
                total += H[i, k] * PHt[k, j]
            S[i, j] = total
            S[j, i] = total
    L, y, squared = np.zeros((m, m)), np.empty(m), 0.0
    if not _cholesky(S, L):
        return -1.0
    for i in range(m):
        total = z[i]
        for k in range(i):
            total -= L[i, k] * y[k]
        y[i] = total / L[i, i]
        squared += y[i] * y[i]
    return squared


@njit(cache=True, nogil=True)
def _gain(PHt, S, estimated, K):  # type: ignore[no-untyped-def]
    """Fill ``K = P H^T S^-1`` for the first states and zero for those considered."""
    m = S.shape[0]
    L = np.zeros((m, m))
    _cholesky(S, L)
    K[:] = 0.0
    for row in range(estimated):
        for i in range(m):
            total = PHt[row, i]
            for k in range(i):
                total -= L[i, k] * K[row, k]
            K[row, i] = total / L[i, i]
        for i in range(m - 1, -1, -1):
            total = K[row, i]
            for k in range(i + 1, m):
                total -= L[k, i] * K[row, k]
            K[row, i] = total / L[i, i]


@njit(cache=True, nogil=True)
def correct_kernel(P, H, R, z, PHt, S, estimated, x):  # type: ignore[no-untyped-def]
    """Work an innovation into P and fill the error estimated.

    Joseph's form for any gain, ``P <- (I - K H) P (I - K H)^T + K R K^T``, without its products
    of full matrices: with ``X = P - K (P H^T)^T`` it is ``X - (X H^T - K R) K^T``.

    Parameters
    ----------
    P, H, R, z
        Of `innovation_kernel`, as are PHt and S, which it filled.
    estimated
        How many states get a gain; those after them are considered.
    """
    n, m = P.shape[0], z.size
    K, rest = np.empty((n, m)), np.empty((n, m))
    _gain(PHt, S, estimated, K)
    for i in range(n):
        x[i] = 0.0
        for k in range(m):
            x[i] += K[i, k] * z[k]
            factor = K[i, k]
            if factor != 0.0:
                for j in range(n):
                    P[i, j] -= factor * PHt[j, k]
    for i in range(n):
        for k in range(m):
            total = 0.0
            for j in range(n):
                total += P[i, j] * H[k, j]
            for j in range(m):
                total -= 0.5 * K[i, j] * (R[j, k] + R[k, j])
            rest[i, k] = total
    for i in range(n):
        for k in range(m):
            for j in range(estimated):
                P[i, j] -= rest[i, k] * K[j, k]
    symmetrise_kernel(P)


@njit(cache=True, nogil=True)
def symmetrise_kernel(P: FloatArray) -> None:
    """Make a covariance symmetric to the bit."""
    for i in range(P.shape[0]):
        for j in range(i):
            mean = 0.5 * (P[i, j] + P[j, i])
            P[i, j] = mean
            P[j, i] = mean


def discretise(F: FloatArray, Q: FloatArray, dt: float) -> tuple[FloatArray, FloatArray]:
    """Return transition matrix and process noise of an interval, exact to second order in it.

    The noise is ``dt (Phi Q Phi^T + Q) / 2``, the trapezium of its integral.

    Parameters
    ----------
    F : ndarray, shape (n, n)
        ``dx/dt = F x + w`` [1/s].
    Q : ndarray, shape (n, n)
        Power spectral density of w, two-sided.
    dt : float
        [s]
    """
    Fdt = np.asarray(F, np.float64) * dt
    Phi = np.eye(Fdt.shape[0]) + Fdt + 0.5 * Fdt @ Fdt
    return Phi, 0.5 * dt * (Phi @ Q @ Phi.T + Q)


# Consistency


def chi_square_limit(dof: int, false_alarm_probability: float) -> float:
    """Return what a chi-square of so many degrees of freedom exceeds with the probability."""
    return float(chdtri(dof, false_alarm_probability))


def chi_square_band(dof: int, count: int, probability: float = 0.95) -> tuple[float, float]:
    """Return the limits of the mean of independent chi-squares, each tail alike.

    Parameters
    ----------
    dof : int
        Degrees of freedom of each, which is its expectation.
    count : int
        How many are averaged.
    probability : float
        That the mean lies between the limits.

    Examples
    --------
    >>> [round(limit, 3) for limit in chi_square_band(3, 100)]
    [2.539, 3.499]
    """
    tail = 0.5 * (1.0 - probability)
    parts, freedom = (tail, 1.0 - tail), dof * count
    low, high = (2.0 * float(gammaincinv(freedom / 2.0, part)) / count for part in parts)
    return low, high
