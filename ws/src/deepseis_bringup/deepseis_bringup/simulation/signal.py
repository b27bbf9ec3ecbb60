"""Figures of a simulated run's sky, signal and receiver clock."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.polynomial import Chebyshev
from scipy.stats import norm

from deepseis_bringup.report.plot import (
    PALETTE,
    SIGMA,
    Colours,
    Figure,
    Panel,
    Row,
    axis,
    envelope,
    line,
    merged,
    nice_span,
    packed,
    rows_panel,
    time_axis,
)
from deepseis_bringup.report.sky_marks import label_places, polar_axes
from deepseis_bringup.simulation.figures import marks, moves, plain
from deepseis_bringup.simulation.pictures import Pictures
from deepseis_core.constants import CA_RATE_CPS, L1_HZ
from deepseis_core.types import FloatArray, IntArray
from deepseis_sim.if_synthesis import OPTIMUM_STEP
from deepseis_sim.sky import BLOCKED_DB, Obstruction

SKY_POINTS: Final = 121
POINTS: Final = 500
"""Of one satellite's line."""
CLOCK_POINTS: Final = 2000
MOST_LEVELS: Final = 64
"""Bars of the histogram; more levels than these are put together."""


def sky(pictures: Pictures, colours: Colours) -> Figure:
    """Where the satellites stand and what stands before them."""
    bench = pictures.bench
    config, duration = bench.scenario.sky, bench.scenario.duration
    t = np.linspace(0.0, duration, SKY_POINTS)
    elevation, azimuth = np.rad2deg(bench.sky.directions(t))
    cn0 = bench.sky.cn0_dbhz(t)
    seen = np.isfinite(cn0)
    data = [_sector(item) for item in config.obstructions if not item.keep]
    data.append(_mask(config.elevation_mask_deg))
    for k in range(len(pictures.satellites)):
        data.append(_track(elevation[:, k], azimuth[:, k], pictures.satellites[k], colours))
    mean = [
        float(cn0[seen[:, k], k].mean()) if seen[:, k].any() else np.nan
        for k in range(len(pictures.satellites))
    ]
    data += _satellites(pictures.satellites, elevation[-1], azimuth[-1], np.array(mean))
    polar = polar_axes(elevation[-1], azimuth[-1])
    layout = {"polar": polar, "margin": {"l": 34, "r": 10, "t": 30, "b": 30}}
    caption = (
        "Zenith in the middle, horizon at the rim; lines show the way of the satellites, marks "
        "stand at the end of the run, coloured by mean C/N0; open: never received."
    )
    caption += "".join(f" {_told(item, duration)}" for item in config.obstructions)
    return Figure("Sky", caption, [Panel(data, layout, 400)], half=True)


def _sector(item: Obstruction) -> dict[str, Any]:
    """Draw an obstruction."""
    height = min(max(item.elevation_to_deg, 0.0), 90.0)
    width = item.azimuth_to_deg - item.azimuth_from_deg
    width = 360.0 if abs(width) >= 360.0 else width % 360.0
    share = min(item.loss_db / BLOCKED_DB, 1.0)
    return {
        **{"type": "barpolar", "base": [90.0 - height], "r": [height], "width": [width]},
        **{"theta": [item.azimuth_from_deg + width / 2.0], "showlegend": False},
        "marker": {"color": "@muted", "opacity": round(0.1 + 0.26 * share, 3)},
        "hoverinfo": "skip",
    }


def _told(item: Obstruction, duration: float) -> str:
    """Say what an obstruction does."""
    if item.keep:
        text = f"All but the {item.keep} highest satellites: {_loss(item)}"
    else:
        text = f"Shaded: {_loss(item)}"
        if item.elevation_to_deg < 90.0:
            text += f" below {item.elevation_to_deg:g}°"
    if item.from_s > 0.0 or item.to_s > 0.0:
        text += f", from {item.from_s:g} to {item.to_s or duration:g} s"
    return text + "."


def _loss(item: Obstruction) -> str:
    return "no signal" if item.loss_db >= BLOCKED_DB else f"{item.loss_db:g} dB of loss"


