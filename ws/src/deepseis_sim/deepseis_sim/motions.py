"""Motions in closed form: the shake tables, steps and flights of the papers, and their sums.

Each is a frozen dataclass of settings, and is the motion itself once `build` has looked at it.
Ramps are polynomials with four continuous derivatives: acceleration begins and ends with zero
jerk and snap, so nothing that differentiates or interpolates a motion sees an edge.

Attitude: `Still` sets it, `Tilt` changes it; the others keep the body's axes forward, left, up at
east, north, up. Several together (`sum_of`) add their translations, and their attitudes multiply
from the left, ``C = C_n ... C_2 C_1``: each turns, in the tangent frame, what stands before it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from deepseis_core.config import setting
from deepseis_core.rotation import enu_flu_from_euler, matrix_from_rotvec
from deepseis_core.types import FloatArray
from deepseis_sim.motion import Kinematics, Motion, MotionConfig, Surroundings
from deepseis_sim.motions_attitude import compose, turn_back
from deepseis_sim.motions_profile import JerkSegment, Profile
from deepseis_sim.motions_shapes import (
    LONGEST,
    Upright,
    along,
    at_rest,
    check_ramp,
    check_settings,
    direction,
    oscillation,
    pulse,
    rise_by,
)

__all__ = [
    "MOTION_KINDS",
    "Circle",
    "JerkSegment",
    "Offset",
    "Profile",
    "Sine",
    "Still",
    "Sum",
    "Tilt",
    "sum_of",
]

_EDGE = 1e-3
"""Beyond its span a part is evaluated all the same, whatever is rounded at its ends [s]."""


@dataclass(frozen=True)
class Still(Upright):
    """No movement, at an attitude.

    The default is that of a `Kinematics` that says nothing: forward, left, up are east, north, up.
    Heading, pitch and roll are the usual yaw-pitch-roll sequence.
    """

    heading_deg: float = setting(
        90.0, "forward axis, clockwise from north [deg]", low=-360.0, high=360.0
    )
    pitch_deg: float = setting(0.0, "forward axis above the horizon [deg]", low=-90.0, high=90.0)
    roll_deg: float = setting(0.0, "right side down [deg]", low=-180.0, high=180.0)

    def build(self, around: Surroundings) -> Motion:
        """Check the settings."""
        check_settings("still", self)
        return self

    @property
    def span(self) -> tuple[float, float]:
        """It never moves."""
        return 0.0, 0.0

    @cached_property
    def _attitude(self) -> FloatArray:
        if (self.heading_deg, self.pitch_deg, self.roll_deg) == (90.0, 0.0, 0.0):
            return np.eye(3)  # free of rounding
        return enu_flu_from_euler(np.deg2rad([self.roll_deg, self.pitch_deg, self.heading_deg]))

    def at(self, time: FloatArray) -> Kinematics:
        """Evaluate at times [s], shape (m,)."""
        return replace(at_rest(time), C_enu_b=self._attitude)


@dataclass(frozen=True)
class Circle(Upright):
    """Level circle about the origin without turning: east h sin, north h cos (thesis eq. 5.1).

    The radius grows from zero and shrinks back to it. With ramps of two periods or more the
    acceleration exceeds that of the circle by 2.2 % at most (half a period doubles it).
    """

    radius: float = setting(0.5, "radius h [m]", low=0.0, high=1e5)
    frequency_hz: float = setting(1.0, "revolutions a second [Hz]", low=1e-4, high=100.0)
    start: float = setting(20.0, "first movement [s]", low=0.0, high=LONGEST)
    duration: float = setting(100.0, "length, ramps included [s]", low=1e-3, high=LONGEST)
    ramp: float = setting(2.0, "growing and shrinking of the radius [s]", low=1e-3, high=LONGEST)

    @property
    def fades(self) -> bool:
        """It leaves nothing behind."""
        return True

    def build(self, around: Surroundings) -> Motion:
        """Check the settings."""
        check_settings("circle", self)
        check_ramp("circle", "ramp", self.ramp, self.duration)
        return self

    @property
    def span(self) -> tuple[float, float]:
        """First and last movement [s]."""
        return self.start, self.start + self.duration

    def at(self, time: FloatArray) -> Kinematics:
        """Evaluate at times [s], shape (m,)."""
        envelope = pulse(time, self.start, self.duration, self.ramp)
        omega = 2.0 * math.pi * self.frequency_hz
        phase = omega * (time - self.start)
        s, c = self.radius * np.sin(phase), self.radius * np.cos(phase)
        out = np.zeros((3, time.size, 3))
        out[:, :, 0] = oscillation(envelope, omega, s, c)
        out[:, :, 1] = oscillation(envelope, omega, c, -s)
        return Kinematics(*out)


@dataclass(frozen=True)
class Sine(Upright):
    """Sine along one axis, such as a shake table's (thesis 5.1.3: 3 cm at 2 Hz)."""

    amplitude: float = setting(0.03, "amplitude [m]", low=0.0, high=1e5)
    frequency_hz: float = setting(2.0, "frequency [Hz]", low=1e-4, high=100.0)
    azimuth_deg: float = setting(90.0, "axis, clockwise from north [deg]", low=-360.0, high=360.0)
    elevation_deg: float = setting(0.0, "axis above the horizon [deg]", low=-90.0, high=90.0)
    start: float = setting(20.0, "first movement [s]", low=0.0, high=LONGEST)
    duration: float = setting(100.0, "length, ramps included [s]", low=1e-3, high=LONGEST)
    ramp: float = setting(2.0, "growing and fading [s]", low=1e-3, high=LONGEST)

    @property
    def fades(self) -> bool:
        """It leaves nothing behind."""
        return True

    def build(self, around: Surroundings) -> Motion:
        """Check the settings."""
        check_settings("sine", self)
        check_ramp("sine", "ramp", self.ramp, self.duration)
        return self

    @property
    def span(self) -> tuple[float, float]:
        """First and last movement [s]."""
        return self.start, self.start + self.duration

    def at(self, time: FloatArray) -> Kinematics:
        """Evaluate at times [s], shape (m,)."""
        envelope = pulse(time, self.start, self.duration, self.ramp)
        omega = 2.0 * math.pi * self.frequency_hz
        phase = omega * (time - self.start)
        amount = oscillation(envelope, omega, np.sin(phase), np.cos(phase))
        return along(self.amplitude * direction(self.azimuth_deg, self.elevation_deg), amount)


