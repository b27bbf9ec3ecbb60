"""Figures of ground motion: displacement of every stream, velocity, acceleration, peaks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np

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
from deepseis_bringup.report.run_measures import Measures
from deepseis_bringup.report.run_motion import (
    AIDED,
    FUSED,
    GNSS,
    OF_IMU,
    RTK,
    SMOOTHED,
    Event,
    Moved,
    errors,
    events,
    streams,
    truth_at,
)
from deepseis_bringup.report.run_truth import Truth
from deepseis_core.types import FloatArray

COLOURS: Final = {name: PALETTE[k] for k, name in enumerate((FUSED, GNSS, RTK, SMOOTHED, AIDED))}
BRIEF: Final = {
    FUSED: "fused", SMOOTHED: "smoothed", AIDED: "aided", GNSS: "GNSS", RTK: "GNSS, base"
}  # fmt: skip
AXES: Final = ("east", "north", "up")
OF_WHAT: Final = (
    " Fused motion is that of the IMU, GNSS alone sees the antenna: a tilt of the mount moves "
    "them apart by its angle times the lever arm."
)
PEAKS: Final = (("PGD", "m"), ("PGV", "m/s"), ("PGA", "m/s²"))


def figures(measures: Measures) -> Iterator[Figure | None]:
    """Give the section's figures; none if the run has no ground motion."""
    moved = streams(measures.run)
    if not moved:
        return
    found = events(measures.run)
    yield _displacement(measures, moved, found)
    for quantity, unit in (("velocity", "m/s"), ("acceleration", "m/s²")):
        yield _derivative(measures, moved, found, quantity, unit)
    yield _growth(measures, found)
    yield _errors(measures, moved, found)


def _displacement(measures: Measures, moved: Mapping[str, Moved], found: list[Event]) -> Figure:
    """Draw every stream over each other, one drawing for each axis below the other."""
    start, end = _span(measures, moved)
    data: list[dict[str, Any]] = []
    layout: dict[str, Any] = {"showlegend": True, "hovermode": "closest"}
    layout["legend"] = {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0}
    t = np.linspace(start, end, 4000)
    truths = _truths(measures.truth, t)
    for k, name in enumerate(AXES):
        y_axis = "y" if k == 0 else f"y{k + 1}"
        place = [1 - (k + 1) / 3 + 0.03, 1 - k / 3 - 0.01]
        layout[f"yaxis{y_axis[1:]}"] = axis(f"{name} [m]", domain=place)
        for name, true in truths.items():
            data.append(
                line(*envelope(t, true[:, k]), "@muted", name=name, yaxis=y_axis,
                     showlegend=k == 0, legendgroup=name, line={"width": 6}, opacity=0.4)
            )  # fmt: skip
        for stream, values in reversed(list(moved.items())):
            shown = envelope(values.t, values.displacement[:, k])
            data.append(
                line(*shown, COLOURS[stream], hover="%{y:.4f} m", name=stream, yaxis=y_axis,
                     showlegend=k == 0, legendgroup=stream)
            )  # fmt: skip
    layout["xaxis"] = time_axis(end, start, anchor="y3")
    caption = "Displacement from where the station was surveyed to stand. " + _told(found)
    caption += OF_WHAT if set(moved) & set(OF_IMU) and set(moved) - set(OF_IMU) else ""
    marked = merged(layout, _onsets(found))
    return Figure("Displacement", caption, [Panel(data, marked, 620)])


def _truths(truth: Truth | None, t: FloatArray) -> dict[str, FloatArray]:
    """Return the antenna's truth, and the IMU's if a tilt makes it another by a millimetre."""
    antenna, imu = truth_at(truth, t), truth_at(truth, t, of_imu=True)
    if antenna is None or imu is None:
        return {}
    if np.abs(imu - antenna).max() < 1e-3:
        return {"truth": antenna}
    return {"truth, antenna": antenna, "truth, IMU": imu}


def _told(found: list[Event]) -> str:
    if not found:
        return "No event: the acceleration never rose fast enough over what it was before."
    texts = []
    for event in found:
        peaks = ", ".join(
            f"{name} {value:.3g} {unit}"
            for (name, unit), value in zip(PEAKS, event.peaks[-1], strict=True)
        )
        text = f"Onset at {event.onset:.2f} s: {peaks}"
        if np.isfinite(event.magnitude):
            text += f", magnitude {event.magnitude:.1f} ± {event.magnitude_sd:.1f} from PGD"
        texts.append(text + ("." if event.ended else ", and it goes on."))
    return " ".join(texts)


