"""Real drives for the acceptance of tight coupling, recorded by others; not part of the project.

Kingston (Ontario) 2008-06-23: a car with a tactical IMU, of which increments of 0.1 s are left, a
NovAtel receiver, and as the reference its maker's own coupling of both (INSPVA). 8 min at rest,
then 51 min of town, 0 to 10 satellites. Its file has positions of satellites, not orbits
(`accept_tight_orbit`), and no TGD: C/A and P2 together tell that against Klobuchar's model.

PSINS: 136 s by car, 70 of them at rest, laser gyroscopes at 200 Hz; no reference.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.io import loadmat

from deepseis_bringup.accept.tight_drive import Drive, Imu, Observed, Truth
from deepseis_bringup.accept.tight_flight import single_point
from deepseis_bringup.accept.tight_orbit import ephemeris_of
from deepseis_core.atmosphere import klobuchar_delay
from deepseis_core.constants import (
    GPS_EARTH_RATE,
    L1_HZ,
    L1_WAVELENGTH,
    NS_PER_S,
    SPEED_OF_LIGHT,
)
from deepseis_core.geodesy import ecef_from_geodetic, geodetic_from_ecef, rotation_ned_ecef
from deepseis_core.hatch import L2_HZ
from deepseis_core.imu_grades import ImuGrade
from deepseis_core.types import Ephemeris, FloatArray
from deepseis_ins.tight import TightConfig

RIGHT_FORWARD_UP: Final = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""To forward-right-down."""

TCXO: Final = TightConfig(
    clock_bias_noise=0.1, clock_drift_noise=0.2, range_false_alarm_probability=1e-3
)
"""Reflections are common: a good range is refused once in a thousand, a bad one at 3.3 sigma."""

CODE_SD, RATE_SD = 2.0, 0.1
"""At the zenith, over the root of the sine of the elevation: what code, reflections and
atmosphere leave [m], [m/s]. Most of it is slow: smoothing takes nothing off it."""

TACTICAL: Final = ImuGrade(
    gyro_bias_deg_per_h=1.5, gyro_instability_deg_per_h=0.5, gyro_walk_deg_per_sqrt_h=0.15,
    gyro_scale_ppm=500.0, gyro_misalignment_deg=0.05, accel_bias=0.01, accel_instability=3e-3,
    accel_walk_per_sqrt_h=0.3, accel_scale_ppm=500.0, accel_misalignment_deg=0.05,
)  # fmt: skip
"""Of Kingston: Allan deviations over the 8 min at rest give 0.1 deg/sqrt(h) and 0.2 m/s/sqrt(h);
more, for what 10 Hz alias of a running car."""

LASER: Final = ImuGrade(
    gyro_bias_deg_per_h=1.0, gyro_instability_deg_per_h=0.5, gyro_walk_deg_per_sqrt_h=0.05,
    gyro_scale_ppm=100.0, gyro_misalignment_deg=0.02, accel_bias=5e-3, accel_instability=1e-3,
    accel_walk_per_sqrt_h=0.05, accel_scale_ppm=300.0, accel_misalignment_deg=0.02,
)  # fmt: skip
"""Of PSINS; as in tests/pipeline/test_real_ins_logs.py."""

PSINS_LAG: Final = 0.45
"""By so much the IMU's times are behind GPS: found there from either half of the drive [s]."""


