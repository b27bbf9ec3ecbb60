"""Parts of figures as plain Plotly JSON: colours, thinned traces, rows of records.

Colours that depend on light and dark are names such as ``@ink``; the page's script knows them.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from deepseis_core.types import FloatArray

PALETTE: Final = (
    *("#3b7dd8", "#d9622b", "#2f9e6e", "#c2456f", "#8a63d2", "#b0860f"),
    *("#1697a6", "#a5673f", "#cf5aa6", "#6b8f23", "#5568c8", "#7c8794"),
)
"""Mid tones: readable on white and on near-black."""

POINTS: Final = 900  # of one line: more than the pixels it is drawn on
ROW_HEIGHT: Final = 46  # [px]
SIGMA: Final = "\N{GREEK SMALL LETTER SIGMA}"
TIMES: Final = "\N{MULTIPLICATION SIGN}"


@dataclass(frozen=True)
class Panel:
    """One drawing: traces and layout of Plotly, height [px], satellite it is about."""

    data: list[dict[str, Any]]
    layout: dict[str, Any]
    height: int = 320
    satellite: str = ""


@dataclass(frozen=True)
class Figure:
    """A titled drawing, or a grid of small ones, with a caption."""

    title: str
    caption: str
    panels: list[Panel] = field(default_factory=list)
    half: bool = False
    grid: bool = False


class Colours:
    """One colour for each satellite, the same in every figure."""

    def __init__(self, satellites: Iterable[str]) -> None:
        self._index = {s: k for k, s in enumerate(sorted(satellites))}

    def __getitem__(self, satellite: str) -> str:
        """Return the colour of a satellite."""
        return PALETTE[self._index.get(satellite, len(PALETTE) - 1) % len(PALETTE)]


def packed(values: Any) -> dict[str, str]:
    """Encode numbers as Plotly's typed arrays: half the size of text, and no digits lost.

    Examples
    --------
    >>> packed([1.0])
    {'dtype': 'f4', 'bdata': 'AACAPw=='}
    """
    data = np.ascontiguousarray(np.asarray(values, dtype="<f4"))
    return {"dtype": "f4", "bdata": base64.b64encode(data.tobytes()).decode("ascii")}


def envelope(
    t: FloatArray, y: NDArray[Any], points: int = POINTS
) -> tuple[FloatArray, FloatArray]:
    """Thin a record so that its extremes stay: the least and the greatest value of every bin.

    Parameters
    ----------
    t, y : ndarray, shape (n,)
        Times in ascending order, and values.
    points : int
        Returned at most; to these a NaN is added for every hole of the record.

    Examples
    --------
    >>> t, y = envelope(np.arange(1000.0), np.where(np.arange(1000) == 500, 9.0, 0.0), 20)
    >>> len(t) <= 20, float(y.max())
    (True, 9.0)
    """
    t, y = np.asarray(t, np.float64), np.asarray(y, np.float64)
    keep = np.isfinite(y)
    t, y = t[keep], y[keep]
    if t.size <= points:
        return with_breaks(t, y)
    part = np.concatenate(([0], np.cumsum(_holes(t))))
    edges = np.linspace(0, t.size, points // 2 + 1).astype(np.int64)
    least = np.array([a + y[a:b].argmin() for a, b in pairwise(edges)])
    most = np.array([a + y[a:b].argmax() for a, b in pairwise(edges)])
    chosen = np.unique(np.concatenate((least, most)))
    breaks = np.flatnonzero(np.diff(part[chosen])) + 1
    return np.insert(t[chosen], breaks, t[chosen[breaks - 1]]), np.insert(
        y[chosen], breaks, np.nan
    )


def averaged(
    t: FloatArray, y: NDArray[Any], bins: int, start: float, end: float
) -> tuple[FloatArray, FloatArray]:
    """Means of equal bins of time; empty ones are left out and break the line."""
    keep = np.isfinite(y) & (t >= start) & (t <= end)
    at = np.clip(((t[keep] - start) / max(end - start, 1e-9) * bins).astype(np.int64), 0, bins - 1)
    count = np.bincount(at, minlength=bins)
    total = np.bincount(at, weights=np.asarray(y, np.float64)[keep], minlength=bins)
    full = count > 0
    centre = start + (np.arange(bins) + 0.5) * (end - start) / bins
    return with_breaks(centre[full], total[full] / count[full])


def with_breaks(t: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Put a NaN into every hole that is much longer than usual, so that no line crosses it."""
    holes = np.flatnonzero(_holes(t)) + 1
    return np.insert(t, holes, t[holes - 1]), np.insert(y, holes, np.nan)


def _holes(t: FloatArray) -> NDArray[np.bool_]:
    """Tell the steps of a record that are much longer than usual."""
    step = np.diff(t)
    usual = float(np.median(step)) if step.size > 1 else np.inf
    return np.asarray(step > max(8 * usual, 0.25))


def line(
    t: Any, y: Any, colour: str, satellite: str = "", *, hover: str = "", **style: Any
) -> dict[str, Any]:
    """Return a line trace."""
    label = f"{satellite} " if satellite else ""
    trace: dict[str, Any] = {
        "type": "scatter",
        "mode": "lines",
        "x": packed(t),
        "y": packed(y),
        "line": {"color": colour, "width": 1.2},
        "showlegend": False,
        "hovertemplate": f"{label}%{{x:.2f}} s: {hover or '%{y:.3g}'}<extra></extra>",
    }
    if satellite:
        trace["legendgroup"] = satellite
    trace["line"] |= style.pop("line", {})
    return trace | style


