"""Growth of the errors of inertial navigation, one step at a time (numba).

Layout of states and constants: `deepseis_ins.error_state`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from deepseis_core.constants import WGS84_EARTH_RATE
from deepseis_core.rotation import Vector
from deepseis_core.types import FloatArray
from deepseis_ins.strapdown_kernels import ATTITUDE, POSITION, VELOCITY, earth_kernel

STATES = 15
MOVING = 9  # position, velocity, attitude: the states that others drive
REFERENCE = 3  # of the constants; behind it the matrices of accelerometers and gyroscopes
CONSTANTS = 21

GYRO_WALK2 = 0  # [rad^2/s]
ACCEL_WALK2 = 1  # [m^2/s^3]
BIAS_VARIANCE = 2  # of six Gauss-Markov processes [rad^2/s^2, m^2/s^4]
BIAS_RATE = 8  # inverses of their correlation times [1/s]
FORCE_REF = 14  # three: the specific force whose share of M counts as bias [m/s^2]
MODEL_SIZE = 17

_GRAVITY_FLATTENING = 0.0053024  # [-] of the gravity formula 1980: its slope along a meridian


@njit(cache=True, nogil=True)
def matrix_kernel(q: FloatArray, C: FloatArray) -> None:
    """Fill the matrix of a unit quaternion (x, y, z, w)."""
    x, y, z, w = q[0], q[1], q[2], q[3]
    C[0, 0], C[0, 1], C[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
    C[1, 0], C[1, 1], C[1, 2] = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
    C[2, 0], C[2, 1], C[2, 2] = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)


@njit(cache=True, nogil=True)
def rates_kernel(latitude: float, height: float, v: FloatArray) -> tuple[Vector, Vector, float]:
    """Return rates of the Earth and of the axes over it, n [rad/s], and gravity [m/s^2]."""
    sin_lat, cos_lat = math.sin(latitude), math.cos(latitude)
    meridian, transverse, gravity = earth_kernel(sin_lat, height)
    earth = WGS84_EARTH_RATE * cos_lat, 0.0, -WGS84_EARTH_RATE * sin_lat
    over = v[1] / transverse, -v[0] / meridian, -v[1] * sin_lat / cos_lat / transverse
    return earth, over, gravity


@njit(cache=True, nogil=True)
def _subtract_skew(F: FloatArray, row: int, column: int, w: Vector) -> None:
    """Take ``[w x]`` off a block."""
    F[row, column + 1] += w[2]
    F[row, column + 2] -= w[1]
    F[row + 1, column] -= w[2]
    F[row + 1, column + 2] += w[0]
    F[row + 2, column] += w[1]
    F[row + 2, column + 1] -= w[0]


@njit(cache=True, nogil=True)
def dynamics_kernel(F, latitude, height, v, force, C, model):  # type: ignore[no-untyped-def]
    """Fill F, shape (15, 15), of zeros.

    The rates of axes change with position and velocity; the derivatives ``earth_r``, ``over_r``,
    ``over_v`` of `rates_kernel` enter attitude directly and velocity through Coriolis.
    """
    sin_lat, cos_lat = math.sin(latitude), math.cos(latitude)
    tan_lat = sin_lat / cos_lat
    meridian, transverse, _ = earth_kernel(sin_lat, height)
    earth, over, gravity = rates_kernel(latitude, height, v)

    # Position. That of longitude is measured in metres of the parallel, which shrinks northward.
    F[0, 0], F[0, 2] = -v[2] / meridian, v[0] / meridian
    F[1, 0], F[1, 2] = v[1] * tan_lat / meridian, v[1] / transverse
    F[1, 1] = -v[2] / transverse - v[0] * tan_lat / meridian
    for k in range(3):
        F[k, 3 + k] = 1.0

    # By north and by down [1/(m s)]; the rates' change with velocity [1/m].
    earth_r = np.zeros((3, 3))
    earth_r[0, 0] = -WGS84_EARTH_RATE * sin_lat / meridian
    earth_r[2, 0] = -WGS84_EARTH_RATE * cos_lat / meridian
    over_r = np.zeros((3, 3))
    over_r[0, 2] = v[1] / transverse**2
    over_r[1, 2] = -v[0] / meridian**2
    over_r[2, 0] = -v[1] / (cos_lat * cos_lat * transverse * meridian)
    over_r[2, 2] = -v[1] * tan_lat / transverse**2
    over_v = np.zeros((3, 3))
    over_v[0, 1], over_v[1, 0] = 1.0 / transverse, -1.0 / meridian
    over_v[2, 1] = -tan_lat / transverse

    # Velocity: -(2 earth + over) x v, gravity, and the force seen in turned axes.
    for j in range(3):
        by_r0, by_r1, by_r2 = (
            2.0 * earth_r[0, j] + over_r[0, j],
            2.0 * earth_r[1, j] + over_r[1, j],
            2.0 * earth_r[2, j] + over_r[2, j],
        )
        F[3, j] = v[1] * by_r2 - v[2] * by_r1
        F[4, j] = v[2] * by_r0 - v[0] * by_r2
        F[5, j] = v[0] * by_r1 - v[1] * by_r0
        F[3, 3 + j] = v[1] * over_v[2, j] - v[2] * over_v[1, j]
        F[4, 3 + j] = v[2] * over_v[0, j] - v[0] * over_v[2, j]
        F[5, 3 + j] = v[0] * over_v[1, j] - v[1] * over_v[0, j]
    coriolis = 2.0 * earth[0] + over[0], 2.0 * earth[1] + over[1], 2.0 * earth[2] + over[2]
    _subtract_skew(F, 3, 3, coriolis)
    F[5, 0] += 2.0 * _GRAVITY_FLATTENING * gravity * sin_lat * cos_lat / meridian
    F[5, 2] += 2.0 * gravity / math.sqrt(meridian * transverse)
    _subtract_skew(F, 3, 6, (-force[0], -force[1], -force[2]))

    # Attitude.
    for i in range(3):
        for j in range(3):
            F[6 + i, j] = earth_r[i, j] + over_r[i, j]
            F[6 + i, 3 + j] = over_v[i, j]
            F[6 + i, 9 + j] = -C[i, j]
            F[3 + i, 12 + j] = C[i, j]
    inertial = earth[0] + over[0], earth[1] + over[1], earth[2] + over[2]
    _subtract_skew(F, 6, 6, inertial)
    for k in range(6):
        F[9 + k, 9 + k] = -model[BIAS_RATE + k]


@njit(cache=True, nogil=True)
def _transition(F: FloatArray, t: float, Phi: FloatArray) -> None:
    """Fill the upper nine rows, (9, 15), of ``I + F t + (F t)^2 / 2``; the rest is diagonal."""
    for i in range(MOVING):
        for j in range(STATES):
            Phi[i, j] = F[i, j] * t
        for k in range(STATES):
            factor = 0.5 * t * t * F[i, k]
            if factor != 0.0:
                for j in range(STATES):
                    Phi[i, j] += factor * F[k, j]
        Phi[i, i] += 1.0


@njit(cache=True, nogil=True)
def _drive(C, force_b, omega_b, force_n, t, G):  # type: ignore[no-untyped-def]
    """Fill what scale factors and misalignments make of nine states in a step, (9, 21)."""
    half = 0.5 * t * t
    for i in range(3):
        for j in range(3):
            column = REFERENCE + 3 * i + j
            for k in range(3):
                G[k, column] = half * C[k, i] * force_b[j]
                G[3 + k, column] = t * C[k, i] * force_b[j]
                G[6 + k, 9 + column] = -t * C[k, i] * omega_b[j]
            # The attitude they spoil turns the force already within the step: f x phi.
            a, b, c = C[0, i] * omega_b[j], C[1, i] * omega_b[j], C[2, i] * omega_b[j]
            G[3, 9 + column] = -half * (force_n[1] * c - force_n[2] * b)
            G[4, 9 + column] = -half * (force_n[2] * a - force_n[0] * c)
            G[5, 9 + column] = -half * (force_n[0] * b - force_n[1] * a)


@njit(cache=True, nogil=True)
def _add_noise(P: FloatArray, model: FloatArray, t: float) -> None:
    """Add half of a step's process noise to the diagonal."""
    half = 0.5 * t
    for k in range(3):
        P[3 + k, 3 + k] += half * model[ACCEL_WALK2]
        P[6 + k, 6 + k] += half * model[GYRO_WALK2]
    for k in range(6):
        P[9 + k, 9 + k] += t * model[BIAS_VARIANCE + k] * model[BIAS_RATE + k]