def kingston(folder: Path) -> Drive:
    """Read the drive of Kingston.

    Parameters
    ----------
    folder : Path
        ``gnss_ins`` of the shared data.
    """
    folder = folder / "kingston_2008_tactical"
    log, raw, ins, imu, air = (
        loadmat(folder / name, squeeze_me=True, struct_as_record=False)
        for name in (
            "GPS_Data_Combined_Nova.mat", "Raw_Data_combined.mat", "INSPVA.mat",
            "f_w_IMSseconds_dt.mat", "IONUTC.mat",
        )
    )  # fmt: skip
    tow = log["GPS_sec"].astype(np.int64)
    week, start = int(log["GPS_week"][0]), int(tow[0])
    columns = {
        "code": "rho_C1", "code_2": "rho_P2", "adr": "phase_L1", "doppler": "dopp_L1",
        "cn0": "c_2_n_L1", "lock": "lockTime_L1", "clock": "dt_sv", "elevation": "el_sat",
        "azimuth": "az_sat",
    }  # fmt: skip
    table = _table(log, "sv_no", columns)
    places = _table(raw, "Sat_Num", {n: n for n in ("Sat_X", "Sat_Y", "Sat_Z", "Sat_VX",
                                                    "Sat_VY", "Sat_VZ")})  # fmt: skip
    klobuchar = np.array([float(air[f"{k}{i}"][0]) for k in "ab" for i in range(4)])
    truth, velocity = _reference(ins, tow)
    delays = _group_delays(table, klobuchar, truth, tow)
    orbits = _orbits(table, places, week, tow, delays)
    numbers = list(orbits)
    t = {key: values[:, numbers] for key, values in table.items()}
    sine = np.sqrt(np.maximum(np.sin(np.radians(t["elevation"])), 0.1))
    lock_before = np.vstack([np.full((1, len(numbers)), np.nan), t["lock"][:-1]])
    observed = Observed(
        (tow - start).astype(np.float64), week, tow * NS_PER_S,
        tuple(orbit.satellite for orbit in orbits.values()), tuple(orbits.values()),
        t["code"], -L1_WAVELENGTH * t["adr"], -L1_WAVELENGTH * t["doppler"],
        ~(t["lock"] > lock_before), t["cn0"], CODE_SD / sine, RATE_SD / sine, klobuchar,
    )  # fmt: skip
    time = imu["IMU_second"] - start
    dt = np.full(time.size, 0.1)
    rates, force = (np.column_stack([getattr(imu[k], a) for a in "xyz"]) for k in ("w", "f"))
    return Drive(
        "Kingston",
        Imu(time, dt, 0.1 * rates @ RIGHT_FORWARD_UP.T, 0.1 * force @ RIGHT_FORWARD_UP.T),
        TACTICAL, observed, Truth(truth, velocity), np.zeros(3), TCXO, (1.0, 470.0),
        smoothed_share=1.0,
    )  # fmt: skip


def _table(data: dict[str, Any], names: str, columns: dict[str, str]) -> dict[str, FloatArray]:
    """Return columns by epoch and number of the satellite, shapes (m, 33), NaN where missing."""
    m = len(data[names])
    out = {key: np.full((m, 33), np.nan) for key in columns}
    for k in range(m):
        numbers = np.atleast_1d(data[names][k]).astype(np.int64)
        for key, name in columns.items():
            values = np.atleast_1d(data[name][k])
            if values.size == numbers.size:
                out[key][k, numbers] = values
    return out


