"""Figures of the solution: position, velocity, clock, residuals, geometry."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from deepseis_bringup.report.plot import (
    PALETTE,
    ROW_HEIGHT,
    SIGMA,
    Colours,
    Figure,
    Panel,
    Row,
    axis,
    envelope,
    line,
    nice_span,
    packed,
    rows_panel,
    signed,
    time_axis,
)
from deepseis_bringup.report.run_measures import Measures, Positions
from deepseis_core.types import FloatArray

EAST, NORTH, UP = PALETTE[:3]  # as on the other pages
AXES: Final = (("E", EAST), ("N", NORTH), ("U", UP))
MOST: Final = 1500  # points of the position scatter


def scatter(measures: Measures) -> Figure | None:
    """Horizontal positions with the one-sigma ellipse."""
    positions = measures.positions
    if positions is None:
        return None
    step = max(1, -(-len(positions.t) // MOST))
    enu, t = positions.enu[::step], positions.t[::step]
    mean = positions.enu.mean(axis=0)
    data: list[dict[str, Any]] = [
        {
            **{"type": "scatter", "mode": "markers", "name": "positions", "showlegend": False},
            **{"x": packed(enu[:, 0]), "y": packed(enu[:, 1])},
            "customdata": packed(t),
            "hovertemplate": "%{customdata:.2f} s: E %{x:.2f} m, N %{y:.2f} m<extra></extra>",
            "marker": {
                **{"size": 5, "color": packed(t), "colorscale": "Viridis", "opacity": 0.8},
                "colorbar": {"title": {"text": "s"}, "thickness": 10, "len": 0.75},
            },
        },
        _ellipse(mean, positions.covariance.mean(axis=0)[:2, :2], f"stated 1 {SIGMA}", "dot"),
    ]
    if len(positions.t) > 2:
        spread = np.cov(positions.enu[:, :2].T)
        data.append(_ellipse(mean, spread, f"scatter 1 {SIGMA}", "solid"))
    centre = "truth" if positions.against_truth else "mean"
    data.append(_point(np.zeros(2), centre, "cross-thin-open", "@warn"))
    if positions.against_truth:
        data.append(_point(mean, "mean", "circle-open", "@ink"))
    reach = nice_span(np.abs(positions.enu[:, :2]).max(axis=0), 0.1) * 1.05
    layout = {
        "xaxis": axis(f"east of the {centre} [m]", range=[-reach, reach], constrain="domain"),
        "yaxis": axis(f"north of the {centre} [m]", range=[-reach, reach])
        | {"scaleanchor": "x", "constrain": "domain"},
        "showlegend": True,
        "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0},
    }
    caption = (
        "Single-point positions from code ranges alone. Solid: spread of the points; dotted: what "
        "the solver states. Points that drift together share the code loops' slow noise."
    )
    return Figure("Horizontal position", caption, [Panel(data, layout, 430)], half=True)


def over_time(measures: Measures) -> Figure | None:
    """East, north and up over time."""
    positions = measures.positions
    if positions is None:
        return None
    notes = [f"{signed(m)} m" for m in positions.enu.mean(axis=0)]
    span = nice_span([*np.abs(positions.enu).max(axis=0), *positions.sd.max(axis=0)])
    rows = _axes_rows(positions, positions.enu, positions.sd, notes)
    panel = rows_panel(
        rows, measures.run.duration, span, "m", start=_start(measures), note_title="mean"
    )
    panel = Panel(panel.data, panel.layout, 430)
    of = "truth" if positions.against_truth else "mean"
    caption = (
        f"East, north and up from the {of}; each row spans ±{span:g} m. Shaded: one sigma as the "
        "solver states it. A still antenna shows the receiver's own noise here."
    )
    return Figure("Position over time", caption, [panel], half=True)


def velocity(measures: Measures) -> Figure | None:
    """Velocity from Doppler."""
    positions = measures.positions
    if positions is None:
        return None
    values, sd = 100 * positions.velocity, 100 * positions.velocity_sd
    rms = np.sqrt((values**2).mean(axis=0))
    span = nice_span([*np.abs(values).max(axis=0), *sd.max(axis=0)])
    rows = _axes_rows(positions, values, sd, [f"{v:.2g} cm/s" for v in rms])
    panel = rows_panel(rows, measures.run.duration, span, "cm/s", start=_start(measures))
    caption = (
        f"From Doppler, epoch by epoch, unfiltered; each row spans ±{span:g} cm/s. "
        "Shaded: one sigma as the solver states it."
    )
    return Figure("Velocity", caption, [Panel(panel.data, panel.layout, 300)], half=True)


def clock(measures: Measures) -> Figure | None:
    """Receiver clock."""
    positions, run = measures.positions, measures.run
    if positions is None:
        return None
    good = run.pvt["status"] > 0
    drift = run.pvt["clock_drift"][good]
    data = [
        line(*envelope(positions.t, run.pvt["clock_bias"][good]), EAST, hover="%{y:.3f} m"),
        line(*envelope(positions.t, drift), NORTH, hover="%{y:.3f} m/s", yaxis="y2"),
    ]
    layout = {
        "xaxis": time_axis(run.duration, _start(measures), anchor="y2"),
        "yaxis": axis("bias [m]", domain=[0.54, 1]),
        "yaxis2": axis("drift [m/s]", domain=[0, 0.46]),
    }
    caption = (
        "Receiver clock ahead of GPS time, in metres of range, and its rate: 1 m/s is 3.3 parts "
        "in 10⁹ of the oscillator's frequency."
    )
    return Figure("Receiver clock", caption, [Panel(data, layout, 300)], half=True)


def residuals(measures: Measures, colours: Colours) -> Figure | None:
    """Pseudorange residuals of the position solutions."""
    run, rows = measures.run, []
    if not run.pvt.count:
        return None
    t = run.seconds(run.pvt.per_row("sample_index"))
    for satellite in np.unique(run.pvt["satellites"]):
        name = str(satellite)
        chosen = run.pvt["satellites"] == satellite
        values = run.pvt["pseudorange_residual"][chosen]
        note = f"{float(np.sqrt(np.mean(values**2))):.2f} m"
        rows.append(Row(name, colours[name], *envelope(t[chosen], values), note, name))
    if not rows:
        return None
    span = nice_span([float(np.abs(run.pvt["pseudorange_residual"]).max())])
    caption = (
        f"Measured less modelled range of the satellites used; each row spans ±{span:g} m. A row "
        "off zero is an error of that range alone: multipath, ephemeris or atmosphere."
    )
    panel = rows_panel(rows, run.duration, span, "m", start=_start(measures))
    return Figure("Pseudorange residuals", caption, [panel], half=True)


def geometry(measures: Measures) -> Figure | None:
    """Dilution of precision, and how many satellites were used."""
    pvt, run = measures.run.pvt, measures.run
    if not pvt.count:
        return None
    t, data = run.seconds(pvt["sample_index"]), []
    names = (("gdop", "@ink"), ("pdop", EAST), ("hdop", NORTH), ("vdop", UP))
    for name, colour in names:
        trace = line(*envelope(t, pvt[name], 500), colour, hover=f"{name.upper()} %{{y:.2f}}")
        data.append(trace | {"name": name.upper(), "showlegend": True})
    used = np.bincount(pvt["row"], minlength=pvt.count)
    count = line(*envelope(t, used, 500), "@muted", hover="%{y:.0f} satellites", yaxis="y2")
    data.append(count)
    data[-1]["line"] = {"color": "@muted", "width": 1.4, "shape": "hv"}
    layout = {
        "xaxis": time_axis(run.duration, _start(measures), anchor="y2"),
        "yaxis": axis("dilution [-]", domain=[0.42, 1], rangemode="tozero"),
        "yaxis2": axis("satellites", domain=[0, 0.32], rangemode="tozero", dtick=4),
        "showlegend": True,
        "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0},
    }
    caption = (
        "Factor from range error to position error: all four unknowns (GDOP), position (PDOP), "
        "horizontal (HDOP), height (VDOP)."
    )
    height = max(300, ROW_HEIGHT * len(np.unique(pvt["satellites"])) + 66)
    return Figure("Geometry", caption, [Panel(data, layout, height)], half=True)


def _start(measures: Measures) -> float:
    """Where time axes of solutions begin [s]: at the run's start if the fix came early."""
    first, end = measures.first_fix_s, measures.run.duration
    return 0.0 if not first > 0.1 * end else max(0.0, first - 0.03 * (end - first))