def _mask(elevation: float) -> dict[str, Any]:
    """Draw the elevation below which nothing is received."""
    theta = np.linspace(0.0, 360.0, 91)
    return {
        **{"type": "scatterpolar", "mode": "lines", "showlegend": False, "hoverinfo": "skip"},
        **{"r": packed(np.full(91, 90.0 - max(elevation, 0.0))), "theta": packed(theta)},
        "line": {"color": "@muted", "width": 1, "dash": "dot"},
    }


def _track(
    elevation: FloatArray, azimuth: FloatArray, satellite: str, colours: Colours
) -> dict[str, Any]:
    up = elevation > 0.0
    return {
        **{"type": "scatterpolar", "mode": "lines", "showlegend": False, "hoverinfo": "skip"},
        **{"r": packed(np.where(up, 90 - elevation, np.nan)), "theta": packed(azimuth)},
        **{"line": {"color": colours[satellite], "width": 2}, "legendgroup": satellite},
    }


def _satellites(
    names: tuple[str, ...], elevation: FloatArray, azimuth: FloatArray, cn0: FloatArray
) -> list[dict[str, Any]]:
    """Draw marks and names, those never received apart from the others."""
    places, data = label_places(elevation, azimuth), []
    for received in (True, False):
        chosen = np.flatnonzero(np.isfinite(cn0) == received)
        trace: dict[str, Any] = {
            **{"type": "scatterpolar", "mode": "markers+text", "showlegend": False},
            **{"cliponaxis": False, "text": [names[k] for k in chosen]},
            "textposition": [places[k] for k in chosen],
            "r": [round(90.0 - max(float(elevation[k]), 0.0), 2) for k in chosen],
            "theta": [round(float(azimuth[k]), 2) for k in chosen],
            "textfont": {"size": 11, "color": "@ink" if received else "@muted"},
            "customdata": [
                [round(float(elevation[k]), 1), round(float(azimuth[k]), 1)] for k in chosen
            ],
            "hovertemplate": "%{text}: elevation %{customdata[0]}°, azimuth %{customdata[1]}°, "
            f"{'%{marker.color:.1f} dB-Hz' if received else 'never received'}<extra></extra>",
            "marker": {"size": 13, "symbol": "circle-open", "color": "@muted"},
        }
        if received:
            trace["marker"] = {
                **{"size": 13, "colorscale": "Viridis", "cmin": 30, "cmax": 50},
                **{"color": [round(float(cn0[k]), 1) for k in chosen], "line": {"width": 2}},
                "colorbar": {"title": {"text": "dB-Hz"}, "thickness": 10, "len": 0.75},
            }
        if chosen.size:
            data.append(trace)
    return data


def cn0(pictures: Pictures, colours: Colours) -> Figure:
    """Signal strength over time; gaps where a satellite is hidden."""
    data = []
    for k, satellite in enumerate(pictures.satellites):
        thinned = envelope(*pictures.cn0.record(k), POINTS)
        data.append(line(*thinned, colours[satellite], satellite, hover="%{y:.1f} dB-Hz"))
    layout = merged(
        {
            "xaxis": time_axis(pictures.bench.scenario.duration),
            "yaxis": axis("C/N0 [dB-Hz]", **_decibels(pictures)),
        },
        *marks(pictures),
    )
    caption = "Carrier power to noise density of every satellite; no line: it is hidden."
    if pictures.bench.scenario.jammers:
        caption += " Without the jammers, which raise the noise beyond it."
    return Figure("Signal strength", caption, [Panel(data, layout, 400)], half=True)


def _decibels(pictures: Pictures) -> dict[str, Any]:
    """Return a scale that makes no mountains of tenths of a decibel."""
    values = np.concatenate([pictures.cn0.low.ravel(), pictures.cn0.high.ravel()])
    values = values[np.isfinite(values)]
    if not values.size:
        return {}
    low, high = float(values.min()), float(values.max())
    middle, half = (low + high) / 2.0, max(0.55 * (high - low), 2.0)
    step = {"dtick": 1} if half < 6.0 else {}
    return {"range": [middle - half, middle + half], **step}


