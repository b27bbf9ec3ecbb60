"""Tables and key figures of the report page, as HTML."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any, Final

import numpy as np

from deepseis_bringup.report.document import Tile
from deepseis_bringup.report.plot import SIGMA, TIMES, Colours, signed
from deepseis_bringup.report.run_measures import Measures
from deepseis_core.imu_grades import STANDARD_GRAVITY

LEVELS: Final = ("ok", "warning", "error", "stale")


def tiles(measures: Measures, summary: Mapping[str, Any]) -> list[Tile]:
    """Choose the key figures of a run."""
    found = [*_motion(summary), _position(measures, summary), _first_fix(summary)]
    found.append(_satellites(summary))
    cn0 = [v["cn0_mean_dbhz"] for v in measures.satellites.values()]
    cn0 = [v for v in cn0 if np.isfinite(v)]
    if cn0:
        span = f"{min(cn0):.1f} to {max(cn0):.1f} dB-Hz"
        found.append(Tile("C/N0, median", f"{np.median(cn0):.1f}", "dB-Hz", span))
    found.append(_phase(measures, summary))
    if (factor := summary.get("real_time_factor")) is not None:
        spent = summary.get("graph_time_s") or summary.get("wall_time_s")
        signal = f"{summary['duration_s']:.0f} s of signal"
        more = f"{signal} in {spent:.0f} s" if spent else signal
        found.append(Tile("Speed", f"{factor:.2f}", f"{TIMES} real time", more))
    gaps, lost = summary["gaps"], summary.get("lost_samples")
    more = "no gap in the samples" if not gaps else f"{gaps} gap{'s' if gaps > 1 else ''}"
    more += f"; {summary['bag_messages']:,} messages recorded"
    found.append(
        Tile("Samples lost", "?" if lost is None else f"{lost:,}", "", more, bad=gaps > 0)
    )
    found.append(_warnings(measures))
    return found


def _motion(summary: Mapping[str, Any]) -> list[Tile]:
    """Peaks of the greatest event, and how far fused displacement is from the truth."""
    found = []
    if (pgd := summary.get("pgd_m")) is not None:
        more = f"length of the vector; {summary['pga_mps2']:.3g} m/s²"
        found.append(Tile("PGA", f"{summary['pga_mps2'] / STANDARD_GRAVITY:.3g}", "g", more))
        more = f"length of the vector; PGV {summary['pgv_mps']:.3g} m/s"
        found.append(Tile("PGD", f"{pgd:.3f}", "m", more))
    flat, up = (
        summary.get(f"displacement_error_{axis}_m.fused_real_time")
        for axis in ("horizontal", "up")
    )
    if flat is not None and up is not None:
        more = f"fused, horizontal RMS; up {1e3 * up:.2f} mm"
        found.append(Tile("Displacement error", f"{1e3 * flat:.2f}", "mm", more))
    return found


def _warnings(measures: Measures) -> Tile:
    """Nodes that ended with a warning, by name; a station that still moves is told, not bad."""
    last = {status.node: status for status in measures.run.diagnostics if status.node}
    warned = {node: status.message for node, status in last.items() if status.level > 0}
    more = (
        "; ".join(f"{node}: {message}" for node, message in warned.items()) or "at the run's end"
    )
    bad = any(node != "motion_state" or last[node].level > 1 for node in warned)
    return Tile("Nodes with warnings", str(len(warned)), "", more, bad=bad)


def _position(measures: Measures, summary: Mapping[str, Any]) -> Tile:
    if measures.positions is None:
        return Tile("Position", "none", "", "no epoch had four usable satellites", bad=True)
    if measures.positions.against_truth:
        flat, up = summary["position_error_horizontal_m"], summary["position_error_up_m"]
        more = f"horizontal {flat:.2f} m, up {signed(up)} m; mean of {summary['positions']} epochs"
        return Tile("Position error", f"{summary['position_error_m']:.2f}", "m", more)
    flat, up = summary["position_sd_horizontal_m"], summary["position_sd_up_m"]
    more = f"horizontal; up {up:.2f} m; {summary['positions']} epochs, no truth given"
    return Tile(f"Position scatter, 1 {SIGMA}", f"{flat:.2f}", "m", more)


def _first_fix(summary: Mapping[str, Any]) -> Tile:
    seconds = summary.get("time_to_first_fix_s")
    if seconds is None:
        return Tile("First fix", "none", bad=True)
    return Tile("First fix after", f"{seconds:.1f}", "s", "from the first sample")


def _satellites(summary: Mapping[str, Any]) -> Tile:
    more = f"{summary['satellites_used']} used, {summary['satellites_searched']} searched"
    count = summary["satellites_tracked"]
    return Tile("Satellites in phase lock", str(count), "", more, bad=count < 4)


def _phase(measures: Measures, summary: Mapping[str, Any]) -> Tile:
    if (ratio := summary.get("phase_error_ratio_median")) is not None:
        more = f"median of the satellites; worst {summary['phase_error_ratio_max']:.2f}"
        return Tile("True phase error", f"{ratio:.2f}", f"{TIMES} thermal limit", more)
    values = list(measures.satellites.values())
    ratios = [v["carrier_error_rms_deg"] / v["carrier_error_expected_deg"] for v in values]
    ratios = [r for r in ratios if np.isfinite(r)]
    if not ratios:
        return Tile("Carrier discriminator", "none", "", "no phase lock", bad=True)
    rms = float(np.nanmedian([v["carrier_error_rms_deg"] for v in values]))
    more = f"median RMS {rms:.1f}°"
    return Tile("Carrier discriminator", f"{np.median(ratios):.2f}", f"{TIMES} theory", more)


COLUMNS: Final[Sequence[tuple[str, str, str, str]]] = (
    ("elevation_deg", "Elevation", "deg", ".1f"),
    ("azimuth_deg", "Azimuth", "deg", ".1f"),
    ("cn0_mean_dbhz", "C/N0", "dB-Hz", ".1f"),
    ("first_lock_s", "Phase lock", "at s", ".2f"),
    ("ephemeris_s", "Ephemeris", "at s", ".1f"),
    ("locked_s", "Locked", "s", ".1f"),
    ("slips", "Slips", "cycles", ".0f"),
    ("half_cycles", "Half", "cycles", ".0f"),
    ("carrier_error_rms_deg", "Carrier disc.", "deg RMS", ".2f"),
    ("carrier_error_expected_deg", "Theory", "deg RMS", ".2f"),
    ("code_error_rms_m", "Code disc.", "m RMS", ".1f"),
    ("phase_error_rms_deg", "True phase", "deg RMS", ".2f"),
    ("phase_error_limit_deg", "Limit", "deg RMS", ".2f"),
    ("residual_rms_m", "Residual", "m RMS", ".2f"),
)


def satellites_table(measures: Measures, colours: Colours) -> str:
    """One row for each satellite."""
    values = {s: dict(v) for s, v in measures.satellites.items()}
    errors = measures.phase_errors
    if errors is not None:
        rms = 360 * errors.rms_cycles()
        for k, satellite in enumerate(errors.satellites):
            values[satellite]["phase_error_rms_deg"] = float(rms[k])
    else:
        for of_one in values.values():
            of_one.pop("phase_error_limit_deg", None)
    shown = [c for c in COLUMNS if any(np.isfinite(v.get(c[0], np.nan)) for v in values.values())]
    head = "".join(
        f"<th>{name}<small>{unit or '&nbsp;'}</small></th>" for _, name, unit, _ in shown
    )
    rows = []
    for satellite, of_one in values.items():
        cells = "".join(f"<td>{_number(of_one.get(key), form)}</td>" for key, _, _, form in shown)
        dot = f'<span class="dot" style="background:{colours[satellite]}"></span>'
        rows.append(f"<tr><td>{dot}<b>{satellite}</b></td>{cells}</tr>")
    return _scroll(f"<table><tr><th>Satellite</th>{head}</tr>{''.join(rows)}</table>")


def _number(value: float | None, form: str) -> str:
    return "-" if value is None or not np.isfinite(value) else signed(value, form)


def diagnostics_table(measures: Measures) -> str:
    """Last status of every node, and what it warned of before."""
    last = {status.node: status for status in measures.run.diagnostics}
    rows = []
    for node, status in last.items():
        warned = {
            s.message: measures.run.seconds_of_utc(s.stamp_ns)
            for s in reversed(measures.run.diagnostics)
            if s.node == node and s.level > 0
        }
        level = LEVELS[min(status.level, 3)]
        values = ", ".join(f"{key} {value}" for key, value in status.values.items())
        earlier = "<br>".join(f"{t:.1f} s: {escape(m)}" for m, t in list(warned.items())[:6])
        rows.append(
            f'<tr><td><b>{escape(node)}</b></td><td class="{"bad" if status.level else ""}">'
            f"{level}</td><td>{escape(status.message)}"
            f'<div class="values">{escape(values)}</div></td><td>{earlier or "none"}</td></tr>'
        )
    head = "<tr><th>Node</th><th>Last state</th><th>Message and counters</th>"
    head += "<th>Warnings, when first given</th></tr>"
    return _scroll(f'<table class="words nodes">{head}{"".join(rows)}</table>') if rows else ""


def files_table(folder: Path, skip: Iterable[str] = ()) -> str:
    """Files of the run with their sizes."""
    rows = []
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        name = path.relative_to(folder).as_posix()
        if name not in set(skip) and not path.name.startswith("."):
            rows.append(
                f"<tr><td><code>{escape(name)}</code></td>"
                f'<td class="size">{_size(path.stat().st_size)}</td></tr>'
            )
    return _scroll(f'<table class="words">{"".join(rows)}</table>')


def values_table(values: Mapping[str, Any]) -> str:
    """Names and values."""
    rows = [
        f"<tr><td>{escape(str(key))}</td><td><code>{escape(str(value))}</code></td></tr>"
        for key, value in values.items()
    ]
    return _scroll(f'<table class="words">{"".join(rows)}</table>') if rows else ""


def _scroll(table: str) -> str:
    return f'<div class="scroll" tabindex="0">{table}</div>'


def _size(count: int) -> str:
    """Format a size.

    Examples
    --------
    >>> _size(512), _size(2_746_869)
    ('512 B', '2.7 MB')
    """
    if count < 1000:
        return f"{count} B"
    for unit in ("kB", "MB", "GB", "TB"):
        count_in = count / 1000 ** (("kB", "MB", "GB", "TB").index(unit) + 1)
        if count_in < 1000:
            break
    return f"{count_in:.1f} {unit}"
