"""Acceptance of faults during an earthquake: what is lost, until when, and no wrong phase.

Each scene is simulated once; a fault is put into its recording (`faulty_bag`) and the receiver
works through it in one process, whose values are those of the graph in lockstep. The full form
runs the graph over DDS instead, in separate processes, where ``/diagnostics`` must say what is
wrong. Kills of processes are the soak test's (`deepseis_bringup.soak`).
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from scipy.interpolate import CubicSpline

from deepseis_bringup.accept.faults_figures import fault_figures
from deepseis_bringup.accept.position import true_position
from deepseis_bringup.accept.scene import RATE_HZ, Recorded, Scene, aided
from deepseis_bringup.accept.tables import Acceptance, Goal, Row
from deepseis_bringup.base import with_base
from deepseis_bringup.faults.cases import Case, Scenes, cases
from deepseis_bringup.faults.measures import (
    Loss,
    WrongCycles,
    complaints,
    deviation,
    loss_of,
    wrong_cycles,
)
from deepseis_bringup.faults.record import RunRecord, positions
from deepseis_bringup.graph import GraphConfig
from deepseis_bringup.graph_payloads import run_graph
from deepseis_bringup.offline import OfflineChain, Output
from deepseis_core.gps_time import GpsTime
from deepseis_core.types import Aiding, FloatArray
from deepseis_tracking.engine import BlockOutput, TrackingEngine

Say = Callable[[str], None]

RECOVERY_S: Final = 2.0
"""Goal: all is back so long after the input is."""
FIRST_S: Final = 4.0
"""Phases are held against the truth from here on [s]: all satellites are tracked."""
LAST_S: Final = 1.0
"""Left out at the end of a recording [s]."""


class _Interrupted(TrackingEngine):
    """Channels that get no aiding for a while, and do not wait for it."""

    away = 0, 0

    def push_aiding(self, aiding: Aiding) -> None:
        """Take the aiding of a span, unless it is lost on the way."""
        if not self.away[0] <= aiding.valid_from < self.away[1]:
            super().push_aiding(aiding)

    def advance(self, *, force: bool = False) -> BlockOutput | None:
        """Work through one block; what is not there by now does not come."""
        return super().advance(force=force or self.waiting_for() == "aiding")


class WithoutAiding(OfflineChain):
    """The chain, whose trackers get no aiding for a while, as when the fusion is stopped.

    Parameters
    ----------
    config : GraphConfig
    begin, end : float
        [s]
    """

    def __init__(self, config: GraphConfig, begin: float, end: float) -> None:
        super().__init__(config)
        made = self.tracking
        interrupted = _Interrupted(
            made.satellites, made.config, made.slots, wait_aiding=made.wait_aiding
        )
        interrupted.away = round(begin * config.sample_rate_hz), round(end * config.sample_rate_hz)
        self.tracking = interrupted


def config_of(case: Case, recorded: Recorded) -> GraphConfig:
    """Return the graph of a case."""
    loop = aided(8.0)
    loop = replace(loop, fusion=dict(case.parameters.get("fusion", {})))
    config = recorded.config(loop)
    return with_base(config) if case.base else config


def outputs(case: Case, config: GraphConfig) -> Iterator[Output]:
    """Work through a case in this process."""
    if case.aiding_away:
        return WithoutAiding(config, case.begin, case.end).run()
    return OfflineChain(config).run()


def measured(case: Case, recorded: Recorded, scene: Scene, folder: Path | None) -> RunRecord:
    """Run a case, over DDS if there is a folder for it, and return what it said."""
    start = scene.scenario.start.time
    record = RunRecord(RATE_HZ, start.tow_ns)
    config = config_of(case, recorded)
    if folder is None or case.aiding_away:
        for output in outputs(case, config):
            record.take(output.topic, output.value)
        return record
    start_utc_ns = GpsTime(start.week, start.tow_ns).to_utc_ns()
    record.take_all(run_graph(config, folder), start_utc_ns)
    return record


def accept_faults(folder: Path, *, short: bool, say: Say = lambda _text: None) -> Acceptance:
    """Measure what faults cost.

    Parameters
    ----------
    folder : Path
        Gets ``faults.csv`` and ``faults.html``.
    short : bool
        In one process; otherwise over DDS.
    say : callable, optional
        Told what is done.
    """
    form = "one process" if short else "graph over DDS, separate processes"
    acceptance = Acceptance("faults", f"Faults during an earthquake, {form}")
    with tempfile.TemporaryDirectory(dir=folder, prefix=".input.") as place:
        scenes = Scenes(Path(place))
        for case in cases():
            say(case.label)
            scene, recorded = scenes.spoilt(case)
            run = None if short else Path(place) / "run"
            record = measured(case, recorded, scene, run)
            add_case(acceptance, case, scene, record)
            for left in (run, Path(place) / f"spoilt-{case.scene}"):
                if left is not None and left.exists():
                    shutil.rmtree(left)
    acceptance.write(folder)
    return acceptance


def add_case(acceptance: Acceptance, case: Case, scene: Scene, record: RunRecord) -> None:
    """Add lines and pictures of a case."""
    end = float(scene.truth.t[-1])
    t, true = true_position(scene)
    truth = CubicSpline(t, true)
    lost = loss_of(record.timelines(), case.begin, case.end, end - LAST_S)
    wrong = wrong_cycles(record, scene.truth, FIRST_S, end)
    if scene.stands_in:
        acceptance.remarks.append(f"{scene.name}: an artificial motion stands in.")
    acceptance.add(*_loss_rows(case, lost), *_phase_rows(case, wrong))
    acceptance.add(*_displacement_rows(case, scene, record, truth))
    for item in complaints(record.said, case.begin, case.end + 3.0):
        acceptance.add(_row(case, f"{item.node} says", "", f"{item.text} ({item.time:.0f} s)"))
    acceptance.figures.append((case.label, fault_figures(case, scene, record, truth)))


def _row(case: Case, quantity: str, unit: str, ours: float | str, goal: Goal | None = None) -> Row:
    return Row(case.label, case.scene, quantity, unit, ours, None, goal)


def _loss_rows(case: Case, lost: Loss) -> list[Row]:
    rows = [_row(case, "lost", "", lost.text())]
    if case.outage:
        rows.append(_row(case, f"all back, {lost.slowest} last", "s", lost.recovery,
                         Goal.at_most(RECOVERY_S)))  # fmt: skip
        rows.append(_row(case, "aiding back", "s", lost.back["aiding"]))
        rows.append(_row(case, "position back", "s", lost.back["position"]))
    return rows


def _phase_rows(case: Case, wrong: list[WrongCycles]) -> list[Row]:
    changes = sum(item.changes for item in wrong)
    epochs = sum(item.epochs for item in wrong)
    marks = sum(item.marks for item in wrong)
    worst = max(wrong, key=lambda item: item.greatest)
    return [
        _row(case, "cycles wrong without LLI", "-", float(changes), Goal.at_most(0.0)),
        _row(case, "epochs off by > 1/4 cycle without LLI", "-", float(epochs),
             Goal.at_most(0.0)),
        _row(case, "LLI marks", "-", float(marks)),
        _row(case, f"greatest deviation in an arc, {worst.satellite}", "cycle", worst.greatest),
    ]  # fmt: skip


def _displacement_rows(
    case: Case, scene: Scene, record: RunRecord, truth: Callable[[FloatArray], FloatArray]
) -> list[Row]:
    t, moved, sd = record.displacement()
    after = case.end + RECOVERY_S, float(scene.truth.t[-1]) - LAST_S
    spans = {"during": (case.begin, case.end), "2 s after and later": after}
    rows = []
    for when, span in spans.items():
        if span[0] >= span[1]:
            continue
        fused = deviation(t, moved, sd, truth, scene.still, span)
        rows.append(_row(case, f"fused displacement, greatest error {when}", "mm",
                         1e3 * fused.greatest))  # fmt: skip
        rows.append(_row(case, f"the same in its sigmas {when}", "-", fused.in_sigmas))
        streams = {"phases": record.precise, "RTK, fixed": record.rtk if case.base else []}
        for name, stream in streams.items():
            if stream:
                found = deviation(*positions(stream), None, truth, scene.still, span)
                share = float(np.mean([good for at, good, _ in stream
                                       if span[0] <= at < span[1]]))  # fmt: skip
                rows.append(_row(case, f"displacement by {name}, greatest error {when}", "mm",
                                 1e3 * found.greatest))  # fmt: skip
                rows.append(_row(case, f"share of epochs with it {when}", "%", 100 * share))
    return rows
