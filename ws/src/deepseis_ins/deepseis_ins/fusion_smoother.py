"""The fusion's motion some seconds later, with what was measured since then (fixed lag).

The delayed filter hands over every step: what its errors went through, and the track it carried
from the step before. A step is smoothed once it is `smoothing_lag_s` old; between two steps the
errors are those of `deepseis_ins.smoother.between`, so that the track has no jumps at updates.
What the filter undoes is forgotten here too; the lag is longer than anything can be undone.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np

from deepseis_core.geodesy import ecef_from_geodetic, rotation_ned_ecef
from deepseis_core.types import FloatArray, IntArray
from deepseis_ins.error_state import POS, STATES, VEL
from deepseis_ins.smoother import FilterStep, FixedLagSmoother
from deepseis_ins.smoother_loose import errors_between

BATCH_S: Final = 0.2
"""Steps are smoothed together so often; a backward pass costs as much for one [s]."""


@dataclass(frozen=True)
class Carried:
    """What the filter's mechanisation went through up to a step.

    Attributes
    ----------
    sample_index : ndarray, shape (m,)
        Ends of the intervals since the step before.
    geodetic : ndarray, shape (m, 3)
        Latitude, longitude [rad], height [m].
    vel_n : ndarray, shape (m, 3)
        [m/s]
    """

    sample_index: IntArray
    geodetic: FloatArray
    vel_n: FloatArray


@dataclass(frozen=True)
class LateMotion:
    """Smoothed motion at m epochs of the IMU; ECEF, with covariances of north, east, down.

    Attributes
    ----------
    sample_index : ndarray, shape (m,)
    position_ecef, velocity_ecef : ndarray, shape (m, 3)
        Of the IMU [m, m/s].
    position_covariance, velocity_covariance : ndarray, shape (3, 3)
        At their end [m^2, m^2/s^2].
    """

    sample_index: IntArray
    position_ecef: FloatArray
    velocity_ecef: FloatArray
    position_covariance: FloatArray
    velocity_covariance: FloatArray


class FusionSmoother:
    """Holds the filter's steps until they are old enough.

    Parameters
    ----------
    lag : float
        [s]
    interval : float
        Of the IMU [s].
    """

    def __init__(self, lag: float, interval: float) -> None:
        self.interval = interval
        self._smoother = FixedLagSmoother(lag, BATCH_S)
        self._held: deque[tuple[float, Carried | None, FloatArray]] = deque()
        self._last: FloatArray | None = None
        self._due: list[LateMotion] = []

    def push(
        self, time: float, steps: list[FilterStep], carried: Carried, beside: FloatArray
    ) -> None:
        """Take what came to the filter's newest step.

        Parameters
        ----------
        time : float
            Of the step; steps of other kinds at one moment follow each other [s].
        steps : list of FilterStep
            `LooseFilter.take_steps`.
        carried : Carried
            Up to the first of them.
        beside : ndarray, shape (3, 3)
            What adds to the covariance of displacements, north, east, down [m^2].
        """
        for k, step in enumerate(steps):
            self._held.append((time, None if k else carried, beside))
            for late in self._smoother.push(time, step):
                _, track, added = self._held.popleft()
                if track is not None and self._last is not None and len(track.sample_index):
                    P = late.P[:STATES, :STATES].copy()
                    P[POS, POS] += added
                    self._due.append(self._smooth(track, self._last, late.error_before, P))
                self._last = late.error

    def rewind(self, time: float) -> None:
        """Forget the steps at and after a time, which the filter has undone."""
        self._smoother.rewind(time)
        while self._held and self._held[-1][0] >= time:
            self._held.pop()

    def take(self) -> list[LateMotion]:
        """Return what has become old enough since the last call."""
        due, self._due = self._due, []
        return due

    def _smooth(
        self, track: Carried, start: FloatArray, end: FloatArray, P: FloatArray
    ) -> LateMotion:
        m = len(track.sample_index)
        share = np.arange(1.0, m + 1.0) / m
        error = errors_between(start, end, share, m * self.interval)
        latitude, longitude, _ = track.geodetic[-1]
        C_en = rotation_ned_ecef(latitude, longitude).T
        return LateMotion(
            track.sample_index,
            ecef_from_geodetic(track.geodetic) - error[:, POS] @ C_en.T,
            (track.vel_n - error[:, VEL]) @ C_en.T,
            P[POS, POS],
            P[VEL, VEL],
        )
