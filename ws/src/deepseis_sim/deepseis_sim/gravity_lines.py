"""One mountain road driven back and forth: the repeated lines of a gravimetric test.

After [1]_: six lines of 11 km through forest, 332.7 m between the lowest and the highest point,
up to 20 m/s. At the end of a line the vehicle rests, turns in a loop beyond the road's end and
comes back over the same points.

References
----------
.. [1] Wei G. et al., "Strapdown vehicle autonomous gravimetry method based on two-dimensional
   laser Doppler velocimeter", Infrared and Laser Engineering 52(6), 2023, section 2.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from deepseis_core.config import setting
from deepseis_core.types import FloatArray
from deepseis_sim.motion import Surroundings
from deepseis_sim.motions_shapes import check_settings
from deepseis_sim.road import Bend, bend_of, smooth_ramp, turning_loop
from deepseis_sim.speed_programme import Stretch, plan_speed
from deepseis_sim.vehicle_path import Height, Ride, VehicleMotion, lay_road, vehicle_motion

LINES_STREAM: Final = 403
"""Stream number of the road's random numbers."""

LOOP_RADIUS: Final = 9.0
"""Of the turn at a line's end [m]."""

END_STRAIGHT: Final = 60.0
"""Straight road at either end of a line [m]."""


class Line(NamedTuple):
    """One pass: from leaving one end [s] to reaching the other [s]; 1 outward, -1 back."""

    start_time: float
    end_time: float
    direction: int


@dataclass(frozen=True)
class LinesMotion(VehicleMotion):
    """A vehicle on its lines.

    Attributes
    ----------
    bounds : ndarray, shape (passes, 2)
        Distance travelled where each line begins and ends [m].
    times : ndarray, shape (passes, 2)
        When it is there; the end before the rest [s].
    """

    bounds: FloatArray
    times: FloatArray

    def lines(self) -> list[Line]:
        """Return the passes in order."""
        return [
            Line(float(first), float(last), -1 if k % 2 else 1)
            for k, (first, last) in enumerate(self.times)
        ]

    def along_line(self, time: FloatArray) -> FloatArray:
        """Return the distance from the line's first end [m], the same on every pass.

        In the loops it stays that of the end.
        """
        length = self.bounds[0, 1]
        ends = np.zeros_like(self.bounds)
        ends[0::2, 1] = ends[1::2, 0] = length
        return np.interp(self.distance(time), self.bounds.ravel(), ends.ravel())


@dataclass(frozen=True)
class GravityLines:
    """One mountain road driven back and forth, from rest to rest."""

    start: float = setting(60.0, "first movement [s]", low=0.0, high=1e5)
    length: float = setting(11000.0, "of the line, in plan [m]", low=500.0, high=30000.0)
    passes: int = setting(6, "how often it is driven", low=1, high=100)
    speed: float = setting(20.0, "highest speed [m/s]", low=3.0, high=40.0)
    rest: float = setting(60.0, "rest at the end of each line [s]", low=1.0, high=3600.0)
    slope: float = setting(
        0.030245, "height change over length [-]; 332.7 m in 11 km", low=0.0, high=0.08
    )
    heading_deg: float = setting(
        60.0, "mean heading outward, clockwise from north [deg]", low=-360.0, high=360.0
    )
    ride: Ride = field(default_factory=Ride)

    def build(self, around: Surroundings) -> LinesMotion:
        """Draw the road from the seed and drive it."""
        check_settings("gravity-lines", self)
        check_settings("gravity-lines: ride", self.ride)
        rng = np.random.default_rng([around.seed, LINES_STREAM])
        line, loop = _winding(self.length, rng), turning_loop(LOOP_RADIUS)
        back = [bend.reversed() for bend in reversed(line)]
        bends: list[Bend] = []
        for k in range(self.passes):
            bends += [*([] if k == 0 else loop), *(back if k % 2 else line)]
        height = self._height(math.fsum(bend.length for bend in loop), rng)
        start = math.radians(90.0 - self.heading_deg)
        road = lay_road(bends, start, height, around.origin)
        ends = road.arc(np.cumsum([bend.length for bend in bends]))
        last = np.arange(self.passes) * (len(line) + len(loop)) + len(line) - 1
        stretches = [
            Stretch(float(length), self._limit(bend), self.rest if k in last[:-1] else 0.0)
            for k, (length, bend) in enumerate(zip(np.diff(ends, prepend=0.0), bends, strict=True))
        ]
        programme = plan_speed(stretches, self.ride.acceleration, self.start)
        first = last[1:] - len(line)  # the stretch before each line but the first: its loop's last
        base = vehicle_motion(road, programme, self.ride, around.origin, around.seed)
        begins = np.append(self.start, programme.arrivals[first])
        return LinesMotion(
            **vars(base),
            bounds=np.column_stack([np.append(0.0, ends[first]), ends[last]]),
            times=np.column_stack([begins, programme.arrivals[last]]),
        )

    def _height(self, loop: float, rng: np.random.Generator) -> Height:
        """Return heights along the way there and back; a loop [m] is as high as the line's end."""
        profile, cycle = _profile(self.length, self.slope, rng), self.length + loop

        def height(distance: FloatArray, _: FloatArray) -> FloatArray:
            number = np.minimum(distance // cycle, self.passes - 1)
            along = np.minimum(distance - number * cycle, self.length)
            return profile(np.where(number % 2 == 1, self.length - along, along))

        return height

    def _limit(self, bend: Bend) -> float:
        if not bend.turn:
            return self.speed
        return min(self.speed, math.sqrt(self.ride.lateral / bend.peak_curvature))


def _winding(length: float, rng: np.random.Generator) -> list[Bend]:
    """Return a winding road: bends from side to side of its mean heading, straights between."""
    bends, heading, side = [Bend(END_STRAIGHT)], 0.0, 1.0
    left = length - 2.0 * END_STRAIGHT
    while True:
        side = -side
        aim = side * math.radians(rng.uniform(15.0, 60.0))
        bend = bend_of(aim - heading, float(rng.uniform(60.0, 180.0)))
        straight = float(rng.uniform(20.0, 150.0))
        if bend.length + straight > left:
            return [*bends, Bend(left + END_STRAIGHT)]
        bends += [bend, Bend(straight)]
        heading, left = aim, left - bend.length - straight


def _profile(length: float, slope: float, rng: np.random.Generator) -> BSpline:
    """Return the height by distance along the line [m]: level at both ends, uneven between."""
    u = np.linspace(0.0, 1.0, max(math.ceil(length / 5.0), 100) + 1)
    share, phase = rng.uniform(0.1, 0.4, 3), rng.uniform(0.0, 2.0 * np.pi, 3)
    wave = 2.0 * np.pi * np.array([2.0, 3.0, 5.0])
    grade = smooth_ramp(10.0 * u) * smooth_ramp(10.0 * (1.0 - u))
    grade *= 1.0 + (share * np.sin(np.multiply.outer(u, wave) + phase)).sum(axis=1)
    height = make_interp_spline(length * u, grade, k=5).antiderivative()(length * u)
    return make_interp_spline(length * u, slope * length / np.ptp(height) * height, k=5)


MOTION_KINDS: Mapping[str, type] = {"gravity-lines": GravityLines}
"""Names of the kinds in scenario files."""
