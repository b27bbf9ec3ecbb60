"""Pictures of the acceptance of displacements: streams beside the truth, and their errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np

from deepseis_bringup.accept.figures import mark
from deepseis_bringup.report.plot import (
    PALETTE,
    Figure,
    Panel,
    Row,
    axis,
    envelope,
    line,
    nice_span,
    rows_panel,
    time_axis,
)
from deepseis_core.types import FloatArray


class Moved(Protocol):
    """Displacements at times [s], east, north, up [m]."""

    @property
    def t(self) -> FloatArray:
        """Times, (m,) [s]."""

    @property
    def moved(self) -> FloatArray:
        """Displacements, (m, 3) [m]."""


def stream_figures(
    scene: str,
    streams: Mapping[str, Moved],
    truth: Callable[[FloatArray], FloatArray],
    still: tuple[float, float],
    moving: tuple[float, float],
) -> list[Figure]:
    """Draw every stream's displacement below the truth, and its error.

    North, or east where nothing moves to the north.

    Parameters
    ----------
    scene : str
        Its name.
    streams : mapping
        Streams by name.
    truth : callable
        Displacement at times, (m, 3) [m].
    still, moving : tuple of float
        [s]
    """
    begin, end = still[0], moving[1] + 1.0
    t = np.arange(begin, end, 0.01)
    moved = 1e3 * truth(t)
    column = 1 if np.ptp(moved[:, 1]) > 0.1 * np.ptp(moved[:, 0]) else 0
    true, side = moved[:, column], ("east", "north")[column]
    shown, wrong, peaks = [Row("truth", "@muted", *envelope(t, true), "", "truth")], [], []
    for k, (name, stream) in enumerate(streams.items()):
        inside = (stream.t >= begin) & (stream.t < end)
        times, given = stream.t[inside], 1e3 * stream.moved[inside][:, column]
        error = given - 1e3 * truth(times)[:, column] if times.size else given
        rest = error[times < still[1]]
        error = error - rest.mean() if rest.size else error
        shaken = error[(times >= moving[0]) & (times < moving[1])]
        rms = float(np.sqrt(np.mean(shaken**2))) if shaken.size else float("nan")
        peaks.append(rms)
        colour = PALETTE[k % len(PALETTE)]
        text = f"{rms:.2f}" if np.isfinite(rms) else "lost"
        shown.append(Row(name, colour, *envelope(times, given), "", name))
        wrong.append(Row(name, colour, *envelope(times, error), text, name))
    span = nice_span([1.05 * float(np.abs(true).max(initial=1.0))])
    small = nice_span([5.0 * min([p for p in peaks if np.isfinite(p)], default=1.0)])
    panels = rows_panel(shown, end, span, ""), rows_panel(wrong, end, small, "mm")
    for panel in panels:
        mark(panel.layout, moving)
    return [
        Figure(
            f"Displacement {side}, {scene}",
            f"Truth and what comes out; rows span {span:g} mm either way.",
            [panels[0]],
        ),
        Figure(
            f"Error {side}, {scene}",
            f"Rows span {small:g} mm either way, at the right the RMS while it moves [mm]; what "
            "a stream is off by at rest is taken off.",
            [panels[1]],
        ),
    ]


def step_figures(
    scene: str,
    streams: Mapping[str, Moved],
    truth: Callable[[FloatArray], FloatArray],
    still: tuple[float, float],
    end: float,
    outside: str,
) -> list[Figure]:
    """Draw a displacement that stays: truth and streams over each other, and small errors.

    Parameters
    ----------
    scene : str
        Its name.
    streams : mapping
        Streams by name.
    truth : callable
        Displacement at times, (m, 3) [m].
    still : tuple of float
        [s]
    end : float
        [s]
    outside : str
        Stream whose errors are far larger than the others': it has no row among them.
    """
    t = np.arange(still[0], end, 0.02)
    figures = []
    for column, axis_name in ((0, "east"), (1, "north")):
        true = truth(t)[:, column]
        data = [line(*envelope(t, true), "@ink", name="truth", showlegend=True, line={"width": 4})]
        for k, (name, stream) in enumerate(streams.items()):
            inside = stream.t >= still[0]
            shown = envelope(stream.t[inside], stream.moved[inside][:, column])
            data.append(line(*shown, PALETTE[k], hover="%{y:.3f} m", name=name, showlegend=True))
        reach = [1.6 * float(np.abs(true).max(initial=0.1))] * 2
        layout = {
            "xaxis": time_axis(end, still[0]),
            "yaxis": axis(f"{axis_name} [m]", range=[-reach[0], reach[1]]),
            "showlegend": True, "legend": {"x": 0, "y": 1},
        }  # fmt: skip
        caption = "Displacement; the accelerometer alone drifts away."
        figures.append(Figure(f"Step {axis_name}, {scene}", caption, [Panel(data, layout)]))
    figures.append(_step_errors(scene, streams, truth, still, end, outside))
    return figures


def _step_errors(
    scene: str, streams: Mapping[str, Moved], truth: Callable[[FloatArray], FloatArray],
    still: tuple[float, float], end: float, outside: str,
) -> Figure:  # fmt: skip
    rows, peaks = [], []
    for k, (name, stream) in enumerate(streams.items()):
        if name == outside or not stream.t.size:
            continue
        error = 1e3 * (stream.moved - truth(stream.t))
        rest = (stream.t >= still[0]) & (stream.t < still[1])
        error -= error[rest].mean(axis=0)
        after = stream.t >= still[0]
        for column, axis_name in enumerate(("E", "N", "U")):
            rms = float(np.sqrt(np.mean(error[after, column] ** 2)))
            peaks.append(float(np.abs(error[after, column]).max()))
            shown = envelope(stream.t[after], error[after, column])
            rows.append(Row(f"{name} {axis_name}", PALETTE[k], *shown, f"{rms:.2f}", ""))
    span = nice_span(peaks, 1.0)
    caption = f"Streams less the truth; rows span {span:g} mm either way, RMS at the right [mm]."
    panel = rows_panel(rows, end, span, "mm", start=still[0])
    return Figure(f"Errors, {scene}", caption, [panel])
