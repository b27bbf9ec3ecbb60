"""The start of a surveyed station: from its first still seconds, or, while it moves, from GNSS."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from deepseis_core.errors import InputError
from deepseis_core.geodesy import (
    ecef_from_enu,
    geodetic_from_ecef,
    rotation_enu_ecef,
    rotation_ned_ecef,
)
from deepseis_core.imu_grades import ImuGrade
from deepseis_core.rotation import (
    enu_flu_from_ned_frd,
    euler_from_matrix,
    flu_from_frd,
    matrix_from_quat,
    ned_frd_from_enu_flu,
    quat_from_matrix,
)
from deepseis_core.types import FloatArray, Pvt, Station
from deepseis_ins.alignment import Alignment, Still, gyro_bias, gyrocompassed, levelled
from deepseis_ins.fusion_config import FusionConfig
from deepseis_ins.loose import LooseConfig, LooseFilter
from deepseis_ins.strapdown import NavState

FilterMaker = Callable[..., LooseFilter]
"""Makes a filter: `LooseFilter`, or one that takes the same arguments."""

_DISAGREEMENT = 5.0
"""Times sigma: a surveyed orientation so far from the vertical is not believed."""


@dataclass(frozen=True)
class Site:
    """A station's survey in the filter's axes.

    Attributes
    ----------
    monument_ecef : ndarray, shape (3,)
        [m]
    C_enu_e : ndarray, shape (3, 3)
        Axes at the monument.
    antenna_enu : ndarray, shape (3,)
        From monument to antenna while nothing has moved [m].
    lever_arm_b : ndarray, shape (3,)
        From IMU to antenna, forward-right-down [m].
    C_nb : ndarray, shape (3, 3) or None
        How the IMU stands; None: not surveyed.
    """

    monument_ecef: FloatArray
    C_enu_e: FloatArray
    antenna_enu: FloatArray
    lever_arm_b: FloatArray
    C_nb: FloatArray | None

    @classmethod
    def of(cls, station: Station) -> Site:
        """Take a station's metadata apart; an orientation of zeros is none.

        Raises
        ------
        InputError
            They make no sense.
        """
        name = f"station {station.name}"
        monument = np.asarray(station.monument_ecef, np.float64)
        quat = np.asarray(station.imu_orientation_xyzw, np.float64)
        arms = np.hstack([station.antenna_lever_arm, station.imu_to_antenna])
        if monument.shape != (3,) or not 6.3e6 < np.linalg.norm(monument) < 6.5e6:
            raise InputError(name, f"monument {monument} is not on Earth", "ECEF [m]")
        norm = float(np.linalg.norm(quat))
        if quat.shape != (4,) or not (norm == 0.0 or abs(norm - 1.0) < 1e-3):
            raise InputError(name, f"orientation {quat} is no attitude", "x, y, z, w, length 1")
        if arms.shape != (6,) or not np.all(np.abs(arms) < 1e3):
            raise InputError(name, "a lever arm is not three numbers below a kilometre")
        latitude, longitude, _ = geodetic_from_ecef(monument)
        return cls(
            monument,
            rotation_enu_ecef(latitude, longitude),
            arms[:3],
            flu_from_frd(arms[3:]),
            ned_frd_from_enu_flu(matrix_from_quat(quat / norm)) if norm else None,
        )

    @property
    def antenna_ecef(self) -> FloatArray:
        """Where the antenna is while nothing has moved [m]."""
        return ecef_from_enu(self.antenna_enu, self.monument_ecef)

    def imu_geodetic(self, C_nb: FloatArray) -> FloatArray:
        """Return where the IMU is while nothing has moved [rad, rad, m]."""
        lever_enu = enu_flu_from_ned_frd(C_nb) @ flu_from_frd(self.lever_arm_b)
        return geodetic_from_ecef(ecef_from_enu(self.antenna_enu - lever_enu, self.monument_ecef))


def align(
    config: FusionConfig, grade: ImuGrade, site: Site, still: Still
) -> tuple[Alignment, bool]:
    """Return the attitude, and whether the survey had to be corrected.

    Without a survey gyroscopes find north. A survey that the vertical contradicts gives the
    heading alone.

    Raises
    ------
    InputError
        The IMU is not at rest, or its gyroscopes are not good enough to find north.
    """
    latitude, _, height = (float(value) for value in geodetic_from_ecef(site.monument_ecef))
    if site.C_nb is None:
        return gyrocompassed(still, latitude, height, grade), False
    heading_sd = np.radians(config.heading_sd_deg)
    heading = float(euler_from_matrix(site.C_nb)[2])
    level = levelled(still, heading, heading_sd, latitude, height, grade)
    level_sd = np.radians(config.level_sd_deg)
    # Down of the body's axes is what levelling finds, whatever the heading.
    apart = np.linalg.norm(np.cross(site.C_nb[2], level.C_nb[2]))
    opposite = site.C_nb[2] @ level.C_nb[2] < 0.0
    if opposite or apart > _DISAGREEMENT * np.hypot(level_sd, level.sd[:2].max()):
        return level, True
    surveyed_sd = np.array([level_sd, level_sd, heading_sd])
    return Alignment(quat_from_matrix(site.C_nb), np.diag(surveyed_sd**2)), False


def start_filter(
    config: FusionConfig,
    loose: LooseConfig,
    grade: ImuGrade,
    site: Site,
    still: Still,
    make: FilterMaker = LooseFilter,
) -> tuple[LooseFilter, bool]:
    """Make the filter of a station that has stood still; see `align`."""
    alignment, corrected = align(config, grade, site, still)
    latitude, longitude, height = (float(v) for v in site.imu_geodetic(alignment.C_nb))
    bias = gyro_bias(still, alignment, latitude, grade)
    nav = NavState(latitude, longitude, height, np.zeros(3), alignment.quat_nb)
    filter = make(
        loose,
        grade,
        nav,
        attitude_sd=alignment.covariance,
        # From the monument; how well that is known stands beside the filter (`delayed_filter`).
        position_sd=[config.still_position_sd] * 3,
        velocity_sd=[config.still_velocity_sd] * 3,
        gyro_bias=bias.value,
        gyro_bias_sd=bias.sd,
        smoothing=config.smoothing_lag_s > 0.0,
    )
    return filter, corrected


def start_moving(
    config: FusionConfig,
    loose: LooseConfig,
    grade: ImuGrade,
    site: Site,
    pvt: Pvt,
    rate_b: FloatArray,
    make: FilterMaker = LooseFilter,
) -> LooseFilter:
    """Make the filter of a surveyed station that may be moving.

    Place and attitude are those of the survey, to the sigmas ``joined_*``; the velocity is that
    of GNSS; biases are unknown as the grade says. The IMU's own errors need no rest to be found:
    the updates with GNSS do that, more slowly.

    Parameters
    ----------
    config : FusionConfig
    loose : LooseConfig
    grade : ImuGrade
    site : Site
        With a surveyed attitude.
    pvt : Pvt
        Epoch at which the filter starts; it must have a velocity.
    rate_b : ndarray, shape (3,)
        Rate of turn measured then, forward-right-down [rad/s].
    make : callable, optional
        Makes the filter.

    Raises
    ------
    InputError
        The attitude has not been surveyed.
    """
    if site.C_nb is None:
        raise InputError("fusion", "cannot start while moving: the orientation is not surveyed")
    latitude, longitude, height = (float(v) for v in site.imu_geodetic(site.C_nb))
    C_ne = rotation_ned_ecef(latitude, longitude)
    lever = site.C_nb @ np.cross(rate_b, site.lever_arm_b)
    velocity = C_ne @ np.asarray(pvt.velocity_ecef) - lever
    formal = np.sqrt(np.diag(np.reshape(pvt.velocity_covariance_ecef, (3, 3))).max())
    nav = NavState(latitude, longitude, height, velocity, quat_from_matrix(site.C_nb))
    return make(
        loose,
        grade,
        nav,
        attitude_sd=np.radians([config.joined_attitude_sd_deg] * 3),
        position_sd=[config.joined_position_sd] * 3,
        velocity_sd=[max(config.joined_velocity_sd, float(formal))] * 3,
    )
