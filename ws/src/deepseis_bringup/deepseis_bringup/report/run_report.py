"""Writes a run's ``summary.json`` and ``report.html``."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from deepseis_bringup.report.page import page
from deepseis_bringup.report.run_data import RunData
from deepseis_bringup.report.run_measures import Measures
from deepseis_bringup.report.run_motion import errors, events, streams
from deepseis_bringup.report.run_truth import Truth
from deepseis_core.errors import InputError

PER_SATELLITE = (
    "cn0_mean_dbhz",
    "carrier_error_rms_deg",
    "carrier_error_expected_deg",
    "code_error_rms_m",
    "residual_rms_m",
    "first_lock_s",
    "ephemeris_s",
    "locked_s",
    "slips",
    "half_cycles",
    "elevation_deg",
    "azimuth_deg",
)


def write_report(
    run_folder: Path,
    *,
    truth: Path | None = None,
    title: str = "DeepSeis run",
    extra: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Write ``report.html`` and ``summary.json`` into a run's folder, each whole or not at all.

    Parameters
    ----------
    run_folder : Path
        Holds ``bag/``.
    truth : Path, optional
        ``truth.npz`` of the simulation.
    title : str
        Heading of the page.
    extra : mapping, optional
        Further figures for the summary (real-time factor, versions, hashes, seeds); nested ones
        get keys joined by dots.

    Returns
    -------
    dict
        The summary.

    Raises
    ------
    InputError
        The bag or the truth cannot be read, or the folder not written.
    """
    folder = Path(run_folder)
    measures = measure(folder, truth, extra)
    summary = summary_of(measures)
    html = page(measures, summary, title)
    _write(folder / "summary.json", json.dumps(summary, indent=2, allow_nan=False) + "\n")
    _write(folder / "report.html", html)
    return summary


