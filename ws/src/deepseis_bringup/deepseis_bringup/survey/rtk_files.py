"""RTK of two sets of RINEX files after the fact: solutions as a table, as CSV and as .pos."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deepseis_core.constants import NS_PER_S
from deepseis_core.errors import InputError
from deepseis_core.geodesy import geodetic_from_ecef, rotation_enu_ecef
from deepseis_core.gps_time import GpsTime
from deepseis_core.types import FloatArray, PreciseStatus
from deepseis_pvt.rtk import RtkConfig, RtkEpoch, solve_files

QUALITY = {int(PreciseStatus.FIX): 1, int(PreciseStatus.FLOAT): 2}
"""RTKLIB's marks of quality in a .pos file."""


@dataclass(frozen=True)
class RtkTable:
    """All epochs of the rover, n of them; NaN where there is no solution.

    Attributes
    ----------
    times : list of GpsTime
    status : ndarray, shape (n,)
        `PreciseStatus`: FIX, FLOAT or NONE.
    position_ecef, sd_enu : ndarray, shape (n, 3)
        Antenna, and one sigma east, north, up there [m].
    covariance_ecef : ndarray, shape (n, 3, 3)
        [m^2]
    enu : ndarray, shape (n, 3)
        East, north, up of the median of the fixed positions (of all, if none is fixed) [m].
    ratio, age, satellites : ndarray, shape (n,)
        Of the ambiguities' test; of the base's observations [s]; number used.
    """

    times: list[GpsTime]
    status: Any
    position_ecef: FloatArray
    covariance_ecef: FloatArray
    enu: FloatArray
    sd_enu: FloatArray
    ratio: FloatArray
    age: FloatArray
    satellites: Any

    @property
    def seconds(self) -> FloatArray:
        """Times since the first epoch [s]."""
        return np.array([1e-9 * time.diff_ns(self.times[0]) for time in self.times])

    def figures(self) -> dict[str, Any]:
        """Return what a summary says."""
        fixed = self.status == PreciseStatus.FIX
        floating = self.status == PreciseStatus.FLOAT
        found: dict[str, Any] = {
            "epochs": len(self.times),
            "fixed": int(fixed.sum()),
            "float": int(floating.sum()),
            "none": int((~(fixed | floating)).sum()),
            "fixed_percent": round(100.0 * float(fixed.mean()), 2),
        }
        if fixed.any():
            found["spread_fixed_enu_m"] = self.enu[fixed].std(axis=0).round(5).tolist()
            found["ratio_median"] = round(float(np.median(self.ratio[fixed])), 2)
        return found


def solve(
    rover: Path,
    base: Path,
    navigation: Sequence[Path],
    config: RtkConfig,
    base_position: FloatArray | None = None,
) -> RtkTable:
    """Solve a rover's file against a base's.

    Raises
    ------
    InputError
        A file cannot be used, or not one epoch has a solution.
    """
    epochs = list(solve_files(rover, base, navigation, config, base_position))
    if not any(epoch.solution for epoch in epochs):
        raise InputError(rover, "has no epoch with a solution", "other times, or no orbits?")
    return _table(epochs)


def _table(epochs: Sequence[RtkEpoch]) -> RtkTable:
    n = len(epochs)
    position, covariance = np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan)
    status, satellites = np.zeros(n, np.int64), np.zeros(n, np.int64)
    ratio, age = np.full(n, np.nan), np.full(n, np.nan)
    for k, epoch in enumerate(epochs):
        s = epoch.solution
        if s is not None:
            position[k], covariance[k], status[k] = s.position_ecef, s.covariance_ecef, s.status
            ratio[k], age[k], satellites[k] = s.ratio, s.age, len(s.satellites)
    chosen = status == PreciseStatus.FIX
    middle = np.nanmedian(position[chosen] if chosen.any() else position, axis=0)
    axes = rotation_enu_ecef(*geodetic_from_ecef(middle)[:2])
    turned = axes @ covariance @ axes.T
    return RtkTable(
        [GpsTime(e.week, round(e.tow * NS_PER_S)) for e in epochs],
        status,
        position,
        covariance,
        (position - middle) @ axes.T,
        np.sqrt(np.maximum(np.diagonal(turned, axis1=1, axis2=2), 0.0)),
        ratio,
        age,
        satellites,
    )


