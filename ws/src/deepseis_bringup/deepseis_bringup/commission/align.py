"""Time offset and lever arm of an IMU from a run without it: `deepseis align`.

Both stand on the clock of the IF samples: epochs of GNSS by their sample index, IMU samples by
what their file says of time 0. So the offset is what is to be added to the IMU's own times.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np

from deepseis_bringup.export.convert_bag import ConvertBag
from deepseis_bringup.report.run_data import EPOCHS_TYPE
from deepseis_core.errors import InputError
from deepseis_core.geodesy import geodetic_from_ecef, rotation_ned_ecef
from deepseis_core.imu_grades import grade_named
from deepseis_core.mcap_scan import McapScan
from deepseis_core.ros import codecs
from deepseis_core.rotation import flu_from_frd, ned_frd_from_enu_flu, quat_from_matrix
from deepseis_core.rotation import matrix_from_quat as matrix
from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import FloatArray, ImuSample, PrecisePosition, PreciseStatus, Pvt
from deepseis_frontend.if_bag import bag_files
from deepseis_frontend.imu_file import Installation
from deepseis_frontend.imu_open import ImuRecording, open_imu
from deepseis_ins.mounting import (
    AntennaSeries,
    ImuSeries,
    Mounting,
    MountingConfig,
    estimate_mounting,
)

CREEP: Final = 8e-4
"""Of positions by phases, by the satellites' clocks [m/sqrt(s)]."""
LEAST_PRECISE_S: Final = 5.0
LEAST_SD: Final = {"position": 5e-4, "velocity": 5e-3}
LONGEST_S: Final = 3600.0
GRAVITY: Final = 9.80665


@dataclass(frozen=True)
class GnssMotion:
    """What a run says of the antenna: `gnss/precise` where it has that, else `gnss/pvt`."""

    series: AntennaSeries
    topic: str


def run_clock(bag: Path) -> SampleClock:
    """Return the clock of a run's IF samples, by its first integrations.

    Raises
    ------
    InputError
        The bag has none, or does not say the sampling rate.
    """
    files = bag_files(bag)
    scan = McapScan(files[0], tolerant=True)
    for message in scan.messages(lambda channel: channel.type_name == EPOCHS_TYPE):
        epochs, utc_ns = codecs.TRACKING_EPOCHS.decode(bytes(message.data))
        rate = json.loads(scan.metadata.get("parameters", {}).get("pvt", "{}"))
        if "sample_rate_hz" not in rate:
            break
        return SampleClock.from_sample(
            epochs.block_sample_index, utc_ns, float(rate["sample_rate_hz"])
        )
    raise InputError(bag, "is no run of the graph: its clock is not known")


def gnss_motion(bag: Path, clock: SampleClock) -> GnssMotion:
    """Return how the antenna moved in a run.

    Raises
    ------
    InputError
        There is no position in the bag.
    """
    precise: list[PrecisePosition] = []
    positions: list[Pvt] = []
    for _, value, _ in ConvertBag(bag).values(("gnss/precise", "gnss/pvt")):
        if isinstance(value, PrecisePosition):
            if value.status == PreciseStatus.PHASE and np.isfinite(value.displacement_enu).all():
                precise.append(value)
        elif np.isfinite(value.velocity_ecef).all():
            positions.append(value)
    if not positions:
        raise InputError(bag, "holds no position", "it needs a fix")
    place = geodetic_from_ecef(np.median([p.position_ecef for p in positions], axis=0))
    rate = clock.sample_rate_hz
    if len(precise) > 8 and _length(precise, rate) > LEAST_PRECISE_S:
        values = np.array([p.displacement_enu for p in precise])[:, [1, 0, 2]] * [1.0, 1.0, -1.0]
        variance = np.median([np.diag(p.covariance_enu.reshape(3, 3)) for p in precise], axis=0)
        sd = np.sqrt(variance)[[1, 0, 2]]
        sd = np.maximum(sd, LEAST_SD["position"])
        found = AntennaSeries(_times(precise, rate), values, sd, False, place[0], place[2], CREEP)
        return GnssMotion(found, "gnss/precise")
    C_ne = rotation_ned_ecef(*place[:2])
    covariance = np.median([p.velocity_covariance_ecef for p in positions], axis=0).reshape(3, 3)
    sd = np.sqrt(np.diag(C_ne @ covariance @ C_ne.T))
    values = np.array([C_ne @ p.velocity_ecef for p in positions])
    sd = np.maximum(sd, LEAST_SD["velocity"])
    found = AntennaSeries(_times(positions, rate), values, sd, True, place[0], place[2])
    return GnssMotion(found, "gnss/pvt")


def _times(values: Sequence[Any], rate_hz: float) -> FloatArray:
    return np.array([value.sample_index for value in values], np.float64) / rate_hz


def _length(values: Sequence[Any], rate_hz: float) -> float:
    return float(values[-1].sample_index - values[0].sample_index) / rate_hz


