"""A drive through a town: laps of a block with turns both ways, swerves, hills and traffic lights.

After the vehicle test of [1]_: some 20 minutes along a planned route. The route is a rectilinear
polygon of six corners, five to the left and one to the right; every lap repeats it with other
speeds and other lights on red.

References
----------
.. [1] Hu J., Shi X., "Application of carrier phase smoothing pseudorange in GPS/SINS tightly
   integrated navigation system", Navigation Positioning & Timing 5(5), 2018, section 3.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from deepseis_core.config import setting
from deepseis_core.errors import InputError
from deepseis_core.types import FloatArray
from deepseis_sim.motion import Surroundings
from deepseis_sim.motions_shapes import check_settings
from deepseis_sim.road import Bend, bend_of, trace
from deepseis_sim.speed_programme import Stretch, plan_speed
from deepseis_sim.vehicle_path import Ride, VehicleMotion, lay_road, vehicle_motion

DRIVE_STREAM: Final = 402
"""Stream number of the route's random numbers."""

SIDES: Final = (250.0, 600.0)
"""Shortest and longest of the four sides that are drawn; the other two are sums of two [m]."""

RED_LIGHT: Final = (8.0, 30.0)
"""Shortest and longest wait [s]."""


@dataclass(frozen=True)
class _Leg:
    """A bend, the speed on it [m/s] and the stop at its end [s]."""

    bend: Bend
    speed: float
    stop: float = 0.0


@dataclass(frozen=True)
class Drive:
    """A drive through a town, from rest to rest."""

    start: float = setting(20.0, "first movement [s]", low=0.0, high=1e5)
    duration: float = setting(
        1170.0, "from the first movement to the last, at most [s]", low=10.0, high=2e4
    )
    speed: float = setting(16.0, "highest speed [m/s]", low=3.0, high=40.0)
    heading_deg: float = setting(
        90.0, "first heading, clockwise from north [deg]", low=-360.0, high=360.0
    )
    relief: float = setting(8.0, "hills, about this much up and down [m]", low=0.0, high=30.0)
    red_lights: float = setting(0.5, "share of the lights that are red", low=0.0, high=1.0)
    ride: Ride = field(default_factory=Ride)

    def build(self, around: Surroundings) -> VehicleMotion:
        """Draw the route from the seed and drive as far as the time allows."""
        check_settings("drive", self)
        check_settings("drive: ride", self.ride)
        rng = np.random.default_rng([around.seed, DRIVE_STREAM])
        route = _Route(self, rng)
        hills = _Hills(self.relief, rng)
        legs: list[_Leg] = []
        while math.fsum(leg.bend.length for leg in legs) < self.duration * self.speed:
            legs += route.lap(rng)
        start = math.radians(90.0 - self.heading_deg)
        road = lay_road([leg.bend for leg in legs], start, hills.height, around.origin)
        ends = road.arc(np.cumsum([leg.bend.length for leg in legs]))
        lengths = np.diff(ends, prepend=0.0)
        stretches = [
            Stretch(float(length), leg.speed, leg.stop)
            for length, leg in zip(lengths, legs, strict=True)
        ]
        turns = [leg.bend.turn != 0.0 for leg in legs]
        stretches = self._that_fit(stretches, turns)
        programme = plan_speed(stretches, self.ride.acceleration, self.start)
        return vehicle_motion(road, programme, self.ride, around.origin, around.seed)

    def _that_fit(self, stretches: Sequence[Stretch], turns: Sequence[bool]) -> list[Stretch]:
        """Return the longest way that ends in time, on a straight."""
        low, high = 0.0, math.fsum(s.length for s in stretches)
        for _ in range(40):
            middle = 0.5 * (low + high)
            way = _cut(stretches, turns, middle)
            took = plan_speed(way, self.ride.acceleration).span[1] if way else 0.0
            low, high = (middle, high) if took <= self.duration else (low, middle)
        way = _cut(stretches, turns, low)
        if not way:
            raise InputError("drive", f"{self.duration:g} s are too short to go anywhere")
        return way


