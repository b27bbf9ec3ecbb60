"""Page of an RTK solution of files: where the antenna went, and how sure that is."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from deepseis_bringup.report.document import Tile, document, page_head, place
from deepseis_bringup.report.plot import Colours, Figure, Panel, axis, packed
from deepseis_bringup.report.tables import values_table
from deepseis_bringup.survey.rtk_files import RtkTable, calendar
from deepseis_core.types import PreciseStatus

STATES: Final = (
    (PreciseStatus.FLOAT, "float", "#d9622b"),
    (PreciseStatus.FIX, "fixed", "#2f9e6e"),
)
LEGEND: Final = {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0}


def _points(
    table: RtkTable, x: Any, y: Any, hover: str, shown: bool = True
) -> list[dict[str, Any]]:
    """Return points of an epoch each, a trace for each state."""
    traces = []
    for status, name, colour in STATES:
        chosen = table.status == status
        traces.append(
            {
                "type": "scatter",
                "mode": "markers",
                "x": packed(x[chosen]),
                "y": packed(y[chosen]),
                "marker": {"color": colour, "size": 4},
                "name": f"{name} ({int(chosen.sum())})",
                "legendgroup": name,
                "showlegend": shown,
                "hovertemplate": hover,
            }
        )
    return traces


def _over_time(table: RtkTable, values: Any, title: str, *, shown: bool, **more: Any) -> Panel:
    hover = "%{x:.2f} s: %{y:.4f}<extra></extra>"
    data = _points(table, table.seconds, values, hover, shown)
    layout = {
        "xaxis": axis("time since the first epoch [s]"),
        "yaxis": axis(title, **more),
        "showlegend": shown,
        "legend": dict(LEGEND),
        "hovermode": "closest",
    }
    return Panel(data, layout, 240)


def figures_of(table: RtkTable, limit: float) -> list[Figure]:
    """Return the pictures."""
    panels = [
        _over_time(table, table.enu[:, k], f"{name} [m]", shown=k == 0)
        for k, name in enumerate(("east", "north", "up"))
    ]
    plan = Panel(
        _points(
            table, table.enu[:, 0], table.enu[:, 1], "%{x:.4f} E, %{y:.4f} N<extra></extra>", False
        ),
        {
            "xaxis": axis("east [m]"),
            "yaxis": axis("north [m]", scaleanchor="x"),
            "hovermode": "closest",
        },
        420,
    )
    ratio = np.clip(table.ratio, 0.5, 1e3)
    lines = {
        "shapes": [
            {
                "type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": limit, "y1": limit,
                "line": {"color": "@muted", "width": 1, "dash": "dot"},
            }
        ]
    }  # fmt: skip
    test = _over_time(table, ratio, "ratio", shown=False, type="log")
    test.layout.update(lines)
    seen = _over_time(table, table.satellites.astype(float), "satellites used", shown=False)
    return [
        Figure(
            "Position over time",
            "East, north, up of the median of the fixed epochs. Drag to zoom, double-click to go "
            "back.",
            panels,
        ),
        Figure("In plan", "The same from above.", [plan], half=True),
        Figure(
            "How sure the integers are",
            f"Ratio of the second best set of integers to the best, up to 1000; from {limit:g} on "
            "an epoch counts as fixed. Below: satellites used.",
            [test, seen],
            half=True,
        ),
    ]


def page(table: RtkTable, about: dict[str, Any], limit: float) -> str:
    """Return the page.

    Parameters
    ----------
    table : RtkTable
    about : dict
        Files and settings, for the last table.
    limit : float
        Least ratio of a fixed epoch.
    """
    figures = table.figures()
    panels: list[dict[str, Any]] = []
    body = [
        place(figures_of(table, limit), panels, Colours([])),
        f"<h2>Files and settings</h2>{values_table(about)}",
    ]
    tiles = [
        Tile("Epochs", str(figures["epochs"])),
        Tile("Fixed", f"{figures['fixed_percent']:.1f}", "%", f"{figures['fixed']} epochs"),
        Tile("Float", str(figures["float"]), "", f"{figures['none']} without a solution"),
        _spread(figures.get("spread_fixed_enu_m")),
    ]
    title = f"{about['rover']} against {about['base']}"
    when = f"{calendar(table.times[0])} to {calendar(table.times[-1])} GPS time"
    head = page_head("RTK", title, when=when, tiles=tiles)
    return document("RTK", head, body, panels, footer="")


def _spread(spread: list[float] | None) -> Tile:
    """Return how far fixed epochs lie apart: noise of an antenna at rest, motion of another."""
    name, more = "Spread of fixed epochs", "one sigma, east / north / up; motion is in it"
    if spread is None:
        return Tile(name, "-")
    if max(spread) > 0.5:
        return Tile(name, " / ".join(f"{value:.1f}" for value in spread), "m", more)
    return Tile(name, " / ".join(f"{1e3 * value:.1f}" for value in spread), "mm", more)
