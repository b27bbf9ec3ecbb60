"""Checks that a new station stands where, and the way round, that its description says.

Each compares what the data say with what the description says, and fails where the difference is
beyond what chance and the sensors' grade allow. What the data cannot tell is said to be open.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import permutations, product
from math import degrees, sqrt
from typing import Final

import numpy as np
from numpy.typing import NDArray

from deepseis_bringup.commission.align import CREEP, LEAST_SD, config_for
from deepseis_bringup.commission.data import StationData
from deepseis_core.constants import SPEED_OF_LIGHT
from deepseis_core.errors import InputError
from deepseis_core.geodesy import (
    ecef_from_enu,
    enu_from_ecef,
    geodetic_from_ecef,
    normal_gravity,
    rotation_ned_ecef,
)
from deepseis_core.gps_time import GpsTime
from deepseis_core.rotation import enu_from_ned, ned_frd_from_enu_flu, quat_from_matrix
from deepseis_core.types import FloatArray, PreciseStatus
from deepseis_frontend.imu_file import Installation
from deepseis_ins.alignment import earth_rate
from deepseis_ins.mounting import AntennaSeries, Mounting, estimate_mounting
from deepseis_ins.mounting_search import search

PASS, FAIL, OPEN = "pass", "fail", "open"
NAMES: Final = ("forward", "left", "up")
SPP_SD: Final = np.array([2.0, 2.0, 4.0])
"""Of the mean of single-point positions of one frequency, east, north, up: atmosphere [m]."""
PHASE_CENTRE: Final = 0.02
"""Largest error of the antenna's place against a base that is taken [m]."""
TILT_DEG: Final = 0.3
LEVER_ARM: Final = 0.02
OFFSET_S: Final = 1e-3
NOISE_RATIO: Final = 1.6
DRIFT: Final = 5e-6
CLOCK_ALLAN: Final = 3e-9
START_S: Final = 0.5
CN0_DBHZ: Final = 40.0
HIGH_DEG, LOW_DEG = 40.0, 15.0


@dataclass(frozen=True)
class Check:
    """One check: what was found, its sigma, what it should be and how far off it may be."""

    name: str
    status: str
    found: str
    expected: str
    text: str = ""


def all_checks(data: StationData) -> list[Check]:
    """Return all checks of a station, in the order in which a person would mend things."""
    found: list[Check] = []
    each: tuple[Callable[[StationData], list[Check]], ...] = (
        *(start_time, position, phase_centre, clock, signal),
        *(gravity, turning, noise, shaking),
    )
    for check in each:
        found += check(data)
    return found


def _judge(name: str, bad: bool, found: str, expected: str, text: str = "") -> Check:
    return Check(name, FAIL if bad else PASS, found, expected, text if bad else "")


def start_time(data: StationData) -> list[Check]:
    """Compare the recording's start by its own word with GPS time."""
    name = "start of the recording"
    if not data.pvt:
        return [Check(name, OPEN, "no position", f"within {START_S} s of GPS time")]
    off = [
        (data.clock.utc_ns(p.sample_index) - GpsTime(p.week, p.tow_ns).to_utc_ns()) / 1e9
        for p in data.pvt
    ]
    late = float(np.median(off))
    text = "IMU logs and base data that come with UTC are off by as much: set start_utc"
    return [_judge(name, abs(late) > START_S, f"{late:+.4f} s", f"within {START_S} s", text)]


def position(data: StationData) -> list[Check]:
    """Compare the mean position with monument and lever arm."""
    name = "monument, by mean position"
    seen = [p for p in data.pvt if not data.imu or data.is_still_at(p.sample_index)]
    if len(seen) < 20:
        return [Check(name, OPEN, f"{len(seen)} positions at rest", "at least 20")]
    station = data.station
    surveyed = ecef_from_enu(station.antenna_lever_arm, station.monument_ecef)
    off = enu_from_ecef(np.array([p.position_ecef for p in seen]), surveyed)
    mean = off.mean(axis=0)
    spread = off.std(axis=0) / sqrt(max(1.0, len(seen) / 100.0))  # errors last for seconds
    sd = np.hypot(SPP_SD, spread)
    bad = bool(np.any(np.abs(mean) > 3.0 * sd))
    expected = "0 within " + " ".join(f"{v:.1f}" for v in 3.0 * sd) + " m (3 sigma)"
    text = "the monument's coordinates, or its lever arm to the antenna, are of another place"
    return [_judge(name, bad, f"E N U {_enu(mean)} m", expected, text)]


