"""WGS-84: geodetic and Earth-centred coordinates, local axes, radii of curvature, gravity.

Latitude and longitude in radians, heights in metres above the ellipsoid. ``C_ab`` projects from
axes ``b`` to axes ``a``: ``e`` ECEF, ``enu`` east-north-up, ``n`` north-east-down.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from deepseis_core.constants import (
    WGS84_A,
    WGS84_B,
    WGS84_E2,
    WGS84_EARTH_RATE,
    WGS84_F,
    WGS84_GM,
    WGS84_GRAVITY_EQUATOR,
    WGS84_GRAVITY_POLE,
)
from deepseis_core.errors import InputError
from deepseis_core.types import FloatArray

_SOMIGLIANA_K = WGS84_B * WGS84_GRAVITY_POLE / (WGS84_A * WGS84_GRAVITY_EQUATOR) - 1.0
_GRAVITY_M = WGS84_EARTH_RATE**2 * WGS84_A**2 * WGS84_B / WGS84_GM


@njit(cache=True, nogil=True)
def geodetic_point(x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return latitude, longitude and height of one ECEF point (kernel)."""
    p = math.hypot(x, y)
    # Bowring's formula: its error after one pass is below 1e-9 rad outside the deep interior
    # and shrinks a thousandfold or more with every further pass.
    u = math.atan2(z, p * (1.0 - WGS84_F))
    lat = 0.0
    for _ in range(4):
        lat = math.atan2(
            z + WGS84_E2 / (1.0 - WGS84_E2) * WGS84_B * math.sin(u) ** 3,
            p - WGS84_E2 * WGS84_A * math.cos(u) ** 3,
        )
        u = math.atan2((1.0 - WGS84_F) * math.sin(lat), math.cos(lat))
    sin_lat = math.sin(lat)
    # This form of the height keeps its precision at the poles and at the equator.
    height = p * math.cos(lat) + z * sin_lat - WGS84_A * math.sqrt(1.0 - WGS84_E2 * sin_lat**2)
    return lat, math.atan2(y, x), height


@njit(cache=True, nogil=True)
def _geodetic_points(points: FloatArray, out: FloatArray) -> None:
    for i in range(points.shape[0]):
        lat, lon, height = geodetic_point(points[i, 0], points[i, 1], points[i, 2])
        out[i, 0] = lat
        out[i, 1] = lon
        out[i, 2] = height


def geodetic_from_ecef(position_ecef: ArrayLike) -> FloatArray:
    """Convert ECEF to geodetic coordinates.

    Parameters
    ----------
    position_ecef : array_like, shape (..., 3)
        ECEF [m], farther than 1000 km from the centre.

    Returns
    -------
    ndarray, shape (..., 3)
        Latitude [rad], longitude [rad], height [m]; within 1e-8 m.
    """
    position = np.ascontiguousarray(position_ecef, np.float64)
    out = np.empty_like(position)
    _geodetic_points(position.reshape(-1, 3), out.reshape(-1, 3))
    return out


def ecef_from_geodetic(geodetic: ArrayLike) -> FloatArray:
    """Convert geodetic coordinates to ECEF.

    Parameters
    ----------
    geodetic : array_like, shape (..., 3)
        Latitude [rad], longitude [rad], height [m].

    Returns
    -------
    ndarray, shape (..., 3)
        ECEF [m].
    """
    lat, lon, height = np.moveaxis(np.asarray(geodetic, np.float64), -1, 0)
    radius = transverse_radius(lat)
    p = (radius + height) * np.cos(lat)
    z = (radius * (1.0 - WGS84_E2) + height) * np.sin(lat)
    return np.stack([p * np.cos(lon), p * np.sin(lon), z], axis=-1)


def rotation_enu_ecef(latitude: ArrayLike, longitude: ArrayLike) -> FloatArray:
    """Return ``C_enu_e``: ECEF components to east, north, up.

    Parameters
    ----------
    latitude, longitude : array_like, shape (...)
        Of the origin [rad].

    Returns
    -------
    ndarray, shape (..., 3, 3)
    """
    lat, lon = np.broadcast_arrays(
        np.asarray(latitude, np.float64), np.asarray(longitude, np.float64)
    )
    sin_lat, cos_lat, sin_lon, cos_lon = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    east = np.stack([-sin_lon, cos_lon, np.zeros_like(lat)], axis=-1)
    north = np.stack([-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat], axis=-1)
    up = np.stack([cos_lat * cos_lon, cos_lat * sin_lon, sin_lat], axis=-1)
    return np.stack([east, north, up], axis=-2)


