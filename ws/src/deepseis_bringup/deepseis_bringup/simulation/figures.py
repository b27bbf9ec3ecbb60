"""Figures of a simulated run's motion and inertial unit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

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
    signed,
    with_breaks,
)
from deepseis_bringup.simulation.envelope import Envelope
from deepseis_bringup.simulation.pictures import PERIODS, Pictures
from deepseis_core.imu_grades import STANDARD_GRAVITY
from deepseis_core.types import FloatArray
from deepseis_sim.artificial_earthquake import SHORTEST_PERIOD, Artificial
from deepseis_sim.design_spectrum import LONGEST_PERIOD

ENU: Final = ("E", "N", "U")
FLU: Final = ("F", "L", "U")
COMPONENTS: Final = ("east", "north", "up")
POINTS: Final = 1500
"""Of one row of a seismogram."""
TRAVELS: Final = 30.0
"""What gets farther than this [m] drives; what does not is shaken."""
REST: Final = 1e-6
"""Peaks below this [m, m/s, m/s^2] are rounding."""
DEGREES: Final = 180.0 / np.pi


def moves(pictures: Pictures) -> bool:
    """Tell whether anything moves."""
    return max(pictures.acceleration.peak(k) for k in range(3)) > REST


def travels(pictures: Pictures) -> bool:
    """Tell whether it goes somewhere, as vehicles do, rather than shakes."""
    return max(pictures.position.peak(k) for k in range(3)) > TRAVELS


def unit_of(peak: float) -> tuple[float, str]:
    """Return factor and unit that make a length readable.

    Examples
    --------
    >>> unit_of(0.024), unit_of(3400.0)
    ((1000.0, 'mm'), (0.001, 'km'))
    """
    if peak < 0.1:
        return 1e3, "mm"
    if peak < 2.0:
        return 1e2, "cm"
    return (1.0, "m") if peak < 3e3 else (1e-3, "km")


def plain(value: float) -> str:
    """Format a number to three digits without powers of ten where it can be done.

    Examples
    --------
    >>> plain(2450.4), plain(0.31149), plain(2.0)
    ('2450', '0.311', '2')
    """
    return f"{float(f'{value:.3g}'):.12g}"


def seismograms(pictures: Pictures) -> list[Figure]:
    """Acceleration, velocity and displacement, three rows each."""
    if not moves(pictures):
        return []
    factor, length = unit_of(max(pictures.position.peak(k) for k in range(3)))
    position = _section("Displacement", pictures, pictures.position, length, factor)
    if travels(pictures):
        position = replace(position, title="Position")
    return [
        _section("Acceleration", pictures, pictures.acceleration, "m/s²"),
        _section("Velocity", pictures, pictures.velocity, "m/s"),
        position,
    ]


def _section(
    title: str, pictures: Pictures, record: Envelope, unit: str, factor: float = 1.0
) -> Figure:
    rows, peaks = [], [factor * record.peak(k) for k in range(3)]
    for k, name in enumerate(ENU):
        t, y = record.record(k)
        note = plain(peaks[k]) if peaks[k] > factor * REST else "0"
        rows.append(Row(name, PALETTE[k], *envelope(t, factor * y, POINTS), note))
    span = nice_span([1.1 * max(peaks)])
    caption = {
        "Acceleration": "True acceleration of the antenna, without gravity",
        "Velocity": "True velocity of the antenna",
        "Displacement": "Where the antenna is, against where it stood",
    }[title]
    caption += f". Each row spans ±{span:g} {unit}; the dot is its peak."
    return Figure(title, caption, [_drawn(pictures, rows, span, unit, f"peak, {unit}")])


def _drawn(
    pictures: Pictures, rows: Sequence[Row], span: float, unit: str, note_title: str
) -> Panel:
    """Draw rows over the window, with their peaks and the motion's beginning and end."""
    start, end = pictures.window
    panel = rows_panel(rows, end, span, unit, start=start, note_title=note_title)
    for k, row in enumerate(rows):
        if row.y.size and np.nanmax(np.abs(row.y)) > 0.02 * span:
            at = int(np.nanargmax(np.abs(row.y)))
            panel.data.append(
                {
                    **{"type": "scatter", "mode": "markers", "showlegend": False},
                    **{"x": [float(row.t[at])], "y": [float(row.y[at])]},
                    "yaxis": f"y{k + 1 if k else ''}",
                    "marker": {"size": 6, "color": row.colour, "line": {"width": 0}},
                    "hovertemplate": f"peak: %{{y:.3g}} {unit} at %{{x:.2f}} s<extra></extra>",
                }
            )
    layout = merged(panel.layout, *marks(pictures), {"margin": {"r": 74, "t": 24}})
    return Panel(panel.data, layout, height=66 * len(rows) + 70)


