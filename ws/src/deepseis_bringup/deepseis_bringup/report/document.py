"""The HTML document that every report page is: style, figures, script, nothing from outside."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from html import escape
from importlib import resources
from typing import Any

from deepseis_bringup.report.plot import Colours, Figure
from deepseis_bringup.report.style import SCRIPT, STYLE

TIMES = "Times count from the first sample of the run. Drag to zoom, double-click to go back."
FOOTER = f"{TIMES} The buttons at the top show or hide a satellite everywhere."


@dataclass(frozen=True)
class Tile:
    """A key figure."""

    name: str
    value: str
    unit: str = ""
    more: str = ""
    bad: bool = False

    def html(self) -> str:
        """Return the tile."""
        unit = f'<span class="unit">{escape(self.unit)}</span>' if self.unit else ""
        return (
            f'<div class="tile{" bad" if self.bad else ""}"><dt>{escape(self.name)}</dt>'
            f'<dd><span class="value">{escape(self.value)}</span>{unit}'
            f'<div class="more">{escape(self.more)}</div></dd></div>'
        )


def page_head(
    kind: str,
    title: str,
    lead: str = "",
    when: str = "",
    tiles: Iterable[Tile] = (),
    more: str = "",
) -> str:
    """Return the top of a page.

    Parameters
    ----------
    kind : str
        What sort of page it is.
    title, lead, when : str
        Heading, what came out in a sentence, and from when to when; plain text.
    tiles : iterable of Tile
        Key figures.
    more : str
        HTML after the lead.
    """
    figures = "".join(tile.html() for tile in tiles)
    parts = [
        f'<p class="kind">DeepSeis {escape(kind)}</p><h1>{escape(title)}</h1>',
        f'<p class="lead">{escape(lead)}</p>' if lead else "",
        more,
        f'<p class="when">{escape(when)}</p>' if when else "",
        f'<dl class="tiles">{figures}</dl>' if figures else "",
    ]
    return f'<header class="top">{"".join(parts)}</header>'


def document(
    title: str,
    head: str,
    body: Iterable[str],
    panels: list[dict[str, Any]],
    footer: str = FOOTER,
) -> str:
    """Return the page.

    Parameters
    ----------
    title : str
        Of the window.
    head : str
        HTML above the body.
    body : iterable of str
        HTML of the sections.
    panels : list
        Drawings, as `place` collected them.
    footer : str
        Plain text below all; empty: none.
    """
    below = f"<footer>{escape(footer)}</footer>" if footer else ""
    data = json.dumps(panels, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>{escape(title)}</title><style>{STYLE}</style></head><body>"
        f"{head}<main>{''.join(body)}</main>{below}"
        f"<script>{_plotly()}</script>"
        f'<script type="application/json" id="figures">{data}</script>'
        f"<script>{SCRIPT}</script></body></html>\n"
    )


def place(figures: Iterable[Figure], panels: list[dict[str, Any]], colours: Colours) -> str:
    """Place figures and append their data to ``panels``."""
    parts = []
    for figure in figures:
        drawings = []
        for panel in figure.panels:
            number = len(panels)
            panels.append({"data": panel.data, "layout": panel.layout, "height": panel.height})
            plot = f'<div data-panel="{number}" style="min-height:{panel.height}px"></div>'
            if figure.grid:
                colour = colours[panel.satellite]
                plot = (
                    f'<div data-satellite="{panel.satellite}"><h4 style="color:{colour}">'
                    f"{panel.satellite}</h4>{plot}</div>"
                )
            drawings.append(plot)
        inside = "".join(drawings)
        inside = f'<div class="grid">{inside}</div>' if figure.grid else inside
        parts.append(
            f"<figure{' class=half' if figure.half else ''}><figcaption>"
            f"<h3>{escape(figure.title)}</h3>"
            f'<p class="caption">{escape(figure.caption)}</p></figcaption>{inside}</figure>'
        )
    return f'<div class="figures">{"".join(parts)}</div>'


def switches(satellites: Iterable[str], colours: Colours) -> str:
    """Return buttons that show or hide a satellite everywhere."""
    buttons = "".join(
        f'<button type="button" value="{s}" aria-pressed="true">'
        f'<i style="background:{colours[s]}"></i>{s}</button>'
        for s in satellites
    )
    return f"<nav><div><span>Show</span>{buttons}</div></nav>" if buttons else ""


def _plotly() -> str:
    script = resources.files("plotly").joinpath("package_data/plotly.min.js")
    return script.read_text(encoding="utf-8").replace("</script", "<\\/script")