@dataclass(frozen=True)
class Offset(Upright):
    """Static displacement, as an earthquake leaves it; with a duration it goes back."""

    east: float = setting(0.0, "displacement to the east [m]", low=-1e5, high=1e5)
    north: float = setting(0.0, "displacement to the north [m]", low=-1e5, high=1e5)
    up: float = setting(0.0, "displacement upwards [m]", low=-1e5, high=1e5)
    start: float = setting(20.0, "first movement [s]", low=0.0, high=LONGEST)
    rise: float = setting(2.0, "time it takes to get there, and back [s]", low=1e-3, high=LONGEST)
    duration: float = setting(
        0.0, "from leaving to being back [s]; 0: it stays", low=0.0, high=LONGEST
    )

    @property
    def fades(self) -> bool:
        """Whether it goes back."""
        return self.duration > 0.0

    def build(self, around: Surroundings) -> Motion:
        """Check the settings."""
        check_settings("offset", self)
        if self.duration > 0.0:
            check_ramp("offset", "rise", self.rise, self.duration)
        return self

    @property
    def span(self) -> tuple[float, float]:
        """First and last movement [s]."""
        return self.start, self.start + (self.duration or self.rise)

    def at(self, time: FloatArray) -> Kinematics:
        """Evaluate at times [s], shape (m,)."""
        if self.duration > 0.0:
            amount = pulse(time, self.start, self.duration, self.rise)
        else:
            amount = rise_by(time, self.start, self.rise)
        return along(np.array([self.east, self.north, self.up]), amount)


