"""Pictures of the acceptance of tight coupling."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from deepseis_bringup.accept.tight_drive import Drive
from deepseis_bringup.report.plot import (
    PALETTE,
    Figure,
    Panel,
    Row,
    axis,
    envelope,
    line,
    merged,
    moment,
    nice_span,
    rows_panel,
    time_axis,
)
from deepseis_core.geodesy import geodetic_from_ecef, rotation_enu_ecef
from deepseis_core.types import FloatArray

LEGEND: dict[str, Any] = {
    "showlegend": True,
    "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0},
}
COLOURS = dict(zip(("raw", "Hatch", "RTKLIB", "truth"), PALETTE, strict=False))


def error_figure(
    title: str,
    caption: str,
    time: FloatArray,
    errors: Mapping[str, FloatArray],
    axes: Sequence[str],
    spans: Sequence[tuple[float, float]] = (),
) -> Figure:
    """Draw errors (m, 3) of several solutions, an axis after the other (H figures 6 to 11)."""
    sizes = [np.nanpercentile(np.abs(e), 99.0) for e in errors.values()]
    span, rows = nice_span(sizes), []
    for k, name in enumerate(axes):
        for solution, error in errors.items():
            colour = COLOURS[solution.split(",")[0]]
            note = f"{np.sqrt(np.nanmean(error[:, k] ** 2)):.2f}"
            rows.append(
                Row(f"{name} {solution.split(',')[0]}", colour, *envelope(time, error[:, k]), note)
            )
    panel = rows_panel(rows, float(time[-1]), span, "m")
    marks = [moment(t, text) for s in spans for t, text in zip(s, ("blocked", ""), strict=True)]
    layout = merged(panel.layout, *marks)
    more = f" Rows span {span:g} m either way; at the right the RMS [m]."
    return Figure(title, caption + more, [Panel(panel.data, layout, panel.height)])


def running_figure(title: str, caption: str, time: FloatArray,
                   errors: Mapping[str, FloatArray]) -> Figure:  # fmt: skip
    """Draw the RMS since the start against time (H figure 12)."""
    data = []
    for name, error in errors.items():
        known = np.isfinite(error)
        total = np.cumsum(np.where(known, error, 0.0) ** 2)
        running = np.sqrt(total / np.maximum(np.cumsum(known), 1))
        running[~known] = np.nan
        trace = line(*envelope(time, running), COLOURS[name.split(",")[0]], hover="%{y:.2f} m")
        data.append(trace | {"name": name, "showlegend": True})
    layout = {"xaxis": time_axis(float(time[-1])), "yaxis": axis("RMS since the start [m]")}
    return Figure(title, caption, [Panel(data, layout | LEGEND)], half=True)


def map_figure(
    title: str,
    caption: str,
    drive: Drive,
    tracks: Mapping[str, FloatArray],
    span: tuple[float, float],
) -> Figure:
    """Draw tracks of a span of time [s] from above, metres east and north of its middle."""
    inside = (drive.observed.time >= span[0]) & (drive.observed.time < span[1])
    origin = np.nanmean(drive.truth.position[inside], axis=0)
    place = geodetic_from_ecef(origin)
    C, data = rotation_enu_ecef(place[0], place[1]), []
    for name, position in {"truth": drive.truth.position, **tracks}.items():
        enu, colour = (position[inside] - origin) @ C.T, COLOURS[name.split(",")[0]]
        trace = line(enu[:, 0], enu[:, 1], colour)
        trace |= {
            "hovertemplate": "%{x:.0f} m east, %{y:.0f} m north<extra></extra>",
            "marker": {"color": colour, "size": 5},
            "mode": "markers" if name == "RTKLIB" else "lines",
            "name": {"truth": "reference"}.get(name, name),
            "showlegend": True,
        }
        data.append(trace)
    layout = {
        "xaxis": axis("east [m]"),
        "yaxis": axis("north [m]", scaleanchor="x"),
        "hovermode": "closest",
    }
    return Figure(title, caption, [Panel(data, layout | LEGEND, height=560)])