def time_axis(end: float, start: float = 0.0, **more: Any) -> dict[str, Any]:
    """Return an axis of time since the first sample [s]."""
    return {"title": {"text": "time since the first sample [s]"}, "range": [start, end], **more}


def axis(title: str, **more: Any) -> dict[str, Any]:
    """Return an axis with a title."""
    return {"title": {"text": title}, **more}


def moment(t: float, text: str) -> dict[str, list[dict[str, Any]]]:
    """Return shapes and annotations that mark a moment, to be merged into a layout."""
    if not np.isfinite(t):
        return {}
    dotted = {"color": "@muted", "width": 1, "dash": "dot"}
    return {
        "shapes": [
            {"type": "line", "x0": t, "x1": t, "yref": "paper", "y0": 0, "y1": 1, "line": dotted}
        ],
        "annotations": [
            {
                **{"x": t, "yref": "paper", "y": 1, "yanchor": "bottom", "text": text},
                **{"showarrow": False, "font": {"size": 11, "color": "@muted"}},
            }
        ],
    }


@dataclass(frozen=True)
class Row:
    """One record of a section: name, colour, samples, what stands at its right end."""

    name: str
    colour: str
    t: FloatArray
    y: FloatArray
    note: str = ""
    satellite: str = ""
    sd: FloatArray | None = None


def rows_panel(
    rows: Sequence[Row],
    end: float,
    span: float,
    unit: str,
    *,
    start: float = 0.0,
    note_title: str = "RMS",
) -> Panel:
    """Draw records below each other on one time axis, as a seismic section.

    Every row spans ``-span`` to ``span``; what goes beyond is cut off at the row's edge.
    """
    data: list[dict[str, Any]] = []
    layout: dict[str, Any] = {"annotations": [], "hovermode": "closest"}
    count = max(len(rows), 1)
    for k, row in enumerate(rows):
        name = "" if k == 0 else str(k + 1)
        top, bottom = 1 - k / count, 1 - (k + 1) / count
        layout[f"yaxis{name}"] = {
            "domain": [bottom, top],
            "range": [-span, span],
            "tickvals": [0],
            "ticktext": [f'<span style="color:{row.colour}"><b>{row.name}</b></span>'],
            "zeroline": True,
            "showgrid": False,
            "fixedrange": True,
        }
        if row.sd is not None:
            data.append(_band(row, f"y{name}"))
        style = {"yaxis": f"y{name}", "hover": f"%{{y:.3g}} {unit}"}
        data.append(line(row.t, row.y, row.colour, row.satellite, **style, line={"width": 1}))
        layout["annotations"].append(
            {
                **{"xref": "paper", "x": 1, "xanchor": "left", "xshift": 6, "showarrow": False},
                **{"yref": f"y{name}", "y": 0, "text": row.note, "font": {"size": 11}},
            }
        )
    last = "" if count == 1 else str(count)
    layout["xaxis"] = time_axis(end, start, anchor=f"y{last}")
    layout["annotations"].append(
        {
            **{"xref": "paper", "x": 1, "xanchor": "left", "xshift": 6, "yref": "paper", "y": 1},
            **{"yanchor": "bottom", "text": note_title, "showarrow": False},
            "font": {"size": 11, "color": "@muted"},
        }
    )
    layout["margin"] = {"r": 66, "t": 22}
    return Panel(data, layout, height=ROW_HEIGHT * count + 66)


def _band(row: Row, y_axis: str) -> dict[str, Any]:
    """One sigma about zero, shaded."""
    assert row.sd is not None
    return {
        "type": "scatter",
        "mode": "none",
        "x": packed(np.concatenate((row.t, row.t[::-1]))),
        "y": packed(np.concatenate((row.sd, -row.sd[::-1]))),
        "fill": "toself",
        "fillcolor": "@band",
        "hoverinfo": "skip",
        "showlegend": False,
        "yaxis": y_axis,
    }


def merged(*parts: dict[str, Any]) -> dict[str, Any]:
    """Join layouts; lists of shapes and annotations are put together."""
    out: dict[str, Any] = {}
    for part in parts:
        for key, value in part.items():
            out[key] = [*out[key], *value] if isinstance(out.get(key), list) else value
    return out


def nice_span(values: Iterable[float], least: float = 0.0) -> float:
    """Round the greatest of some values up to a plain number.

    Examples
    --------
    >>> nice_span([0.3, 12.1])
    15.0
    """
    greatest = max([abs(v) for v in values if np.isfinite(v)] + [least, 1e-9])
    power = 10.0 ** np.floor(np.log10(greatest))
    steps = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.5, 10.0)
    return float(next(m * power for m in steps if m * power >= greatest * 0.999))


def decades(low: float, high: float) -> dict[str, Any]:
    """Return a logarithmic axis with plain numbers on it."""
    ticks = [m * 10.0**k for k in range(-3, 6) for m in (1, 2, 5)]
    ticks = [v for v in ticks if low <= v <= high]
    limits = [float(np.log10(low)), float(np.log10(high))]
    text = [f"{v:g}" for v in ticks]
    return {"type": "log", "range": limits, "tickvals": ticks, "ticktext": text}


def signed(value: float, form: str = "+.2f") -> str:
    """Format a number with a true minus sign."""
    return f"{value:{form}}".replace("-", "\N{MINUS SIGN}")
