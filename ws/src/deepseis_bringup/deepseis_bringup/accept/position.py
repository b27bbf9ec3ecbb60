"""Loosely coupled positions with conventional and with aided loops (thesis figures 5.18, 5.21).

The same fusion gets the positions and velocities that the receiver made with one loop or the
other; the inertial half has the same data both times.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from deepseis_bringup.accept.figures import mark
from deepseis_bringup.accept.scene import RATE_HZ, Outcome, Recorded, Scene, Work, aided
from deepseis_bringup.accept.tables import Goal
from deepseis_bringup.accept.tables import Row as Line
from deepseis_bringup.offline import OfflineChain
from deepseis_bringup.report.plot import (
    PALETTE,
    Figure,
    Panel,
    Row,
    envelope,
    nice_span,
    rows_panel,
)
from deepseis_core.geodesy import geodetic_from_ecef, rotation_enu_ecef
from deepseis_core.types import FloatArray, IntArray, Pvt

TABLE: Final = "T figures 5.18, 5.21, loose position"
BLOCK: Final = round(0.02 * RATE_HZ)
AXES: Final = ("east", "north", "up")


def loose_solution(scene: Recorded, pvts: Sequence[Pvt]) -> tuple[IntArray, FloatArray]:
    """Run the inertial half of the graph on a recording, with positions from elsewhere.

    Parameters
    ----------
    scene : Recorded
    pvts : sequence of Pvt
        In order.

    Returns
    -------
    sample_index : ndarray, shape (m,)
        IMU epochs.
    position_enu : ndarray, shape (m, 3)
        Of the IMU, from the monument [m].
    """
    chain = OfflineChain(scene.config(aided(8.0))).inertial
    assert chain is not None
    samples, positions = [], []
    waiting = list(reversed(pvts))
    end = round(float(scene.truth.t[-1]) * RATE_HZ)
    for through in range(BLOCK - 1, end, BLOCK):
        while waiting and waiting[-1].valid_through <= through:
            chain.push_pvt(waiting.pop())
        chain.pvt_valid(through)
        for topic, value, _ in chain.advance(through):
            if topic == "ins/solution":
                samples.append(value.sample_index)
                positions.append(value.position_enu)
    return np.concatenate(samples), np.concatenate(positions)


def true_position(scene: Scene) -> tuple[FloatArray, FloatArray]:
    """Return times [s], (m,), and the antenna's displacement east, north, up [m], (m, 3)."""
    with np.load(scene.truth_file) as truth:
        t, antenna = truth["motion_t_s"], truth["antenna_ecef_m"]
    latitude, longitude, _ = geodetic_from_ecef(antenna[0])
    return t, (antenna - antenna[0]) @ rotation_enu_ecef(latitude, longitude).T


def loose_positions(work: Work, scene: Scene, outcomes: Sequence[Outcome]) -> None:
    """Add rows and a picture of the loosely coupled position with every loop but the narrowest."""
    t, displacement = true_position(scene)
    rms: dict[str, FloatArray] = {}
    curves = []
    for outcome in outcomes:
        if outcome.loop.bandwidth_hz < 8.0:
            continue
        work.say(f"{scene.name}: loose position, {outcome.loop.name}")
        samples, position = loose_solution(scene, outcome.pvts)
        when = samples / RATE_HZ
        truth = np.column_stack([np.interp(when, t, axis) for axis in displacement.T])
        error = position - truth
        still = (when >= scene.still[0]) & (when < scene.still[1])
        error = error - error[still].mean(axis=0)
        moving = (when >= scene.moving[0]) & (when < scene.moving[1])
        rms[outcome.loop.name] = np.sqrt(np.mean(error[moving] ** 2, axis=0))
        curves.append((outcome.loop.name, when, error))
    work.acceptance.add(*_rows(scene, rms))
    work.acceptance.figures.append((TABLE, _figures(scene, curves)))


def _rows(scene: Scene, rms: dict[str, FloatArray]) -> list[Line]:
    rows = []
    for name, values in rms.items():
        for axis, value in zip(AXES, values, strict=True):
            rows.append(
                Line(TABLE, f"{scene.name}, {name}", f"loose position, RMS {axis}", "m",
                     float(value), "picture")
            )  # fmt: skip
    size = {name: float(np.linalg.norm(values)) for name, values in rms.items()}
    ours = next(name for name in size if name.startswith("aided"))
    for name, value in size.items():
        if name != ours:
            rows.append(
                Line(TABLE, f"{scene.name}, {ours}", f"loose position, RMS in space, over {name}",
                     "-", size[ours] / value, "aided better", Goal.at_most(1.0))
            )  # fmt: skip
    return rows


def _figures(scene: Scene, curves: Sequence[tuple[str, FloatArray, FloatArray]]) -> list[Figure]:
    figures = []
    for k, axis in enumerate(AXES):
        rows = []
        for number, (name, when, error) in enumerate(curves):
            inside = (when >= scene.moving[0]) & (when < scene.moving[1])
            rms = float(np.sqrt(np.mean(error[inside, k] ** 2)))
            colour = PALETTE[number % len(PALETTE)]
            rows.append(Row(name, colour, *envelope(when, error[:, k]), f"{rms:.3f}", ""))
        span = nice_span([float(np.abs(error[:, k]).max()) for _, _, error in curves], 0.02)
        panel: Panel = rows_panel(rows, float(scene.truth.t[-1]), span, "m")
        mark(panel.layout, scene.moving)
        caption = (
            f"Position of the loosely coupled filter less the truth, {axis} [m]; rows span "
            f"{span:g} m either way, at the right the RMS while it moves."
        )
        figures.append(Figure(f"Loose position, {axis}, {scene.name}", caption, [panel]))
    return figures
