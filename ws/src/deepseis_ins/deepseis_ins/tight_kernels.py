"""Ranges and range rates against inertial navigation: rows, gates, updates (numba).

States in the order in which they are worked on: the 15 of `deepseis_ins.error_state`, clock bias
and drift, the error of the reference attitude; behind them what is considered.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from deepseis_core.atmosphere import klobuchar_point, saastamoinen_point
from deepseis_core.constants import GPS_EARTH_RATE
from deepseis_core.constants import SPEED_OF_LIGHT as C
from deepseis_core.ephemeris import CLOCK, CLOCK_RATE
from deepseis_core.kalman import correct_kernel, innovation_kernel
from deepseis_core.propagation import LOS_COLUMNS, geometry_kernel
from deepseis_core.types import FloatArray
from deepseis_ins.error_state_kernels import CONSTANTS, STATES
from deepseis_ins.measurement_kernels import (
    ned_from_ecef_kernel,
    position_kernel,
    velocity_kernel,
)
from deepseis_ins.strapdown_kernels import ATTITUDE, DELTA_THETA, POSITION, VELOCITY

BIAS, DRIFT = STATES, STATES + 1  # of the receiver's clock, as an error to be estimated
TIGHT_STATES = STATES + 2
ESTIMATED = TIGHT_STATES + 3
JOINED = TIGHT_STATES + CONSTANTS

TOW = 8  # behind the eight parameters of the ionosphere
IONOSPHERE_ON = 9
TROPOSPHERE_ON = 10
AIR_SIZE = 11


@njit(cache=True, nogil=True)
def antenna_kernel(x, omega, lever_b, rate_sd, receiver, H_r, H_v, R_v):  # type: ignore[no-untyped-def]
    """Fill where the antenna is and how it moves, ECEF, shape (9,), and what that depends on.

    ``H_r`` and ``H_v``, shapes (3, 15), are of position and velocity north, east, down; ``R_v``
    is what the noise of ``omega`` makes of the velocity.
    """
    latitude, longitude, height = x[POSITION], x[POSITION + 1], x[POSITION + 2]
    quat, nothing, none = x[ATTITUDE:DELTA_THETA], np.zeros(3), np.zeros((3, 3))
    position, velocity, R = np.empty(3), np.empty(3), np.empty((3, 3))
    position_kernel(latitude, longitude, height, quat, lever_b, nothing, none, position, H_r, R)
    velocity_kernel(
        latitude, longitude, x[VELOCITY:ATTITUDE], quat, omega, lever_b, nothing, none, rate_sd,
        velocity, H_v, R_v,
    )  # fmt: skip
    C_ne = ned_from_ecef_kernel(latitude, longitude)
    receiver[0:3] = C_ne.T @ position
    receiver[3:6] = C_ne.T @ velocity
    receiver[6:9] = 0.0


@njit(cache=True, nogil=True)
def _flight(satellite: FloatArray, receiver: FloatArray, los: FloatArray) -> None:
    """Fill the line of sight to a satellite whose state at departure is known."""
    delay = 0.075
    for _ in range(3):  # the Earth turns on by 1e-6 of the range: each pass gains six digits
        geometry_kernel(satellite, delay, receiver, los)
        delay = los[0] / C


@njit(cache=True, nogil=True)
def _air(air, latitude, longitude, height, e_n):  # type: ignore[no-untyped-def]
    """Return the code's delay by ionosphere and troposphere [m]."""
    elevation = math.asin(min(1.0, max(-1.0, e_n[2])))
    delay = 0.0
    if elevation > 0.0:
        if air[IONOSPHERE_ON] > 0.0:
            azimuth = math.atan2(-e_n[1], -e_n[0])
            delay += klobuchar_point(
                air[0:4], air[4:8], latitude, longitude, elevation, azimuth, air[TOW]
            )
        if air[TROPOSPHERE_ON] > 0.0:
            delay += saastamoinen_point(latitude, height, elevation, 0.7)
    return delay


