"""Delays of ionosphere and troposphere by the models of the broadcast message and of RTKLIB."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from deepseis_core.constants import SPEED_OF_LIGHT
from deepseis_core.types import FloatArray


@njit(cache=True, nogil=True)
def klobuchar_point(
    alpha: FloatArray,
    beta: FloatArray,
    latitude: float,
    longitude: float,
    elevation: float,
    azimuth: float,
    tow: float,
) -> float:
    """Return one delay of `klobuchar_delay` (kernel)."""
    el = elevation / math.pi
    psi = 0.0137 / (el + 0.11) - 0.022
    phi = latitude / math.pi + psi * math.cos(azimuth)
    phi = min(max(phi, -0.416), 0.416)
    lam = longitude / math.pi + psi * math.sin(azimuth) / math.cos(phi * math.pi)
    phi += 0.064 * math.cos((lam - 1.617) * math.pi)
    local = (43200.0 * lam + tow) % 86400.0
    amplitude = alpha[0] + phi * (alpha[1] + phi * (alpha[2] + phi * alpha[3]))
    period = beta[0] + phi * (beta[1] + phi * (beta[2] + phi * beta[3]))
    x = 2.0 * math.pi * (local - 50400.0) / max(period, 72000.0)
    delay = 5e-9
    if abs(x) < 1.57:
        delay += max(amplitude, 0.0) * (1.0 + x * x * (-0.5 + x * x / 24.0))
    return SPEED_OF_LIGHT * (1.0 + 16.0 * (0.53 - el) ** 3) * delay


@njit(cache=True, nogil=True)
def saastamoinen_point(latitude: float, height: float, elevation: float, humidity: float) -> float:
    """Return one delay of `saastamoinen_delay` (kernel)."""
    if height < -100.0 or height > 1e4 or elevation <= 0.0:
        return 0.0
    h = max(height, 0.0)
    pressure = 1013.25 * (1.0 - 2.2557e-5 * h) ** 5.2568
    kelvin = 15.0 - 6.5e-3 * h + 273.16
    vapour = 6.108 * humidity * math.exp((17.15 * kelvin - 4684.0) / (kelvin - 38.45))
    dry = 0.0022768 * pressure / (1.0 - 0.00266 * math.cos(2.0 * latitude) - 0.00028 * h / 1e3)
    wet = 0.002277 * (1255.0 / kelvin + 0.05) * vapour
    return (dry + wet) / math.sin(elevation)


@njit(cache=True, nogil=True)
def klobuchar_delay(
    alpha: FloatArray,
    beta: FloatArray,
    latitude: float,
    longitude: float,
    elevation: FloatArray,
    azimuth: FloatArray,
    tow: float,
) -> FloatArray:
    """Return the ionosphere's delay of the L1 code (kernel).

    Parameters
    ----------
    alpha, beta : ndarray, shape (4,)
        Broadcast parameters [s, s/semicircle, ...].
    latitude, longitude : float
        Of the receiver [rad].
    elevation, azimuth : ndarray, shape (n,)
        Of the satellites [rad].
    tow : float
        GPS time of week [s].

    Returns
    -------
    ndarray, shape (n,)
        [m], positive: the code is late and the carrier early by this much.

    References
    ----------
    IS-GPS-200, figure 20-4.
    """
    out = np.empty(elevation.shape[0])
    for i in range(elevation.shape[0]):
        out[i] = klobuchar_point(alpha, beta, latitude, longitude, elevation[i], azimuth[i], tow)
    return out


@njit(cache=True, nogil=True)
def saastamoinen_delay(
    latitude: float, height: float, elevation: FloatArray, humidity: float = 0.7
) -> FloatArray:
    """Return the troposphere's delay in the standard atmosphere (kernel).

    Parameters
    ----------
    latitude, height : float
        Of the receiver [rad], above the ellipsoid [m].
    elevation : ndarray, shape (n,)
        Of the satellites [rad].
    humidity : float, optional
        Relative, 0 to 1.

    Returns
    -------
    ndarray, shape (n,)
        [m]; zero below the horizon, and below -100 m or above 10 km, where the model has no say.

    References
    ----------
    Saastamoinen (1972) with the mapping 1/sin(elevation), as RTKLIB's ``tropmodel`` has it.
    """
    out = np.empty(elevation.shape[0])
    for i in range(elevation.shape[0]):
        out[i] = saastamoinen_point(latitude, height, elevation[i], humidity)
    return out