def _axes_rows(
    positions: Positions, values: FloatArray, sd: FloatArray, notes: list[str]
) -> list[Row]:
    rows = []
    for k, (name, colour) in enumerate(AXES):
        t, y = envelope(positions.t, values[:, k])
        rows.append(Row(name, colour, t, y, notes[k], sd=np.interp(t, positions.t, sd[:, k])))
    return rows


def _ellipse(centre: FloatArray, covariance: FloatArray, name: str, dash: str) -> dict[str, Any]:
    """One-sigma ellipse (39 % of a normal distribution lie in it)."""
    sizes, axes = np.linalg.eigh(covariance)
    angle = np.linspace(0, 2 * np.pi, 73)
    circle = np.stack((np.cos(angle), np.sin(angle))) * np.sqrt(np.maximum(sizes, 0))[:, None]
    x, y = axes @ circle
    style: dict[str, Any] = {
        "line": {"dash": dash, "width": 1.6},
        "name": name,
        "showlegend": True,
    }
    return line(centre[0] + x, centre[1] + y, "@ink", **style) | {"hoverinfo": "skip"}


def _point(at: FloatArray, name: str, symbol: str, colour: str) -> dict[str, Any]:
    marker = {"symbol": symbol, "size": 13, "color": colour, "line": {"width": 2}}
    values = {"x": [float(at[0])], "y": [float(at[1])], "name": name, "showlegend": True}
    hover = name + ": E %{x:.2f} m, N %{y:.2f} m<extra></extra>"
    base = {"type": "scatter", "mode": "markers", "hovertemplate": hover}
    return base | values | {"marker": marker}