def _reference(ins: dict[str, Any], tow: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return position and velocity of the reference at the epochs, ECEF."""
    geodetic = np.column_stack(
        [np.radians(ins["INS_Lat"]), np.radians(ins["INS_Long"]), ins["INS_Alt"]]
    )
    ned = np.column_stack([ins["INS_vn"], ins["INS_ve"], -ins["INS_vu"]])
    C_ne = rotation_ned_ecef(geodetic[:, 0], geodetic[:, 1])
    out = np.full((2, len(tow), 3), np.nan)
    rows = np.searchsorted(ins["INS_second"], tow)
    known = rows < len(geodetic)
    out[0, known] = ecef_from_geodetic(geodetic)[rows[known]]
    out[1, known] = np.einsum("kij,ki->kj", C_ne, ned)[rows[known]]
    return out[0], out[1]


def _group_delays(
    table: dict[str, FloatArray], klobuchar: FloatArray, place: FloatArray, tow: FloatArray
) -> FloatArray:
    """Return what C/A is late by that neither clock nor Klobuchar knows, shape (33,) [m].

    ``(P2 - C1) / (f1^2 / f2^2 - 1)`` is the ionosphere and TGD, and a constant of the receiver's;
    the median over the drive less the model's ionosphere is taken.
    """
    where = geodetic_from_ecef(np.nanmean(place, axis=0))
    seen = (table["code_2"] - table["code"]) / ((L1_HZ / L2_HZ) ** 2 - 1.0)
    out = np.zeros(33)
    for n in range(33):
        known = np.isfinite(seen[:, n] + table["elevation"][:, n])
        if not known.any():
            continue
        rows = np.flatnonzero(known)[::20]
        model = [
            klobuchar_delay(
                klobuchar[:4], klobuchar[4:], where[0], where[1],
                np.radians(table["elevation"][k, [n]]), np.radians(table["azimuth"][k, [n]]),
                float(tow[k]),
            )[0]
            for k in rows
        ]  # fmt: skip
        out[n] = np.median(seen[rows, n] - model)
    return out


def _orbits(
    table: dict[str, FloatArray], places: dict[str, FloatArray], week: int, tow: FloatArray,
    delays: FloatArray,
) -> dict[int, Ephemeris]:  # fmt: skip
    """Return an ephemeris of every satellite that was seen for two minutes, by number."""
    position, velocity = (
        np.stack([places[f"Sat_{k}{axis}"] for axis in "XYZ"], -1) for k in ("", "V")
    )
    out = {}
    for n in range(33):
        known = np.isfinite(table["code"][:, n] + table["clock"][:, n])
        known &= np.isfinite(position[:, n]).all(axis=-1) & (table["code"][:, n] > 1e7)
        if known.sum() < 120:
            continue
        flight = table["code"][known, n] / SPEED_OF_LIGHT + table["clock"][known, n]
        # The file's positions are in the axes of reception.
        turn = GPS_EARTH_RATE * flight
        x, y, z = position[known, n].T
        cos, sin = np.cos(turn), np.sin(turn)
        at_departure = np.column_stack([cos * x - sin * y, sin * x + cos * y, z])
        out[n], _ = ephemeris_of(
            f"G{n:02d}", week, tow[known] - flight, at_departure, velocity[known, n],
            table["clock"][known, n], tgd=delays[n] / SPEED_OF_LIGHT,
        )  # fmt: skip
    return out


_ROW: Final = (
    *("iode", "crs", "delta_n", "m0", "cuc", "eccentricity", "cus", "sqrt_a", "toe", "cic"),
    *("omega0", "cis", "i0", "crc", "omega", "omega_dot", "i_dot", "l2_code", "week"),
)


def psins(folder: Path) -> Drive:
    """Read the drive of PSINS; smoothing begins with the 27 min of GPS before it."""
    data = loadmat(folder / "psins" / "insgpseo_tc.mat", squeeze_me=True)
    start, imu, rows = float(data["t0"]), data["imu"], data["obss"]
    orbits = {int(row[0]): _broadcast(row) for row in data["ephs"] if row[12] > 5000.0}
    rows = rows[np.isin(rows[:, 1], list(orbits))]
    tow, at = np.unique(rows[:, 0], return_inverse=True)
    numbers = sorted({int(n) for n in rows[:, 1]})
    column = np.searchsorted(numbers, rows[:, 1])
    code, phase, rate = (np.full((len(tow), len(numbers)), np.nan) for _ in range(3))
    code[at, column], phase[at, column] = rows[:, 2], rows[:, 3]
    rate[at, column] = -rows[:, 5]
    # Times of samples jitter by 2 ms about 5 ms: they were stamped, not taken, unevenly.
    dt = np.full(len(imu), (imu[-1, 6] - imu[0, 6]) / (len(imu) - 1))
    time = imu[0, 6] + np.cumsum(dt) - PSINS_LAG
    week = next(iter(orbits.values())).week
    flat = np.full(code.shape, 1.0)
    observed = Observed(
        tow - start, week, np.rint(tow * NS_PER_S).astype(np.int64),
        tuple(f"G{n:02d}" for n in numbers), tuple(orbits[n] for n in numbers), code, phase, rate,
        np.zeros(code.shape, np.bool_), 45.0 * flat, CODE_SD * flat, 0.5 * RATE_SD * flat,
    )  # fmt: skip
    unknown = np.full((len(tow), 3), np.nan)
    drive = Drive(
        "PSINS", Imu(time, dt, imu[:, :3] @ RIGHT_FORWARD_UP.T, imu[:, 3:6] @ RIGHT_FORWARD_UP.T),
        LASER, observed, Truth(unknown, unknown), np.zeros(3), TCXO, (0.0, 14.0),
        somewhere=np.zeros(3), smoothed_share=1.0,
    )  # fmt: skip
    first = int(np.searchsorted(observed.time, 0.0))
    fix = single_point(drive, observed.states(), first)
    return replace(drive, somewhere=None if fix is None else fix.position_ecef)


def _broadcast(row: FloatArray) -> Ephemeris:
    """Return an ephemeris of a row in the order of RINEX 2."""
    orbit: dict[str, Any] = dict(zip(_ROW, row[5:24].tolist(), strict=True))
    orbit |= {name: int(orbit[name]) for name in ("iode", "l2_code", "week")}
    return Ephemeris(
        f"G{int(row[0]):02d}", toc=row[1], af0=row[2], af1=row[3], af2=row[4], tgd=row[27],
        **orbit,
    )  # fmt: skip
