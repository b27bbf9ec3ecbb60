"""Soak test: a station disturbed by chance for a long time; what was lost, and what grew."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from deepseis_bringup.accept.tables import Acceptance, Goal, Row
from deepseis_bringup.faults.measures import wrong_cycles
from deepseis_bringup.soak.observables import soak_observables
from deepseis_bringup.soak.plan import Disturbance
from deepseis_bringup.soak.report import (
    add_losses,
    add_resources,
    losses,
    losses_of_holes,
)
from deepseis_bringup.soak.signal import SoakConfig, SoakRun, soak_signal

Say = Callable[[str], None]

SIGNAL: Final = "from IF samples, over DDS"
OBSERVABLES: Final = "from observables, one process"
SHOWN: Final = 10
"""Wrong phases of a satellite that are listed with time and place."""
FIRST_S: Final = 10.0
"""Phases are held against the truth from here on: their polarity is known [s]."""


def soak_from_signal(folder: Path, config: SoakConfig, say: Say) -> Acceptance:
    """Run the soak test over DDS; leaves ``soak.csv`` and ``soak.html``."""
    acceptance = Acceptance("soak", "Soak test from IF samples, over DDS")
    say(f"simulating {config.duration:.0f} s, disturbing them, playing them")
    run = soak_signal(config, folder)
    _add_run(acceptance, run)
    timelines = run.record.timelines()
    add_losses(acceptance, f"{SIGNAL}: what was lost", losses(
        run.disturbances, timelines, config.duration))  # fmt: skip
    add_resources(acceptance, f"{SIGNAL}: memory and file handles", run.resources)
    acceptance.write(folder)
    return acceptance


def _add_run(acceptance: Acceptance, run: SoakRun) -> None:
    config = run.config
    how = f"realtime at pace {config.pace:g}" if config.pace else "lockstep"
    wrong = wrong_cycles(run.record, run.truth, FIRST_S, config.duration)
    changes, epochs = (
        sum(getattr(item, name) for item in wrong) for name in ("changes", "epochs")
    )
    table, scene = SIGNAL, f"{how}, seed {config.seed}"
    acceptance.add(
        Row(table, scene, "station time", "min", config.duration / 60.0),
        Row(table, scene, "wall time", "min", run.wall_s / 60.0),
        Row(table, scene, "disturbances", "-", float(len(run.disturbances))),
        Row(table, scene, "restarts", "-", float(run.restarts)),
        Row(table, scene, "cycles wrong without LLI", "-", float(changes), None,
            Goal.at_most(0.0)),
        Row(table, scene, "epochs off by > 1/4 cycle without LLI", "-", float(epochs), None,
            Goal.at_most(0.0)),
        *(
            Row(table, scene, f"{item.satellite} wrong without LLI at", "s",
                f"{at:.2f}, {_last(run.disturbances, at)}")
            for item in wrong for at in item.times[:SHOWN]
        ),
    )  # fmt: skip


def _last(disturbances: Sequence[Disturbance], at: float) -> str:
    """Say which disturbance began last before a moment [s]."""
    before = [item for item in disturbances if item.begin <= at]
    if not before:
        return "before any disturbance"
    last = max(before, key=lambda item: item.begin)
    return f"{at - last.begin:.2f} s into {last.name} of {last.length:.2f} s"


def soak_from_observables(
    folder: Path,
    hours: float,
    *,
    rate_hz: float,
    seed: int,
    every_s: float,
    show: Callable[[float], object] = lambda _done: None,
) -> Acceptance:
    """Run the soak test of the filters; leaves ``soak.csv`` and ``soak.html``."""
    acceptance = Acceptance("soak", "Soak test from observables")
    run = soak_observables(hours, rate_hz=rate_hz, seed=seed, every_s=every_s, show=show)
    table, scene = OBSERVABLES, f"{rate_hz:g} Hz, IMU 200 Hz, seed {seed}"
    acceptance.add(
        Row(table, scene, "station time", "h", run.hours),
        Row(table, scene, "wall time", "min", run.wall_s / 60.0),
        Row(table, scene, "disturbances", "-", float(len(run.disturbances))),
        Row(table, scene, "epochs", "-", float(run.epochs)),
        Row(table, scene, "events", "-", float(run.events)),
    )
    found = losses_of_holes(run.disturbances, run.holes, 3600.0 * run.hours)
    add_losses(acceptance, f"{OBSERVABLES}: what was lost", found)
    add_resources(acceptance, f"{OBSERVABLES}: memory and file handles", run.resources)
    acceptance.write(folder)
    return acceptance
