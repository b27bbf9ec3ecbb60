"""Pictures of a gravimetric survey: map, profiles of every pass, what the methods differ in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any, Final

import numpy as np

from deepseis_bringup.report.document import Tile, document, page_head, place
from deepseis_bringup.report.plot import (
    PALETTE,
    Colours,
    Figure,
    Panel,
    axis,
    line,
    nice_span,
    packed,
)
from deepseis_bringup.survey.gravimetry import LDV, METHODS, SurveyResult
from deepseis_core.imu_grades import MGAL
from deepseis_core.types import FloatArray
from deepseis_ins.gravimetry_lines import Line, Pass, coincidence

LEGEND: Final = {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0}
HOVER: Final = "%{x:.2f} km E, %{y:.2f} km N: %{marker.color:.1f} mGal<extra></extra>"


def arrow(item: Pass) -> str:
    """Return how a pass is run, for people."""
    return "outward" if item.direction > 0 else "back"


def pass_name(number: int, item: Pass) -> str:
    """Return the name of a pass in legends and tables."""
    return f"{number + 1}, {arrow(item)}"


def profiles_figure(method: str, found: Line, truth: FloatArray | None = None) -> Figure:
    """Draw the disturbance along a line, every pass, and their mean."""
    x = found.station / 1000.0
    data = [
        _named(line(x, item.gravity, PALETTE[k % len(PALETTE)]), pass_name(k, item))
        for k, item in enumerate(found.passes)
    ]
    mean = line(x, found.gravity.mean(axis=0), "@ink", line={"width": 2.4})
    data.append(_named(mean, "mean"))
    if truth is not None:
        dashed = line(x, truth, "@warn", line={"width": 2.0, "dash": "dash"})
        data.append(_named(dashed, "true field, filtered"))
    agreed = coincidence(found.gravity)
    caption = (
        f"Gravity disturbance along the line [mGal], {len(found.passes)} passes; they agree "
        f"within {agreed.total:.2f} mGal (RMS of the deviation from their mean)."
    )
    return Figure(f"Profiles, {method}", caption, [_panel(data, "disturbance [mGal]")])


def deviations_figure(method: str, found: Line) -> Figure:
    """Draw how every pass deviates from the mean of all."""
    common = np.isfinite(found.gravity).all(axis=0)
    agreed = coincidence(found.gravity)
    x = found.station[common] / 1000.0
    data = [
        _named(
            line(x, agreed.deviation[k], PALETTE[k % len(PALETTE)]),
            f"{pass_name(k, item)}: {agreed.rms[k]:.2f}",
        )
        for k, item in enumerate(found.passes)
    ]
    caption = "Each pass less the mean of all [mGal]; behind the name its RMS."
    return Figure(f"Deviations, {method}", caption, [_panel(data, "deviation [mGal]")])


def map_figure(method: str, lines: Sequence[Line]) -> Figure:
    """Draw where what was found: the lines in plan, coloured by the mean disturbance."""
    means = [np.nanmean(item.gravity, axis=0) for item in lines]
    span = nice_span([float(np.nanmax(np.abs(part))) for part in means])
    data: list[dict[str, Any]] = []
    for item, mean in zip(lines, means, strict=True):
        good = np.isfinite(mean)
        data.append(
            {
                "type": "scatter",
                "mode": "markers",
                "x": packed(item.position[good, 0] / 1000.0),
                "y": packed(item.position[good, 1] / 1000.0),
                "marker": {
                    "color": packed(mean[good]),
                    "colorscale": "RdBu",
                    "cmin": -span,
                    "cmax": span,
                    "size": 9,
                    "colorbar": {"title": {"text": "mGal"}, "thickness": 14},
                },
                "showlegend": False,
                "hovertemplate": HOVER,
            }
        )
    layout = {
        "xaxis": axis("east of the start [km]"),
        "yaxis": axis("north of the start [km]", scaleanchor="x"),
        "hovermode": "closest",
    }
    caption = "Mean of all passes, relative to the rest at the start; red is stronger gravity."
    return Figure(f"Map, {method}", caption, [Panel(data, layout, 420)])


def heights_figure(method: str, found: Line) -> Figure:
    """Draw the height of every pass: what dead reckoning has made of one road."""
    x = found.station / 1000.0
    data = [
        _named(line(x, item.height, PALETTE[k % len(PALETTE)]), pass_name(k, item))
        for k, item in enumerate(found.passes)
    ]
    apart = np.nanmax(np.ptp(np.array([item.height for item in found.passes]), axis=0))
    caption = f"Height above the ellipsoid [m]; the passes lie within {apart:.2f} m."
    return Figure(f"Heights, {method}", caption, [_panel(data, "height [m]")])


def method_figures(
    method: str, lines: Sequence[Line], truth: Mapping[int, FloatArray] | None = None
) -> list[Figure]:
    """Return all pictures of a method; ``truth`` [mGal] by the number of the line."""
    figures = [map_figure(method, lines)] if lines else []
    for number, found in enumerate(lines):
        own = method if len(lines) == 1 else f"{method}, line {number + 1}"
        figures.append(profiles_figure(own, found, (truth or {}).get(number)))
        if len(found.passes) > 1:
            figures += [deviations_figure(own, found), heights_figure(own, found)]
    return figures


def series_figure(result: SurveyResult, drive: int) -> Figure:
    """Draw the disturbance over the time of a drive, all methods."""
    data = []
    for k, method in enumerate(m for m in METHODS if m in result.solutions):
        solution = result.solutions[method][drive]
        series = solution.series
        values = (series.filtered - solution.base) / MGAL
        data.append(_named(line(series.time, values, PALETTE[k]), method))
    caption = (
        "Filtered disturbance against time [mGal], rests and turns included; zero is the first "
        "rest. Where GNSS was lost the value before is carried on."
    )
    panel = _panel(data, "disturbance [mGal]", "time since the start [s]")
    return Figure(f"All of {result.drives[drive].data.name}", caption, [panel])


def page(result: SurveyResult) -> str:
    """Return the page of a survey."""
    panels: list[dict[str, Any]] = []
    body, tiles = [], []
    for method in (m for m in METHODS if m in result.lines):
        lines = result.lines[method]
        body.append(
            f"<h2>{escape(method)}</h2>{place(method_figures(method, lines), panels, Colours([]))}"
        )
        repeated = [item for item in lines if len(item.passes) > 1]
        if repeated:
            total = coincidence(repeated[0].gravity).total
            count = len(repeated[0].passes)
            tiles.append(Tile(method, f"{total:.2f}", "mGal", f"{count} passes agree within"))
    figures = [series_figure(result, k) for k in range(len(result.drives))]
    body.append(f"<h2>Drives</h2>{place(figures, panels, Colours([]))}")
    tiles.append(Tile("Drives", str(len(result.drives))))
    lead = (
        "Gravity less normal gravity along the way, positive where gravity is stronger. "
        "Velocity from outside: the laser velocimeter, the receiver's Doppler, carrier phases."
    )
    head = page_head("gravimetry", f"Gravity along {_count(result)}", lead, tiles=tiles)
    return document("Gravimetry", head, body, panels, footer="")


def _count(result: SurveyResult) -> str:
    method = LDV if LDV in result.lines else next(iter(result.lines))
    count = len(result.lines[method])
    return f"{count} line{'' if count == 1 else 's'}"


def _named(trace: dict[str, Any], name: str) -> dict[str, Any]:
    hover = f"{name}: %{{y:.2f}}<extra></extra>"
    return trace | {"name": name, "showlegend": True, "hovertemplate": hover}


def _panel(data: list[dict[str, Any]], y_name: str, x_name: str = "along the line [km]") -> Panel:
    layout = {
        "xaxis": axis(x_name),
        "yaxis": axis(y_name),
        "showlegend": True,
        "legend": dict(LEGEND),
    }
    return Panel(data, layout, 360)
