"""Figures of the tracking loops: discriminators, true errors, theory, correlators, Doppler."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from deepseis_bringup.report.plot import (
    ROW_HEIGHT,
    Colours,
    Figure,
    Panel,
    Row,
    averaged,
    axis,
    decades,
    envelope,
    line,
    nice_span,
    packed,
    rows_panel,
    time_axis,
)
from deepseis_bringup.report.run_measures import CHIP, Measures, thermal
from deepseis_bringup.report.run_truth import is_settled
from deepseis_core.types import FloatArray

SCATTER: Final = 350  # points of one correlator cloud


def phase_error(measures: Measures, colours: Colours) -> Figure | None:
    """Draw the true phase error of the loops."""
    errors = measures.phase_errors
    if errors is None:
        return None
    rms, rows = 360 * errors.rms_cycles(), []
    for k, satellite in enumerate(errors.satellites):
        thinned = envelope(errors.t, 360 * errors.error_cycles[:, k])
        row = Row(satellite, colours[satellite], *thinned, f"{rms[k]:.2f}°", satellite)
        rows.append(row)
    span = nice_span(3.6 * rms)
    caption = (
        f"Phase of the loop's oscillator less the simulator's; constants and the part common to "
        f"all satellites (the receiver's own clock) taken away. Each row spans ±{span:g}°; "
        "10° of phase is 5 mm of range."
    )
    panel = rows_panel(rows, measures.run.duration, span, "°")
    return Figure("True phase error", caption, [panel], half=True)


def theory(measures: Measures, colours: Colours) -> Figure | None:
    """RMS of discriminators and true errors against C/N0, with what theory expects."""
    known = {
        s: v for s, v in measures.satellites.items() if np.isfinite(v["carrier_error_rms_deg"])
    }
    if not known:
        return None
    cn0 = np.array([v["cn0_mean_dbhz"] for v in known.values()])
    aided = float(np.mean([v["aided_share"] for v in known.values()])) > 0.5
    bandwidth = float(measures.loops["aided_bandwidth_hz" if aided else "pll_bandwidth_hz"])
    seconds = float(np.nanmedian([v["integration_s"] for v in known.values()]))
    x = np.linspace(np.floor(cn0.min()) - 1, np.ceil(cn0.max()) + 1, 60)
    limit, single = thermal(x, bandwidth, seconds)
    data = [
        _curve(x, np.hypot(limit, single), "discriminator, theory", "dot"),
        _points(known, "carrier_error_rms_deg", colours, "discriminator", "circle-open"),
    ]
    errors = measures.phase_errors
    if errors is not None:
        true = dict(zip(errors.satellites, 360 * errors.rms_cycles(), strict=True))
        both = {s: v | {"true": float(true[s])} for s, v in known.items() if s in true}
        data.append(_curve(x, limit, "true error, thermal limit", "solid"))
        data.append(_points(both, "true", colours, "true error", "circle"))
    layout = {
        "xaxis": axis("mean C/N0 [dB-Hz]"),
        "yaxis": axis("RMS [deg]", **decades(*_reach(data))),
        "showlegend": True,
        "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0},
    }
    caption = (
        f"Every point is a satellite. Curves: thermal noise of a loop with {bandwidth:g} Hz noise "
        f"bandwidth and {1000 * seconds:g} ms integrations; points on them leave nothing to gain "
        "at this bandwidth, points above suffer from motion, oscillator or interference."
    )
    height = ROW_HEIGHT * max(len(known), 7) + 66
    return Figure("Loops and theory", caption, [Panel(data, layout, height)], half=True)


def doppler(measures: Measures, colours: Colours) -> list[Figure]:
    """Doppler, and what is left of it without its straight line."""
    run, data, rows = measures.run, [], []
    for satellite in run.satellites:
        columns = run.tracking[satellite]
        locked = is_settled(columns, run.sample_rate_hz)
        if locked.sum() < 10:
            continue
        t = run.seconds(columns["sample_index"])[locked]
        values, colour = columns["carrier_doppler_hz"][locked], colours[satellite]
        mean = averaged(t, values, 60, 0.0, run.duration)
        data.append(line(*mean, colour, satellite, hover="%{y:.1f} Hz"))
        bent = values - np.polyval(np.polyfit(t, values, 1), t)
        note = f"{float(np.sqrt(np.mean(bent**2))):.2f} Hz"
        rows.append(Row(satellite, colour, *envelope(t, bent), note, satellite))
    if not rows:
        return []
    span = nice_span([4 * float(row.note.split()[0]) for row in rows])
    panel = rows_panel(rows, run.duration, span, "Hz")
    layout = {"xaxis": time_axis(run.duration), "yaxis": axis("Doppler [Hz]")}
    return [
        Figure(
            "Doppler",
            "Carrier Doppler of the loops, positive when a satellite approaches.",
            [Panel(data, layout, panel.height)],
            half=True,
        ),
        Figure(
            "Doppler less its straight line",
            f"Motion of the antenna and of the receiver's oscillator show here, the noise of the "
            f"loop too. Each row spans ±{span:g} Hz; 1 Hz is 19 cm/s.",
            [panel],
            half=True,
        ),
    ]


def clouds(measures: Measures, colours: Colours) -> Figure | None:
    """Prompt correlators in the complex plane."""
    run, panels = measures.run, []
    parts: dict[str, tuple[NDArray[Any], NDArray[Any]]] = {}
    for satellite in run.satellites:
        columns = run.tracking[satellite]
        chosen = np.flatnonzero(is_settled(columns, run.sample_rate_hz))
        chosen = chosen[:: max(1, -(-chosen.size // SCATTER))]
        if chosen.size:
            parts[satellite] = columns["prompt_i"][chosen], columns["prompt_q"][chosen]
    if not parts:
        return None
    span = 1.15 * max(float(np.abs(i).max()) for i, _ in parts.values())
    for satellite, (i, q) in parts.items():
        trace = {
            **{"type": "scatter", "mode": "markers", "x": packed(i), "y": packed(q)},
            "marker": {"size": 3, "color": colours[satellite], "opacity": 0.55},
            **{"showlegend": False, "hoverinfo": "skip"},
        }
        layout = {
            "xaxis": {"range": [-span, span], "nticks": 4, "zeroline": True},
            "yaxis": {"scaleanchor": "x", "nticks": 3, "zeroline": True},
            "margin": {"l": 28, "r": 6, "t": 4, "b": 22},
        }
        panels.append(Panel([trace], layout, 112, satellite))
    caption = (
        "In-phase (across) and quadrature (up) sums of whole integrations while locked, in units "
        "of their noise. Two clouds on the horizontal axis are the two values of a data bit; "
        "their width is noise, a tilt would be a phase error."
    )
    return Figure("Prompt correlators", caption, panels, grid=True)


def arms(measures: Measures, colours: Colours) -> Figure | None:
    """Envelopes of the early, prompt and late correlators over time."""
    run, panels = measures.run, []
    for satellite in run.satellites:
        columns = run.tracking[satellite]
        locked = is_settled(columns, run.sample_rate_hz)
        if not locked.any():
            continue
        t = run.seconds(columns["sample_index"])[locked]
        data = []
        for arm, colour in (
            *(("early", "@muted"), ("late", "@ink")),
            ("prompt", colours[satellite]),
        ):
            size = np.hypot(columns[f"{arm}_i"][locked], columns[f"{arm}_q"][locked])
            mean = averaged(t, size, 80, 0.0, run.duration)
            dash = {"early": "solid", "late": "dot", "prompt": "solid"}[arm]
            data.append(line(*mean, colour, hover=f"{arm} %{{y:.1f}}", line={"dash": dash}))
        layout = {
            "xaxis": {"range": [0, run.duration], "nticks": 4},
            "yaxis": {"rangemode": "tozero", "nticks": 4},
            "margin": {"l": 28, "r": 6, "t": 4, "b": 22},
        }
        panels.append(Panel(data, layout, 150, satellite))
    caption = (
        "Size of the prompt (colour), early (grey) and late (dotted) sums over time [s], in units "
        "of their noise. Early and late lie on each other while the code loop is centred; apart "
        "they tell of multipath or a filtered signal."
    )
    return Figure("Early, prompt, late", caption, panels, grid=True) if panels else None


def carrier_discriminator(measures: Measures, colours: Colours) -> Figure | None:
    """Phase discriminator of every satellite."""
    notes = {s: v["carrier_error_rms_deg"] for s, v in measures.satellites.items()}
    rows = _rows(measures, colours, "carrier_error_cycles", 360.0, notes, "°")
    if not rows:
        return None
    span = nice_span([3.6 * v for v in notes.values()])
    caption = (
        f"Phase discriminator after lock, RMS at the right. Each row spans ±{span:g}°. Most of it "
        "is noise of single integrations: see the theory curve under “Loops and theory”."
    )
    panel = rows_panel(rows, measures.run.duration, span, "°")
    return Figure("Carrier discriminator", caption, [panel], half=True)


def code_discriminator(measures: Measures, colours: Colours) -> Figure | None:
    """Code discriminator of every satellite."""
    notes = {s: v["code_error_rms_m"] for s, v in measures.satellites.items()}
    rows = _rows(measures, colours, "code_error_chips", CHIP, notes, " m")
    if not rows:
        return None
    span = nice_span([3.6 * v for v in notes.values()])
    caption = (
        f"Code discriminator after lock in metres, RMS at the right. Each row spans ±{span:g} m. "
        "The code loop averages over about half a second: ranges are far quieter than this."
    )
    panel = rows_panel(rows, measures.run.duration, span, "m")
    return Figure("Code discriminator", caption, [panel], half=True)


def _rows(
    measures: Measures,
    colours: Colours,
    name: str,
    scale: float,
    notes: dict[str, float],
    unit: str,
) -> list[Row]:
    run, rows = measures.run, []
    for satellite in run.satellites:
        columns = run.tracking[satellite]
        settled = is_settled(columns, run.sample_rate_hz)
        if not settled.any():
            continue
        t: FloatArray = run.seconds(columns["sample_index"])[settled]
        thinned = envelope(t, scale * columns[name][settled])
        note = f"{notes[satellite]:.1f}{unit}"
        rows.append(Row(satellite, colours[satellite], *thinned, note, satellite))
    return rows


def _reach(data: list[dict[str, Any]]) -> tuple[float, float]:
    """Limits of a logarithmic axis that hold all plain points."""
    values = [v for trace in data if isinstance(trace["y"], list) for v in trace["y"]]
    values = [v for v in values if np.isfinite(v) and v > 0]
    return min(values) / 1.5, max(values) * 1.5


def _curve(x: FloatArray, y: FloatArray, name: str, dash: str) -> dict[str, Any]:
    trace = line(x, y, "@muted", line={"dash": dash, "width": 1.5})
    return trace | {"name": name, "showlegend": True, "hoverinfo": "skip", "hovertemplate": None}


def _points(
    values: dict[str, dict[str, float]], key: str, colours: Colours, name: str, symbol: str
) -> dict[str, Any]:
    return {
        **{"type": "scatter", "mode": "markers", "name": name, "showlegend": True},
        "x": [round(v["cn0_mean_dbhz"], 2) for v in values.values()],
        "y": [round(v[key], 3) for v in values.values()],
        "text": list(values),
        "hovertemplate": "%{text}: %{y:.2f}° at %{x:.1f} dB-Hz<extra>" + name + "</extra>",
        "marker": {
            **{"symbol": symbol, "size": 10, "color": [colours[s] for s in values]},
            "line": {"width": 2},
        },
    }
