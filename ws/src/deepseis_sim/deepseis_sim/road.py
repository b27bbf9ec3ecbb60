"""Roads as smooth curves: bends laid end to end, heights, and the curve they make in space.

A bend turns by a total angle over its length with the curvature ``(turn / length) w(u)``,
``u`` from 0 to 1 along it and ``w(u) = 8/3 sin(pi u)^4``: curvature and its first three
derivatives vanish at both ends, so any sequence of bends (a straight is a bend of no turn) is a
C^5 curve. It looks the same driven from either end.

Plan coordinates are east and north of the tangent frame; the third coordinate follows from the
height above the ellipsoid, which the tangent plane leaves by 9.5 m over 11 km.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline, make_interp_spline
from scipy.optimize import brentq

from deepseis_core.geodesy import (
    ecef_from_enu,
    ecef_from_geodetic,
    geodetic_from_ecef,
    meridian_radius,
    transverse_radius,
)
from deepseis_core.types import FloatArray

PEAK: Final = 8.0 / 3.0
"""Largest value of the weight ``w``; its mean is 1."""

STEP: Final = 1.25
"""Between the nodes of a road's spline [m]."""


@njit(cache=True, nogil=True)
def ramp(u: float) -> float:
    """Integrate the weight ``w`` from 0 to u: a C^4 step from 0 to 1 (kernel)."""
    turn = 2.0 * math.pi * u
    return u - (8.0 * math.sin(turn) - math.sin(2.0 * turn)) / (12.0 * math.pi)


def smooth_ramp(u: ArrayLike) -> FloatArray:
    """Return `ramp` of an array, clipped to 0 before and 1 after.

    Examples
    --------
    >>> [round(float(x), 6) for x in smooth_ramp([-1.0, 0.5, 2.0])]
    [0.0, 0.5, 1.0]
    """
    u = np.clip(np.asarray(u, np.float64), 0.0, 1.0)
    turn = 2.0 * np.pi * u
    return u - (8.0 * np.sin(turn) - np.sin(2.0 * turn)) / (12.0 * np.pi)


@dataclass(frozen=True)
class Bend:
    """A piece of road in plan: its length [m] and its turn [rad], positive to the left."""

    length: float
    turn: float = 0.0

    @property
    def peak_curvature(self) -> float:
        """Largest curvature [1/m], without sign."""
        return PEAK * abs(self.turn) / self.length

    def reversed(self) -> Bend:
        """Return the same piece as driven from its other end."""
        return Bend(self.length, -self.turn)


def bend_of(turn: float, radius: float) -> Bend:
    """Return the shortest bend with this turn [rad] and nowhere a smaller radius [m]."""
    return Bend(PEAK * abs(turn) * radius, turn)


def heading_along(bends: Sequence[Bend], distance: FloatArray, start: float = 0.0) -> FloatArray:
    """Return the heading [rad], counted from east to north, at plan distances [m]."""
    lengths = np.array([bend.length for bend in bends])
    turns = np.array([bend.turn for bend in bends])
    ends = np.cumsum(lengths)
    k = np.minimum(np.searchsorted(ends, distance, side="right"), len(bends) - 1)
    before = np.concatenate([[start], start + np.cumsum(turns)])[k]
    return before + turns[k] * smooth_ramp((distance - (ends - lengths)[k]) / lengths[k])


def trace(
    bends: Sequence[Bend], start: float = 0.0, step: float = STEP
) -> tuple[FloatArray, FloatArray]:
    """Lay bends end to end from the origin.

    Parameters
    ----------
    bends : sequence of Bend
    start : float
        Heading at the origin [rad], from east to north.
    step : float
        Largest distance between the points [m].

    Returns
    -------
    distance : ndarray, shape (m,)
        Along the curve in plan, equidistant, the last one at the end [m].
    plan : ndarray, shape (m, 2)
        East and north [m].
    """
    length = math.fsum(bend.length for bend in bends)
    distance = np.linspace(0.0, length, max(math.ceil(length / step), 6) + 1)
    nodes, weights = np.polynomial.legendre.leggauss(5)
    half = 0.5 * np.diff(distance)[:, np.newaxis]
    points = distance[:-1, np.newaxis] + half * (1.0 + nodes)
    heading = heading_along(bends, points.ravel(), start).reshape(points.shape)
    moves = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    cells = (half[..., np.newaxis] * weights[:, np.newaxis] * moves).sum(axis=1)
    return distance, np.concatenate([np.zeros((1, 2)), np.cumsum(cells, axis=0)])