def marks(pictures: Pictures) -> list[dict[str, Any]]:
    """Mark the motion's first and last moment, where the run shows them."""
    begin, end = pictures.bench.motion.span
    duration = pictures.bench.scenario.duration
    if end <= begin:
        return []
    found = [moment(begin, "onset")] if 0.0 < begin < duration else []
    return [*found, moment(end, "end")] if end < duration else found


def trajectory(pictures: Pictures) -> list[Figure]:
    """Draw the way in plan, and height or vertical section."""
    track = pictures.track
    if not moves(pictures) or len(track) < 3:
        return []
    reach = max(pictures.position.peak(k) for k in range(3))
    factor, unit = unit_of(reach)
    way = factor * track[:, 1:]
    travelled = travels(pictures)
    caption = (
        "The way from above; the ring is where it begins, the square where it ends."
        if travelled
        else "What the antenna draws, seen from above; the ring is where it stood before."
    )
    plan = _plane(way[:, 0], way[:, 1], f"east [{unit}]", f"north [{unit}]", track[:, 0])
    figures = [Figure("Trajectory, in plan", caption, [plan], half=True)]
    if travelled:
        figures.append(_along_time(pictures, track))
    elif pictures.position.peak(2) > 0.02 * reach:
        side = int(np.argmax([pictures.position.peak(k) for k in range(2)]))
        name = COMPONENTS[side]
        panel = _plane(way[:, side], way[:, 2], f"{name} [{unit}]", f"up [{unit}]", track[:, 0])
        caption = f"The same seen from the side: {name} to the right, up is up."
        figures.append(Figure("Trajectory, from the side", caption, [panel], half=True))
    return figures


def _plane(x: FloatArray, y: FloatArray, x_title: str, y_title: str, t: FloatArray) -> Panel:
    """Draw a way in a plane with equal axes."""
    way = line(x, y, PALETTE[0], line={"shape": "spline", "width": 1.1})
    way |= {"customdata": packed(t), "hovertemplate": "%{customdata:.2f} s<extra></extra>"}
    back = np.hypot(x[-1] - x[0], y[-1] - y[0]) < 0.01 * max(np.ptp(x), np.ptp(y))
    ends = {
        **{"type": "scatter", "mode": "markers", "showlegend": False, "hoverinfo": "skip"},
        **{"x": [float(x[0]), float(x[-1])], "y": [float(y[0]), float(y[-1])]},
        "marker": {
            **{"size": [10, 10 if back else 7], "color": "@ink", "line": {"width": 1.6}},
            "symbol": ["circle-open", "circle-open" if back else "square"],
        },
    }
    half = 0.54 * max(np.ptp(x), np.ptp(y))
    middle = (x.max() + x.min()) / 2, (y.max() + y.min()) / 2
    layout = {
        "xaxis": axis(x_title, range=[middle[0] - half, middle[0] + half], constrain="domain"),
        "yaxis": axis(
            y_title,
            **{"range": [middle[1] - half, middle[1] + half], "constrain": "domain"},
            **{"scaleanchor": "x", "scaleratio": 1},
        ),
    }
    return Panel([way, ends], layout, 400)


def _along_time(pictures: Pictures, track: FloatArray) -> Figure:
    """Height and speed of what travels."""
    t, up = track[:, 0], track[:, 3]
    data = [
        line(*envelope(t, up), PALETTE[0], hover="%{y:.2f} m"),
        line(*envelope(t, speed(track)), PALETTE[1], hover="%{y:.2f} m/s", yaxis="y2"),
    ]
    start, end = pictures.window
    level = {"range": [-1, 1]} if np.ptp(up) < 1e-3 else {}
    layout = merged(
        {
            "xaxis": axis("time since the first sample [s]", range=[start, end], anchor="y2"),
            "yaxis": axis("height [m]", domain=[0.54, 1], **level),
            "yaxis2": axis("speed [m/s]", domain=[0, 0.46], rangemode="tozero"),
        },
        *marks(pictures),
    )
    caption = "Height above where it stood, along the tangent frame's up, and speed in space."
    return Figure("Height and speed", caption, [Panel(data, layout, 400)], half=True)


