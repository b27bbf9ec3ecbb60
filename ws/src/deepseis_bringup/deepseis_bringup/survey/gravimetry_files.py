"""Files of a gravimetric survey: profiles, series, installation, summary."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any, Final

import numpy as np

from deepseis_bringup.survey.gravimetry import SurveyResult
from deepseis_bringup.survey.gravimetry_page import arrow, page
from deepseis_core.errors import InputError
from deepseis_core.geodesy import ecef_from_enu, ecef_from_geodetic, geodetic_from_ecef
from deepseis_core.imu_grades import MGAL
from deepseis_core.rotation import euler_from_matrix
from deepseis_core.types import FloatArray
from deepseis_ins.gravimetry_lines import Line, coincidence
from deepseis_ins.ldv import LdvInstallation

PROFILE: Final = (
    *("method", "line", "pass", "drive", "direction", "station_m", "latitude_deg"),
    *("longitude_deg", "height_m", "disturbance_mgal", "mean_mgal"),
)
SERIES: Final = ("method", "drive", "time_s", "raw_mgal", "filtered_mgal", "measured")
KEYS: Final = ("roll_pitch_yaw_deg", "scale", "lever_arm_flu_m", "sd_scale_pitch_yaw")


def write_files(result: SurveyResult, folder: Path) -> dict[str, Any]:
    """Write everything into a folder and return the summary."""
    _write_profiles(result, folder / "profiles.csv")
    _write_series(result, folder / "series.csv")
    summary: dict[str, Any] = {
        "drives": [drive.data.name for drive in result.drives],
        "imu_grade": [drive.data.grade_name for drive in result.drives],
        "methods": {method: _figures(lines) for method, lines in result.lines.items()},
        "coupling_mgal_per_mps2": {
            method: [round(float(x), 3) for x in (*found.coefficient, *found.sd)]
            for method, found in result.coupling.items()
        },
    }
    if result.calibration is not None:
        write_installation(result.calibration.installation, folder / "installation.json")
        summary["lever_arm_sd_m"] = [round(float(x), 4) for x in result.calibration.lever.sd]
    (folder / "summary.json").write_text(json.dumps(summary, indent=2) + "\n")
    (folder / "report.html").write_text(page(result), encoding="utf-8")
    return summary


def _figures(lines: list[Line]) -> list[dict[str, Any]]:
    found = []
    for item in lines:
        figures: dict[str, Any] = {
            "length_m": round(float(np.ptp(item.station)), 1),
            "passes": len(item.passes),
        }
        if len(item.passes) > 1:
            agreed = coincidence(item.gravity)
            for name in ("rms", "least", "greatest"):
                values = getattr(agreed, name)
                figures[f"{name}_mgal"] = [round(float(x), 3) for x in values]
            figures["total_mgal"] = round(agreed.total, 3)
        found.append(figures)
    return found


def _write_profiles(result: SurveyResult, path: Path) -> None:
    start = result.drives[0].start
    origin = ecef_from_geodetic(np.array([start.latitude, start.longitude, start.height]))
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(PROFILE)
        for method, lines in result.lines.items():
            for number, item in enumerate(lines, 1):
                writer.writerows(_profile_rows(method, number, item, origin))


def _profile_rows(method: str, number: int, item: Line, origin: FloatArray) -> list[list[str]]:
    plan = item.position.copy()
    plan[:, 2] = 0.0
    degrees = np.degrees(geodetic_from_ecef(ecef_from_enu(plan, origin))[:, :2])
    mean = item.gravity.mean(axis=0)
    return [
        [
            method, str(number), str(k), str(one.drive + 1), arrow(one), f"{item.station[j]:.1f}",
            f"{degrees[j, 0]:.7f}", f"{degrees[j, 1]:.7f}", f"{one.height[j]:.2f}",
            f"{one.gravity[j]:.3f}", f"{mean[j]:.3f}",
        ]
        for k, one in enumerate(item.passes, 1)
        for j in range(item.station.size)
    ]  # fmt: skip


def _write_series(result: SurveyResult, path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(SERIES)
        for method, solutions in result.solutions.items():
            for k, solution in enumerate(solutions):
                s = solution.series
                raw, filtered = ((x - solution.base) / MGAL for x in (s.raw, s.filtered))
                writer.writerows(
                    [method, str(k + 1), f"{t:.2f}", f"{a:.2f}", f"{b:.3f}", str(int(m))]
                    for t, a, b, m in zip(s.time, raw, filtered, s.measured, strict=True)
                )


def write_installation(installation: LdvInstallation, path: Path) -> None:
    """Write an installation as JSON; arm forward-left-up, angles of forward-right-down."""
    angles = np.degrees(euler_from_matrix(installation.C_bd))
    arm = installation.lever_arm_b * [1.0, -1.0, -1.0]
    values = (angles, installation.scale, arm, installation.sd)
    record = {key: np.asarray(value).tolist() for key, value in zip(KEYS, values, strict=True)}
    path.write_text(json.dumps(record, indent=2) + "\n")


def read_installation(path: Path) -> LdvInstallation:
    """Read what `write_installation` wrote.

    Raises
    ------
    InputError
        It is no such file.
    """
    try:
        record = json.loads(path.read_text())
        angles, scale, arm, sd = (record[key] for key in KEYS)
        arm_b = np.array(arm, np.float64) * [1.0, -1.0, -1.0]
        return LdvInstallation.from_angles(np.radians(angles), float(scale), arm_b, sd)
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, AttributeError, IndexError, RecursionError):
        hint = "installation.json of another survey"
        raise InputError(path, "is no velocimeter's installation", hint) from None