def summarise(
    run_folder: Path, truth: Path | None = None, extra: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Return the figures of a run without writing anything (see `write_report`)."""
    return summary_of(measure(Path(run_folder), truth, extra))


def measure(
    run_folder: Path, truth: Path | None = None, extra: Mapping[str, Any] | None = None
) -> Measures:
    """Read a run, and its truth if there is one."""
    known = Truth.read(truth) if truth is not None else None
    return Measures(RunData.read(run_folder), known, dict(extra or {}))


def summary_of(measures: Measures) -> dict[str, Any]:
    """Flat figures with units in their keys; what is not known is left out."""
    run, of_satellites = measures.run, measures.satellites
    gaps, lost = measures.gaps
    last = {status.node: status.level for status in run.diagnostics}
    used = np.unique(run.pvt["satellites"]) if run.pvt.count else np.zeros(0)
    searched = np.unique(run.acquisition["satellite"]) if run.acquisition.count else np.zeros(0)
    summary: dict[str, Any] = {
        **_flat(measures.extra),
        "duration_s": round(run.duration, 6) if run.sample_rate_hz > 0 else 0.0,
        "sample_rate_hz": run.sample_rate_hz,
        **_position(measures),
        **_motion(measures),
        "satellites_tracked": sum(v["phase_lock_s"] > 0 for v in of_satellites.values()),
        "satellites_used": len(used),
        "satellites_searched": max(len(searched), len(of_satellites)),
        "slips": int(sum(v["slips"] for v in of_satellites.values())),
        "gaps": gaps,
        "lost_samples": lost,
        "observation_epochs": run.observations.count,
        "ephemerides": len(run.ephemerides),
        "bag_messages": sum(run.messages.values()),
        "bag_is_whole": run.is_whole,
        "nodes_with_warnings": sum(level > 0 for level in last.values()),
        "diagnostics_warnings": sum(status.level > 0 for status in run.diagnostics),
    }
    for key in PER_SATELLITE:
        summary |= {f"{key}.{s}": v[key] for s, v in of_satellites.items()}
    summary |= _phase(measures)
    return {key: value for key, value in map(_plain, summary.items()) if value is not None}


def _position(measures: Measures) -> dict[str, float]:
    positions = measures.positions
    if positions is None:
        return {"positions": 0}
    east, north, up = positions.enu.mean(axis=0)
    sd = positions.enu.std(axis=0)
    found: dict[str, float] = {
        "time_to_first_fix_s": measures.first_fix_s,
        "positions": len(positions.t),
        "position_sd_horizontal_m": float(np.hypot(*sd[:2])),
        "position_sd_up_m": float(sd[2]),
        "velocity_rms_horizontal_mps": _rms_length(positions.velocity[:, :2]),
        "velocity_rms_up_mps": _rms_length(positions.velocity[:, 2:]),
        "pdop_median": float(np.median(measures.run.pvt["pdop"])),
    }
    if positions.against_truth:
        size = np.linalg.norm(positions.enu, axis=1)
        found |= {
            "position_error_m": float(np.linalg.norm([east, north, up])),
            "position_error_horizontal_m": float(np.hypot(east, north)),
            "position_error_east_m": float(east),
            "position_error_north_m": float(north),
            "position_error_up_m": float(up),
            "position_error_rms_m": float(np.sqrt((size**2).mean())),
            "position_error_max_m": float(size.max()),
        }
    return found


def _motion(measures: Measures) -> dict[str, Any]:
    """Figures of ground motion: of the event with the greatest displacement, and of streams."""
    found: dict[str, Any] = {}
    if seen := events(measures.run):
        event = max(seen, key=lambda item: float(item.peaks[-1, 0]))
        pgd, pgv, pga = event.peaks[-1].tolist()
        found = {
            "events": len(seen),
            "onset_s": event.onset,
            "pgd_m": pgd,
            "pgv_mps": pgv,
            "pga_mps2": pga,
            "magnitude": event.magnitude,
        }
    for name, error in errors(streams(measures.run), measures.truth).items():
        key = name.replace(",", "").replace(" ", "_")
        found[f"displacement_error_horizontal_m.{key}"] = _rms_length(error[:, :2])
        found[f"displacement_error_up_m.{key}"] = _rms_length(error[:, 2:])
    return found


def _rms_length(values: np.ndarray[Any, Any]) -> float:
    return float(np.sqrt((values**2).sum(axis=1).mean()))


def _phase(measures: Measures) -> dict[str, float]:
    errors = measures.phase_errors
    if errors is None:
        return {}
    found, ratios = {}, []
    for satellite, rms in zip(errors.satellites, 360 * errors.rms_cycles(), strict=True):
        limit = measures.satellites[satellite]["phase_error_limit_deg"]
        ratios.append(float(rms) / limit)
        found[f"phase_error_rms_deg.{satellite}"] = float(rms)
        found[f"phase_error_limit_deg.{satellite}"] = limit
        found[f"phase_error_ratio.{satellite}"] = ratios[-1]
    median, worst = float(np.median(ratios)), max(ratios)
    return found | {"phase_error_ratio_median": median, "phase_error_ratio_max": worst}


def _flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    out: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, Mapping):
            out |= _flat(value, f"{prefix}{key}.")
        else:
            out[f"{prefix}{key}"] = value
    return out


def _plain(item: tuple[str, Any]) -> tuple[str, Any]:
    """Turn a value into one JSON has; None where it is not known."""
    key, value = item
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return key, float(f"{value:.9g}") if math.isfinite(value) else None
    known = value is None or isinstance(value, str | int | bool | list)
    return key, value if known else str(value)


def _write(path: Path, text: str) -> None:
    draft = path.with_name(f".{path.name}.part")
    try:
        draft.write_text(text, encoding="utf-8")
        os.replace(draft, path)
    except OSError as error:
        draft.unlink(missing_ok=True)
        raise InputError(path, f"cannot be written: {error.strerror}") from None