def speed(track: FloatArray) -> FloatArray:
    """Return the speed [m/s] along a track, shape (n, 4): time [s] and position [m]."""
    if len(track) < 2:
        return np.zeros(len(track))
    along = np.gradient(track[:, 1:], track[:, 0], axis=0)
    return np.asarray(np.linalg.norm(along, axis=1))


def response(pictures: Pictures, *, half: bool = False) -> Figure | None:
    """Response spectra of the components, with the design spectrum where one was aimed at."""
    if not moves(pictures) or travels(pictures):
        return None
    target = _target(pictures)
    damping = target.damping if target else 0.05
    curves = [found.sa_pseudo / STANDARD_GRAVITY for found in pictures.response(damping)]
    greatest = max((float(curve.max()) for curve in curves), default=0.0)
    shown = [k for k, curve in enumerate(curves) if curve.max() > 1e-3 * greatest]
    if not shown:
        return None
    data = _design(target) if target else []
    for k in shown:
        hover = f"{COMPONENTS[k]}, %{{x:.3g}} s: %{{y:.3g}} g"
        trace = line(PERIODS, curves[k], PALETTE[k], line={"width": 1.7})
        trace |= {"name": COMPONENTS[k], "showlegend": True}
        data.append(trace | {"hovertemplate": hover + "<extra></extra>"})
    least = min(float(curves[k].min()) for k in shown)
    limits = max(0.5 * least, 1e-4 * greatest), 2.0 * greatest
    layout = {
        "xaxis": axis("natural period [s]", **decades(PERIODS[0], PERIODS[-1])),
        "yaxis": axis("pseudo-acceleration [g]", **_powers(*limits)),
        "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0},
        "showlegend": True,
    }
    caption = (
        "Greatest pseudo-acceleration of an oscillator that stands on this ground, against its "
        f"natural period; damping {100.0 * damping:g} %."
    )
    if target:
        caption += (
            " Dashed: the design spectra of GB 50011 that the motion was made for, horizontal "
            f"and vertical, with a band of ±{100.0 * target.tolerance:g} %."
        )
    return Figure("Response spectrum", caption, [Panel(data, layout, 420)], half=half)


def _target(pictures: Pictures) -> Artificial | None:
    """Return the settings of an earthquake that was made after a design spectrum."""
    bench = pictures.bench
    kinds = bench.scenario.stand_in if bench.stands_in else bench.scenario.motion
    found = [item for item in kinds if isinstance(item, Artificial)]
    return found[0] if len(found) == len(kinds) == 1 else None


def _design(target: Artificial) -> list[dict[str, Any]]:
    """Draw the design spectra, horizontal and vertical, and how far off they may be met."""
    data: list[dict[str, Any]] = []
    period = np.geomspace(SHORTEST_PERIOD, LONGEST_PERIOD, 150).clip(max=LONGEST_PERIOD)
    for component, name in ((0, "design, horizontal"), (2, "vertical")):
        goal = target.spectrum(component).coefficient(period)
        band = [(1.0 + target.tolerance) * goal, ((1.0 - target.tolerance) * goal)[::-1]]
        data.append(
            {
                **{"type": "scatter", "mode": "none", "fill": "toself", "fillcolor": "@band"},
                **{"hoverinfo": "skip", "showlegend": False},
                "x": packed(np.concatenate([period, period[::-1]])),
                "y": packed(np.concatenate(band)),
            }
        )
        dash = "dash" if component == 0 else "dot"
        trace = line(period, goal, "@ink", line={"width": 1.2, "dash": dash})
        trace["hovertemplate"] = f"{name}, %{{x:.3g}} s: %{{y:.3g}} g<extra></extra>"
        data.append(trace | {"name": name, "showlegend": True})
    return data


