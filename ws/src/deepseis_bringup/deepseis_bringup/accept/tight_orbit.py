"""An ephemeris that reproduces satellite positions and clocks of a recording without one.

Receivers log positions computed from the broadcast; the fifteen parameters of the orbit and two
of the clock come back by least squares. They need not be those that were sent.
"""

from __future__ import annotations

import numpy as np

from deepseis_core.constants import GPS_EARTH_RATE, GPS_GM
from deepseis_core.ephemeris import PACKED_COLUMNS, POSITION, pack, satellite_states
from deepseis_core.errors import InputError
from deepseis_core.types import Ephemeris, FloatArray

_STEPS = np.array(
    [0.1, 1e-5, 1e-6, 1e-6, 1e-4, 1e-4, 1e-10, 1e-10, 1e-10, 1e-7, 1e-7, 10, 10, 1e-8, 1e-8]
)
_NAMES = (
    *("sqrt_a", "eccentricity", "i0", "omega0", "omega", "m0", "delta_n", "omega_dot", "i_dot"),
    *("cuc", "cus", "crc", "crs", "cic", "cis"),
)
FITTED = 200
"""Moments that take part in a fit, at most."""
PASSES = 8
"""Of Gauss and Newton."""


def ephemeris_of(
    satellite: str,
    week: int,
    tow: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    clock: FloatArray,
    *,
    tgd: float = 0.0,
) -> tuple[Ephemeris, float]:
    """Fit an ephemeris; return it and the RMS of what is left of positions [m].

    Parameters
    ----------
    satellite : str
    week : int
    tow : ndarray, shape (m,)
        GPS time when the signals left [s of week].
    position, velocity : ndarray, shape (m, 3)
        Then, in the ECEF axes of then; the velocity is where the search starts [m, m/s].
    clock : ndarray, shape (m,)
        Ahead of GPS time, without relativity and TGD: the broadcast polynomial [s].
    tgd : float, optional
        To be taken off it [s].

    Raises
    ------
    InputError
        Fewer than 30 moments.
    """
    if len(tow) < 30:
        raise InputError(f"orbit of {satellite}", f"is known at {len(tow)} moments", "30 or more")
    middle = int(np.argmin(np.abs(tow - np.mean(tow))))
    toe = float(16.0 * np.round(tow[middle] / 16.0))
    chosen = np.unique(np.linspace(0, len(tow) - 1, FITTED).astype(np.int64))
    start = _kepler(position[middle], velocity[middle], tow[middle], toe)

    def made(step: FloatArray) -> Ephemeris:
        values = dict(zip(_NAMES, (start + step * _STEPS).tolist(), strict=True))
        return Ephemeris(satellite, week, toe, toe, 0.0, 0.0, 0.0, 0.0, **values)

    def misfit(step: FloatArray) -> FloatArray:
        states = _states(made(step), tow[chosen])
        return (states[:, POSITION] - position[chosen]).ravel()

    step = np.zeros(len(_NAMES))
    for _ in range(PASSES):
        rest = misfit(step)
        # The parameters are nearly alike over an hour: steps of their size, and a small cut-off.
        J = np.column_stack([misfit(step + row) - rest for row in np.eye(len(_NAMES))])
        size = np.linalg.norm(J, axis=0)
        step = step - np.linalg.lstsq(J / size, rest, rcond=1e-11)[0] / size
    orbit = made(step)
    af1, af0 = np.polyfit(tow - toe, clock, 1)
    values = {**vars(orbit), "af0": float(af0), "af1": float(af1), "tgd": tgd}
    return Ephemeris(**values), float(np.sqrt(np.mean(misfit(step) ** 2)))


def _states(ephemeris: Ephemeris, tow: FloatArray) -> FloatArray:
    rows = np.broadcast_to(pack([ephemeris]), (len(tow), PACKED_COLUMNS))
    return satellite_states(np.ascontiguousarray(rows), ephemeris.week, 0, -tow)


def _kepler(r: FloatArray, velocity: FloatArray, tow: float, toe: float) -> FloatArray:
    """Return the parameters of the ellipse through a position with a velocity."""
    v = velocity + np.cross([0.0, 0.0, GPS_EARTH_RATE], r)
    h = np.cross(r, v)
    towards_perigee = np.cross(v, h) / GPS_GM - r / np.linalg.norm(r)
    node = np.array([-h[1], h[0], 0.0]) / np.hypot(h[0], h[1])
    pole = h / np.linalg.norm(h)
    a = 1.0 / (2.0 / np.linalg.norm(r) - v @ v / GPS_GM)
    e = float(np.linalg.norm(towards_perigee))
    omega = np.arctan2(np.cross(node, towards_perigee) @ pole, node @ towards_perigee)
    anomaly = np.arctan2(np.cross(towards_perigee, r) @ pole, towards_perigee @ r)
    eccentric = 2.0 * np.arctan2(
        np.sqrt(1.0 - e) * np.sin(anomaly / 2.0), np.sqrt(1.0 + e) * np.cos(anomaly / 2.0)
    )
    mean = eccentric - e * np.sin(eccentric) - np.sqrt(GPS_GM / a**3) * (tow - toe)
    # The node is counted from Greenwich at the beginning of the week.
    omega0 = np.arctan2(node[1], node[0]) + GPS_EARTH_RATE * tow
    i0 = np.arccos(pole[2])
    return np.array([np.sqrt(a), e, i0, omega0, omega, mean, 4e-9, -8e-9, *np.zeros(7)])
