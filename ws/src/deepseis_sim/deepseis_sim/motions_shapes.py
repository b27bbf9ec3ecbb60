"""What the motions are made of: smooth ramps, oscillations, directions, and checked settings."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from deepseis_core.config import check
from deepseis_core.errors import InputError
from deepseis_core.types import FloatArray
from deepseis_sim.motion import Kinematics

LONGEST = 1e6  # [s]

Derivatives = tuple[FloatArray, FloatArray, FloatArray]
"""A function of time with its first and second derivative, each of shape (m,)."""


def smooth_step(x: FloatArray) -> Derivatives:
    """Rise from 0 at x <= 0 to 1 at x >= 1 with four continuous derivatives.

    ``x^5 (126 - 420 x + 540 x^2 - 315 x^3 + 70 x^4)``; its slope is at most 2.46.

    Examples
    --------
    >>> smooth_step(np.array([-1.0, 0.5, 2.0]))[0]
    array([0. , 0.5, 1. ])
    """
    x = np.clip(x, 0.0, 1.0)
    y = 1.0 - x
    cube = (x * y) ** 3
    value = x**2 * x**3 * (126.0 + x * (-420.0 + x * (540.0 + x * (-315.0 + x * 70.0))))
    return value, 630.0 * cube * x * y, 2520.0 * cube * (1.0 - 2.0 * x)


def rise_by(time: FloatArray, start: float, rise: float) -> Derivatives:
    """Rise from 0 to 1 between ``start`` and ``start + rise`` [s]."""
    value, slope, curve = smooth_step((time - start) / rise)
    return value, slope / rise, curve / rise**2


def pulse(time: FloatArray, start: float, duration: float, ramp: float) -> Derivatives:
    """Rise to 1 and, ``duration`` after the start, be back at 0; ramps do not overlap."""
    up, down = rise_by(time, start, ramp), rise_by(time, start + duration - ramp, ramp)
    return up[0] - down[0], up[1] - down[1], up[2] - down[2]


def oscillation(envelope: Derivatives, omega: float, s: FloatArray, c: FloatArray) -> Derivatives:
    """Multiply an envelope by ``s``, whose derivative is ``omega c``."""
    a, slope, curve = envelope
    speed = slope * s + omega * (a * c)
    return a * s, speed, curve * s + omega * (2.0 * slope * c - omega * (a * s))


def along(direction: FloatArray, amount: Derivatives) -> Kinematics:
    """Return the translation by so much along a vector, east, north, up."""
    return Kinematics(*(value[:, None] * direction for value in amount))


def at_rest(time: FloatArray) -> Kinematics:
    """Return what never moves."""
    return Kinematics(*(np.zeros((time.size, 3)) for _ in range(3)))


def direction(azimuth_deg: float, elevation_deg: float) -> FloatArray:
    """Return the unit vector east, north, up."""
    azimuth, elevation = math.radians(azimuth_deg), math.radians(elevation_deg)
    level = math.cos(elevation)
    return np.array([level * math.sin(azimuth), level * math.cos(azimuth), math.sin(elevation)])


def check_settings(kind: str, config: Any) -> None:
    """Raise InputError where a setting is outside its limits or not finite."""
    for item in dataclasses.fields(config):
        value = getattr(config, item.name)
        if isinstance(value, float) and not math.isfinite(value):
            raise InputError(kind, f"{item.name} = {value} is not a finite number")
    try:
        check(config)
    except ValueError as error:
        raise InputError(kind, str(error)) from None


def check_ramp(kind: str, name: str, ramp: float, duration: float) -> None:
    """Raise InputError where going up and coming down would overlap."""
    if ramp > duration / 2:
        reason = f"{name} = {ramp} s is longer than half the duration of {duration} s"
        raise InputError(kind, reason, f"at most {duration / 2}")


class Upright:
    """What motions that never turn have in common."""

    @property
    def rotates(self) -> bool:
        """Never."""
        return False
