"""Flight with piecewise constant jerk: the high-dynamics track of the doppler-aided paper."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from deepseis_core.config import setting
from deepseis_core.errors import InputError
from deepseis_core.types import FloatArray
from deepseis_sim.motion import Kinematics, Motion, Surroundings
from deepseis_sim.motions_shapes import LONGEST, Upright, along, check_settings, direction

_JERK = 245.0  # [m/s^3] 25 g/s with the paper's g of 9.8 m/s^2: 5 s at 50 g are its 2450 m/s


@dataclass(frozen=True)
class JerkSegment:
    """A time of constant jerk."""

    duration: float = setting(1.0, "length [s]", low=1e-3, high=LONGEST)
    jerk: float = setting(0.0, "jerk [m/s^3]", low=-1e6, high=1e6)


@dataclass(frozen=True)
class Profile(Upright):
    """Flight along a straight line with piecewise constant jerk, then at constant speed for ever.

    The default is table 2 of the doppler-aided paper with the edges it leaves out: at rest for
    30 s, 2 s at 25 g/s, 3 s at 50 g, 2 s at -25 g/s, and 2450 m/s from there on. The line is
    straight in the tangent frame; after 100 km it is 800 m above a level one.
    """

    segments: tuple[JerkSegment, ...] = setting(
        (JerkSegment(2.0, _JERK), JerkSegment(3.0, 0.0), JerkSegment(2.0, -_JERK)),
        "jerk by jerk; the acceleration must be zero after the last",
    )
    azimuth_deg: float = setting(90.0, "line, clockwise from north [deg]", low=-360.0, high=360.0)
    elevation_deg: float = setting(0.0, "line above the horizon [deg]", low=-90.0, high=90.0)
    start: float = setting(30.0, "first movement [s]", low=0.0, high=LONGEST)

    def build(self, around: Surroundings) -> Motion:
        """Check the settings."""
        check_settings("profile", self)
        for number, segment in enumerate(self.segments, 1):
            check_settings(f"profile, segment {number}", segment)
        _, _, _, acceleration, jerk = self._knots
        if not np.any(jerk):
            raise InputError("profile", "segments have no jerk: nothing moves", "or use still")
        if acceleration[-1] != 0.0:
            reason = f"segments leave an acceleration of {acceleration[-1]:.6g} m/s^2"
            raise InputError("profile", reason, "jerk times duration must add up to zero")
        return self

    @property
    def span(self) -> tuple[float, float]:
        """First movement, and last unless it flies on for ever: infinity [s]."""
        begin, _, speed, _, _ = self._knots
        return self.start, math.inf if speed[-1] else float(begin[-1])

    @cached_property
    def _knots(self) -> tuple[FloatArray, ...]:
        """Begin of each segment and of what follows; position, speed, acceleration, jerk there."""
        state = [(self.start, 0.0, 0.0, 0.0)]
        for segment in self.segments:
            (t, p, v, a), d, j = state[-1], segment.duration, segment.jerk
            p += d * (v + d * (a / 2.0 + d * j / 6.0))
            state.append((t + d, p, v + d * (a + d * j / 2.0), a + d * j))
        jerk = np.array([*(segment.jerk for segment in self.segments), 0.0])
        knots = np.array(state)
        # What rounding leaves over would be an acceleration for ever.
        for column in knots.T[2:]:
            if abs(column[-1]) < 1e-9 * np.abs(column).max():
                column[-1] = 0.0
        return (*knots.T, jerk)

    def at(self, time: FloatArray) -> Kinematics:
        """Evaluate at times [s], shape (m,)."""
        begin, position, speed, acceleration, jerk = self._knots
        k = np.maximum(np.searchsorted(begin, time, side="right") - 1, 0)
        d = np.maximum(time - begin[k], 0.0)
        a, j = acceleration[k], jerk[k]
        p = position[k] + d * (speed[k] + d * (a / 2.0 + d * j / 6.0))
        amount = p, speed[k] + d * (a + d * j / 2.0), a + d * j
        return along(direction(self.azimuth_deg, self.elevation_deg), amount)