CSV_COLUMNS = (
    *("gps_week", "tow_s", "status", "satellites", "ratio", "age_s", "latitude_deg"),
    *("longitude_deg", "height_m", "x_m", "y_m", "z_m", "east_m", "north_m", "up_m"),
    *("sd_east_m", "sd_north_m", "sd_up_m"),
)


def write_csv(table: RtkTable, path: Path) -> None:
    """Write every epoch; where there is no solution, fields are empty."""
    with path.open("w", newline="", encoding="ascii") as file:
        writer = csv.writer(file)
        writer.writerow(CSV_COLUMNS)
        for k, time in enumerate(table.times):
            head = [time.week, f"{time.tow_s():.4f}", PreciseStatus(table.status[k]).name.lower()]
            if not np.isfinite(table.position_ecef[k, 0]):
                writer.writerow([*head, *[""] * (len(CSV_COLUMNS) - len(head))])
                continue
            lat, lon, height = geodetic_from_ecef(table.position_ecef[k])
            place = [f"{np.degrees(lat):.10f}", f"{np.degrees(lon):.10f}", f"{height:.4f}"]
            rest = [*table.position_ecef[k], *table.enu[k], *table.sd_enu[k]]
            mid = [table.satellites[k], f"{table.ratio[k]:.2f}", f"{table.age[k]:.3f}"]
            writer.writerow([*head, *mid, *place, *(f"{value:.5f}" for value in rest)])


def write_pos(table: RtkTable, path: Path, about: Sequence[str]) -> None:
    """Write solutions as RTKLIB's ``.pos``: GPS time, ECEF; Q 1 fixed, 2 float."""
    lines = [f"% {text}" for text in about]
    names = ["sdx(m)", "sdy(m)", "sdz(m)", "sdxy(m)", "sdyz(m)", "sdzx(m)"]
    lines.append(
        "%  GPST                      x-ecef(m)      y-ecef(m)      z-ecef(m)   Q  ns "
        + " ".join(f"{name:>8}" for name in names)
        + "  age(s)  ratio"
    )
    for k, time in enumerate(table.times):
        if int(table.status[k]) not in QUALITY:
            continue
        C = table.covariance_ecef[k]
        parts = [C[0, 0], C[1, 1], C[2, 2], C[0, 1], C[1, 2], C[2, 0]]
        roots = [np.sign(value) * np.sqrt(abs(value)) for value in parts]
        position = " ".join(f"{value:14.4f}" for value in table.position_ecef[k])
        lines.append(
            f"{calendar(time)} {position} {QUALITY[int(table.status[k])]:3d} "
            f"{table.satellites[k]:3d} {' '.join(f'{value:8.4f}' for value in roots)} "
            f"{table.age[k]:6.2f} {table.ratio[k]:6.1f}"
        )
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


def calendar(time: GpsTime) -> str:
    """Return a GPS time as RTKLIB's files have it.

    Examples
    --------
    >>> calendar(GpsTime(2190, 525_601_500_000_000))
    '2022/01/01 02:00:01.500'
    """
    year, month, day, hour, minute, ns = time.add_ns(500_000).to_calendar()
    return f"{year:04d}/{month:02d}/{day:02d} {hour:02d}:{minute:02d}:{ns // 10**6 / 1e3:06.3f}"


def write_summary(table: RtkTable, path: Path, about: dict[str, Any]) -> dict[str, Any]:
    """Write what a program reads first, and return it."""
    found = {**table.figures(), **about}
    path.write_text(json.dumps(found, indent=2) + "\n")
    return found
