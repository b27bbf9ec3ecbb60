"""Magnitude from peak ground displacement.

``log10 PGD = A + B M + C M log10 R``, PGD in centimetres and R, the distance to the hypocentre, in
kilometres [1]_. The constants are those of GFAST [2]_.

References
----------
.. [1] D. Melgar et al., "Earthquake magnitude calculation without saturation from the scaling of
   peak ground displacement", Geophys. Res. Lett. 42, 5197-5205, 2015.
.. [2] B. W. Crowell et al., "Demonstration of the Cascadia G-FAST geodetic earthquake early
   warning system for the Nisqually, Washington, earthquake", Seismol. Res. Lett. 87, 930-943,
   2016.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from deepseis_core.errors import InputError
from deepseis_core.geodesy import ecef_from_geodetic
from deepseis_core.types import FloatArray

A: Final = -6.687
B: Final = 1.500
C: Final = -0.214
SCATTER: Final = 0.27
"""One sigma of a magnitude from its peaks, by [1]_."""


def peak_displacement(magnitude: float, distance: float) -> float:
    """Return the peak displacement [m] that a magnitude has at a distance [m].

    Examples
    --------
    >>> round(peak_displacement(9.0, 100e3), 1)
    9.1
    """
    return 1e-2 * float(10.0 ** (A + magnitude * _slope(distance)))


def magnitude(displacement: float, distance: float) -> float:
    """Return the magnitude of a peak displacement [m] at a distance [m]; NaN without any.

    Examples
    --------
    >>> round(magnitude(9.16, 100e3), 2)
    9.0
    """
    if not (displacement > 0.0 and distance > 0.0):
        return float("nan")
    return (math.log10(1e2 * displacement) - A) / _slope(distance)


def magnitude_sd(displacement: float, displacement_sd: float, distance: float) -> float:
    """Return one sigma of `magnitude`: its own scatter and that of a displacement [m]."""
    if not (displacement > 0.0 and distance > 0.0):
        return float("nan")
    measured = displacement_sd / (displacement * math.log(10.0) * _slope(distance))
    return math.hypot(SCATTER, measured)


def hypocentral_distance(station_ecef: FloatArray, hypocentre: list[float]) -> float:
    """Return the distance [m] of a hypocentre: latitude, longitude [deg], depth [km].

    Without a hypocentre, an empty list, it is NaN.

    Raises
    ------
    InputError
        That is no place in the Earth.
    """
    if not hypocentre:
        return float("nan")
    bounds = (90.0, 360.0, 800.0)
    given = len(hypocentre) == len(bounds)
    if not given or not all(abs(v) <= b for v, b in zip(hypocentre, bounds, strict=True)):
        raise InputError("hypocentre", f"is {hypocentre}", "latitude, longitude [deg], depth [km]")
    latitude, longitude, depth = hypocentre
    place = ecef_from_geodetic([np.radians(latitude), np.radians(longitude), -1e3 * depth])
    return float(np.linalg.norm(place - station_ecef))


def _slope(distance: float) -> float:
    return B + C * math.log10(1e-3 * distance)