def doppler(pictures: Pictures, colours: Colours) -> Figure | None:
    """Draw what the loops have to follow: Doppler of motion and oscillator."""
    orbits = pictures.orbits
    if len(orbits) < 20:
        return None
    rows = []
    for k, satellite in enumerate(pictures.satellites):
        t, change = _without_orbit(pictures, k)
        peak = float(np.abs(change).max(initial=0.0))
        thinned = envelope(t, change, 2 * POINTS)
        rows.append(Row(satellite, colours[satellite], *thinned, plain(peak), satellite))
    span = nice_span(np.abs(row.y[np.isfinite(row.y)]).max(initial=0.0) for row in rows)
    start, end = pictures.window
    panel = rows_panel(rows, end, span, "Hz", start=start, note_title="peak, Hz")
    layout = merged(panel.layout, *marks(pictures), {"margin": {"r": 66, "t": 24}})
    caption = (
        "Carrier Doppler less what the satellite's orbit and a steady clock make: what antenna "
        "and oscillator do to it, and the tracking loops must follow. Each row spans "
        f"±{span:g} Hz; 1 Hz is 0.19 m/s."
    )
    return Figure("Doppler of the motion", caption, [Panel(panel.data, layout, panel.height)])


def _without_orbit(pictures: Pictures, number: int) -> tuple[FloatArray, FloatArray]:
    """Return times and Doppler of a satellite, a smooth fit to that of an antenna at rest off."""
    duration, orbits = pictures.bench.scenario.duration, pictures.orbits
    degree = 3 + min(int(duration / 900.0), 9)
    domain = [0.0, duration]
    smooth = Chebyshev.fit(orbits[:, 0], orbits[:, 1 + number], degree, domain=domain)
    t, y = pictures.doppler.record(number)
    return t, y - smooth(t)


def spectrum(pictures: Pictures) -> Figure | None:
    """Spectrum of the samples beside that of C/A codes in white noise."""
    f, power = pictures.if_spectrum()
    if not f.size:
        return None
    middle = float(np.mean(pictures.window))
    cn0 = pictures.bench.sky.cn0_dbhz(np.array([middle]))[0]
    hertz = float(np.sum(10.0 ** (cn0[np.isfinite(cn0)] / 10.0)))
    expected = 1.0 + hertz / CA_RATE_CPS * np.sinc(f / CA_RATE_CPS) ** 2
    expected_db = 10.0 * np.log10(expected / np.median(expected))
    t, y = envelope(f / 1e6, power, 1400)
    hover = "%{x:.3f} MHz: %{y:.2f} dB<extra></extra>"
    data = [
        line(t, y, PALETTE[0], line={"width": 0.8}) | {"hovertemplate": hover},
        line(f[::8] / 1e6, expected_db[::8], "@ink", line={"width": 1.6, "dash": "dot"}),
    ]
    data[1]["hoverinfo"] = "skip"
    low, high = np.percentile(power, [1, 99])
    limits = [min(low, -2.0) - 1.0, max(float(power.max()), high, 3.0) + 1.0]
    layout = {
        "xaxis": axis("frequency from L1 [MHz]", range=[f.min() / 1e6, f.max() / 1e6]),
        "yaxis": axis("power density [dB]", range=limits),
    }
    caption = (
        "Power density of the samples against its median, over 0.1 s "
        f"in the middle of the {'motion' if moves(pictures) else 'run'}. "
        "Dotted: C/A codes of the satellites in white noise"
    )
    caption += ", without jammers." if pictures.bench.scenario.jammers else "."
    return Figure("Spectrum of the samples", caption, [Panel(data, layout, 320)], half=True)


