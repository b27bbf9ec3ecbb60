"""A vehicle on a road: from bends, heights and a speed programme to the motion of its body.

The body's origin runs on the road itself. Its forward axis is the road's tangent, its left axis
is horizontal by the vertical of where it is, then it leans out of the bend in proportion to the
lateral acceleration. Distance is a closed form of time and everything else a spline of distance,
so velocity, acceleration and angular rate are exact derivatives, and the memory taken is that of
the road alone: 58 bytes a metre.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from deepseis_core.config import setting
from deepseis_core.types import FloatArray
from deepseis_sim.motion import Kinematics
from deepseis_sim.road import Bend, Road, tilt_of_vertical, trace
from deepseis_sim.speed_programme import SpeedProgramme
from deepseis_sim.vehicle_kernel import fill_kinematics

VIBRATION_STREAM: Final = 401
"""Stream number of the vibration's random numbers."""

VIBRATION_BAND: Final = (1.0, 15.0)
"""[Hz] Body resonance to wheel hop."""

VIBRATION_LINES: Final = 24
"""Sine waves that make up the vibration."""

VIBRATION_FADE: Final = 5.0
"""Speed at which the vibration has half its amplitude [m/s]."""

HALF_WHEELBASE: Final = 1.35
"""Lever that turns heave into pitch [m]."""

Height = Callable[[FloatArray, FloatArray], FloatArray]
"""Distances in plan (m,) and plan points (m, 2) [m] to heights above the origin's (m,) [m]."""


@dataclass(frozen=True)
class Ride:
    """How a vehicle's body follows its road."""

    acceleration: float = setting(2.5, "peak along the road [m/s^2]", low=0.1, high=10.0)
    lateral: float = setting(2.5, "largest lateral acceleration [m/s^2]", low=0.1, high=10.0)
    lean_deg: float = setting(4.0, "roll outwards per g of lateral [deg]", low=-30.0, high=30.0)
    vibration: float = setting(
        0.2, "vertical vibration at speed, RMS, 1 to 15 Hz [m/s^2]; 0: none", low=0.0, high=5.0
    )


@dataclass(frozen=True)
class VehicleMotion:
    """A vehicle that travels a road by a speed programme (a `deepseis_sim.motion.Motion`).

    Attributes
    ----------
    road : Road
    programme : SpeedProgramme
    tilt : tuple of float
        Lean of the vertical per metre east and north [rad/m].
    lean : float
        Roll per lateral acceleration [rad s^2/m].
    vibration : ndarray, shape (k, 5)
        Sine waves: angular frequency [rad/s], heave's cosine and sine amplitudes [m], pitch's
        [rad]; along the tangent frame's up, multiplied by v^2 / (v^2 + fade^2).
    """

    road: Road
    programme: SpeedProgramme
    tilt: tuple[float, float]
    lean: float
    vibration: FloatArray

    @property
    def rotates(self) -> bool:
        """Whether the attitude ever changes."""
        return True

    @property
    def span(self) -> tuple[float, float]:
        """First and last moment at which it moves [s]."""
        return self.programme.span

    def at(self, time: FloatArray) -> Kinematics:
        """Evaluate at times [s], shape (m,), in any order."""
        time = np.ascontiguousarray(np.atleast_1d(time), np.float64)
        position, velocity, acceleration, rate = np.empty((4, time.size, 3))
        attitude = np.empty((time.size, 3, 3))
        fill_kinematics(
            time,
            self.programme.phases,
            self.road.nodes,
            self.road.step,
            self.tilt,
            self.lean,
            self.vibration,
            VIBRATION_FADE,
            position,
            velocity,
            acceleration,
            attitude,
            rate,
        )
        return Kinematics(position, velocity, acceleration, attitude, rate)

    def distance(self, time: FloatArray) -> FloatArray:
        """Return the distance travelled [m] at times [s]."""
        return self.programme.at(time)[:, 0]


def vehicle_motion(
    road: Road,
    programme: SpeedProgramme,
    ride: Ride,
    origin: tuple[float, float, float],
    seed: int,
) -> VehicleMotion:
    """Put a vehicle on a road; ``origin`` as in `deepseis_sim.motion.Surroundings`."""
    lean = float(np.radians(ride.lean_deg)) / 9.80665
    return VehicleMotion(
        road, programme, tilt_of_vertical(origin), lean, vibration_lines(ride.vibration, seed)
    )


def vibration_lines(rms: float, seed: int) -> FloatArray:
    """Return sine waves of equal acceleration, one in each of equal parts of the band.

    Parameters
    ----------
    rms : float
        Of the heave's acceleration [m/s^2]; pitch has the same shape, its acceleration at the
        axles as large.
    seed : int

    Returns
    -------
    ndarray, shape (k, 5)
        As `VehicleMotion.vibration`; empty without vibration.
    """
    if rms == 0.0:
        return np.empty((0, 5))
    rng = np.random.default_rng([seed, VIBRATION_STREAM])
    low, high = VIBRATION_BAND
    parts = (np.arange(VIBRATION_LINES) + rng.random(VIBRATION_LINES)) / VIBRATION_LINES
    omega = 2.0 * np.pi * (low + (high - low) * parts)
    size = rms * np.sqrt(2.0 / VIBRATION_LINES) / omega**2
    phases = 2.0 * np.pi * rng.random((2, VIBRATION_LINES))
    heave = size * np.array([np.cos(phases[0]), np.sin(phases[0])])
    pitch = size / HALF_WHEELBASE * np.array([np.cos(phases[1]), np.sin(phases[1])])
    return np.ascontiguousarray(np.vstack([omega, heave, pitch]).T)


def lay_road(
    bends: Sequence[Bend],
    start: float,
    height: Height,
    origin: tuple[float, float, float],
) -> Road:
    """Make a road from the tangent frame's origin.

    Parameters
    ----------
    bends : sequence of Bend
    start : float
        First heading [rad], from east to north.
    height : Height
        Smooth.
    origin : tuple of float
        Latitude [rad], longitude [rad], height [m] of the site.
    """
    distance, plan = trace(bends, start)
    return Road(distance, plan, height(distance, plan), origin)