def _powers(low: float, high: float) -> dict[str, Any]:
    """Return a logarithmic axis over few decades or many."""
    if high < 500.0 * low:
        return decades(low, high)
    return {"type": "log", "range": [float(np.log10(low)), float(np.log10(high))], "dtick": 1}


def inertial(pictures: Pictures) -> list[Figure]:
    """Specific force and angular rate as the inertial unit measures them."""
    imu = pictures.bench.scenario.imu
    if imu is None:
        return []
    record = pictures.imu
    figures = []
    levels = [_level(pictures, record, 3 + k) for k in range(3)]
    if np.isfinite(levels).all():
        rows = _rows(record, 3, levels, 1.0)
        span = nice_span([1.1 * max(_peak(row) for row in rows)])
        at_rest = ", ".join(f"{n} {signed(v, '+.3f')}" for n, v in zip(FLU, levels, strict=True))
        caption = (
            f"As measured at {imu.rate_hz:g} Hz along the forward, left and up axis, less the "
            f"level at rest ({at_rest} m/s²). Each row spans ±{span:g} m/s²."
        )
        panel = _drawn(pictures, rows, span, "m/s²", "peak, m/s²")
        figures.append(Figure("Specific force", caption, [panel]))
    if max((v for v in map(record.peak, range(3)) if np.isfinite(v)), default=0.0) > 0.0:
        rows = _rows(record, 0, [0.0] * 3, DEGREES)
        span = nice_span([1.1 * max(_peak(row) for row in rows)])
        caption = (
            f"As measured: about the forward, left and up axis. Each row spans ±{span:g} °/s; the "
            "Earth turns by 0.0042 °/s."
        )
        panel = _drawn(pictures, rows, span, "°/s", "peak, °/s")
        figures.append(Figure("Angular rate", caption, [panel]))
    return figures


def velocimeter(pictures: Pictures) -> Figure | None:
    """Velocity as the laser velocimeter measures it."""
    if pictures.bench.scenario.ldv is None or not np.isfinite(pictures.ldv.peak(0)):
        return None
    rows = _rows(pictures.ldv, 0, [0.0] * 2, 1.0, ("forward", "up"))
    span = nice_span([1.1 * max(_peak(row) for row in rows)])
    caption = f"As measured, in the axes of the sensor. Each row spans ±{span:g} m/s."
    panel = _drawn(pictures, rows, span, "m/s", "peak, m/s")
    return Figure("Laser velocimeter", caption, [panel])


def positions(pictures: Pictures) -> Figure | None:
    """Errors of the positions that are given instead of a receiver's."""
    if pictures.bench.scenario.positions is None or not np.isfinite(pictures.fixes.peak(0)):
        return None
    rows = _rows(pictures.fixes, 0, [0.0] * 3, 1e3, ENU)
    span = nice_span([1.1 * max(_peak(row) for row in rows)])
    end = pictures.bench.scenario.duration
    panel = rows_panel(rows, end, span, "mm", note_title="peak, mm")
    layout = merged(panel.layout, *marks(pictures), {"margin": {"r": 74, "t": 24}})
    caption = f"Given positions of the antenna less the true ones. Each row spans ±{span:g} mm."
    shown = Panel(panel.data, layout, height=66 * len(rows) + 70)
    return Figure("Errors of the positions", caption, [shown])


def _level(pictures: Pictures, record: Envelope, column: int) -> float:
    """Return the middle of a record before the motion begins, or of all of it."""
    t, y = record.record(column)
    before = t < pictures.bench.motion.span[0]
    chosen = y[before] if np.count_nonzero(before) > 20 else y
    return float(np.median(chosen)) if chosen.size else float("nan")


def _rows(
    record: Envelope,
    first: int,
    levels: Sequence[float],
    factor: float,
    names: Sequence[str] = FLU,
) -> list[Row]:
    rows = []
    for k, (name, level) in enumerate(zip(names, levels, strict=True)):
        t, y = record.record(first + k)
        t, y = with_breaks(t, factor * (y - level))
        row = Row(name, PALETTE[k], *envelope(t, y, POINTS))
        rows.append(replace(row, note=plain(_peak(row))))
    return rows


def _peak(row: Row) -> float:
    return float(np.nanmax(np.abs(row.y))) if row.y.size else 0.0
