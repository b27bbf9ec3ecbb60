"""Checks of the receiver: start, place, clock, signal."""

from __future__ import annotations

from math import sqrt
from typing import Final

import numpy as np

from deepseis_bringup.commission.checks import OPEN, Check, allan, enu, judge
from deepseis_bringup.commission.data import StationData
from deepseis_core.constants import SPEED_OF_LIGHT
from deepseis_core.geodesy import ecef_from_enu, enu_from_ecef
from deepseis_core.gps_time import GpsTime
from deepseis_core.types import PreciseStatus

SPP_SD: Final = np.array([2.0, 2.0, 4.0])
"""Of the mean of single-point positions of one frequency, east, north, up: atmosphere [m]."""
PHASE_CENTRE: Final = 0.02
"""Largest error of the antenna's place against a base that is taken [m]."""
DRIFT: Final = 5e-6
CLOCK_ALLAN: Final = 3e-9
START_S: Final = 0.5
CN0_DBHZ: Final = 40.0
HIGH_DEG, LOW_DEG = 40.0, 15.0


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
    return [judge(name, abs(late) > START_S, f"{late:+.4f} s", f"within {START_S} s", text)]


def position(data: StationData) -> list[Check]:
    """Compare the mean position with monument and lever arm."""
    name = "monument, by mean position"
    seen = [p for p in data.placed if not data.has_imu or data.is_still_at(p.sample_index)]
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
    return [judge(name, bad, f"E N U {enu(mean)} m", expected, text)]


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
    return [judge(name, bad, f"E N U {enu(mean, 3)} m", expected, text)]


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
        judge("clock source, frequency", abs(mean) > DRIFT, f"{mean * 1e9:+.1f} ppb",
              f"within {DRIFT * 1e6:g} ppm", "the reference is not connected, or of a poor kind"),
        judge(f"clock source, Allan deviation at {tau:g} s", sigma > CLOCK_ALLAN,
              f"{sigma:.2g} (the measurement's noise in it)", f"below {CLOCK_ALLAN:g}",
              "the oscillator wanders: phases move together, loops lose lock when narrow"),
    ]  # fmt: skip


def signal(data: StationData) -> list[Check]:
    """Look at C/N0 of high satellites, and at the sky."""
    if not data.placed or not data.observations:
        return [Check("C/N0", OPEN, "no position or no observations", "")]
    last = data.placed[-1]
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
        first = judge(f"C/N0 above {HIGH_DEG:g} deg, median", float(np.median(high)) < CN0_DBHZ,
                      f"{np.median(high):.1f} dB-Hz", f"at least {CN0_DBHZ:g}", text)  # fmt: skip
    around = sorted(azimuth[s] % 360.0 for s, e in height.items() if e > LOW_DEG)
    gaps = np.diff([*around, around[0] + 360.0]) if around else np.array([360.0])
    widest = float(np.max(gaps))
    text = f"nothing above {LOW_DEG:g} deg in that sector: look for what hides it"
    second = judge("widest empty sector of the sky", widest > 180.0, f"{widest:.0f} deg",
                   "at most 180 deg", text)  # fmt: skip
    return [first, second]
