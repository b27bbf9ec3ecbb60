"""Check of IMU and GNSS against each other while the station moves."""

from __future__ import annotations

from itertools import permutations, product
from typing import Final

import numpy as np

from deepseis_bringup.commission.align import CREEP, LEAST_SD, config_for
from deepseis_bringup.commission.checks import AXES, FAIL, OPEN, PASS, Check, enu, judge
from deepseis_bringup.commission.data import StationData
from deepseis_core.errors import InputError
from deepseis_core.geodesy import geodetic_from_ecef, rotation_ned_ecef
from deepseis_core.rotation import ned_frd_from_enu_flu, quat_from_matrix
from deepseis_core.types import PreciseStatus
from deepseis_frontend.imu_file import Installation
from deepseis_ins.mounting import AntennaSeries, Mounting, estimate_mounting
from deepseis_ins.mounting_search import search

LEVER_ARM: Final = 0.02
OFFSET_S: Final = 1e-3


def shaking(data: StationData) -> list[Check]:
    """Compare IMU and GNSS while it moves: axes, time offset, lever arm."""
    name = "IMU and GNSS while moving"
    hint = "move or shake the antenna's mount for half a minute, 0.1 g and more"
    if not data.has_imu or not data.moves():
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
    agrees = Check(name, PASS, f"agreement {found.agreement:.2f}", "above 0.5")
    return [agrees, _time_offset(found), _lever_arm(data, found)]


def _time_offset(found: Mounting) -> Check:
    name, offset, sd = "IMU's time offset", found.time_offset, found.time_offset_sd
    said = f"{offset * 1e3:+.2f} ms, sigma {sd * 1e3:.2f}"
    if sd > OFFSET_S:
        return Check(name, OPEN, said, f"0 within {OFFSET_S * 1e3:g} ms", "shake more")
    limit = max(OFFSET_S, 3.0 * sd)
    text = "time: {offset: ...} of the IMU's description"
    return judge(name, abs(offset) > limit, said, f"0 within {limit * 1e3:.2f} ms", text)


def _lever_arm(data: StationData, found: Mounting) -> Check:
    name = "lever arm, IMU to antenna"
    if not found.lever_arm_shows.all():
        hint = "tilt the mount to and fro by some degrees"
        return Check(name, OPEN, "it did not turn", "", hint)
    arm, sd = found.imu_to_antenna, found.imu_to_antenna_sd
    says = np.asarray(data.station.imu_to_antenna)
    limit = np.maximum(LEVER_ARM, 3.0 * sd)
    bad = bool(np.any(np.abs(arm - says) > limit))
    said = f"{enu(arm, 3)} m, sigma {enu(sd, 3)}"
    expected = f"{enu(says, 3)} within {enu(limit, 3)}"
    return judge(name, bad, said, expected, "imu_to_antenna, forward, left, up")


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
                names = [f"{'-' if s < 0 else ''}{AXES[c]}" for c, s in each]
                said = ", ".join(f"{n} is {m}" for n, m in zip(AXES, names, strict=True) if n != m)
                best = (agreement, said or "axes as said")
    return best[1]