@njit(cache=True, nogil=True)
def rows_kernel(  # type: ignore[no-untyped-def]
    x, omega, lever_b, rate_sd, clock, satellites, pseudorange, range_rate, variance, air, z, H, R
):
    """Fill the rows of n satellites: ranges, then range rates; NaN in z where there is none.

    With e from satellite to receiver, tau' the derivative of the time of flight by the time of
    reception, b and b' clock bias and drift, s and s' the satellite's clock [s, s/s]::

        P = range + b - c s + air
        dP/dt = c (tau' + b'/c - s' (1 - tau')) / (1 + b'/c)

    Parameters
    ----------
    x, omega
        State of the mechanisation and angular rate without bias.
    clock
        Bias and drift, shape (2,) [m, m/s].
    satellites
        At departure, shape (n, 12).
    pseudorange, range_rate
        Shape (n,) [m, m/s].
    variance
        Of both, shape (2 n,) [m^2, m^2/s^2].
    air
        Shape (11,), see the offsets.
    z, H, R
        Shapes (2 n,), (2 n, 17), (2 n,).
    """
    n, receiver, los = len(pseudorange), np.empty(9), np.zeros(LOS_COLUMNS)
    H_r, H_v, R_v = np.zeros((3, STATES)), np.zeros((3, STATES)), np.empty((3, 3))
    antenna_kernel(x, omega, lever_b, rate_sd, receiver, H_r, H_v, R_v)
    C_ne = ned_from_ecef_kernel(x[POSITION], x[POSITION + 1])
    H[:] = 0.0
    for i in range(n):
        satellite = satellites[i]
        _flight(satellite, receiver, los)
        e = los[3:6]
        e_n = C_ne @ e
        tau_rate, clock_rate = los[1] / C, satellite[CLOCK_RATE]
        delay = _air(air, x[POSITION], x[POSITION + 1], x[POSITION + 2], e_n)
        z[i] = los[0] + clock[0] - C * satellite[CLOCK] + delay - pseudorange[i]
        fast = 1.0 + clock[1] / C
        seen = C * (tau_rate - clock_rate * (1.0 - tau_rate)) + clock[1]
        z[n + i] = seen / fast - range_rate[i]

        # The line of sight turns with the position: the velocity across it over the range.
        theta = GPS_EARTH_RATE * los[0] / C
        sin, cos = math.sin(theta), math.cos(theta)
        across = np.array(
            [
                receiver[3] - cos * satellite[3] - sin * satellite[4],
                receiver[4] - cos * satellite[4] + sin * satellite[3],
                receiver[5] - satellite[5],
            ]
        )
        across -= (across @ e) * e
        turning = (C_ne @ across) / los[0]
        for k in range(STATES):
            for m in range(3):
                H[i, k] += e_n[m] * H_r[m, k]
                H[n + i, k] += e_n[m] * H_v[m, k] + turning[m] * H_r[m, k]
        H[i, BIAS], H[n + i, DRIFT] = 1.0, 1.0
        R[i], R[n + i] = variance[i], variance[n + i] + e_n @ R_v @ e_n


@njit(cache=True, nogil=True)
def clock_kernel(P, U, B, t, bias_noise, drift_noise):  # type: ignore[no-untyped-def]
    """Carry the clock's columns, the last two, over t seconds: ``db/dt = b' + w``.

    However the covariance went in steps meanwhile, one for the clock at their end is exact: its
    transition multiplies U and B from the other side.
    """
    first = CONSTANTS
    for i in range(U.shape[0]):
        U[i, first] += t * U[i, first + 1]
    for i in range(first):
        B[i, first] += t * B[i, first + 1]
        B[first, i], B[first + 1, i] = B[i, first], B[i, first + 1]
    rate = B[first + 1, first + 1]
    q_b, q_d = bias_noise * bias_noise, drift_noise * drift_noise
    both = B[first, first + 1] + t * rate + q_d * t * t / 2.0
    B[first, first] += t * (2.0 * B[first, first + 1] + t * rate) + q_b * t + q_d * t**3 / 3.0
    B[first, first + 1], B[first + 1, first] = both, both
    B[first + 1, first + 1] += q_d * t