def rotation_ned_ecef(latitude: ArrayLike, longitude: ArrayLike) -> FloatArray:
    """Return ``C_ne``: ECEF components to north, east, down; arguments of `rotation_enu_ecef`."""
    enu = rotation_enu_ecef(latitude, longitude)
    return np.stack([enu[..., 1, :], enu[..., 0, :], -enu[..., 2, :]], axis=-2)


def enu_from_ecef(position_ecef: ArrayLike, origin_ecef: ArrayLike) -> FloatArray:
    """Return east, north, up [m] of points about an origin.

    Parameters
    ----------
    position_ecef : array_like, shape (..., 3)
        ECEF [m].
    origin_ecef : array_like, shape (3,)
        ECEF [m].

    Returns
    -------
    ndarray, shape (..., 3)
    """
    origin = np.asarray(origin_ecef, np.float64)
    lat, lon, _ = geodetic_from_ecef(origin)
    return (np.asarray(position_ecef, np.float64) - origin) @ rotation_enu_ecef(lat, lon).T


def ecef_from_enu(enu: ArrayLike, origin_ecef: ArrayLike) -> FloatArray:
    """Return ECEF [m] of points given east, north, up [m] of an origin; inverse of the above."""
    origin = np.asarray(origin_ecef, np.float64)
    lat, lon, _ = geodetic_from_ecef(origin)
    return origin + np.asarray(enu, np.float64) @ rotation_enu_ecef(lat, lon)


def meridian_radius(latitude: ArrayLike) -> FloatArray:
    """Return the meridian radius of curvature R_M [m], ``a (1-e^2) / (1-e^2 sin^2)^(3/2)``."""
    sin_lat = np.sin(np.asarray(latitude, np.float64))
    return WGS84_A * (1.0 - WGS84_E2) / (1.0 - WGS84_E2 * sin_lat**2) ** 1.5


def transverse_radius(latitude: ArrayLike) -> FloatArray:
    """Return the radius of curvature in the prime vertical R_N [m], ``a / sqrt(1-e^2 sin^2)``."""
    sin_lat = np.sin(np.asarray(latitude, np.float64))
    return WGS84_A / np.sqrt(1.0 - WGS84_E2 * sin_lat**2)


def normal_gravity(latitude: ArrayLike, height: ArrayLike = 0.0) -> FloatArray:
    """Return normal gravity [m/s^2], centrifugal part included, positive down.

    Somigliana's closed formula on the ellipsoid and its expansion to second order in height::

        gamma_0 = gamma_e (1 + k sin^2) / sqrt(1 - e^2 sin^2)
        gamma_h = gamma_0 (1 - 2/a (1 + f + m - 2 f sin^2) h + 3 h^2/a^2)

    Parameters
    ----------
    latitude : array_like
        Geodetic [rad].
    height : array_like, optional
        Above the ellipsoid [m]; the expansion is good to 1e-6 m/s^2 below 10 km.

    References
    ----------
    NGA.STND.0036, equations 4-1 and 4-3.
    """
    sin2 = np.sin(np.asarray(latitude, np.float64)) ** 2
    h = np.asarray(height, np.float64)
    surface = WGS84_GRAVITY_EQUATOR * (1.0 + _SOMIGLIANA_K * sin2) / np.sqrt(1.0 - WGS84_E2 * sin2)
    slope = 2.0 / WGS84_A * (1.0 + WGS84_F + _GRAVITY_M - 2.0 * WGS84_F * sin2)
    return surface * (1.0 - slope * h + 3.0 * h**2 / WGS84_A**2)


def ecef_from_text(text: str) -> list[float]:
    """Read 'latitude longitude height' [deg deg m] as ECEF [m].

    Raises
    ------
    InputError
        There are not three numbers, or they are out of range.

    Examples
    --------
    >>> [round(x) for x in ecef_from_text("0 90 100")]
    [0, 6378237, 0]
    """
    hint = "such as '35.681298 139.766247 10'"
    try:
        lat, lon, height = (float(part) for part in text.replace(",", " ").split())
    except ValueError:
        raise InputError(f"position {text!r}", "is not three numbers", hint) from None
    if not (abs(lat) <= 90.0 and abs(lon) <= 360.0 and abs(height) < 1e5):
        raise InputError(f"position {text!r}", "is out of range", hint)
    geodetic = np.array([np.radians(lat), np.radians(lon), height])
    return [float(value) for value in ecef_from_geodetic(geodetic)]