def histogram(pictures: Pictures) -> Figure | None:
    """How often the quantiser's levels are used, beside those of a normal variable."""
    levels, counts = pictures.level_counts()
    if not levels.size:
        return None
    packing = pictures.bench.front_end.format
    every = np.arange(-packing.max_level, packing.max_level + 1)
    every = every[np.isin(every % 2, [1]) | (packing.levels != "odd")]
    if packing.levels != "odd":
        every = np.arange(int(levels.min()), int(levels.max()) + 1)
    share = np.zeros(every.size)
    share[np.searchsorted(every, levels)] = counts / counts.sum()
    ideal = ideal_shares(every, packing.levels == "odd", OPTIMUM_STEP[packing.bits])
    x = every.astype(np.float64)
    if every.size > MOST_LEVELS:
        group = -(-every.size // MOST_LEVELS)
        cuts = np.arange(0, every.size, group)
        share, ideal = np.add.reduceat(share, cuts), np.add.reduceat(ideal, cuts)
        x = x[cuts] + (group - 1) / 2.0
    width = float(x[1] - x[0]) if x.size > 1 else 1.0
    data: list[dict[str, Any]] = [
        {
            **{"type": "bar", "x": packed(x), "y": packed(100 * share), "showlegend": False},
            **{"marker": {"color": PALETTE[0], "opacity": 0.75}, "width": 0.86 * width},
            "hovertemplate": "level %{x}: %{y:.2f} %<extra></extra>",
        },
        {
            **{"type": "scatter", "mode": "lines", "x": packed(x), "y": packed(100 * ideal)},
            **{"showlegend": False, "line": {"shape": "hvh", "width": 1.8, "color": "@ink"}},
            "hovertemplate": "normal variable: %{y:.2f} %<extra></extra>",
        },
    ]
    layout = {
        "xaxis": axis(
            "level",
            **({"tickvals": every[:: 1 + every.size // 9].tolist()} if every.size <= 16 else {}),
        ),
        "yaxis": axis("share of the samples [%]", rangemode="tozero"),
    }
    caption = (
        f"{'Real samples' if packing.is_real else 'I and Q together'}, "
        f"{packing.bits} bit{'s' if packing.bits > 1 else ''}. Line: a normal variable at the "
        f"step of least distortion, {OPTIMUM_STEP[packing.bits]:.3g} {SIGMA}."
    )
    return Figure("Quantiser", caption, [Panel(data, layout, 320)], half=True)


def ideal_shares(levels: IntArray, odd: bool, step: float) -> FloatArray:
    """Return how often a normal variable falls on levels, the outer ones taking the tails.

    Parameters
    ----------
    levels : ndarray, shape (n,)
        All levels, ascending.
    odd : bool
        Levels are ..., -3, -1, 1, 3, ... half steps; else ..., -1, 0, 1, ... steps.
    step : float
        In standard deviations.

    Examples
    --------
    >>> ideal_shares(np.array([-1, 1]), True, 1.596)
    array([0.5, 0.5])
    """
    middle = np.asarray(levels) * (step / 2.0 if odd else step)
    edges = (middle[1:] + middle[:-1]) / 2.0
    return np.diff(np.concatenate([[0.0], norm.cdf(edges), [1.0]]))


def clock(pictures: Pictures) -> Figure:
    """Noise of the receiver's clock, and of the base's."""
    bench = pictures.bench
    duration = bench.scenario.duration
    t = np.linspace(0.0, duration, CLOCK_POINTS)
    curves = [("receiver", PALETTE[0], bench.clock(t))]
    if bench.base:
        curves.append(("base", PALETTE[1], bench.base.signals.clock(t)))
    data, told, greatest = [], [], 0.0
    for name, colour, bias in curves:
        slope, start = np.polyfit(t, bias, 1)
        rest = 1e9 * (bias - start - slope * t)
        greatest = max(greatest, float(np.abs(rest).max()))
        told.append(f"{name}: {1e6 * bias[0]:.1f} µs at the start, {1e9 * slope:+.2f} ns/s")
        thinned = envelope(t, rest, CLOCK_POINTS)
        hover = f"{name}: %{{y:.3g}} ns"
        trace = line(*thinned, colour, hover=hover, line={"width": 1.4})
        data.append(trace | {"name": name, "showlegend": len(curves) > 1})
    span = nice_span([1.05 * greatest], least=0.01)
    cycles = span * 1e-9 * L1_HZ
    data.append(
        {
            **{"type": "scatter", "x": [0], "y": [0], "yaxis": "y2", "opacity": 0},
            **{"showlegend": False, "hoverinfo": "skip"},
        }
    )
    layout = {
        "xaxis": time_axis(duration),
        "yaxis": axis("bias less a straight line [ns]", range=[-span, span]),
        "yaxis2": axis(
            "carrier cycles",
            **{"range": [-cycles, cycles], "overlaying": "y", "side": "right"},
            showgrid=False,
            tick0=0,
            dtick=nice_span([cycles / 4.0]),
        ),
        "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0},
        "showlegend": len(curves) > 1,
        "margin": {"r": 60},
    }
    kind = bench.scenario.receiver.oscillator.kind
    caption = f"What the oscillators' noise makes (the receiver's: {kind}). Taken off: "
    caption += "; ".join(told).replace("-", "\N{MINUS SIGN}") + "."
    return Figure("Clocks", caption, [Panel(data, layout, 320)])