def imu_series(samples: Iterable[ImuSample], clock: SampleClock, rate_hz: float) -> ImuSeries:
    """Return increments, forward-right-down, of samples on the IF's clock.

    Raises
    ------
    InputError
        There are less than two.
    """
    some = list(islice(samples, int(LONGEST_S * rate_hz)))
    time = np.array([s.sample_index for s in some], np.float64) / clock.sample_rate_hz
    dt = np.full(len(some), 1.0 / rate_hz)
    rate = flu_from_frd(np.array([s.angular_velocity for s in some]).reshape(-1, 3))
    force = flu_from_frd(np.array([s.linear_acceleration for s in some]).reshape(-1, 3))
    if not (np.isfinite(rate).all() and np.isfinite(force).all()):
        raise InputError("IMU", "has no gyroscopes, or values that are not finite")
    return ImuSeries(time, dt, rate / rate_hz, force / rate_hz)


def config_for(stands: Installation | None) -> MountingConfig:
    """Return settings for the grade of an IMU, where it is said."""
    if stands is None or not stands.grade:
        return MountingConfig()
    grade = grade_named(stands.grade)
    gyros, accels = grade.gyros, grade.accelerometers
    tilt = GRAVITY * (accels.scale + accels.misalignment)
    return MountingConfig(
        gyro_bias_sd=max(1e-5, 3.0 * (gyros.bias + gyros.instability)),
        accel_bias_sd=max(1e-3, 3.0 * (accels.bias + accels.instability + tilt)),
        accel_scale_sd=max(1e-4, 3.0 * accels.scale),
        accel_walk=max(1e-4, accels.walk),
    )


def installation_of(imu: ImuRecording) -> Installation | None:
    """Return how an IMU stands, where its own description says so."""
    described = getattr(imu, "format", None)
    found = getattr(described, "installation", None)
    return found if isinstance(found, Installation) else None


def surveyed_attitude(stands: Installation | None) -> FloatArray | None:
    """Return the attitude, forward-right-down to north-east-down, or None."""
    if stands is None or not any(stands.orientation_xyzw):
        return None
    C = matrix(np.array(stands.orientation_xyzw, np.float64))
    return quat_from_matrix(ned_frd_from_enu_flu(C))


def align(bag: Path, imu_path: Path | None = None) -> dict[str, Any]:
    """Estimate how an IMU stands to the antenna of a run.

    Parameters
    ----------
    bag : Path
        The run's bag.
    imu_path : Path, optional
        Where the IMU is, if not in that bag.

    Returns
    -------
    dict
        Figures, unit in the name: offset, lever arm, attitude, sigmas.

    Raises
    ------
    InputError
        They cannot be compared, or do not agree.
    """
    clock = run_clock(bag)
    imu = open_imu(imu_path or bag, clock)
    stands = installation_of(imu)
    motion = gnss_motion(bag, clock)
    lever = np.array(stands.imu_to_antenna) if stands is not None else None
    found = estimate_mounting(
        imu_series(imu.samples(), clock, imu.rate_hz),
        motion.series,
        quat_nb=surveyed_attitude(stands),
        lever_arm=lever,
        config=config_for(stands),
    )
    return {**figures_of(found), "compared_with": motion.topic, "imu_rate_hz": imu.rate_hz}


def figures_of(found: Mounting) -> dict[str, Any]:
    """Return an estimate as plain numbers."""
    angles = np.degrees(found.roll_pitch_heading)
    arm, arm_sd = found.imu_to_antenna, found.imu_to_antenna_sd
    axes = ("forward", "left", "up")
    return {
        "time_offset_s": round(found.time_offset, 7),
        "time_offset_sd_s": round(found.time_offset_sd, 7),
        **{f"lever_arm_{a}_m": round(float(v), 4) for a, v in zip(axes, arm, strict=True)},
        **{f"lever_arm_{a}_sd_m": round(float(v), 4) for a, v in zip(axes, arm_sd, strict=True)},
        "lever_arm_shows": bool(found.lever_arm_shows.all()),
        "roll_deg": round(float(angles[0]), 3),
        "pitch_deg": round(float(angles[1]), 3),
        "heading_deg": round(float(angles[2]) % 360.0, 3),
        "agreement": round(found.agreement, 4),
        "residual_ratio": round(found.residual_ratio, 3),
        "stretches": found.stretches,
    }


def as_yaml(figures: dict[str, Any], offset_so_far: float = 0.0) -> str:
    """Return the lines for the IMU's description."""
    total = offset_so_far + figures["time_offset_s"]
    lines = [f"time: {{offset: {total:.6f}}}  # s; in place of what stands there"]
    if figures["lever_arm_shows"]:
        arm = [figures[f"lever_arm_{axis}_m"] for axis in ("forward", "left", "up")]
        lines.append("installation:")
        lines.append(f"  imu_to_antenna: [{', '.join(f'{v:.3f}' for v in arm)}]")
    return "\n".join(lines)


def offset_so_far(imu_path: Path | None, clock: SampleClock) -> float:
    """Return the offset that an IMU's description has already [s]."""
    if imu_path is None:
        return 0.0
    described: Any = getattr(open_imu(imu_path, clock), "format", None)
    return float(described.time.offset) if described is not None else 0.0
