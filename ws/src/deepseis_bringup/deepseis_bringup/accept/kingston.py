"""The Kingston drive of 2008: car, tactical IMU at 10 Hz, GPS, speed of the on-board diagnostics.

A recording of others (Queen's University, J. Georgy and T. Karamat); it is no part of the
project. Axes of the IMU are right-forward-up. Its reference is the INS/GPS solution of the
receiver; heights of the GPS positions are above the geoid, those of the reference above the
ellipsoid.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.io import loadmat

from deepseis_core.errors import InputError
from deepseis_core.geodesy import ecef_from_geodetic, rotation_ned_ecef
from deepseis_core.imu_grades import ImuGrade
from deepseis_core.types import FloatArray
from deepseis_ins.alignment import Alignment, levelled, still_mean
from deepseis_ins.ldv import LdvConfig, LdvRecord
from deepseis_ins.loose import LooseConfig, LooseFilter
from deepseis_ins.strapdown import NavState
from deepseis_ins.survey_records import FixRecord, ImuRecord

FOLDER: Final = Path("gnss_ins", "kingston_2008_tactical")
UNDULATION: Final = -34.1
"""Of the geoid there: median of reference less GPS height [m]."""
START: Final = 400.0
"""After the first sample: it rests until 530 s [s]."""
VELOCITY_SD: Final = 0.1
"""Of GPS velocities, their correlation counted in [m/s]."""
HEADING_SD: Final = np.radians(0.5)
DELAYS: Final = np.arange(-1.0, 1.01, 0.05)
SPEED_SD: Final = (0.15, 0.15)
"""Of the speed, and of no velocity across the road's surface [m/s]."""

GRADE: Final = ImuGrade(
    gyro_bias_deg_per_h=5.0,
    gyro_instability_deg_per_h=1.0,
    gyro_walk_deg_per_sqrt_h=0.3,
    gyro_scale_ppm=300.0,
    gyro_misalignment_deg=0.03,
    accel_bias=0.02,
    accel_instability=0.002,
    accel_walk_per_sqrt_h=0.3,
    accel_scale_ppm=300.0,
    accel_misalignment_deg=0.03,
)
"""What a tactical unit of its class has, its noise that of the log with the engine running."""

SPEED: Final = LdvConfig(window=1.0, noise=0.0, lateral_sd=0.15, scale_sd=0.03, angle_sd_deg=3.0)
"""The speedometer as a velocimeter whose vertical is known to be nothing."""


@dataclass(frozen=True)
class Kingston:
    """The drive; times [s] since its first IMU sample.

    ``speed`` stands for a velocimeter, ``delay`` is what its clock was found to be early [s];
    ``reference_time``, ``reference_ecef`` and ``reference_distance`` [m] are of the reference.
    """

    imu: ImuRecord
    fixes: FixRecord
    speed: LdvRecord
    delay: float
    start: NavState
    alignment: Alignment
    reference_time: FloatArray
    reference_ecef: FloatArray
    reference_distance: FloatArray

    def filter(self) -> LooseFilter:
        """Return a filter as it is at the start."""
        covariance = self.alignment.covariance
        return LooseFilter(
            LooseConfig(covariance_step=0.1),
            GRADE,
            self.start,
            attitude_sd=0.5 * (covariance + covariance.T),
            position_sd=[2.0, 2.0, 4.0],
            velocity_sd=[0.05] * 3,
        )


