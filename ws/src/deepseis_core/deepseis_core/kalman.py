"""Kalman filtering that every filter here shares: measurement update, transition, consistency.

The update has Joseph's form and leaves covariances symmetric to the bit. It knows *considered*
parameters as well (S. F. Schmidt, 1966; P. D. Groves, "Principles of GNSS, Inertial, and
Multisensor Integrated Navigation Systems", 2nd ed., section 3.4.5): constants that nobody
estimates, but whose uncertainty the covariance carries, with ``U`` the cross-covariance of the
states with them and ``B`` their own covariance.

Innovations are *prediction minus measurement*, ``z = H x + v`` with ``x`` the error of the
estimate; the error estimated, ``K z``, is taken off.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.stats import chi2

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
    n = P.shape[0]
    U, B, D = np.zeros((n, 1)), np.zeros((1, 1)), np.zeros((z.size, 1))
    S, x = np.empty((z.size, z.size)), np.empty(n)
    squared = innovation_kernel(P, U, B, H, D, R, z, S)
    if not squared >= 0.0:
        raise InputError("measurement", "has a covariance that is not positive definite")
    correct_kernel(P, U, B, H, D, R, z, S, x)
    return Correction(x, P, S, squared)


@njit(cache=True, nogil=True)
def innovation_kernel(P, U, B, H, D, R, z, S):  # type: ignore[no-untyped-def]
    """Fill the covariance ``S`` of an innovation and return its normalised square.

    ``z = H x + D c + v``, ``c`` the considered parameters. Returns -1 where S is not positive
    definite. Sizes: P (n, n), U (n, k), B (k, k), H (m, n), D (m, k), R and S (m, m), z (m,).
    """
    m = z.size
    HUD = (H @ U) @ D.T
    S[:] = (H @ P) @ H.T + HUD + HUD.T + (D @ B) @ D.T + R
    for i in range(m):
        for j in range(i):
            S[i, j] = S[j, i] = 0.5 * (S[i, j] + S[j, i])
    # Cholesky by hand: numba's raises, and m is three.
    L, y, squared = np.zeros((m, m)), np.empty(m), 0.0
    for i in range(m):
        for j in range(i + 1):
            total = S[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i > j:
                L[i, j] = total / L[j, j]
            elif total > 0.0 and total < np.inf:
                L[i, i] = np.sqrt(total)
            else:
                return -1.0
        total = z[i]
        for k in range(i):
            total -= L[i, k] * y[k]
        y[i] = total / L[i, i]
        squared += y[i] * y[i]
    return squared


@njit(cache=True, nogil=True)
def correct_kernel(P, U, B, H, D, R, z, S, x):  # type: ignore[no-untyped-def]
    """Work an innovation with covariance ``S`` into P and U, and fill the error estimated.

    Considered parameters get no gain: they stay as uncertain as they were.
    """
    n = P.shape[0]
    K = np.ascontiguousarray(np.linalg.solve(S, H @ P + D @ U.T).T)
    x[:] = K @ z
    A = -(K @ H)
    for i in range(n):
        A[i, i] += 1.0
    KD = K @ D
    AU = A @ U
    mixed = AU @ KD.T
    P[:] = (A @ P) @ A.T - mixed - mixed.T + (KD @ B) @ KD.T + (K @ R) @ K.T
    U[:] = AU - KD @ B
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
    return float(chi2.isf(false_alarm_probability, dof))


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
    low, high = (float(chi2.ppf(part, dof * count)) / count for part in (tail, 1.0 - tail))
    return low, high