def phase_centre(data: StationData) -> list[Check]:
    """Compare the antenna's place against a base with the surveyed one."""
    name = "antenna's phase centre, against a base"
    fixed = [p for p in data.rtk if p.status == PreciseStatus.FIX]
    fixed = [p for p in fixed if data.is_still_at(p.sample_index)]
    expected = f"0 within {100 * PHASE_CENTRE:.0f} cm and 3 sigma"
    if len(fixed) < 20:
        said = "no base: metres are all that the check of the mean position can tell"
        return [Check(name, OPEN, f"{len(fixed)} fixed positions at rest", expected, said)]
    off = np.array([p.displacement_enu for p in fixed])
    mean, sd = off.mean(axis=0), off.std(axis=0) / sqrt(max(1.0, len(fixed) / 50.0))
    bad = bool(np.any(np.abs(mean) > np.maximum(PHASE_CENTRE, 3.0 * sd)))
    text = "lever arm from the monument, the antenna's phase centre offset, or the base's place"
    return [_judge(name, bad, f"E N U {_enu(mean, 3)} m", expected, text)]


def clock(data: StationData) -> list[Check]:
    """Look at the receiver's clock: how far off, how steady."""
    drift = np.array([p.clock_drift for p in data.pvt if np.isfinite(p.clock_drift)])
    if len(drift) < 30:
        return [Check("clock source", OPEN, f"{len(drift)} drifts", "at least 30")]
    y = drift / SPEED_OF_LIGHT
    step = np.median(np.diff([p.sample_index for p in data.pvt])) / data.clock.sample_rate_hz
    tau = min(1.0, 0.1 * len(y) * float(step))
    sigma = allan(y, float(step), tau)
    mean = float(y.mean())
    return [
        _judge("clock source, frequency", abs(mean) > DRIFT, f"{mean * 1e9:+.1f} ppb",
               f"within {DRIFT * 1e6:g} ppm", "the reference is not connected, or of a poor kind"),
        _judge(f"clock source, Allan deviation at {tau:g} s", sigma > CLOCK_ALLAN,
               f"{sigma:.2g} (the measurement's noise in it)", f"below {CLOCK_ALLAN:g}",
               "the oscillator wanders: phases move together, loops lose lock when narrow"),
    ]  # fmt: skip


def signal(data: StationData) -> list[Check]:
    """Look at C/N0 of high satellites, and at the sky."""
    if not data.pvt or not data.observations:
        return [Check("C/N0", OPEN, "no position or no observations", "")]
    last = data.pvt[-1]
    height = dict(zip(last.satellites, np.degrees(last.elevation), strict=False))
    azimuth = dict(zip(last.satellites, np.degrees(last.azimuth), strict=False))
    cn0: dict[str, list[float]] = {}
    for epoch in data.observations[-500:]:
        for name, value in zip(epoch.satellites, epoch.cn0_dbhz, strict=True):
            cn0.setdefault(name, []).append(float(value))
    high = [float(np.median(cn0[s])) for s, e in height.items() if e > HIGH_DEG and s in cn0]
    if not high:
        first = Check("C/N0", OPEN, f"no satellite above {HIGH_DEG:g} deg", "")
    else:
        text = "antenna, cable, gain or a jammer: the sky alone gives 42 to 50 dB-Hz up there"
        first = _judge(f"C/N0 above {HIGH_DEG:g} deg, median", float(np.median(high)) < CN0_DBHZ,
                       f"{np.median(high):.1f} dB-Hz", f"at least {CN0_DBHZ:g}", text)  # fmt: skip
    around = sorted(azimuth[s] % 360.0 for s, e in height.items() if e > LOW_DEG)
    gaps = np.diff([*around, around[0] + 360.0]) if around else np.array([360.0])
    widest = float(np.max(gaps))
    text = f"nothing above {LOW_DEG:g} deg in that sector: look for what hides it"
    second = _judge("widest empty sector of the sky", widest > 180.0, f"{widest:.0f} deg",
                    "at most 180 deg", text)  # fmt: skip
    return [first, second]