@dataclass(frozen=True)
class Tilt:
    """Permanent turn about an axis fixed in the tangent frame, through the body's origin.

    The three angles are the components of one rotation vector, ``(pitch, roll, -heading)`` along
    east, north, up: to first order, what a body that faces north calls pitch, roll and heading.
    """

    pitch_deg: float = setting(0.0, "about east, north side up [deg]", low=-180.0, high=180.0)
    roll_deg: float = setting(0.0, "about north, east side down [deg]", low=-180.0, high=180.0)
    heading_deg: float = setting(0.0, "clockwise from above [deg]", low=-360.0, high=360.0)
    start: float = setting(20.0, "first movement [s]", low=0.0, high=LONGEST)
    rise: float = setting(2.0, "time it takes [s]", low=1e-3, high=LONGEST)

    def build(self, around: Surroundings) -> Motion:
        """Check the settings."""
        check_settings("tilt", self)
        return self

    @property
    def rotates(self) -> bool:
        """Whether there is any angle."""
        return bool(np.any(self._rotation))

    @property
    def span(self) -> tuple[float, float]:
        """First and last movement [s]."""
        return (self.start, self.start + self.rise) if self.rotates else (0.0, 0.0)

    @cached_property
    def _rotation(self) -> FloatArray:
        """Rotation vector, tangent frame [rad]; it is the same in body axes."""
        return np.deg2rad([self.pitch_deg, self.roll_deg, -self.heading_deg])

    def at(self, time: FloatArray) -> Kinematics:
        """Evaluate at times [s], shape (m,)."""
        if not self.rotates:
            return at_rest(time)
        share, rate, _ = rise_by(time, self.start, self.rise)
        turned = matrix_from_rotvec(share[:, None] * self._rotation)
        return replace(at_rest(time), C_enu_b=turned, omega_b=rate[:, None] * self._rotation)


@dataclass(frozen=True)
class Sum:
    """Several motions at once; see the module for how attitudes combine."""

    parts: tuple[Motion, ...]

    @property
    def rotates(self) -> bool:
        """Whether any part does."""
        return any(part.rotates for part in self.parts)

    @property
    def span(self) -> tuple[float, float]:
        """From the first movement of any part to the last [s]."""
        spans = [part.span for part in self.parts if part.span[1] > part.span[0]]
        return min((s[0] for s in spans), default=0.0), max((s[1] for s in spans), default=0.0)

    @cached_property
    def _times(self) -> list[tuple[Motion, float, float]]:
        """Return the parts, and from when to when each counts [s]."""
        found: list[tuple[Motion, float, float]] = []
        for part in self.parts:
            begin, end = part.span if getattr(part, "fades", False) else (-math.inf, math.inf)
            found.append((part, begin - _EDGE, end + _EDGE))
        return found

    def at(self, time: FloatArray) -> Kinematics:
        """Evaluate at times [s], shape (m,).

        With ``C = C_2 C_1`` the rate is ``omega_1 + C_1^T omega_2``, in axes of the body. Parts
        that are over, or have not begun, and leave nothing behind are passed over: a day of
        earthquakes takes as long as one.
        """
        whole = at_rest(time)
        low, high = (time.min(), time.max()) if time.size else (0.0, 0.0)
        for part, begin, end in self._times:
            if end < low or begin > high:
                continue
            new = part.at(time)
            omega = whole.omega_b
            if part.rotates:
                omega = omega + turn_back(whole.C_enu_b, new.omega_b)
            whole = Kinematics(
                whole.position + new.position,
                whole.velocity + new.velocity,
                whole.acceleration + new.acceleration,
                compose(new.C_enu_b, whole.C_enu_b),
                omega,
            )
        return whole


def sum_of(configs: Sequence[MotionConfig], around: Surroundings) -> Motion:
    """Build motions and put them together; none at all is `Still`.

    Raises
    ------
    InputError
        Where the settings of one make no motion.
    """
    parts = tuple(config.build(around) for config in configs)
    if len(parts) == 1:
        return parts[0]
    return Sum(parts or (Still(),))


MOTION_KINDS: Mapping[str, type] = {
    "still": Still,
    "circle": Circle,
    "sine": Sine,
    "offset": Offset,
    "tilt": Tilt,
    "profile": Profile,
}
"""Names of the kinds in scenario files."""