class _Route:
    """Geometry of a lap: six sides, their corners and swerves; the same on every lap."""

    def __init__(self, config: Drive, rng: np.random.Generator) -> None:
        self.config = config
        a1, b1, a2, b2 = rng.uniform(*SIDES, size=4)
        turns = 0.5 * math.pi * np.array([1.0, -1.0, 1.0, 1.0, 1.0, 1.0])
        corners = [bend_of(float(turn), float(rng.uniform(10.0, 20.0))) for turn in turns]
        # A bend mirrors itself: a corner takes the same from the side before and after it.
        taken = [float(trace([corner])[1][-1, 0]) for corner in corners]
        self.corners = corners
        self.sides = [
            self._side(side - taken[k - 1] - taken[k], rng)
            for k, side in enumerate([a1, b1, a2, b2, a1 + a2, b1 + b2])
        ]

    @staticmethod
    def _side(length: float, rng: np.random.Generator) -> list[Bend]:
        """Fill a side with straights and, on a long one, a swerve to its side and back."""
        angle = math.radians(rng.uniform(8.0, 20.0)) * rng.choice([-1.0, 1.0])
        first = bend_of(angle, float(rng.uniform(80.0, 150.0)))
        swerve = [first, Bend(2.0 * first.length, -2.0 * angle), first]
        along = float(trace(swerve)[1][-1, 0])
        if along > 0.6 * length:
            return _straights(length, rng)
        before = (length - along) * rng.uniform(0.3, 0.7)
        after = length - along - before
        return [*_straights(before, rng), *swerve, *_straights(after, rng)]

    def lap(self, rng: np.random.Generator) -> list[_Leg]:
        """Return a lap; the lights and the speeds are drawn anew."""
        legs = []
        for side, corner in zip(self.sides, self.corners, strict=True):
            legs += [self._leg(bend, rng) for bend in side]
            if rng.random() < self.config.red_lights:
                legs[-1] = replace(legs[-1], stop=float(rng.uniform(*RED_LIGHT)))
            legs.append(self._leg(corner, rng))
        return legs

    def _leg(self, bend: Bend, rng: np.random.Generator) -> _Leg:
        limit = self.config.speed * float(rng.uniform(0.7, 1.0))
        if bend.turn:
            limit = min(limit, math.sqrt(self.config.ride.lateral / bend.peak_curvature))
        return _Leg(bend, limit)


class _Hills:
    """Heights as a smooth function of the place, so that every lap finds the same; 0 at origin."""

    def __init__(self, relief: float, rng: np.random.Generator) -> None:
        wavelength, direction = rng.uniform(900.0, 2000.0, 4), rng.uniform(0.0, 2.0 * np.pi, 4)
        self.waves = 2.0 * np.pi / wavelength * np.array([np.cos(direction), np.sin(direction)])
        self.phase = rng.uniform(0.0, 2.0 * np.pi, 4)
        self.amplitude = 0.5 * relief

    def height(self, _: FloatArray, plan: FloatArray) -> FloatArray:
        """Return heights [m] at plan points (m, 2)."""
        waves = np.sin(plan @ self.waves + self.phase) - np.sin(self.phase)
        return self.amplitude * waves.sum(axis=1)


def _straights(length: float, rng: np.random.Generator) -> list[Bend]:
    """Split a straight into pieces of some 150 m, each of which gets a speed of its own."""
    count = max(round(length / 150.0), 1)
    shares = rng.uniform(0.7, 1.3, count)
    return [Bend(float(length * share)) for share in shares / shares.sum()]


def _cut(stretches: Sequence[Stretch], turns: Sequence[bool], distance: float) -> list[Stretch]:
    """Return the beginning of a way, at most so long [m], that ends on a straight."""
    way: list[Stretch] = []
    for stretch in stretches:
        if stretch.length >= distance:
            way.append(replace(stretch, length=distance))
            break
        way.append(stretch)
        distance -= stretch.length
    while way and (turns[len(way) - 1] or way[-1].length < 5.0):
        way.pop()
    return [*way[:-1], replace(way[-1], stop=0.0)] if way else []


MOTION_KINDS: Mapping[str, type] = {"drive": Drive}
"""Names of the kinds in scenario files."""