def gravity(data: StationData) -> list[Check]:
    """Compare the specific force at rest with gravity upwards."""
    name = "IMU's axes, by gravity"
    if not data.imu:
        return [Check(name, OPEN, "no IMU", "")]
    force = data.windows[0][data.still()].mean(axis=0)
    place = geodetic_from_ecef(data.station.monument_ecef)
    g = float(normal_gravity(place[0], place[2]))
    accel = data.grade.accelerometers
    sd = sqrt(accel.bias**2 + accel.instability**2 + (g * accel.scale) ** 2)
    size = float(np.linalg.norm(force))
    strength = _judge("specific force at rest", abs(size - g) > max(0.02, 3.0 * sd),
                      f"{size:.4f} m/s^2", f"{g:.4f} within {max(0.02, 3.0 * sd):.3f}",
                      "unit or scale of the accelerometers, or gravity is taken off")  # fmt: skip
    up = force / size
    C = data.C_enu_b
    says = np.array([0.0, 0.0, 1.0]) if C is None else C.T @ np.array([0.0, 0.0, 1.0])
    tilt = degrees(np.arccos(np.clip(up @ says, -1.0, 1.0)))
    slope = sqrt(sd**2 + (g * accel.misalignment) ** 2) / g
    limit = 5.0 if C is None else max(TILT_DEG, degrees(3.0 * slope))
    axis = int(np.argmax(np.abs(up)))
    text = f"upwards is {'+' if up[axis] > 0 else '-'}{NAMES[axis]} by the data: axes or signs"
    found, expected = f"{tilt:.2f} deg from where it is said", f"at most {limit:.2f} deg"
    return [strength, _judge(name, tilt > limit, found, expected, text)]


