"""Pictures of the acceptance of tracking loops, as the thesis draws them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from deepseis_bringup.accept.loop_measures import CarrierTruth, phase_errors
from deepseis_bringup.report.plot import (
    PALETTE,
    Figure,
    Panel,
    Row,
    axis,
    envelope,
    line,
    moment,
    nice_span,
    rows_panel,
)
from deepseis_bringup.report.run_columns import Columns
from deepseis_core.types import FloatArray


def discriminator_figure(
    scenario: str,
    satellite: str,
    tracks: Mapping[str, Columns],
    sample_rate_hz: float,
    moving: tuple[float, float],
) -> Figure:
    """Draw the discriminator's output of every loop below each other (thesis 5.6 to 5.13)."""
    rows, peaks, end = [], [], 0.0
    for k, (name, track) in enumerate(tracks.items()):
        t = (track["sample_index"] + track["sample_count"] / 2) / sample_rate_hz
        shown = 360.0 * track["carrier_error_cycles"].astype(np.float64)
        kept = t > min(6.0, moving[0])
        rms, greatest = _of_motion(t, shown, moving)
        colour = PALETTE[k % len(PALETTE)]
        rows.append(Row(name, colour, *envelope(t[kept], shown[kept]), f"{rms:.1f}", name))
        peaks.append(greatest)
        end = max(end, float(t.max(initial=0.0)))
    span = min(95.0, nice_span([np.median(peaks) * 1.3]))
    panel = rows_panel(rows, end, span, "deg")
    mark(panel.layout, moving)
    caption = (
        f"What the carrier loop of {satellite} sees of its own error [deg]; rows span "
        f"{span:g} deg either way, at the right the RMS while it moves."
    )
    return Figure(f"Discriminator, {scenario}", caption, [panel])


def error_figure(
    scenario: str,
    outcomes: Sequence[Any],
    truth: CarrierTruth,
    sample_rate_hz: float,
    still: tuple[float, float],
    moving: tuple[float, float],
) -> Figure:
    """Draw the true phase error of every loop, satellite of the tables."""
    rows, end = [], float(truth.t[-1])
    name = outcomes[0].satellite().satellite
    column = truth.satellites.index(name)
    peaks = []
    for k, outcome in enumerate(outcomes):
        error = 360.0 * phase_errors(outcome.tracks, truth, sample_rate_hz)[:, column]
        quiet = error[(truth.t >= still[0]) & (truth.t < still[1])]
        if np.isfinite(quiet).any():
            error = error - np.nanmean(quiet)
        rms, _ = _of_motion(truth.t, error, moving)
        peaks.append(rms)
        colour = PALETTE[k % len(PALETTE)]
        rows.append(Row(outcome.loop.name, colour, *envelope(truth.t, error), f"{rms:.2f}", ""))
    finite = [value for value in peaks if np.isfinite(value)]
    span = nice_span([5.0 * min(finite)]) if finite else 10.0
    panel = rows_panel(rows, end, span, "deg")
    mark(panel.layout, moving)
    caption = (
        f"NCO phase of {name} less the truth [deg], the part common to all satellites included; "
        f"rows span {span:g} deg either way, a gap is lost phase lock."
    )
    return Figure(f"True phase error, {scenario}", caption, [panel])


def _of_motion(
    t: FloatArray, values: FloatArray, moving: tuple[float, float]
) -> tuple[float, float]:
    chosen = values[(t >= moving[0]) & (t < moving[1])]
    chosen = chosen[np.isfinite(chosen)]
    if not chosen.size:
        return float("nan"), float("nan")
    return float(np.sqrt(np.mean(chosen**2))), float(np.abs(chosen).max())


def mark(layout: dict[str, Any], moving: tuple[float, float]) -> None:
    """Mark the beginning and end of the motion."""
    for when, text in zip(moving, ("moving", "end"), strict=True):
        for key, values in moment(when, text).items():
            layout[key] = [*layout.get(key, []), *values]


def jamming_figure(
    name: str, levels: FloatArray, seen: FloatArray, theory: FloatArray, marks: Sequence[float]
) -> Figure:
    """Draw measured C/N0 over the level of a jammer, and the formula's (Doppler-aided, 8)."""
    data = [
        line(levels, theory, "@muted", hover="%{y:.1f} dB-Hz", name="formula", showlegend=True,
             line={"dash": "dash"}),
        line(levels, seen, PALETTE[0], hover="%{y:.1f} dB-Hz", name="measured", showlegend=True,
             mode="lines+markers"),
    ]  # fmt: skip
    shapes = [
        {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": value, "y1": value,
         "line": {"color": "@muted", "width": 1, "dash": "dot"}}
        for value in marks
    ]  # fmt: skip
    layout = {
        "xaxis": axis("J/S [dB]"), "yaxis": axis("C/N0 [dB-Hz]"), "shapes": shapes,
        "showlegend": True, "legend": {"x": 1, "xanchor": "right", "y": 1},
    }  # fmt: skip
    caption = (
        f"Jammer: {name}. C/N0 as the receiver measures it, mean of the satellites, and by the "
        "formula; dotted: what the paper's two loops need."
    )
    return Figure(f"C/N0 under {name}", caption, [Panel(data, layout)], half=True)


def threshold_figure(
    curves: Sequence[tuple[str, FloatArray, FloatArray]], marks: Sequence[float]
) -> Figure:
    """Draw loops' true phase error over the level of a jammer while the antenna moves."""
    data = []
    for k, (name, level, error) in enumerate(curves):
        shown = envelope(level, np.minimum(error, 1e3), 300)
        data.append(line(*shown, PALETTE[k], hover="%{y:.1f} deg", name=name, showlegend=True))
    layout: dict[str, Any] = {
        "xaxis": axis("J/S [dB]"),
        "yaxis": axis("RMS of true phase error [deg]", range=[0, 45]),
        "showlegend": True,
        "legend": {"x": 0, "y": 1},
    }
    for value in marks:
        for key, values in moment(value, f"{value:g} dB: table 1").items():
            layout[key] = [*layout.get(key, []), *values]
    caption = (
        "Antenna on a circle of 2 g at 1 Hz, the jammer rises: true phase error of the median "
        "satellite, RMS over a second. The rule of thumb's limit is 15 deg."
    )
    return Figure("Loops under a rising jammer", caption, [Panel(data, layout)], half=True)