def _derivative(
    measures: Measures, moved: Mapping[str, Moved], found: list[Event], quantity: str, unit: str
) -> Figure | None:
    """Draw velocity or acceleration of the streams that have it."""
    start, end = _span(measures, moved)
    rows, peaks = [], []
    for name in (FUSED, SMOOTHED):
        if name not in moved:
            continue
        values = getattr(moved[name], quantity)
        for k, letter in enumerate("ENU"):
            peak = float(np.nanmax(np.abs(values[:, k]), initial=0.0))
            peaks.append(peak)
            label = letter if name == FUSED else f"{letter} smoothed"
            shown = envelope(moved[name].t, values[:, k])
            rows.append(Row(label, COLOURS[name], *shown, f"{peak:.3g} {unit}"))
    if not rows:
        return None
    span = nice_span(peaks, 1e-3)
    panel = rows_panel(rows, end, span, unit, start=start, note_title="peak")
    layout = merged(panel.layout, _onsets(found), {"margin": {"r": 96, "t": 22}})
    caption = f"Of the fused motion; each row spans ±{span:g} {unit}, its peak at the right."
    return Figure(quantity.capitalize(), caption, [Panel(panel.data, layout, 300)], half=True)


def _growth(measures: Measures, found: list[Event]) -> Figure | None:
    """Draw the peaks as they were reported."""
    if not found:
        return None
    data: list[dict[str, Any]] = []
    layout: dict[str, Any] = {}
    for k, (name, unit) in enumerate(PEAKS):
        y_axis = "y" if k == 0 else f"y{k + 1}"
        place = [1 - (k + 1) / 3 + 0.03, 1 - k / 3 - 0.02]
        layout[f"yaxis{y_axis[1:]}"] = axis(f"{name} [{unit}]", domain=place, rangemode="tozero")
        for event in found:
            hover = f"%{{y:.4g}} {unit}"
            data.append(
                line(event.t, event.peaks[:, k], PALETTE[k], hover=hover, yaxis=y_axis,
                     line={"shape": "hv", "width": 1.6})
            )  # fmt: skip
    first = min(event.onset for event in found) - 2.0
    layout["xaxis"] = time_axis(measures.run.duration, max(first, 0.0), anchor="y3")
    marked = merged(layout, _onsets(found))
    caption = "Peaks of displacement, velocity and acceleration vectors so far, as reported."
    return Figure("Peaks as they grew", caption, [Panel(data, marked, 330)])


def _errors(measures: Measures, moved: Mapping[str, Moved], found: list[Event]) -> Figure | None:
    """Draw every stream less the truth, with what it says of its sigma."""
    off = errors(moved, measures.truth)
    if not off:
        return None
    start, end = _span(measures, moved)
    rows, sizes = [], []
    for name, error in off.items():
        shown = 1e3 * error
        sd = 1e3 * moved[name].sd
        for k, letter in enumerate("ENU"):
            t, y = envelope(moved[name].t, shown[:, k])
            rms = float(np.sqrt(np.nanmean(shown[:, k] ** 2)))
            sizes.append(5.0 * rms)
            band = np.interp(t, moved[name].t, sd[:, k])
            rows.append(
                Row(f"{BRIEF[name]} {letter}", COLOURS[name], t, y, f"{rms:.2f} mm", sd=band)
            )
    span = nice_span([float(np.median(sizes))], 1.0)
    panel = rows_panel(rows, end, span, "mm", start=start)
    layout = merged(panel.layout, _onsets(found), {"margin": {"r": 96, "t": 22, "l": 150}})
    caption = (
        f"Streams less the truth; each row spans ±{span:g} mm, at the right the RMS. Shaded: one "
        "sigma as the stream states it."
    )
    return Figure("Displacement error", caption, [Panel(panel.data, layout, panel.height)])


def _onsets(found: list[Event]) -> dict[str, Any]:
    return merged(*(moment(event.onset, "onset") for event in found))


def _span(measures: Measures, moved: Mapping[str, Moved]) -> tuple[float, float]:
    """Return where the streams begin, and the run's end [s]."""
    first = min(float(values.t[0]) for values in moved.values())
    return max(first, 0.0), measures.run.duration
