"""The page that a simulated run leaves: what moved, what was measured, what the sky was."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from html import escape
from pathlib import Path
from typing import Any, Final

import numpy as np

from deepseis_bringup.report.document import Tile, document, page_head, place, switches
from deepseis_bringup.report.plot import TIMES, Colours, Figure
from deepseis_bringup.report.tables import files_table, values_table
from deepseis_bringup.simulation import figures as motion
from deepseis_bringup.simulation import signal
from deepseis_bringup.simulation.pictures import Pictures
from deepseis_core.imu_grades import STANDARD_GRAVITY

OWN_FILES: Final = ("report.html", "summary.json")
MESSAGES: Final = "messages."
MADE_OF: Final = (
    "scenario", "short", "changes", "source", "seed", "imu_grade", "if_format", "sample_rate_hz",
)  # fmt: skip


def page(pictures: Pictures, summary: Mapping[str, Any], folder: Path, title: str) -> str:
    """Return the page.

    Parameters
    ----------
    pictures : Pictures
        Of the whole run.
    summary : mapping
        As written to ``summary.json``.
    folder : path
        The run's, for the list of its files.
    title : str
        What the run is called.
    """
    colours = Colours(pictures.satellites)
    panels: list[dict[str, Any]] = []
    body = [
        f"<h2>{escape(name)}</h2>{place(figures, panels, colours)}"
        for name, figures in sections(pictures, colours)
        if figures
    ]
    body.append(_records(summary, folder))
    head = f"{_head(pictures, summary, title)}{switches(pictures.satellites, colours)}"
    return document(title, head, body, panels)


def sections(pictures: Pictures, colours: Colours) -> list[tuple[str, list[Figure]]]:
    """All figures that the run has data for, in order."""
    way = motion.trajectory(pictures)
    groups: list[tuple[str, list[Figure | None]]] = [
        (
            "Motion",
            [
                *motion.seismograms(pictures),
                *way,
                motion.response(pictures, half=len(way) == 1),
            ],
        ),
        (
            "Sensors",
            [
                *motion.inertial(pictures),
                motion.velocimeter(pictures),
                motion.positions(pictures),
            ],
        ),
        (
            "Sky and signal",
            [
                signal.sky(pictures, colours),
                signal.cn0(pictures, colours),
                signal.doppler(pictures, colours),
                signal.spectrum(pictures),
                signal.histogram(pictures),
                signal.clock(pictures),
            ],
        ),
    ]
    return [(name, [f for f in figures if f is not None]) for name, figures in groups]


def _head(pictures: Pictures, summary: Mapping[str, Any], title: str) -> str:
    scenario = pictures.bench.scenario
    utc_ns = pictures.bench.start.to_utc_ns()
    when = f"{datetime.fromtimestamp(utc_ns // 10**9, UTC):%Y-%m-%d %H:%M:%S} UTC"
    when += f", seed {scenario.seed}"
    if scenario.source:
        when += f", after {scenario.source}"
    stands_in = ""
    if summary.get("motion_stands_in"):
        stands_in = (
            '<p class="lead bad">The record that this scenario calls for is not at hand: the '
            "motion is an artificial one that stands in for it.</p>"
        )
    lead, figures = verdict(pictures, summary), tiles(pictures, summary)
    return page_head("test bench", title, lead, when, figures, stands_in)


def verdict(pictures: Pictures, summary: Mapping[str, Any]) -> str:
    """Say in a sentence or two what was made."""
    scenario = pictures.bench.scenario
    text = _seconds(scenario.duration) + (_motion(pictures) or " at rest")
    count = len(pictures.satellites)
    text += f"; {count} satellite{'' if count == 1 else 's'}"
    text += "" if scenario.signal else ", as observations without a signal"
    if scenario.imu:
        text += f"; inertial unit of grade {scenario.imu.grade} at {scenario.imu.rate_hz:g} Hz"
    if "baseline_m" in summary:
        text += f"; base station {summary['baseline_m'] / 1e3:.1f} km away"
    return text + "."


def _motion(pictures: Pictures) -> str:
    if not motion.moves(pictures):
        return ""
    begin, end = pictures.bench.motion.span
    lasts = _seconds(min(end, pictures.bench.scenario.duration) - max(begin, 0.0))
    g, component = _peak_g(pictures)
    ground = "" if motion.travels(pictures) else "ground "
    return (
        f", in motion for {lasts} from {begin:g} s on; "
        f"peak {ground}acceleration {motion.plain(g)} g ({component})"
    )


def _peak_g(pictures: Pictures) -> tuple[float, str]:
    peaks = [pictures.acceleration.peak(k) for k in range(3)]
    at = int(np.argmax(peaks))
    return peaks[at] / STANDARD_GRAVITY, motion.COMPONENTS[at]


def _seconds(value: float) -> str:
    """Format a length of time.

    Examples
    --------
    >>> _seconds(44.0), _seconds(1200.0)
    ('44 s', '20 min')
    """
    if value < 300.0:
        return f"{value:.3g} s"
    minutes, rest = divmod(round(value), 60)
    return f"{minutes} min" + (f" {rest} s" if rest else "")


def tiles(pictures: Pictures, summary: Mapping[str, Any]) -> list[Tile]:
    """Choose the key figures."""
    found = _motion_tiles(pictures) if motion.moves(pictures) else []
    found += [_satellites(pictures), _cn0(pictures)]
    if "baseline_m" in summary:
        found.append(Tile("Baseline", f"{summary['baseline_m'] / 1e3:.2f}", "km", "to the base"))
    if pictures.bench.scenario.imu:
        clipped = int(summary.get("imu_clipped_samples", 0))
        more = (
            f"{summary.get('imu_grade', '')}, beyond its range"
            if clipped
            else "all within its range"
        )
        found.append(Tile("IMU samples clipped", f"{clipped:,}", "", more, bad=clipped > 0))
    duration, receiver = pictures.bench.scenario.duration, pictures.bench.scenario.receiver
    if spent := summary.get("wall_time_s"):
        speed = motion.plain(duration / spent)
        found.append(Tile("Speed", speed, f"{TIMES} real time", f"made in {spent:.0f} s"))
    found.append(Tile("Length", *_length(duration), f"{_count(summary)} messages"))
    if pictures.bench.scenario.signal:
        packing = str(summary.get("if_format", ""))
        found.append(Tile("Samples", motion.plain(receiver.sample_rate_hz / 1e6), "MHz", packing))
    found.append(Tile("Oscillator", receiver.oscillator.kind, "", "of the receiver"))
    return found[: max(len(found) // 4 * 4, 4)]


def _length(duration: float) -> tuple[str, str]:
    return (f"{duration:.3g}", "s") if duration < 300.0 else (f"{duration / 60.0:.3g}", "min")


def _count(summary: Mapping[str, Any]) -> str:
    return f"{sum(v for k, v in summary.items() if k.startswith(MESSAGES)):,}"


def _motion_tiles(pictures: Pictures) -> list[Tile]:
    g, component = _peak_g(pictures)
    if motion.travels(pictures):
        way, speed = pictures.track[:, 1:], motion.speed(pictures.track)
        factor, unit = motion.unit_of(farthest := float(np.linalg.norm(way, axis=1).max()))
        return [
            Tile("Peak acceleration", motion.plain(g), "g", f"largest component: {component}"),
            Tile("Top speed", motion.plain(speed.max()), "m/s", "in space"),
            Tile("Farthest", motion.plain(factor * farthest), unit, "from where it stood"),
        ]
    found = [Tile("PGA", motion.plain(g), "g", f"peak ground acceleration, {component}")]
    for name, words, record in (
        ("PGV", "velocity", pictures.velocity),
        ("PGD", "displacement", pictures.position),
    ):
        peaks = [record.peak(k) for k in range(3)]
        at = int(np.argmax(peaks))
        factor, unit = motion.unit_of(peaks[at])
        unit += "/s" if name == "PGV" else ""
        more = f"peak ground {words}, {motion.COMPONENTS[at]}"
        found.append(Tile(name, motion.plain(factor * peaks[at]), unit, more))
    return found


def _satellites(pictures: Pictures) -> Tile:
    hidden = [
        name
        for k, name in enumerate(pictures.satellites)
        if not np.isfinite(pictures.cn0.low[:, k]).any()
    ]
    more = f"never received: {', '.join(hidden)}" if hidden else "all of them received"
    return Tile("Satellites", str(len(pictures.satellites)), "", more)


def _cn0(pictures: Pictures) -> Tile:
    low, high = pictures.cn0.low, pictures.cn0.high
    values = np.concatenate([low[np.isfinite(low)], high[np.isfinite(high)]])
    if not values.size:
        return Tile("C/N0", "none", bad=True)
    low_text, high_text = f"{values.min():.0f}", f"{values.max():.0f}"
    span = low_text if low_text == high_text else f"{low_text} to {high_text}"
    return Tile("C/N0", span, "dB-Hz", "in the course of the run")


def _records(summary: Mapping[str, Any], folder: Path) -> str:
    """List what the run was made of and left behind."""
    made_of = {
        k: v
        for k, v in summary.items()
        if k in MADE_OF or k.startswith("version") or "sha256" in k
    }
    messages = {
        k.removeprefix(MESSAGES): f"{v:,}" for k, v in summary.items() if k.startswith(MESSAGES)
    }
    return (
        '<h2>Records</h2><div class="figures">'
        f'<figure class="half"><h3>Made of</h3>{values_table(made_of)}</figure>'
        f'<figure class="half"><h3>Files</h3>{files_table(folder, OWN_FILES)}</figure>'
        "<figure><details><summary>Messages, by topic</summary>"
        f"{values_table(messages)}</details>"
        "<details><summary>All figures of summary.json</summary>"
        f"{values_table(summary)}</details></figure></div>"
    )
