"""How the body moves: position, velocity, acceleration and attitude at any moment.

The bench speaks the frames of the topics: the *tangent frame* ``enu`` (east, north, up at the
site's origin, fixed to the Earth; far from the origin its up is no longer the vertical there) and
the body ``b`` (forward, left, up). ``C_enu_b`` takes body to tangent frame. The body's origin is
the IMU; lever arms lead from it to the antenna.

Time is true GPS time in seconds since the start of the recording (sample 0 of a perfect clock).
A motion answers for every time: before it begins and after it ends the body is at rest.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from deepseis_core.types import FloatArray


def _level() -> FloatArray:
    return np.eye(3)


@dataclass(frozen=True)
class Kinematics:
    """Motion of the body at m times.

    Attributes
    ----------
    position, velocity, acceleration : ndarray, shape (m, 3)
        Of the body's origin, in the tangent frame [m, m/s, m/s^2].
    C_enu_b : ndarray, shape (3, 3) or (m, 3, 3)
        Attitude; one matrix where it does not change.
    omega_b : ndarray, shape (3,) or (m, 3)
        Rate of the body against the tangent frame, body axes [rad/s]; zeros, shape (3,), where
        it does not turn.
    """

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    C_enu_b: FloatArray = field(default_factory=_level)
    omega_b: FloatArray = field(default_factory=lambda: np.zeros(3))


class Motion(Protocol):
    """What moves."""

    @property
    def rotates(self) -> bool:
        """Whether the attitude ever changes."""

    @property
    def span(self) -> tuple[float, float]:
        """First and last moment at which it moves [s]; (0, 0) if never."""

    def at(self, time: FloatArray) -> Kinematics:
        """Evaluate at times [s], shape (m,), in any order."""


@dataclass(frozen=True)
class Surroundings:
    """What a motion may need to know besides its own settings.

    ``origin`` is the latitude [rad], longitude [rad] and height [m] of the site; relative names
    of files count from ``folder``; ``duration`` is the length of the recording [s].
    """

    origin: tuple[float, float, float]
    duration: float
    seed: int = 1
    folder: Path = Path()


class MotionConfig(Protocol):
    """Settings of one kind of motion, a frozen dataclass of `deepseis_core.config.setting`."""

    def build(self, around: Surroundings) -> Motion:
        """Make the motion; raises InputError where settings or files make none."""
