"""Pictures of the acceptance of faults: displacement, its error, and phases against the truth."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from scipy.interpolate import CubicSpline

from deepseis_bringup.accept.figures import mark
from deepseis_bringup.accept.scene import Scene
from deepseis_bringup.faults.cases import Case
from deepseis_bringup.faults.measures import deviations
from deepseis_bringup.faults.record import RunRecord, positions
from deepseis_bringup.report.plot import PALETTE, Figure, Row, envelope, nice_span, rows_panel
from deepseis_core.types import FloatArray, Lli

CLEAR_S: Final = 3.0
"""Shown before and after [s]."""
GREATEST_MM: Final = 500.0


def fault_figures(
    case: Case, scene: Scene, record: RunRecord, truth: Callable[[FloatArray], FloatArray]
) -> list[Figure]:
    """Draw a case: error of the displacements, and every satellite's phase less the truth."""
    return [_displacement(case, scene, record, truth), _phases(case, scene, record)]


def _displacement(
    case: Case, scene: Scene, record: RunRecord, truth: Callable[[FloatArray], FloatArray]
) -> Figure:
    t, moved, _ = record.displacement()
    curves = {"fused": (t, moved), "phases": positions(record.precise)}
    if case.base:
        curves["RTK"] = positions(record.rtk)
    begin, end = scene.still[0], float(scene.truth.t[-1])
    rows, sizes = [], []
    for k, (name, (times, places)) in enumerate(curves.items()):
        inside = (times >= begin) & (times < end)
        times, error = times[inside], places[inside] - truth(times[inside])
        rest = error[times < scene.still[1]]
        error = 1e3 * (error - (rest.mean(axis=0) if len(rest) else 0.0))
        for axis, of_axis in enumerate(("east", "north", "up")):
            greatest = float(np.abs(error[:, axis]).max(initial=0.0))
            sizes.append(min(greatest, GREATEST_MM))
            colour = PALETTE[(3 * k + axis) % len(PALETTE)]
            rows.append(Row(f"{name} {of_axis}", colour, *envelope(times, error[:, axis]),
                            f"{greatest:.0f}", ""))  # fmt: skip
    span = nice_span([float(np.median(sizes)) * 3.0], 1.0)
    panel = rows_panel(rows, end, span, "mm")
    mark(panel.layout, (case.begin, case.end))
    return Figure(
        f"Error of displacement, {case.label}",
        f"Less the truth; rows span {span:g} mm either way, at the right the greatest [mm]. "
        "Marked is the fault.",
        [panel],
    )


def _phases(case: Case, scene: Scene, record: RunRecord) -> Figure:
    rows, end = [], float(scene.truth.t[-1])
    for k, (name, (t, phase, lli)) in enumerate(record.observed().items()):
        if name not in scene.truth.satellites:
            continue
        column = scene.truth.phase_cycles[:, scene.truth.satellites.index(name)]
        inside = (t > 4.0) & (t < end) & np.isfinite(phase)
        t, marks = t[inside], (lli[inside].astype(np.int64) & int(Lli.SLIP)) != 0
        constant = phase[inside] + CubicSpline(scene.truth.t, column)(t)
        marks[:1] = True
        arcs = np.split(np.arange(t.size), np.flatnonzero(marks)[1:])
        off = np.concatenate(deviations(constant, arcs))
        colour = PALETTE[k % len(PALETTE)]
        count = int(marks[1:].sum())
        rows.append(Row(name, colour, *envelope(t, np.clip(off, -1.0, 1.0)), f"{count}", ""))
    panel = rows_panel(rows, end, 0.5, "cycle")
    mark(panel.layout, (case.begin, case.end))
    return Figure(
        f"Carrier phases, {case.label}",
        "Less the truth and whole cycles of each arc; rows span half a cycle either way, at "
        "the right the number of loss-of-lock marks. A step without a mark would be wrong.",
        [panel],
    )
