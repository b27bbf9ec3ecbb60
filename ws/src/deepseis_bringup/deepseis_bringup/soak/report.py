"""What a soak test found: a table of losses, memory and handles, and pictures of both."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from deepseis_bringup.accept.tables import Acceptance, Goal, Row
from deepseis_bringup.faults.measures import Timelines, loss_of
from deepseis_bringup.faults.record import Timeline
from deepseis_bringup.report.plot import PALETTE, Figure, Panel, axis, envelope, line
from deepseis_bringup.soak.observables import Holes
from deepseis_bringup.soak.plan import Disturbance
from deepseis_bringup.soak.resources import Growth, Resources

BEYOND_S: Final = 1.0
"""Goal: nothing is lost beyond the gap itself and this [s]."""
GROWTH_MB_PER_H: Final = 8.0
"""Goal of memory's slope with two of its sigmas: 200 MB a day fill no machine in a week."""
LEAST_HOURS: Final = 0.25
"""Of a warm life, to hold its slope against the goal."""
BEFORE_S: Final = 1.0
"""What was not there so long before a disturbance is none of its losses [s]."""
LOOKED_S: Final = 12.0
"""After a disturbance, or to the next one [s]."""


def losses(
    disturbances: Sequence[Disturbance], timelines: Timelines, end: float
) -> dict[str, dict[str, list[tuple[float, float]]]]:
    """Return, by disturbance and by stream, seconds lost and seconds lost beyond the gap.

    Parameters
    ----------
    disturbances : sequence of Disturbance
        In order; what follows within `LOOKED_S` ends the look at the one before.
    timelines : mapping
        From `RunRecord.timelines`.
    end : float
        Of the recording [s].
    """
    found: dict[str, dict[str, list[tuple[float, float]]]] = defaultdict(lambda: defaultdict(list))
    begins = [item.begin for item in disturbances] + [end]
    for number, item in enumerate(disturbances):
        until = min(item.end + LOOKED_S, begins[number + 1], end)
        if until <= item.end:
            continue  # the next one hit before this one was over: theirs is one gap
        lost = loss_of(timelines, item.begin, item.end, until)
        for name, seconds in lost.missing.items():
            if not _was_there(timelines[name], item.begin):
                continue  # lost by one before
            beyond = max(0.0, seconds - item.length) if seconds else 0.0
            found[item.name][name].append((seconds, beyond))
    return found


def _was_there(line: Timeline, begin: float) -> bool:
    t, good = line
    return bool((good & (t >= begin - BEFORE_S) & (t < begin)).any())


def losses_of_holes(
    disturbances: Sequence[Disturbance], holes: Mapping[str, Holes], end: float
) -> dict[str, dict[str, list[tuple[float, float]]]]:
    """Return the same from the holes of streams."""
    found: dict[str, dict[str, list[tuple[float, float]]]] = defaultdict(lambda: defaultdict(list))
    begins = [item.begin for item in disturbances] + [end]
    for number, item in enumerate(disturbances):
        for name, stream in holes.items():
            hit = stream.between(item.begin - 0.2, begins[number + 1] - 0.2)
            seconds = sum(b - a for a, b in hit)
            beyond = max(0.0, seconds - item.length) if seconds else 0.0
            found[item.name][name].append((seconds, beyond))
    return found


def add_losses(
    acceptance: Acceptance,
    table: str,
    found: dict[str, dict[str, list[tuple[float, float]]]],
    *,
    bound: bool = True,
) -> None:
    """Add a line for each disturbance and stream that lost something, and their goals."""
    for name, streams in sorted(found.items()):
        count = len(next(iter(streams.values())))
        for stream in streams:
            values = np.array(streams[stream])
            scenario = f"{name}, {count} times"
            worst = float(values[:, 1].max())
            acceptance.add(
                Row(table, scenario, f"{stream}: lost in all", "s", float(values[:, 0].sum())),
                Row(table, scenario, f"{stream}: beyond the gap, most", "s", worst, None,
                    Goal.at_most(BEYOND_S) if bound else None),
            )  # fmt: skip


def add_resources(acceptance: Acceptance, table: str, resources: Resources) -> None:
    """Add lines of memory and handles, and their picture."""
    for item in resources.growth():
        acceptance.add(*_growth_rows(table, item))
    acceptance.figures.append((table, [_memory(resources), _handles(resources)]))


def _growth_rows(table: str, item: Growth) -> list[Row]:
    who = f"{item.name}, {60.0 * item.hours:.1f} min"
    most = item.slope_mb_per_h + 2.0 * item.slope_sd
    goal = Goal.at_most(GROWTH_MB_PER_H) if item.hours >= LEAST_HOURS else None
    return [
        Row(table, who, "memory, first and last quarter", "MB",
            f"{item.first_mb:.1f}, {item.last_mb:.1f}"),
        Row(table, who, "memory's slope", "MB/h",
            f"{item.slope_mb_per_h:.2f} +- {item.slope_sd:.2f}"),
        Row(table, who, "slope and two sigmas", "MB/h", most, None, goal),
        Row(table, who, "file handles gained", "-", item.last_handles - item.first_handles, None,
            Goal.at_most(0.0)),
    ]  # fmt: skip


def _memory(resources: Resources) -> Figure:
    return _picture(resources, 1, "Memory", "memory without that of files [MB]", "MB")


def _handles(resources: Resources) -> Figure:
    return _picture(resources, 2, "File handles", "file handles", "")


def _picture(resources: Resources, column: int, title: str, label: str, unit: str) -> Figure:
    data = []
    for k, name in enumerate(resources.names):
        table = resources.table(name)
        shown = envelope(table[:, 0], table[:, column], 300)
        data.append(
            line(*shown, PALETTE[k % len(PALETTE)], hover=f"%{{y:.0f}} {unit}", name=name,
                 showlegend=True)
        )  # fmt: skip
    layout = {
        "xaxis": axis("time of the samples [s]"), "yaxis": axis(label, rangemode="tozero"),
        "showlegend": True,
    }  # fmt: skip
    caption = "Of the longest life of every process."
    return Figure(title, caption, [Panel(data, layout)], half=True)
