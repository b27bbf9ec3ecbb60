"""Pictures of the acceptance without gyroscopes: displacement, errors, their spectra."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from scipy.signal import periodogram

from deepseis_bringup.accept.gyrofree_runs import Stations, Ways
from deepseis_bringup.report.plot import (
    PALETTE,
    Figure,
    Panel,
    Row,
    axis,
    decades,
    envelope,
    line,
    merged,
    moment,
    nice_span,
    packed,
    rows_panel,
    time_axis,
)
from deepseis_core.types import FloatArray
from deepseis_ins import gyrofree_limits as limits

AXES: Final = ("East", "North", "Up")
LEGEND: Final[dict[str, Any]] = {
    "showlegend": True,
    "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0},
}
ENDING_S: Final = 35.0
"""Of the motion that is drawn larger [s]."""
BINS: Final = 40
"""Of a spectrum, equally wide on its logarithmic axis."""


def pictures(stations: Stations, runs: Sequence[Ways]) -> list[tuple[str, list[Figure]]]:
    """Return all figures in sections; those of one run are of the first."""
    return [
        ("Displacement, run 1", [_displacement(stations, runs[0], k) for k in range(3)]),
        ("Errors, run 1", [_errors(stations, runs[0], k) for k in range(3)]),
        ("Spectra of errors, all runs", [_spectra(stations, runs, k) for k in range(3)]),
    ]


def _estimates(ways: Ways) -> list[tuple[str, FloatArray]]:
    return [
        ("9 states", ways.nine.forward),
        ("9, smoothed", ways.nine.smoothed),
        ("12 states", ways.twelve.forward),
        ("12, smoothed", ways.twelve.smoothed),
        ("still known", ways.held.forward),
        ("same, smoothed", ways.held.smoothed),
    ]


def _displacement(stations: Stations, ways: Ways, k: int) -> Figure:
    """Draw truth, GNSS, filter and smoother: the whole motion, and its end where it is small."""
    begin, end = stations.moving
    return Figure(
        AXES[k],
        "The whole motion, and below it the end on a scale that shows the errors. GNSS once a "
        "second.",
        [
            _tracks(stations, ways, k, (begin - 5.0, end), 240),
            _tracks(stations, ways, k, (end - ENDING_S, end), 300),
        ],
    )


def _tracks(
    stations: Stations, ways: Ways, k: int, span: tuple[float, float], height: int
) -> Panel:
    inside = (stations.time >= span[0]) & (stations.time <= span[1])
    t, truth = stations.time[inside], stations.truth[inside, k]
    at = stations.epochs / stations.rate_hz
    chosen = (at >= span[0]) & (at <= span[1])
    measured = stations.at_epochs[chosen, k] + ways.gnss[chosen, k]
    data = [
        _named(t, truth, "@muted", "truth", width=4.0),
        _named(t, truth + ways.twelve.forward[inside, k], PALETTE[1], "filter, 12 states"),
        _named(t, truth + ways.held.smoothed[inside, k], PALETTE[0], "still known, smoothed"),
        {
            **{"type": "scatter", "mode": "markers", "name": "GNSS", "showlegend": True},
            **{"x": packed(at[chosen]), "y": packed(100.0 * measured)},
            "marker": {"color": PALETTE[2], "size": 5},
        },
    ]
    layout = {
        "xaxis": time_axis(span[1], span[0]),
        "yaxis": axis(f"{AXES[k].lower()} [cm]"),
        **LEGEND,
    }
    return Panel(data, layout, height=height)


def _errors(stations: Stations, ways: Ways, k: int) -> Figure:
    """Draw errors below each other, the whole run."""
    at = stations.epochs / stations.rate_hz
    records = [("GNSS", at, ways.gnss[:, k]), ("its drift", at, ways.drift[:, k])]
    records += [(name, stations.time, error[:, k]) for name, error in _estimates(ways)]
    rows = []
    for n, (name, t, error) in enumerate(records):
        settled = t >= stations.settled[0]
        note = f"{100.0 * np.sqrt(np.mean(error[settled] ** 2)):.2f}"
        rows.append(Row(name, PALETTE[n], *envelope(t, 100.0 * error), note))
    span = nice_span([250.0 * stations.errors_of_axis(k).sd])
    panel = rows_panel(rows, stations.duration, span, "cm", note_title="RMS [cm]")
    layout = merged(panel.layout, moment(stations.moving[0], "moving"))
    caption = (
        f"Estimate less truth [cm]; rows span {span:g} cm either way. At the right the RMS from "
        f"{stations.settled[0]:g} s on."
    )
    return Figure(AXES[k], caption, [Panel(panel.data, layout, panel.height)])


def _spectra(stations: Stations, runs: Sequence[Ways], k: int) -> Figure:
    """Draw densities of errors at the epochs before the motion's end, and what theory says."""
    at, errors = stations.epochs / stations.rate_hz, stations.errors_of_axis(k)
    kept = np.flatnonzero((at >= stations.settled[0]) & (at > 0.0))
    looks = [stations.looks_at(int(n)) for n in kept]

    def density(series: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
        # Windowed, or the drift would leak over all that lies below it at high frequencies.
        found = [periodogram(x, errors.rate_hz, window="hann", detrend=False) for x in series]
        return _binned(found[0][0][1:], np.mean([p for _, p in found], axis=0)[1:])

    series = {"GNSS": [ways.gnss[kept, k] for ways in runs]}
    for n, (name, _) in enumerate(_estimates(runs[0])[:4]):
        series[name] = [_estimates(ways)[n][1][looks, k] for ways in runs]
    data = [
        _named(*density(values), PALETTE[n], name, scale=1e4)
        for n, (name, values) in enumerate(series.items())
    ]
    f = np.geomspace(0.5 / stations.duration, 0.5 * errors.rate_hz, 200)
    data += [
        _named(f, limits.best_density(f, errors, stations.grade), "@ink", "limit", scale=1e4,
               dash="dash"),
        _named(f, limits.accelerometer_density(f, stations.grade), "@muted", "accelerometers",
               scale=1e4, dash="dot"),
    ]  # fmt: skip
    top = 1e4 * float(errors.density(f).max())
    layout = {
        "xaxis": axis("frequency [Hz]", **decades(float(f[0]), float(f[-1]))),
        "yaxis": axis("density [cm^2/Hz]", **decades(1e-3, 4.0 * top)),
        **LEGEND,
    }
    crossing = limits.crossing_hz(errors, stations.grade)
    caption = (
        "One-sided densities. Accelerometers cannot help where theirs, dotted, lies above the "
        f"drift's: below {crossing:.2f} Hz."
    )
    return Figure(AXES[k], caption, [Panel(data, layout, height=360)])


def _binned(f: FloatArray, density: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Average a spectrum over bins of its logarithmic axis."""
    edges = np.geomspace(f[0], f[-1] * 1.0001, BINS + 1)
    at = np.digitize(f, edges) - 1
    used = np.unique(at)
    return (
        np.array([f[at == n].mean() for n in used]),
        np.array([density[at == n].mean() for n in used]),
    )


def _named(
    x: FloatArray,
    y: FloatArray,
    colour: str,
    name: str,
    *,
    scale: float = 100.0,
    width: float = 1.4,
    dash: str = "solid",
) -> dict[str, Any]:
    style = {"width": width, "dash": dash}
    trace = line(x, scale * y, colour, line=style)
    return trace | {"name": name, "showlegend": True}
