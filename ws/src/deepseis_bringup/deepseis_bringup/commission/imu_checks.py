"""Checks of the IMU at rest: axes, units, noise."""

from __future__ import annotations

from math import degrees, sqrt
from typing import Final

import numpy as np
from numpy.typing import NDArray

from deepseis_bringup.commission.checks import AXES, OPEN, Check, allan, enu, judge
from deepseis_bringup.commission.data import StationData
from deepseis_core.geodesy import geodetic_from_ecef, normal_gravity
from deepseis_core.imu_grades import TriadGrade
from deepseis_core.rotation import enu_from_ned
from deepseis_core.types import FloatArray
from deepseis_ins.alignment import earth_rate

TILT_DEG: Final = 0.3
NOISE_RATIO: Final = 1.6


def gravity(data: StationData) -> list[Check]:
    """Compare the specific force at rest with gravity upwards."""
    name = "IMU's axes, by gravity"
    if not data.has_imu:
        return [Check(name, OPEN, "no IMU", "")]
    force = data.windows.force[data.still()].mean(axis=0)
    place = geodetic_from_ecef(data.station.monument_ecef)
    g = float(normal_gravity(place[0], place[2]))
    accel = data.grade.accelerometers
    sd = sqrt(accel.bias**2 + accel.instability**2 + (g * accel.scale) ** 2)
    size = float(np.linalg.norm(force))
    strength = judge("specific force at rest", abs(size - g) > max(0.02, 3.0 * sd),
                     f"{size:.4f} m/s^2", f"{g:.4f} within {max(0.02, 3.0 * sd):.3f}",
                     "unit or scale of the accelerometers, or gravity is taken off")  # fmt: skip
    up = force / size
    C = data.C_enu_b
    says = np.array([0.0, 0.0, 1.0]) if C is None else C.T @ np.array([0.0, 0.0, 1.0])
    tilt = degrees(np.arccos(np.clip(up @ says, -1.0, 1.0)))
    slope = sqrt(sd**2 + (g * accel.misalignment) ** 2) / g
    limit = 5.0 if C is None else max(TILT_DEG, degrees(3.0 * slope))
    axis = int(np.argmax(np.abs(up)))
    text = f"upwards is {'+' if up[axis] > 0 else '-'}{AXES[axis]} by the data: axes or signs"
    found, expected = f"{tilt:.2f} deg from where it is said", f"at most {limit:.2f} deg"
    return [strength, judge(name, tilt > limit, found, expected, text)]


def turning(data: StationData) -> list[Check]:
    """Compare the rate at rest with the Earth's."""
    name = "gyroscopes' axes, by the Earth's rate"
    if not data.has_imu or not data.grade.has_gyros:
        return [Check(name, OPEN, "no gyroscopes", "")]
    still = data.still()
    rate = data.windows.rate[still].mean(axis=0)
    gyros = data.grade.gyros
    sd = sqrt(gyros.bias**2 + gyros.instability**2 + gyros.walk**2 / max(1, int(still.sum())))
    place = geodetic_from_ecef(data.station.monument_ecef)
    earth = enu_from_ned(earth_rate(place[0]))
    size = judge("rate of turn at rest", float(np.linalg.norm(rate)) > 3.0 * sqrt(3) * sd + 1e-4,
                 f"{degrees(float(np.linalg.norm(rate))):.4f} deg/s",
                 f"at most {degrees(3.0 * sqrt(3) * sd + 1e-4):.4f} deg/s",
                 "unit or bias of the gyroscopes")  # fmt: skip
    C = data.C_enu_b
    if C is None or 3.0 * sd > 0.5 * float(np.linalg.norm(earth)):
        why = "attitude not surveyed" if C is None else "the grade's bias hides the Earth's turn"
        return [size, Check(name, OPEN, why, "shaking and tilting tell signs as well")]
    off = C @ rate - earth
    bad = bool(np.any(np.abs(off) > 3.5 * sd + 0.02 * np.linalg.norm(earth)))
    text = "signs or order of the gyroscopes, or the surveyed heading"
    found = f"off by E N U {enu(np.degrees(off) * 3600.0, 2)} deg/h"
    return [size, judge(name, bad, found, f"within {degrees(3.5 * sd) * 3600:.2f} deg/h", text)]


def noise(data: StationData) -> list[Check]:
    """Compare the IMU's noise at rest with its grade, by the Allan deviation."""
    if not data.has_imu:
        return []
    windows, grade = data.windows, data.grade
    quiet = np.zeros(windows.second[-1] + 1, np.bool_)
    quiet[windows.second[data.still() & windows.whole]] = True
    begin, end = _longest(quiet)
    if end - begin < 5:
        return [Check("IMU's noise", OPEN, "no 5 s at rest", "")]
    first, last = np.searchsorted(windows.of_sample, [begin, end])
    part = data.imu[first:last]
    rate = np.array([s.angular_velocity for s in part])
    force = np.array([s.linear_acceleration for s in part])
    return [
        _noise_of(data, what, triad, values)
        for what, triad, values in (
            ("gyroscopes", grade.gyros, rate),
            ("accelerometers", grade.accelerometers, force),
        )
        if np.isfinite(values).all() and triad.walk > 0.0
    ]


def _noise_of(data: StationData, what: str, triad: TriadGrade, values: FloatArray) -> Check:
    step = 1.0 / data.imu_rate_hz
    tau = min(1.0, 0.1 * len(values) * step)
    # increments are rounded to the resolution: as noise of its own
    rounded = triad.resolution / sqrt(6.0) / tau
    expected = sqrt(triad.walk**2 / tau + rounded**2 + triad.instability**2)
    ratio = np.array([allan(values[:, k], step, tau) for k in range(3)]) / expected
    most = NOISE_RATIO + 2.0 / sqrt(len(values) * step / tau)  # 2 sigma of the estimate
    least = 1.0 / (4.0 * most)
    worst = int(np.argmax(np.abs(np.log(np.maximum(ratio, 1e-12)))))
    bad = bool(np.any(ratio > most) or np.any(ratio < least))
    text = (
        f"{AXES[worst]}: vibration of the mount, or not the grade {data.station.imu}"
        if ratio[worst] > 1.0
        else f"{AXES[worst]}: too quiet, dead or filtered"
    )
    found = " ".join(f"{r:.2f}" for r in ratio)
    name = f"noise of the {what} at {tau:g} s, times the grade's"
    return judge(name, bad, found, f"{least:.2f} to {most:.2f}", text)


def _longest(still: NDArray[np.bool_]) -> tuple[int, int]:
    """Return where the longest run of True begins and ends."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.asarray(still, int), [0]])))
    runs = list(zip(edges[::2], edges[1::2], strict=True))
    begin, end = max(runs, key=lambda run: run[1] - run[0]) if runs else (0, 0)
    return int(begin), int(end)