@njit(cache=True, nogil=True)
def _place(k: int) -> int:
    """Return where column k of U and B stands in the joined covariance."""
    return TIGHT_STATES + k if k < CONSTANTS else STATES + k - CONSTANTS


@njit(cache=True, nogil=True)
def join_kernel(P, U, B, J):  # type: ignore[no-untyped-def]
    """Fill the joined covariance, shape (38, 38)."""
    J[:STATES, :STATES] = P
    for k in range(U.shape[1]):
        for i in range(STATES):
            J[i, _place(k)] = U[i, k]
            J[_place(k), i] = U[i, k]
        for j in range(U.shape[1]):
            J[_place(k), _place(j)] = B[k, j]


@njit(cache=True, nogil=True)
def part_kernel(J, P, U, B):  # type: ignore[no-untyped-def]
    """Undo `join_kernel`."""
    P[:] = J[:STATES, :STATES]
    for k in range(U.shape[1]):
        for i in range(STATES):
            U[i, k] = J[i, _place(k)]
        for j in range(U.shape[1]):
            B[k, j] = J[_place(k), _place(j)]


@njit(cache=True, nogil=True)
def _prediction(J, H, R, x, z, i):  # type: ignore[no-untyped-def]
    """Return innovation and variance of row i, after what is estimated already."""
    rest, total = z[i], R[i]
    for k in range(TIGHT_STATES):
        a = H[i, k]
        if a != 0.0:
            rest -= a * x[k]
            for m in range(TIGHT_STATES):
                total += a * J[k, m] * H[i, m]
    return rest, total


@njit(cache=True, nogil=True)
def update_kernel(J, z, H, R, limit, x, sd, squared, accepted):  # type: ignore[no-untyped-def]
    """Work the rows in one by one, the one that agrees best first, while they pass the gate.

    So an outlier is judged by what the good ones left of the uncertainty. The order does not
    matter to the result: errors of the rows are independent, and the sum of ``squared`` over the
    rows accepted is the normalised square of all of them together.

    Parameters
    ----------
    J
        Joined covariance; updated.
    limit
        Of a row's normalised square.
    x
        Filled with the error estimated, shape (38,).
    sd, squared, accepted
        Filled, a row each: sigma of the innovation before any of them; its normalised square when
        its turn came; whether it was used. NaN and False where z is NaN.
    """
    rows, n = len(z), J.shape[0]
    open_ = np.isfinite(z)
    step, PHt, S = np.empty(n), np.empty((n, 1)), np.empty((1, 1))
    row, noise, rest = np.zeros((1, n)), np.empty((1, 1)), np.empty(1)
    x[:] = 0.0
    for i in range(rows):
        accepted[i], squared[i], sd[i] = False, np.nan, np.nan
        if open_[i]:
            sd[i] = math.sqrt(_prediction(J, H, R, x, z, i)[1])
    for _ in range(rows):
        best = -1
        for i in range(rows):
            if open_[i]:
                innovation, total = _prediction(J, H, R, x, z, i)
                squared[i] = innovation * innovation / total
                if best < 0 or squared[i] < squared[best]:
                    best = i
        if best < 0 or not squared[best] <= limit:
            break
        open_[best] = False
        accepted[best] = True
        rest[0] = _prediction(J, H, R, x, z, best)[0]
        row[0, :TIGHT_STATES], noise[0, 0] = H[best], R[best]
        innovation_kernel(J, row, noise, rest, PHt, S)
        correct_kernel(J, row, noise, rest, PHt, S, ESTIMATED, step)
        x += step
