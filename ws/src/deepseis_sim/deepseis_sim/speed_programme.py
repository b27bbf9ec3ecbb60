"""How fast a vehicle goes along its road: cruises, smooth ramps between them, stops.

A ramp takes the speed from one value to another as `deepseis_sim.road.ramp`: acceleration and its
first three derivatives vanish at both ends, and its peak is 8/3 of its mean. From speed v0 to v1
with peak acceleration a it lasts ``8/3 |v1 - v0| / a`` and covers ``4/3 |v1^2 - v0^2| / a``.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit

from deepseis_core.errors import InputError
from deepseis_core.types import FloatArray
from deepseis_sim.road import PEAK

COVERED: Final = 0.5 * PEAK
"""Distance of a ramp times its peak acceleration, over the difference of squared speeds."""


@dataclass(frozen=True)
class Stretch:
    """A piece of the way: its length [m], the highest speed [m/s], the stop after it [s]."""

    length: float
    speed: float
    stop: float = 0.0


@dataclass(frozen=True)
class SpeedProgramme:
    """Distance travelled as a C^5 function of time.

    Attributes
    ----------
    phases : ndarray, shape (k, 5)
        Time of the beginning [s], duration [s], distance at the beginning [m], speed at the
        beginning and at the end [m/s]: cruises, ramps and stops, without gaps.
    arrivals : ndarray, shape (n,)
        When each stretch's end was reached, before its stop [s].
    """

    phases: FloatArray
    arrivals: FloatArray

    @property
    def span(self) -> tuple[float, float]:
        """First and last moment of movement [s]."""
        return float(self.phases[0, 0]), float(self.arrivals[-1])

    def at(self, time: FloatArray) -> FloatArray:
        """Return distance and its first three derivatives [m, m/s, ...], shape (m, 4)."""
        time = np.ascontiguousarray(time, np.float64)
        out = np.empty((time.size, 4))
        _travel(self.phases, time, out)
        return out


def plan_speed(
    stretches: Sequence[Stretch], acceleration: float, start: float = 0.0
) -> SpeedProgramme:
    """Drive stretches as fast as their limits and an acceleration allow, from rest to rest.

    Parameters
    ----------
    stretches : sequence of Stretch
    acceleration : float
        Peak of every ramp, up or down [m/s^2].
    start : float
        When it starts to move [s].
    """
    if not stretches or min(min(s.length, s.speed) for s in stretches) <= 0.0:
        raise InputError("speed programme", "a stretch without length or speed")
    joints = _joint_speeds(stretches, acceleration)
    phases: list[tuple[float, float, float, float, float]] = []
    arrivals, time, distance = [], start, 0.0
    for stretch, first, last in zip(stretches, joints[:-1], joints[1:], strict=True):
        begin = distance
        for duration, length, before, after in _phases_of(stretch, first, last, acceleration):
            phases.append((time, duration, distance, before, after))
            time, distance = time + duration, distance + length
        distance = begin + stretch.length
        arrivals.append(time)
        if stretch.stop > 0.0:
            phases.append((time, stretch.stop, distance, 0.0, 0.0))
            time += stretch.stop
    phases.append((time, math.inf, distance, 0.0, 0.0))
    return SpeedProgramme(np.array(phases), np.array(arrivals))


def _joint_speeds(stretches: Sequence[Stretch], acceleration: float) -> list[float]:
    """Return the speed at each joint, ends included: what limits and ramps allow."""
    inner = [
        0.0 if before.stop > 0.0 else min(before.speed, after.speed)
        for before, after in itertools.pairwise(stretches)
    ]
    squares = np.square([0.0, *inner, 0.0])
    gain = np.array([s.length for s in stretches]) * acceleration / COVERED
    for k in range(len(stretches)):
        squares[k + 1] = min(squares[k + 1], squares[k] + gain[k])
    for k in reversed(range(len(stretches))):
        squares[k] = min(squares[k], squares[k + 1] + gain[k])
    return [float(v) for v in np.sqrt(squares)]


def _phases_of(
    stretch: Stretch, first: float, last: float, acceleration: float
) -> list[tuple[float, float, float, float]]:
    """Return duration, length, speed before and after of a stretch's ramps and cruise."""
    reachable = 0.5 * (first**2 + last**2 + stretch.length * acceleration / COVERED)
    top = max(min(stretch.speed, math.sqrt(reachable)), first, last)
    ramps = [
        (PEAK * abs(b - a) / acceleration, COVERED * abs(b**2 - a**2) / acceleration, a, b)
        for a, b in ((first, top), (top, last))
    ]
    left = max(stretch.length - ramps[0][1] - ramps[1][1], 0.0)
    parts = [ramps[0], (left / top, left, top, top), ramps[1]]
    return [part for part in parts if part[0] > 1e-9]


@njit(cache=True, nogil=True)
def travel(phases: FloatArray, k: int, time: float) -> tuple[int, float, float, float, float]:
    """Return the phase at a time, and distance, speed, acceleration, jerk (kernel).

    ``k`` is the phase to look at first: times that rise are found at once.
    """
    if time <= phases[0, 0]:
        return 0, phases[0, 2], 0.0, 0.0, 0.0
    if not (phases[k, 0] <= time < phases[k, 0] + phases[k, 1]):
        k = int(np.searchsorted(phases[:, 0], time, side="right")) - 1
    duration, v0 = phases[k, 1], phases[k, 3]
    change = phases[k, 4] - v0
    tau = time - phases[k, 0]
    if change == 0.0:
        return k, phases[k, 2] + v0 * tau, v0, 0.0, 0.0
    u = tau / duration
    turn = 2.0 * math.pi * u
    s1, c1, s2, c2 = math.sin(turn), math.cos(turn), math.sin(2.0 * turn), math.cos(2.0 * turn)
    covered = 0.5 * u * u - (16.0 * (1.0 - c1) - (1.0 - c2)) / (48.0 * math.pi**2)
    risen = u - (8.0 * s1 - s2) / (12.0 * math.pi)
    weight = 1.0 - (4.0 * c1 - c2) / 3.0
    slope = math.pi / 3.0 * (8.0 * s1 - 4.0 * s2)
    return (
        k,
        phases[k, 2] + v0 * tau + change * duration * covered,
        v0 + change * risen,
        change * weight / duration,
        change * slope / duration**2,
    )


@njit(cache=True, nogil=True)
def _travel(phases: FloatArray, time: FloatArray, out: FloatArray) -> None:
    k = 0
    for i in range(time.size):
        k, out[i, 0], out[i, 1], out[i, 2], out[i, 3] = travel(phases, k, time[i])
