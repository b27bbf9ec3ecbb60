"""What the estimate of a mounting works on: an IMU's increments and an antenna's motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deepseis_core.errors import InputError
from deepseis_core.types import FloatArray


@dataclass(frozen=True)
class ImuSeries:
    """Increments of an IMU without gaps.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Ends of the intervals, by the IMU's stamps [s].
    dt : ndarray, shape (n,)
        Their lengths [s].
    delta_theta_b, delta_vel_b : ndarray, shape (n, 3)
        Forward-right-down [rad, m/s].
    """

    time: FloatArray
    dt: FloatArray
    delta_theta_b: FloatArray
    delta_vel_b: FloatArray

    def __post_init__(self) -> None:
        """Refuse what is no series."""
        if len(self.time) < 2 or not np.all(np.diff(self.time) > 0.0):
            raise InputError("mounting", "the IMU's samples are not in order, or less than two")

    def before(self, time: float) -> ImuSeries:
        """Return the part up to a time, at least two samples [s]."""
        return self.part(0, max(2, int(np.searchsorted(self.time, time, "right"))))

    def part(self, begin: int, end: int) -> ImuSeries:
        """Return some of the samples."""
        part = slice(begin, end)
        return ImuSeries(
            self.time[part], self.dt[part], self.delta_theta_b[part], self.delta_vel_b[part]
        )


@dataclass(frozen=True)
class AntennaSeries:
    """How the antenna moved.

    Attributes
    ----------
    time : ndarray, shape (m,)
        [s]
    value : ndarray, shape (m, 3)
        North, east, down, of positions from a fixed place [m] or velocities over ground [m/s].
    sd : ndarray, shape (3,)
        White noise of it.
    is_velocity : bool
    latitude, height : float
        Of the place [rad, m].
    creep : float
        Random walk of positions [m/sqrt(s)].
    """

    time: FloatArray
    value: FloatArray
    sd: FloatArray
    is_velocity: bool
    latitude: float
    height: float
    creep: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what is no series."""
        if len(self.time) < 8 or not np.all(np.diff(self.time) > 0.0):
            raise InputError("mounting", "there are less than eight epochs of GNSS in order")
        if not np.all(self.sd > 0.0):
            raise InputError("mounting", "GNSS has no sigma")

    @property
    def rate_hz(self) -> float:
        """Epochs a second."""
        return 1.0 / float(np.median(np.diff(self.time)))
