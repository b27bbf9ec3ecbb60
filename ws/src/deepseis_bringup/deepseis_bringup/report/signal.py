"""Figures of the signal: sky, C/N0, acquisition, pull-in."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from deepseis_bringup.report.plot import (
    Colours,
    Figure,
    Panel,
    averaged,
    axis,
    decades,
    envelope,
    line,
    merged,
    moment,
    packed,
    time_axis,
)
from deepseis_bringup.report.run_measures import Measures
from deepseis_bringup.report.run_truth import is_settled
from deepseis_bringup.report.sky_marks import label_places, polar_axes

PULL_IN: Final = 3.0  # [s] shown after the hand-over


def sky(measures: Measures, colours: Colours) -> Figure:
    """Where the satellites stand, coloured by C/N0."""
    data: list[dict[str, Any]] = []
    names = list(measures.sky)
    for satellite in names:
        track = measures.sky[satellite]
        data.append(
            {
                **{"type": "scatterpolar", "mode": "lines", "showlegend": False},
                **{"r": packed(90 - track.elevation), "theta": packed(track.azimuth)},
                **{"line": {"color": "@muted", "width": 1}, "hoverinfo": "skip"},
                "legendgroup": satellite,
            }
        )
    cn0 = [measures.satellites[s]["cn0_mean_dbhz"] for s in names]
    used = [measures.satellites[s]["used_share"] > 0 for s in names]
    elevation = np.array([measures.sky[s].elevation[-1] for s in names])
    azimuth = np.array([measures.sky[s].azimuth[-1] for s in names])
    last = list(zip(elevation.tolist(), azimuth.tolist(), strict=True))
    data.append(
        {
            **{"type": "scatterpolar", "mode": "markers+text", "showlegend": False},
            "cliponaxis": False,
            "r": [round(90 - e, 2) for e, _ in last],
            "theta": [round(a, 2) for _, a in last],
            "text": names,
            "textposition": label_places(elevation, azimuth),
            "textfont": {"size": 11, "color": "@ink"},
            "customdata": [[round(e, 1), round(a, 1)] for e, a in last],
            "hovertemplate": "%{text}: elevation %{customdata[0]}°, azimuth %{customdata[1]}°, "
            "%{marker.color:.1f} dB-Hz<extra></extra>",
            "marker": {
                "size": 13,
                "symbol": ["circle" if u else "circle-open" for u in used],
                "color": [None if np.isnan(c) else round(c, 1) for c in cn0],
                "colorscale": "Viridis",
                **{"cmin": 30, "cmax": 50, "line": {"width": 2}},
                "colorbar": {"title": {"text": "dB-Hz"}, "thickness": 10, "len": 0.75},
            },
        }
    )
    polar = polar_axes(elevation, azimuth)
    layout = {"polar": polar, "margin": {"l": 34, "r": 10, "t": 30, "b": 30}}
    caption = (
        "Zenith in the middle, horizon at the rim. Filled: used for positions; open: tracked "
        "only. Lines show the way travelled during the run."
    )
    return Figure("Sky", caption, [Panel(data, layout, 390)], half=True)


def cn0(measures: Measures, colours: Colours) -> Figure:
    """Signal strength over time."""
    run, data = measures.run, []
    for satellite in run.satellites:
        columns = run.tracking[satellite]
        t = run.seconds(columns["sample_index"])
        mean = averaged(t, columns["cn0_dbhz"], 240, 0.0, run.duration)
        data.append(line(*mean, colours[satellite], satellite, hover="%{y:.1f} dB-Hz"))
    layout = merged(
        {"xaxis": time_axis(run.duration), "yaxis": axis("C/N0 [dB-Hz]")},
        moment(measures.first_fix_s, "first fix"),
    )
    caption = (
        "Carrier power to noise density as the channels estimate it. The estimator settles "
        "during the first second of tracking."
    )
    return Figure("Signal strength", caption, [Panel(data, layout, 390)], half=True)


def acquisition(measures: Measures, colours: Colours) -> Figure | None:
    """Draw the detection statistics of all searches."""
    found = measures.run.acquisition
    if not found.count:
        return None
    ratio = found["statistic"] / found["threshold"]
    best = {s: float(ratio[found["satellite"] == s].max()) for s in np.unique(found["satellite"])}
    names = sorted(best)
    hits = [s for s in names if found["detected"][found["satellite"] == s].any()]
    data: list[dict[str, Any]] = []
    for kind, chosen in (("found", hits), ("nothing", [s for s in names if s not in hits])):
        colour = [colours[s] if s in measures.run.satellites else "@muted" for s in chosen]
        data.append(
            {
                **{"type": "bar", "name": kind, "showlegend": False, "x": chosen},
                "y": [round(best[s], 3) for s in chosen],
                "marker": {"color": colour if kind == "found" else "@band"},
                "hovertemplate": "%{x}: %{y:.2f} x threshold<extra>" + kind + "</extra>",
            }
        )
    low = min(0.6, 0.9 * min(best.values()))
    line_at_1 = {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": 1, "y1": 1}
    layout = {
        "xaxis": {"categoryorder": "array", "categoryarray": names, "tickangle": -90},
        "yaxis": axis("statistic / threshold", **decades(low, 1.25 * max(best.values()))),
        "shapes": [line_at_1 | {"line": {"color": "@warn", "width": 1.2, "dash": "dash"}}],
        "bargap": 0.35,
    }
    chance = float(found["false_alarm_probability"].max())
    caption = (
        f"Strongest search of every satellite. Above the dashed line a satellite is declared "
        f"found; noise alone gets there with a probability of {chance:g} per search."
    )
    return Figure("Acquisition", caption, [Panel(data, layout, 300)], half=True)


def pull_in(measures: Measures, colours: Colours) -> Figure | None:
    """How the loops settle after the hand-over from acquisition."""
    run, data = measures.run, []
    for satellite in run.satellites:
        columns = run.tracking[satellite]
        t = run.seconds(columns["sample_index"])
        settled = is_settled(columns, run.sample_rate_hz)
        if not settled.any():
            continue
        final = float(np.median(columns["carrier_doppler_hz"][settled][:50]))
        since = t - t[0]
        early = since <= PULL_IN
        doppler = columns["carrier_doppler_hz"][early] - final
        colour, thin = colours[satellite], {"width": 1}
        frequency = envelope(since[early], doppler, 300)
        data.append(line(*frequency, colour, satellite, hover="%{y:.1f} Hz", line=thin))
        lock = averaged(since[early], columns["phase_lock_indicator"][early], 200, 0.0, PULL_IN)
        data.append(line(*lock, colour, satellite, yaxis="y2", line=thin))
    if not data:
        return None
    layout = {
        "xaxis": axis("time since the hand-over [s]", range=[0, PULL_IN], anchor="y2"),
        "yaxis": axis("Doppler - final [Hz]", domain=[0.46, 1]),
        "yaxis2": axis("lock", domain=[0, 0.36], range=[-0.3, 1.1]),
    }
    caption = (
        "Above: carrier frequency of the loop less the value it settles at. Below: phase-lock "
        "indicator, cos(2 x phase error) filtered; 1 is perfect lock."
    )
    return Figure("Pull-in", caption, [Panel(data, layout, 300)], half=True)
