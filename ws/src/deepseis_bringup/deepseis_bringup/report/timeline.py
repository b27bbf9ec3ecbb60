"""Figure: what every channel was doing, and when."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from deepseis_bringup.report.plot import Figure, Panel, merged, moment, time_axis
from deepseis_bringup.report.run_columns import Columns
from deepseis_bringup.report.run_measures import Measures
from deepseis_core.types import FloatArray, TrackingFlag, TrackingMode

SEARCH, PULL_IN, BITS, CODE, PHASE, AIDED = range(6)
STATES: Final = (
    ("searching", "@band"),
    ("pull-in", "#d8a23a"),
    ("bit sync", "#b9c46a"),
    ("code only", "#d9622b"),
    ("phase lock", "#2f9e6e"),
    ("phase lock, aided", "#3b7dd8"),
)
EVENTS: Final = (
    ("slip", TrackingFlag.SLIP, "x-thin-open", "#c2333f"),
    ("half cycle", TrackingFlag.HALF_CYCLE, "diamond-open", "#c2333f"),
    ("samples missing", TrackingFlag.GAP, "line-ns-open", "#c2333f"),
    ("aiding late", TrackingFlag.AID_MISSED, "triangle-down-open", "@ink"),
    ("aiding dropped", TrackingFlag.AID_DIVERGED, "triangle-down", "#c2333f"),
)
MOST: Final = 400  # stretches or marks of one kind for one satellite


def timeline(measures: Measures) -> Figure | None:
    """Tracking mode, lock and events of every satellite."""
    run = measures.run
    names = run.satellites[::-1]
    if not names:
        return None
    bars: dict[int, list[tuple[str, float, float]]] = {k: [] for k in range(len(STATES))}
    marks: dict[str, list[tuple[str, float]]] = {name: [] for name, *_ in EVENTS}
    for satellite in names:
        columns = run.tracking[satellite]
        sample, state = states(columns)
        for k, start, end in stretches(run.seconds(sample), state, run.duration)[:MOST]:
            bars[k].append((satellite, start, end))
        _events(columns, run.seconds(columns["sample_index"]), satellite, marks)
    decoded = [
        (e.satellite, float(run.seconds(e.effective_sample_index)))
        for e in run.ephemerides
        if e.effective_sample_index >= 0 and e.satellite in names
    ]
    data = [_bar_trace(k, values) for k, values in bars.items() if values]
    for name, _, symbol, colour in EVENTS:
        if marks[name]:
            data.append(_mark_trace(name, marks[name], symbol, colour))
    if decoded:
        data.append(_mark_trace("ephemeris", decoded, "star-triangle-up", "@ink"))
    layout = merged(
        {
            "xaxis": time_axis(run.duration),
            "yaxis": {"categoryorder": "array", "categoryarray": names, "showgrid": False},
            **{"barmode": "overlay", "bargap": 0.42, "showlegend": True},
            "legend": {"orientation": "h", "y": 1.06, "yanchor": "bottom", "x": 0},
        },
        moment(measures.first_fix_s, ""),
    )
    caption = (
        "State of every channel. A triangle marks a complete ephemeris decoded from the signal; "
        "crosses are losses of phase continuity after first lock. The dotted line is the first "
        "position."
    )
    return Figure("Tracking", caption, [Panel(data, layout, 26 * len(names) + 130)])


def states(columns: Columns) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """State at samples in ascending order: of integrations, and of blocks without any."""
    flags = columns["flags"].astype(np.int64)
    mode = columns.per_row("mode")
    state = np.full(flags.shape, PULL_IN)
    state[(mode >= TrackingMode.BIT_SYNC) | ((flags & TrackingFlag.PHASE_LOCK) > 0)] = BITS
    synchronous = (flags & TrackingFlag.BIT_SYNC) > 0
    state[synchronous] = CODE
    phase = synchronous & ((flags & TrackingFlag.PHASE_LOCK) > 0)
    state[phase] = PHASE
    state[phase & (mode == TrackingMode.TRACK_AIDED)] = AIDED
    idle = columns["mode"] == TrackingMode.IDLE
    sample = np.concatenate((columns["sample_index"], columns["block_sample_index"][idle]))
    joined = np.concatenate((state, np.full(int(idle.sum()), SEARCH)))
    order = np.argsort(sample, kind="stable")
    return sample[order], joined[order]


def stretches(
    t: FloatArray, state: NDArray[np.int64], end: float
) -> list[tuple[int, float, float]]:
    """Join equal neighbours: state, start and end [s] of each stretch.

    Examples
    --------
    >>> stretches(np.array([0.0, 1.0, 2.0]), np.array([0, 4, 4]), 3.0)
    [(0, 0.0, 1.0), (4, 1.0, 3.0)]
    """
    if not t.size:
        return []
    first = np.concatenate(([0], np.flatnonzero(np.diff(state)) + 1))
    ends = np.concatenate((t[first[1:]], [end]))
    values = zip(state[first], t[first], ends, strict=True)
    return [(int(k), float(a), float(b)) for k, a, b in values]


def _events(
    columns: Columns, t: FloatArray, satellite: str, marks: dict[str, list[tuple[str, float]]]
) -> None:
    """Collect where a flag comes up after the polarity was first known."""
    flags = columns["flags"].astype(np.int64)
    since = np.cumsum((flags & TrackingFlag.POLARITY_KNOWN) > 0) > 1
    for name, flag, *_ in EVENTS:
        on = ((flags & flag) > 0) & (since | (flag == TrackingFlag.GAP))
        rises = np.flatnonzero(on & ~np.concatenate(([False], on[:-1])))
        marks[name] += [(satellite, float(t[k])) for k in rises[:MOST]]


def _bar_trace(k: int, values: list[tuple[str, float, float]]) -> dict[str, Any]:
    name, colour = STATES[k]
    return {
        **{"type": "bar", "orientation": "h", "name": name, "marker": {"color": colour}},
        "y": [satellite for satellite, _, _ in values],
        "base": [round(start, 4) for _, start, _ in values],
        "x": [round(end - start, 4) for _, start, end in values],
        "customdata": [[round(start, 2), round(end, 2)] for _, start, end in values],
        "hovertemplate": f"%{{y}} {name}: "
        "%{customdata[0]} to %{customdata[1]} s<extra></extra>",
    }


def _mark_trace(
    name: str, values: list[tuple[str, float]], symbol: str, colour: str
) -> dict[str, Any]:
    return {
        **{"type": "scatter", "mode": "markers", "name": name},
        "x": [round(t, 4) for _, t in values],
        "y": [satellite for satellite, _ in values],
        "marker": {"symbol": symbol, "color": colour, "size": 9, "line": {"width": 1.5}},
        "hovertemplate": "%{y} " + name + ": %{x:.2f} s<extra></extra>",
    }