def read_kingston(data: Path) -> Kingston:
    """Read the drive out of the folder of recordings.

    Raises
    ------
    InputError
        It is not there or not whole.
    """
    folder = data / FOLDER
    try:
        names = ("f_w_IMSseconds_dt", "INSPVA", "CarChip_Speed_interpolated")
        log, reference, chip = (loadmat(folder / f"{name}.mat") for name in names)
        place, motion = (loadmat(folder / f"BESTGPS{name}.mat") for name in ("POS", "VEL"))
    except (OSError, ValueError) as error:
        raise InputError(folder, f"cannot be read: {error}") from None
    first = float(log["IMU_second"].ravel()[0])
    skipped = round(START * 10)
    time = log["IMU_second"].ravel() - first
    force, turn = (
        np.stack([log[name][0, 0][axis].ravel() for axis in "yxz"], axis=1) * [1.0, 1.0, -1.0]
        for name in ("f", "w")
    )
    dt = 0.1
    speed, delay, still = _speed(chip, motion, first, time)
    imu = ImuRecord(time[skipped:], turn[skipped:] * dt, force[skipped:] * dt, dt, still[skipped:])
    fixes = _fixes(place, motion, first)
    geodetic = np.stack(
        [
            np.radians(reference["INS_Lat"].ravel()),
            np.radians(reference["INS_Long"].ravel()),
            reference["INS_Alt"].ravel(),
        ],
        axis=1,
    )
    reference_time = reference["INS_second"].ravel() - first
    at = int(np.searchsorted(reference_time, START))
    mean = still_mean(turn[:skipped] * dt, force[:skipped] * dt, dt)
    heading = np.radians(float(reference["INS_Azi"].ravel()[at]))
    aligned = levelled(mean, heading, HEADING_SD, geodetic[at, 0], geodetic[at, 2], GRADE)
    latitude, longitude, height = (float(x) for x in geodetic[at])
    start = NavState(latitude, longitude, height, np.zeros(3), aligned.quat_nb)
    velocity = np.hypot(reference["INS_vn"].ravel(), reference["INS_ve"].ravel())
    return Kingston(
        imu, fixes, speed, delay, start, aligned, reference_time,
        ecef_from_geodetic(geodetic), np.cumsum(velocity),
    )  # fmt: skip


def _speed(chip: Any, motion: Any, first: float, time: FloatArray) -> tuple[LdvRecord, float, Any]:
    """Return the speed with its clock set by GPS's, that delay, and where it stands."""
    when = chip["CarChip_second_1HZ"].ravel() - first
    value = chip["CarChip_Speed_1HZ"].ravel()
    gps_time, gps = motion["BGV_second"].ravel() - first, motion["BGV_hor_spd"].ravel()
    # The first half of the drive, where the sky is open.
    open_sky = (gps_time > START) & (gps_time < 0.5 * time[-1])
    left = [
        np.std(np.interp(gps_time[open_sky], when + late, value) - gps[open_sky])
        for late in DELAYS
    ]
    delay = float(DELAYS[int(np.argmin(left))])
    standing = np.interp(time, when + delay, np.convolve(value > 0.05, np.ones(5), "same")) < 0.01
    count = when.size
    variance = np.tile([SPEED_SD[0] ** 2, SPEED_SD[1] ** 2, 0.0], (count, 1))
    record = LdvRecord(
        when + delay, np.stack([value, np.zeros(count)], axis=1), variance, np.full(count, 1e3)
    )
    return record, delay, standing


def _fixes(place: Any, motion: Any, first: float) -> FixRecord:
    """Return GPS positions and velocities as fixes, with the receiver's own sigmas."""
    time = place["BGP_second"].ravel() - first
    latitude, longitude = (np.radians(place[f"BGP_{k}"].ravel()) for k in ("Lat", "Long"))
    height = place["BGP_Alt"].ravel() + UNDULATION
    C_ne = rotation_ned_ecef(latitude, longitude)
    sds = np.stack([place[f"BGP_{k}_std"].ravel() for k in ("Lat", "Long", "Alt")], axis=1)
    other = motion["BGV_second"].ravel() - first
    columns = motion["BGV_vn"].ravel(), motion["BGV_ve"].ravel(), -motion["BGV_vu"].ravel()
    velocity = np.stack([np.interp(time, other, column) for column in columns], axis=1)
    square = np.einsum("mki,mk,mkj->mij", C_ne, sds**2, C_ne)
    return FixRecord(
        time,
        ecef_from_geodetic(np.stack([latitude, longitude, height], axis=1)),
        np.einsum("mki,mk->mi", C_ne, velocity),
        square,
        np.tile(VELOCITY_SD**2 * np.eye(3), (time.size, 1, 1)),
        np.zeros(3),
    )
