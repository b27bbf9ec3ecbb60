"""Least squares of one epoch: position and clock from ranges, velocity and drift from Doppler."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepseis_core.atmosphere import klobuchar_point, saastamoinen_point
from deepseis_core.constants import GPS_EARTH_RATE as EARTH_RATE
from deepseis_core.constants import SPEED_OF_LIGHT as C
from deepseis_core.ephemeris import CLOCK, CLOCK_RATE
from deepseis_core.geodesy import geodetic_point
from deepseis_core.types import FloatArray

Flags = NDArray[np.bool_]

USED, RESIDUAL, VARIANCE, ELEVATION, AZIMUTH, EX, EY, EZ = range(8)
"""Columns of ``geometry``: 1 where used; range residual [m] and its variance [m^2]; elevation and
azimuth [rad]; unit vector from the receiver to the satellite."""

MASK, SINE_ON, FLOOR_SD, IONO_ON, TROPO_ON, IONO_PART, TROPO_SD, IONO_SD = range(8)
"""Fields of ``model``: elevation mask [rad]; 1 where noise grows towards the horizon; noise
of every range [m]; switches; part of the ionosphere [-] and zenith troposphere [m] left over;
zenith ionosphere [m] that is in the ranges unknown."""


@njit(cache=True, nogil=True)
def invert_4(N: FloatArray, out: FloatArray) -> bool:
    """Invert a symmetric positive definite 4 x 4 matrix by Cholesky; False if it is not one."""
    L = np.zeros((4, 4))
    for i in range(4):
        for j in range(i + 1):
            rest = N[i, j]
            for k in range(j):
                rest -= L[i, k] * L[j, k]
            if i == j:
                if not rest > 1e-12 * N[i, i]:
                    return False
                L[i, i] = np.sqrt(rest)
            else:
                L[i, j] = rest / L[j, j]
    for c in range(4):
        for i in range(4):
            rest = 1.0 if i == c else 0.0
            for k in range(i):
                rest -= L[i, k] * out[k, c]
            out[i, c] = rest / L[i, i]
        for i in range(3, -1, -1):
            rest = out[i, c]
            for k in range(i + 1, 4):
                rest -= L[k, i] * out[k, c]
            out[i, c] = rest / L[i, i]
    return True


@njit(cache=True, nogil=True)
def line_of_sight(
    x: float, y: float, z: float, satellite: FloatArray, turned: FloatArray
) -> float:
    """Return the range at the moment of reception; fill the satellite turned with the Earth.

    ``turned`` gets position, velocity and the Earth-turn velocity ``-omega x r`` in the axes of
    the moment of reception (Sagnac effect, rigorous).
    """
    theta, distance = 0.0, 0.0
    for _ in range(3):
        cos, sin = np.cos(theta), np.sin(theta)
        turned[0] = cos * satellite[0] + sin * satellite[1]
        turned[1] = cos * satellite[1] - sin * satellite[0]
        dx, dy, dz = turned[0] - x, turned[1] - y, satellite[2] - z
        distance = np.sqrt(dx * dx + dy * dy + dz * dz)
        theta = EARTH_RATE * distance / C
    turned[2] = satellite[2]
    turned[3] = cos * satellite[3] + sin * satellite[4]
    turned[4] = cos * satellite[4] - sin * satellite[3]
    turned[5] = satellite[5]
    return distance


@njit(cache=True, nogil=True)
def look_angles(lat: float, lon: float, ex: float, ey: float, ez: float) -> tuple[float, float]:
    """Return elevation and azimuth [rad] of a unit vector at a geodetic direction."""
    sin_lat, cos_lat, sin_lon, cos_lon = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    east = cos_lon * ey - sin_lon * ex
    outward = cos_lon * ex + sin_lon * ey
    north = cos_lat * ez - sin_lat * outward
    up = cos_lat * outward + sin_lat * ez
    return np.arcsin(min(1.0, max(-1.0, up))), np.arctan2(east, north) % (2.0 * np.pi)


@njit(cache=True, nogil=True)
def form_residuals(
    state: FloatArray, satellites: FloatArray, pseudorange: FloatArray, noise: FloatArray,
    orbit_sd: FloatArray, excluded: Flags, klobuchar: FloatArray, tow: float,
    model: FloatArray, geometry: FloatArray,
) -> int:  # fmt: skip
    """Fill ``geometry`` at a position and clock; return the number of satellites used.

    Near the Earth's centre, where a search starts, there is no elevation: no mask, no atmosphere.
    """
    cold = state[0] ** 2 + state[1] ** 2 + state[2] ** 2 < 1e12
    lat, lon, height = 0.0, 0.0, 0.0
    if not cold:
        lat, lon, height = geodetic_point(state[0], state[1], state[2])
    turned = np.empty(6)
    used = 0
    for i in range(len(pseudorange)):
        distance = line_of_sight(state[0], state[1], state[2], satellites[i], turned)
        for k in range(3):
            geometry[i, EX + k] = (turned[k] - state[k]) / distance
        delay, variance = 0.0, 1.0
        elevation = 0.5 * np.pi
        if not cold:
            elevation, geometry[i, AZIMUTH] = look_angles(
                lat, lon, geometry[i, EX], geometry[i, EY], geometry[i, EZ]
            )
            sine = max(np.sin(elevation), 0.05)
            growth = 1.0 / sine if model[SINE_ON] > 0.0 else 1.0
            variance = model[FLOOR_SD] ** 2 + noise[i] ** 2 * growth + orbit_sd[i] ** 2
            if model[IONO_ON] > 0.0 and elevation > 0.0:
                iono = klobuchar_point(
                    klobuchar[:4], klobuchar[4:], lat, lon, elevation, geometry[i, AZIMUTH], tow
                )
                delay += iono
                variance += (model[IONO_PART] * iono) ** 2
            oblique = 1.0 + 16.0 * (0.53 - elevation / np.pi) ** 3
            variance += (model[IONO_SD] * oblique) ** 2
            if model[TROPO_ON] > 0.0 and elevation > 0.0:
                delay += saastamoinen_point(lat, height, elevation, 0.7)
                variance += (model[TROPO_SD] / (sine + 0.1)) ** 2
        geometry[i, ELEVATION] = elevation
        geometry[i, VARIANCE] = variance
        predicted = distance + state[3] - C * satellites[i, CLOCK] + delay
        geometry[i, RESIDUAL] = pseudorange[i] - predicted
        fit = not excluded[i] and elevation >= model[MASK]
        geometry[i, USED] = 1.0 if fit else 0.0
        used += fit
    return used


@njit(cache=True, nogil=True)
def normal_step(geometry: FloatArray, covariance: FloatArray, step: FloatArray) -> bool:
    """Solve the weighted normal equations of the satellites used; False if singular."""
    N, g = np.zeros((4, 4)), np.zeros(4)
    h = np.empty(4)
    for i in range(len(geometry)):
        if geometry[i, USED] == 0.0:
            continue
        h[0], h[1], h[2], h[3] = -geometry[i, EX], -geometry[i, EY], -geometry[i, EZ], 1.0
        weight = 1.0 / geometry[i, VARIANCE]
        for a in range(4):
            g[a] += weight * h[a] * geometry[i, RESIDUAL]
            for b in range(4):
                N[a, b] += weight * h[a] * h[b]
    if not invert_4(N, covariance):
        return False
    for a in range(4):
        step[a] = 0.0
        for b in range(4):
            step[a] += covariance[a, b] * g[b]
    return True


@njit(cache=True, nogil=True)
def solve_position(
    state: FloatArray, satellites: FloatArray, pseudorange: FloatArray, noise: FloatArray,
    orbit_sd: FloatArray, excluded: Flags, klobuchar: FloatArray, tow: float, model: FloatArray,
    geometry: FloatArray, covariance: FloatArray,
) -> int:  # fmt: skip
    """Iterate position and clock to convergence (Gauss-Newton). Returns the satellites used.

    Parameters
    ----------
    state : ndarray, shape (4,)
        Start, then solution: ECEF position and clock bias [m]. Zeros will do.
    satellites : ndarray, shape (n, 12)
        States at the moments of transmission, as of `core.ephemeris.satellite_states`.
    pseudorange, noise, orbit_sd : ndarray, shape (n,)
        Measured ranges, their code noise at the zenith, and sigma of orbit and clock [m].
    excluded : ndarray of bool, shape (n,)
        Satellites left out (their residuals are still formed).
    klobuchar, tow, model
        Ionosphere's eight parameters; GPS seconds of week; see ``MASK`` and following.
    geometry, covariance : ndarray, shapes (n, 8) and (4, 4)
        Filled at the solution.

    Returns
    -------
    int
        Satellites used; 0 if it did not converge or fewer than four remain.
    """
    step = np.empty(4)
    for _ in range(30):
        used = form_residuals(
            state, satellites, pseudorange, noise, orbit_sd,
            excluded, klobuchar, tow, model, geometry,
        )  # fmt: skip
        if used < 4 or not normal_step(geometry, covariance, step):
            return 0
        largest = 0.0
        for a in range(4):
            state[a] += step[a]
            largest = max(largest, abs(step[a]))
        if largest < 1e-4:
            return form_residuals(
                state,
                satellites,
                pseudorange,
                noise,
                orbit_sd,
                excluded,
                klobuchar,
                tow,
                model,
                geometry,
            )
    return 0


@njit(cache=True, nogil=True)
def solve_velocity(
    position: FloatArray, satellites: FloatArray, range_rate: FloatArray, variance: FloatArray,
    excluded: Flags, geometry: FloatArray, state: FloatArray, covariance: FloatArray,
    residual: FloatArray,
) -> int:  # fmt: skip
    """Solve velocity and clock drift from the rate of the pseudorange per receiver second.

    With e the unit vector to the satellite turned with the Earth (position r, velocity v,
    u = -omega x r), light time, Sagnac effect and the receiver's own second give rigorously ::

        tau' = e . (v - v_rx) / (c + e . (v - u))
        rate = c (tau' + b' - s' (1 - tau')) / (1 + b')

    Parameters are as in ``solve_position``; ``geometry`` is its result, ``state`` [m/s] the start,
    then the solution, ``residual`` [m/s] is NaN for satellites not used.
    """
    fit = np.zeros((len(range_rate), 8))
    turned = np.empty(6)
    step = np.empty(4)
    used = 0
    for _ in range(4):
        used = 0
        for i in range(len(range_rate)):
            residual[i] = np.nan
            use = geometry[i, USED] > 0.0 and not excluded[i] and np.isfinite(range_rate[i])
            fit[i, USED] = 1.0 if use else 0.0
            if not use:
                continue
            used += 1
            line_of_sight(position[0], position[1], position[2], satellites[i], turned)
            ex, ey, ez = geometry[i, EX], geometry[i, EY], geometry[i, EZ]
            e_v = ex * turned[3] + ey * turned[4] + ez * turned[5]
            e_u = EARTH_RATE * (ex * turned[1] - ey * turned[0])
            approach = e_v - (ex * state[0] + ey * state[1] + ez * state[2])
            tau_rate = approach / (C + e_v - e_u)
            bias_rate = state[3] / C
            clock = satellites[i, CLOCK_RATE] * (1.0 - tau_rate)
            predicted = C * (tau_rate + bias_rate - clock) / (1.0 + bias_rate)
            residual[i] = range_rate[i] - predicted
            fit[i, RESIDUAL] = residual[i]
            fit[i, VARIANCE] = variance[i]
            fit[i, EX], fit[i, EY], fit[i, EZ] = ex, ey, ez
        if used < 4 or not normal_step(fit, covariance, step):
            return 0
        largest = 0.0
        for a in range(4):
            state[a] += step[a]
            largest = max(largest, abs(step[a]))
        if largest < 1e-7:
            break
    return used


@njit(cache=True, nogil=True)
def dilution(geometry: FloatArray, position: FloatArray, out: FloatArray) -> bool:
    """Fill GDOP, PDOP, HDOP and VDOP of the satellites used; False if singular."""
    lat, lon, _ = geodetic_point(position[0], position[1], position[2])
    N, Q = np.zeros((4, 4)), np.zeros((4, 4))
    h = np.empty(4)
    for i in range(len(geometry)):
        if geometry[i, USED] == 0.0:
            continue
        elevation, azimuth = look_angles(
            lat, lon, geometry[i, EX], geometry[i, EY], geometry[i, EZ]
        )
        h[0] = np.cos(elevation) * np.sin(azimuth)
        h[1] = np.cos(elevation) * np.cos(azimuth)
        h[2], h[3] = np.sin(elevation), 1.0
        for a in range(4):
            for b in range(4):
                N[a, b] += h[a] * h[b]
    if not invert_4(N, Q):
        return False
    out[0] = np.sqrt(Q[0, 0] + Q[1, 1] + Q[2, 2] + Q[3, 3])
    out[1] = np.sqrt(Q[0, 0] + Q[1, 1] + Q[2, 2])
    out[2] = np.sqrt(Q[0, 0] + Q[1, 1])
    out[3] = np.sqrt(Q[2, 2])
    return True