def turning_loop(radius: float) -> list[Bend]:
    """Return bends that bring a vehicle back to where it was, headed the other way.

    A drop: gently away to the right, half a turn and more to the left, and to the right again.
    The curve mirrors itself about its middle; it closes when the middle lies on the road's line.
    """

    def bends(angle: float) -> list[Bend]:
        aside = bend_of(-angle, 3.0 * radius)
        return [aside, bend_of(math.pi + 2.0 * angle, radius), aside]

    def miss(angle: float) -> float:
        return float(trace(bends(angle), step=1.0)[1][-1, 1])

    return bends(float(brentq(miss, 0.1, 1.5, xtol=1e-14)))


class Road:
    """A smooth curve in the tangent frame, by its length from the start.

    A quintic spline (C^4) in its own arc length, so that its derivative is a unit vector.

    Parameters
    ----------
    distance : ndarray, shape (m,)
        Along the plan curve [m], equidistant from 0.
    plan : ndarray, shape (m, 2)
        East and north [m].
    height : ndarray, shape (m,)
        Above the ellipsoid, counted from the site's origin [m].
    origin : tuple of float
        Latitude [rad], longitude [rad], height [m] of the site.

    Attributes
    ----------
    length : float
        Of the curve in space [m].
    nodes : ndarray, shape (n, 9)
        Position [m], its first [-] and second [1/m] derivative at equidistant lengths.
    step : float
        Between the nodes [m].
    """

    def __init__(
        self,
        distance: FloatArray,
        plan: FloatArray,
        height: FloatArray,
        origin: tuple[float, float, float],
    ) -> None:
        raw = make_interp_spline(distance, lift(plan, height, origin), k=5)
        speed = np.linalg.norm(raw.derivative()(distance), axis=1)
        arc = make_interp_spline(distance, speed, k=5).antiderivative()(distance)
        self._arc_of_plan: BSpline = make_interp_spline(distance, arc, k=5)
        self.length = float(arc[-1])
        lengths = np.linspace(0.0, self.length, distance.size)
        self.step = float(lengths[1])
        plan_of_arc = make_interp_spline(arc, distance, k=5)
        curve = make_interp_spline(lengths, raw(plan_of_arc(lengths)), k=5)
        self.nodes = np.concatenate([curve.derivative(k)(lengths) for k in range(3)], axis=1)

    def arc(self, plan_distance: ArrayLike) -> FloatArray:
        """Return the length along the curve [m] at distances along the plan curve [m]."""
        return self._arc_of_plan(np.asarray(plan_distance, np.float64))


def lift(plan: FloatArray, height: FloatArray, origin: tuple[float, float, float]) -> FloatArray:
    """Place plan points at heights above the ellipsoid.

    Parameters
    ----------
    plan : ndarray, shape (m, 2)
        East and north in the tangent frame [m].
    height : ndarray, shape (m,)
        Above the origin's height over the ellipsoid [m].
    origin : tuple of float
        Latitude [rad], longitude [rad], height [m].

    Returns
    -------
    ndarray, shape (m, 3)
        Tangent frame [m].
    """
    origin_ecef = ecef_from_geodetic(np.array(origin))
    points = np.column_stack([plan, height])
    for _ in range(4):  # each pass leaves the tilt of the vertical squared of the error: 3e-6
        miss = geodetic_from_ecef(ecef_from_enu(points, origin_ecef))[:, 2] - origin[2] - height
        points[:, 2] -= miss
    return points


def tilt_of_vertical(origin: tuple[float, float, float]) -> tuple[float, float]:
    """Return how the vertical leans per metre east and north of the origin [rad/m].

    The local vertical at (east, north) is along (a east, b north, 1): the radii of curvature
    are those at the origin, which errs by the square of the distance over the radius (3e-6 rad
    at 11 km).
    """
    latitude, _, height = origin
    return (
        float(1.0 / (transverse_radius(latitude) + height)),
        float(1.0 / (meridian_radius(latitude) + height)),
    )
