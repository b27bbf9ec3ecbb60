"""What the estimate of a mounting works on: an IMU's increments and an antenna's motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deepseis_core.config import setting
from deepseis_core.errors import InputError
from deepseis_core.types import FloatArray


@dataclass(frozen=True)
class MountingConfig:
    """Settings of `estimate_mounting`."""

    largest_offset: float = setting(2.0, "searched for on both sides [s]", low=0.01, high=60.0)
    stretch: float = setting(8.0, "length of a stretch of the fit [s]", low=2.0, high=60.0)
    most_stretches: int = setting(40, "fitted, those that move most [-]", low=1, high=1000)
    level_s: float = setting(1.0, "at rest at the start, for levelling [s]", low=0.1, high=600.0)
    attitude_sd: float = setting(0.2, "of a stretch's first attitude [rad]", low=1e-6, high=1.0)
    gyro_bias_sd: float = setting(5e-3, "of the gyroscopes' bias [rad/s]", low=0.0)
    accel_bias_sd: float = setting(0.2, "of the accelerometers' bias [m/s^2]", low=0.0)
    accel_scale_sd: float = setting(3e-3, "of the accelerometers' scale [-]", low=0.0)
    accel_walk: float = setting(2e-3, "velocity random walk [m/s/sqrt(s)]", low=0.0)
    lever_arm_sd: float = setting(3.0, "what is known of the lever arm before [m]", low=1e-4)
    least_turning: float = setting(
        4e-3, "to and fro, r.m.s., below which the lever arm is left as given [rad]", low=0.0
    )
    offset_sd: float = setting(0.1, "of the offset after the search [s]", low=1e-4)
    least_agreement: float = setting(
        0.5, "correlation of both velocities, below which nothing is said [-]", low=0.0, high=1.0
    )


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
