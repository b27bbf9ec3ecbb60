"""Pictures of the acceptance of displacements: streams beside the truth, and their errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np

from deepseis_bringup.accept_figures import mark
from deepseis_bringup.report_plot import PALETTE, Figure, Row, envelope, nice_span, rows_panel
from deepseis_core.types import FloatArray


class Moved(Protocol):
    """Displacements at times [s], east, north, up [m]."""

    @property
    def t(self) -> FloatArray:
        """Times, (m,) [s]."""

    @property
    def moved(self) -> FloatArray:
        """Displacements, (m, 3) [m]."""


def displacement_figures(
    scene: str,
    streams: Mapping[str, Moved],
    truth: Callable[[FloatArray], FloatArray],
    still: tuple[float, float],
    moving: tuple[float, float],
) -> list[Figure]:
    """Draw the northward displacement of every stream below the truth, and their errors.

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
    true = 1e3 * truth(t)[:, 1]
    shown, wrong, peaks = [Row("truth", "@muted", *envelope(t, true), "", "truth")], [], []
    for k, (name, stream) in enumerate(streams.items()):
        inside = (stream.t >= begin) & (stream.t < end)
        times, moved = stream.t[inside], 1e3 * stream.moved[inside][:, 1]
        error = moved - 1e3 * truth(times)[:, 1] if times.size else moved
        rest = error[times < still[1]]
        error = error - rest.mean() if rest.size else error
        shaken = error[(times >= moving[0]) & (times < moving[1])]
        rms = float(np.sqrt(np.mean(shaken**2))) if shaken.size else float("nan")
        peaks.append(rms)
        colour = PALETTE[k % len(PALETTE)]
        text = f"{rms:.2f}" if np.isfinite(rms) else "lost"
        shown.append(Row(name, colour, *envelope(times, moved), "", name))
        wrong.append(Row(name, colour, *envelope(times, error), text, name))
    span = nice_span([1.05 * float(np.abs(true).max(initial=1.0))])
    small = nice_span([5.0 * min([p for p in peaks if np.isfinite(p)], default=1.0)])
    panels = rows_panel(shown, end, span, ""), rows_panel(wrong, end, small, "mm")
    for panel in panels:
        mark(panel.layout, moving)
    return [
        Figure(
            f"Displacement north, {scene}",
            f"Truth and what comes out; rows span {span:g} mm either way.",
            [panels[0]],
        ),
        Figure(
            f"Error north, {scene}",
            f"Rows span {small:g} mm either way, at the right the RMS while it moves [mm]; what "
            "a stream is off by at rest is taken off.",
            [panels[1]],
        ),
    ]
