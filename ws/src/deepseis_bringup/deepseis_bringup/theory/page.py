"""The page of the redrawn theory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any, Final

from deepseis_bringup.report.document import document, page_head, place
from deepseis_bringup.report.plot import PALETTE, Colours, Figure, Panel, axis, line, moment
from deepseis_bringup.report.tables import files_table
from deepseis_bringup.theory.chart import OTHER, TOTAL, Chart, Comparison

TITLE: Final = "Errors of the tracking loops, in theory"
LEAD: Final = (
    "The papers' theoretical figures, drawn from our formulas (deepseis_tracking.loop_theory). "
    "Their pictures are lost: what the text reads off them is marked, and stands beside ours."
)
OWN_STYLE: Final = "<style>td .line{white-space:normal}</style>"
HEIGHT: Final = 330
LEGEND_ROW: Final = 19


def page(
    sections: Mapping[str, Sequence[Chart]],
    rows: Sequence[Comparison],
    inconsistencies: Mapping[str, str],
    folder: Path,
) -> str:
    """Return the page.

    Parameters
    ----------
    sections : mapping
        Figures by the title of their section.
    rows : sequence of Comparison
        For the table at the end.
    inconsistencies : mapping
        What is wrong in print, by where it stands.
    folder : path
        The run's, for the list of its files.
    """
    panels: list[dict[str, Any]] = []
    colours = Colours([])
    body = [
        f"<h2>{escape(name)}</h2>{place(map(figure, charts), panels, colours)}"
        for name, charts in sections.items()
    ]
    body += [_published(rows), _inconsistencies(inconsistencies), _files(folder)]
    head = OWN_STYLE + page_head("theory", TITLE, LEAD)
    return document(TITLE, head, body, panels, footer="")


def figure(chart: Chart) -> Figure:
    """Draw a chart."""
    data, colour = [], iter(PALETTE)
    totals = sum(curve.kind == TOTAL for curve in chart.curves)
    for curve in chart.curves:
        own = "@ink" if curve.kind == TOTAL and totals == 1 else next(colour)
        width = {TOTAL: 2.4, OTHER: 1.4}.get(curve.kind, 1.4)
        style = {"width": width} | ({"dash": "dash"} if curve.kind == OTHER else {})
        trace = line(chart.x, curve.y, own, line=style, name=curve.name, showlegend=True)
        hover = f"{escape(curve.name)}<br>{chart.x_name}: %{{x:.4g}}<br>%{{y:.3g}}°<extra></extra>"
        data.append(trace | {"hovertemplate": hover})
    height = HEIGHT + LEGEND_ROW * ((len(data) + 1) // 2)
    return Figure(chart.title, chart.caption, [Panel(data, _layout(chart), height)], chart.half)


def _layout(chart: Chart) -> dict[str, Any]:
    shapes: list[dict[str, Any]] = []
    notes: list[dict[str, Any]] = []
    for at, text in chart.marks:
        marked = moment(at, text)
        shapes += marked["shapes"]
        notes += marked["annotations"]
    if chart.limit is not None:
        red = {"color": "@warn", "width": 1, "dash": "dash"}
        whole = {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "line": red}
        shapes.append(whole | {"y0": chart.limit, "y1": chart.limit})
        notes.append(
            {
                **{"xref": "paper", "x": 1, "xanchor": "right", "y": chart.limit},
                **{"yanchor": "bottom", "text": f"{chart.limit:g}°", "showarrow": False},
                "font": {"size": 11, "color": "@warn"},
            }
        )
    return {
        "xaxis": axis(chart.x_name, range=[float(chart.x[0]), float(chart.x[-1])]),
        "yaxis": axis(chart.y_name, range=list(chart.y_range)),
        "shapes": shapes,
        "annotations": notes,
        "showlegend": True,
        "legend": {
            "orientation": "h",
            "y": 1.08 if chart.marks else 1.02,
            "yanchor": "bottom",
            "x": 0,
        }
        | {"entrywidth": 0.48, "entrywidthmode": "fraction"},
    }


def _published(rows: Sequence[Comparison]) -> str:
    head = "".join(f"<th>{name}</th>" for name in ("Where", "What", "Published", "Ours", "Remark"))
    lines = "".join(
        "<tr>" + "".join(f"<td>{escape(value)}</td>" for value in vars(row).values()) + "</tr>"
        for row in rows
    )
    table = f'<table class="words"><tr>{head}</tr>{lines}</table>'
    return (
        '<h2>Published and ours</h2><div class="figures"><figure>'
        f'<div class="scroll" tabindex="0">{table}</div></figure></div>'
    )


def _inconsistencies(found: Mapping[str, str]) -> str:
    lines = "".join(
        f"<tr><td>{escape(where)}</td><td>{escape(text)}</td></tr>"
        for where, text in found.items()
    )
    return (
        "<h2>Where the papers contradict themselves or are silent</h2>"
        '<div class="figures"><figure>'
        f'<div class="scroll" tabindex="0"><table class="words">{lines}</table></div>'
        "</figure></div>"
    )


def _files(folder: Path) -> str:
    return (
        '<h2>Files</h2><div class="figures"><figure class="half">'
        f"{files_table(folder, ('report.html',))}</figure></div>"
    )