def turning(data: StationData) -> list[Check]:
    """Compare the rate at rest with the Earth's."""
    name = "gyroscopes' axes, by the Earth's rate"
    if not data.imu or not data.grade.has_gyros:
        return [Check(name, OPEN, "no gyroscopes", "")]
    still = data.still()
    rate = data.windows[1][still].mean(axis=0)
    gyros = data.grade.gyros
    sd = sqrt(gyros.bias**2 + gyros.instability**2 + gyros.walk**2 / max(1, int(still.sum())))
    place = geodetic_from_ecef(data.station.monument_ecef)
    earth = enu_from_ned(earth_rate(place[0]))
    size = _judge("rate of turn at rest", float(np.linalg.norm(rate)) > 3.0 * sqrt(3) * sd + 1e-4,
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
    found = f"off by E N U {_enu(np.degrees(off) * 3600.0, 2)} deg/h"
    return [size, _judge(name, bad, found, f"within {degrees(3.5 * sd) * 3600:.2f} deg/h", text)]


def noise(data: StationData) -> list[Check]:
    """Compare the IMU's noise at rest with its grade, by the Allan deviation."""
    if not data.imu:
        return []
    still = data.still()
    size, longest = round(data.imu_rate_hz), _longest(still)
    if longest[1] - longest[0] < 5:
        return [Check("IMU's noise", OPEN, "no 5 s at rest", "")]
    part = data.imu[longest[0] * size : longest[1] * size]
    tau = min(1.0, 0.1 * len(part) / size)
    out = []
    for what, triad, values in (
        ("gyroscopes", data.grade.gyros, np.array([s.angular_velocity for s in part])),
        ("accelerometers", data.grade.accelerometers,
         np.array([s.linear_acceleration for s in part])),
    ):  # fmt: skip
        if not np.isfinite(values).all() or not triad.walk > 0.0:
            continue
        step = 1.0 / data.imu_rate_hz
        # increments are rounded to the resolution: as noise of its own
        rounded = triad.resolution / sqrt(6.0) / tau
        expected = sqrt(triad.walk**2 / tau + rounded**2 + triad.instability**2)
        each = np.array([allan(values[:, k], step, tau) for k in range(3)])
        share = 2.0 / sqrt(len(part) * step / tau)  # 2 sigma of the estimate
        limit = NOISE_RATIO + share
        ratio = each / expected
        worst = int(np.argmax(np.abs(np.log(ratio))))
        bad = bool(np.any(ratio > limit) or np.any(ratio < 1.0 / (limit * 4.0)))
        text = (
            f"{NAMES[worst]}: vibration of the mount, or not the grade {data.station.imu}"
            if ratio[worst] > 1.0
            else f"{NAMES[worst]}: too quiet, dead or filtered"
        )
        found = " ".join(f"{r:.2f}" for r in ratio)
        out.append(_judge(f"noise of the {what} at {tau:g} s, times the grade's", bad, found,
                          f"{1 / (limit * 4):.2f} to {limit:.2f}", text))  # fmt: skip
    return out


def shaking(data: StationData) -> list[Check]:
    """Compare IMU and GNSS while it moves: axes, time offset, lever arm."""
    name = "IMU and GNSS while moving"
    hint = "move or shake the antenna's mount for half a minute, 0.1 g and more"
    if not data.imu or not data.moves():
        return [Check(name, OPEN, "nothing moved", "agreement above 0.5", hint)]
    seen = antenna_series(data)
    if seen is None:
        return [Check(name, OPEN, "no positions", "agreement above 0.5")]
    try:
        found = mounting(data, seen)
    except InputError as error:
        other = other_axes(data, seen)
        text = f"by the data {other}" if other else "no other order or sign of axes agrees better"
        return [Check(name, FAIL, error.reason, "agreement above 0.5", text)]
    out = [Check(name, PASS, f"agreement {found.agreement:.2f}", "above 0.5")]
    offset, sd = found.time_offset, found.time_offset_sd
    limit, said = max(OFFSET_S, 3.0 * sd), f"{offset * 1e3:+.2f} ms, sigma {sd * 1e3:.2f}"
    if sd > OFFSET_S:
        out.append(Check("IMU's time offset", OPEN, said, f"0 within {OFFSET_S * 1e3:g} ms",
                         "shake more"))  # fmt: skip
    else:
        out.append(_judge("IMU's time offset", abs(offset) > limit, said,
                          f"0 within {limit * 1e3:.2f} ms",
                          "time: {offset: ...} of the IMU's description"))  # fmt: skip
    if not found.lever_arm_shows.all():
        out.append(Check("lever arm, IMU to antenna", OPEN, "it did not turn", "",
                         "tilt the mount to and fro by some degrees"))  # fmt: skip
        return out
    arm, arm_sd = found.imu_to_antenna, found.imu_to_antenna_sd
    says = np.asarray(data.station.imu_to_antenna)
    off = arm - says
    allowed = np.maximum(LEVER_ARM, 3.0 * arm_sd)
    out.append(_judge("lever arm, IMU to antenna", bool(np.any(np.abs(off) > allowed)),
                      f"{_enu(arm, 3)} m, sigma {_enu(arm_sd, 3)}",
                      f"{_enu(says, 3)} within {_enu(allowed, 3)}",
                      "imu_to_antenna, forward, left, up"))  # fmt: skip
    return out


def antenna_series(data: StationData) -> AntennaSeries | None:
    """Return how the antenna moved: precise positions where there are enough, else velocities."""
    place = geodetic_from_ecef(data.station.monument_ecef)
    rate = data.clock.sample_rate_hz
    good = [p for p in data.precise if p.status == PreciseStatus.PHASE]
    if len(good) > 100:
        value = np.array([p.displacement_enu for p in good])[:, [1, 0, 2]] * [1.0, 1.0, -1.0]
        each = [np.diag(np.reshape(p.covariance_enu, (3, 3))) for p in good]
        sd = np.maximum(np.sqrt(np.median(each, axis=0))[[1, 0, 2]], LEAST_SD["position"])
        time = np.array([p.sample_index for p in good]) / rate
        return AntennaSeries(time, value, sd, False, place[0], place[2], CREEP)
    positions = [p for p in data.pvt if np.isfinite(p.velocity_ecef).all()]
    if len(positions) < 50:
        return None
    C = rotation_ned_ecef(*place[:2])
    spread = np.median([np.reshape(p.velocity_covariance_ecef, (3, 3)) for p in positions], axis=0)
    sd = np.maximum(np.sqrt(np.diag(C @ spread @ C.T)), LEAST_SD["velocity"])
    value = np.array([C @ p.velocity_ecef for p in positions])
    time = np.array([p.sample_index for p in positions]) / rate
    return AntennaSeries(time, value, sd, True, place[0], place[2])


def mounting(data: StationData, seen: AntennaSeries) -> Mounting:
    """Fit the IMU to the antenna; the attitude is the surveyed one, if there is any."""
    station, C = data.station, data.C_enu_b
    quat = None if C is None else quat_from_matrix(ned_frd_from_enu_flu(C))
    stands = Installation(grade=station.imu)
    return estimate_mounting(
        data.series(),
        seen,
        quat_nb=quat,
        lever_arm=np.asarray(station.imu_to_antenna),
        config=config_for(stands),
    )


def other_axes(data: StationData, seen: AntennaSeries) -> str:
    """Name the order and signs of axes with which IMU and GNSS agree best, if they do.

    Only the forces are looked at: a few tenths of a degree of turning do not matter here.
    """
    C = data.C_enu_b
    if C is None:
        return ""
    series, best = data.series(), (0.5, "")
    turn = ned_frd_from_enu_flu(C)
    sign = np.array([1.0, -1.0, -1.0])
    force = series.delta_vel_b / series.dt[:, None] * sign  # forward, left, up
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            forces = (force[:, order] * signs * sign) @ turn.T
            at = series.time - 0.5 * series.dt
            agreement = search((at, forces), seen, 0.5, heading_known=True).agreement
            if agreement > best[0]:
                each = zip(order, signs, strict=True)
                names = [f"{'-' if s < 0 else ''}{NAMES[c]}" for c, s in each]
                said = ", ".join(
                    f"{n} is {m}" for n, m in zip(NAMES, names, strict=True) if n != m
                )
                best = (agreement, said or "axes as said")
    return best[1]


def allan(values: FloatArray, step: float, tau: float) -> float:
    """Return the overlapping Allan deviation of rates or frequencies at one averaging time.

    Examples
    --------
    >>> white = np.random.default_rng(1).standard_normal(100_000)
    >>> bool(abs(allan(white, 0.01, 1.0) / 0.1 - 1.0) < 0.05)
    True
    """
    m = max(1, round(tau / step))
    phase = np.concatenate([[0.0], np.cumsum(values)]) * step
    second = phase[2 * m :] - 2.0 * phase[m:-m] + phase[: -2 * m]
    return float(np.sqrt(0.5 * np.mean(second**2)) / (m * step))


def _longest(still: NDArray[np.bool_]) -> tuple[int, int]:
    """Return where the longest run of True begins and ends."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.asarray(still, int), [0]])))
    runs = list(zip(edges[::2], edges[1::2], strict=True))
    begin, end = max(runs, key=lambda run: run[1] - run[0]) if runs else (0, 0)
    return int(begin), int(end)


def _enu(value: FloatArray, digits: int = 2) -> str:
    return " ".join(f"{v:+.{digits}f}" if digits else f"{v:+.0f}" for v in value)