@njit(cache=True, nogil=True)
def _apply(Phi, decay, X, out):  # type: ignore[no-untyped-def]
    """Fill the product of the transition and X, shape (15, n)."""
    n = X.shape[1]
    for i in range(MOVING):
        for j in range(n):
            out[i, j] = 0.0
        for k in range(STATES):
            factor = Phi[i, k]
            if factor != 0.0:
                for j in range(n):
                    out[i, j] += factor * X[k, j]
    for i in range(MOVING, STATES):
        for j in range(n):
            out[i, j] = decay[i - MOVING] * X[i, j]


@njit(cache=True, nogil=True)
def _times_transposed(A, Phi, decay, P):  # type: ignore[no-untyped-def]
    """Fill ``P = A Phi^T``, symmetric."""
    for i in range(STATES):
        for j in range(i + 1):
            if j < MOVING:
                total = 0.0
                for k in range(STATES):
                    total += A[i, k] * Phi[j, k]
            else:
                total = decay[j - MOVING] * A[i, j]
            P[i, j] = total
            P[j, i] = total


@njit(cache=True, nogil=True)
def _consider(P, U1, B, G, U):  # type: ignore[no-untyped-def]
    """Add what the constants do: ``U = U1 + G B``, ``P += U1 G^T + G U^T``.

    The elements of the matrices are independent of each other.
    """
    width = U.shape[1]
    for i in range(STATES):
        for j in range(width):
            U[i, j] = U1[i, j]
    for i in range(MOVING):
        for k in range(REFERENCE, CONSTANTS):
            U[i, k] += G[i, k] * B[k, k]
            for j in range(REFERENCE):
                U[i, j] += G[i, k] * B[k, j]
            for j in range(CONSTANTS, width):
                U[i, j] += G[i, k] * B[k, j]
    for i in range(STATES):
        for j in range(min(i + 1, MOVING)):
            total = 0.0
            for k in range(REFERENCE, CONSTANTS):
                total += U1[i, k] * G[j, k]
            if i < MOVING:
                for k in range(REFERENCE, CONSTANTS):
                    total += G[i, k] * U[j, k]
            P[i, j] += total
            if i != j:
                P[j, i] = P[i, j]


