"""The report as one HTML page that needs nothing else, not even a network."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from html import escape
from typing import Any, Final

from deepseis_bringup.report import loops, motion, position, signal
from deepseis_bringup.report.document import document, page_head, place, switches
from deepseis_bringup.report.plot import Colours, Figure
from deepseis_bringup.report.run_measures import Measures
from deepseis_bringup.report.tables import (
    diagnostics_table,
    files_table,
    satellites_table,
    tiles,
    values_table,
)
from deepseis_bringup.report.timeline import timeline
from deepseis_core.imu_grades import STANDARD_GRAVITY

OWN_FILES: Final = ("report.html", "summary.json")
PROVENANCE: Final = ("version", "input", "sha256", "seed", "mode", "host", "processor")


def page(measures: Measures, summary: Mapping[str, Any], title: str) -> str:
    """Return the page.

    Parameters
    ----------
    measures : Measures
        The run.
    summary : mapping
        As written to ``summary.json``.
    title : str
        What the run is called.
    """
    colours = Colours(measures.run.satellites)
    panels: list[dict[str, Any]] = []
    body = [
        f"<h2>{escape(name)}</h2>{place(figures, panels, colours)}"
        for name, figures in sections(measures, colours)
        if figures
    ]
    if measures.satellites:
        table = satellites_table(measures, colours)
        body.insert(0, f"<h2>Satellites</h2><figure>{table}</figure>")
    body.append(_records(measures, summary))
    head = f"{_head(measures, summary, title)}{switches(measures.run.satellites, colours)}"
    return document(title, head, body, panels)


def sections(measures: Measures, colours: Colours) -> list[tuple[str, list[Figure]]]:
    """All figures that the run has data for, in order."""
    if not measures.run.duration > 0:
        return []
    tracked = bool(measures.run.satellites)
    groups: list[tuple[str, list[Figure | None]]] = [
        (
            "Signal",
            [
                signal.sky(measures, colours) if measures.sky else None,
                signal.cn0(measures, colours) if tracked else None,
                timeline(measures),
                signal.acquisition(measures, colours),
                signal.pull_in(measures, colours),
            ],
        ),
        ("Ground motion", list(motion.figures(measures))),
        (
            "Position",
            [
                position.scatter(measures),
                position.over_time(measures),
                position.velocity(measures),
                position.clock(measures),
                position.residuals(measures, colours),
                position.geometry(measures),
            ],
        ),
        (
            "Tracking loops",
            [
                loops.carrier_discriminator(measures, colours),
                loops.code_discriminator(measures, colours),
                loops.phase_error(measures, colours),
                loops.theory(measures, colours),
                *loops.doppler(measures, colours),
                loops.clouds(measures, colours),
                loops.arms(measures, colours),
            ],
        ),
    ]
    return [(name, [f for f in figures if f is not None]) for name, figures in groups]


def _head(measures: Measures, summary: Mapping[str, Any], title: str) -> str:
    run = measures.run
    start = datetime.fromtimestamp(0, UTC) + timedelta(microseconds=run.start_utc_ns // 1000)
    when = f"{start:%Y-%m-%d %H:%M:%S} UTC, {summary['duration_s']:.1f} s"
    if run.sample_rate_hz == run.sample_rate_hz:
        when += f" at {run.sample_rate_hz / 1e6:g} MHz"
    if name := summary.get("input"):
        when += f", from {name}"
    lead, figures = verdict(measures, summary), tiles(measures, summary)
    return page_head("run report", title, lead, when, figures)


def verdict(measures: Measures, summary: Mapping[str, Any]) -> str:
    """Say in a sentence or two how the run went."""
    tracked = summary["satellites_tracked"]
    text = _event(summary)
    text += f"{tracked} satellite{'' if tracked == 1 else 's'} tracked to phase lock"
    if measures.positions is None:
        text += "; no position."
    else:
        text += f"; first position after {summary['time_to_first_fix_s']:.1f} s"
        if "position_error_m" in summary:
            text += f", {summary['position_error_m']:.2f} m from the truth on average"
        text += "."
    slips = int(sum(v["slips"] for v in measures.satellites.values()))
    if tracked:
        text += f" {slips or 'No'} cycle slip{'' if slips == 1 else 's'} after lock."
    if summary["gaps"]:
        text += f" The signal has {summary['gaps']} gaps."
    if not measures.run.is_whole:
        text += " The recording is cut short or damaged; the report covers what could be read."
    return text


def _event(summary: Mapping[str, Any]) -> str:
    """Say what shook, and how well displacement was found."""
    if (pgd := summary.get("pgd_m")) is None:
        return ""
    more = f" ({summary['events']} events; the greatest)" if summary["events"] > 1 else ""
    text = f"The ground moved from {summary['onset_s']:.1f} s on{more}: "
    pga_g = summary["pga_mps2"] / STANDARD_GRAVITY
    text += f"peak acceleration {pga_g:.3g} g, displacement {pgd:.3g} m"
    flat = summary.get("displacement_error_horizontal_m.fused_real_time")
    up = summary.get("displacement_error_up_m.fused_real_time")
    if flat is not None and up is not None:
        text += f", known to {1e3 * flat:.1f} mm horizontally and {1e3 * up:.1f} mm upwards (RMS)"
    return text + ". "


def _records(measures: Measures, summary: Mapping[str, Any]) -> str:
    """List what the run was made of and left behind."""
    made_of = {k: v for k, v in summary.items() if k.startswith(PROVENANCE) or "sha256" in k}
    if measures.run.if_format:
        made_of["if_format"] = measures.run.if_format
    parts = ["<h2>Records</h2>", '<div class="figures">']
    if table := diagnostics_table(measures):
        parts.append(f"<figure><h3>Nodes</h3>{table}</figure>")
    if made_of:
        parts.append(f'<figure class="half"><h3>Made of</h3>{values_table(made_of)}</figure>')
    files = files_table(measures.run.folder, OWN_FILES)
    parts.append(f'<figure class="half"><h3>Files</h3>{files}</figure>')
    rows = values_table(measures.run.messages)
    parts.append(
        f"<figure><details><summary>Messages recorded, by topic</summary>{rows}</details>"
        f"<details><summary>All figures of summary.json</summary>{values_table(summary)}"
        "</details></figure></div>"
    )
    return "".join(parts)