@njit(cache=True, nogil=True)
def _carry_transition(Phi, decay, G, T):  # type: ignore[no-untyped-def]
    """Put a step behind those that led to T, shape (15, 36): ``T = [Phi 0] T + [0 G]``."""
    before = T.copy()
    _apply(Phi, decay, before, T)
    for i in range(MOVING):
        for k in range(CONSTANTS):
            T[i, STATES + k] += G[i, k]


@njit(cache=True, nogil=True)
def covariance_kernel(P, U, B, model, x, v0, q0, angle_b, gain_b, t, T):  # type: ignore[no-untyped-def]
    """Carry P, shape (15, 15), and U, shape (15, 21), over a step that led to the state ``x``.

    Columns of U and B beyond the 21 are of what else there is beside inertial navigation, as the
    clock of `deepseis_ins.tight`; its own dynamics are not applied here.

    Parameters
    ----------
    v0, q0
        Velocity and attitude at its start. What the velocity gained gives the mean force in n,
        with all turning within the step.
    angle_b, gain_b
        Sums of the increments, without biases [rad, m/s].
    t
        Length [s].
    T
        Transition of states and constants so far, shape (15, 36), carried on; or no rows.
    """
    C0, C = np.empty((3, 3)), np.empty((3, 3))
    matrix_kernel(q0, C0)
    matrix_kernel(x[ATTITUDE : ATTITUDE + 4], C)
    v, force_n = np.empty(3), np.empty(3)
    force_b, omega_b = gain_b / t, angle_b / t
    for i in range(3):
        v[i] = 0.5 * (v0[i] + x[VELOCITY + i])
        for j in range(3):
            C[i, j] = 0.5 * (C[i, j] + C0[i, j])
    latitude, height = x[POSITION], x[POSITION + 2]
    earth, over, gravity = rates_kernel(latitude, height, v)
    a, b, c = 2.0 * earth[0] + over[0], 2.0 * earth[1] + over[1], 2.0 * earth[2] + over[2]
    force_n[0] = (x[VELOCITY] - v0[0]) / t + b * v[2] - c * v[1]
    force_n[1] = (x[VELOCITY + 1] - v0[1]) / t + c * v[0] - a * v[2]
    force_n[2] = (x[VELOCITY + 2] - v0[2]) / t + a * v[1] - b * v[0] - gravity

    F, Phi, decay = np.zeros((STATES, STATES)), np.empty((MOVING, STATES)), np.empty(6)
    dynamics_kernel(F, latitude, height, v, force_n, C, model)
    _transition(F, t, Phi)
    for k in range(6):
        decay[k] = math.exp(-t * model[BIAS_RATE + k])
    G = np.zeros((MOVING, CONSTANTS))
    _drive(C, force_b - model[FORCE_REF : FORCE_REF + 3], omega_b, force_n, t, G)
    if T.shape[0] > 0:
        _carry_transition(Phi, decay, G, T)

    A, U1 = np.empty((STATES, STATES)), np.empty(U.shape)
    _add_noise(P, model, t)
    _apply(Phi, decay, P, A)
    _times_transposed(A, Phi, decay, P)
    _add_noise(P, model, t)
    _apply(Phi, decay, U, U1)
    _consider(P, U1, B, G, U)
