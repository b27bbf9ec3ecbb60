"""Soak test from IF samples: the graph over DDS in real time, disturbed by chance.

The signal is simulated with earthquakes and satellites masked, gaps are put into the recording,
and processes are killed while the graph plays it. What was lost is told from what was recorded.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import monotonic
from typing import Final

import numpy as np

from deepseis_bringup.accept.loop_measures import CarrierTruth
from deepseis_bringup.accept.scene import RATE_HZ, Recorded, aided
from deepseis_bringup.faults.cases import masked
from deepseis_bringup.faults.faulty_bag import faulty_bag
from deepseis_bringup.faults.record import RunRecord
from deepseis_bringup.graph import build_graph
from deepseis_bringup.restarts import RestartConfig, Restarts
from deepseis_bringup.simulation.simulate import simulate
from deepseis_bringup.soak.plan import Disturbance, plan
from deepseis_bringup.soak.resources import Resources
from deepseis_bringup.supervisor import Supervisor, own_domain, running
from deepseis_bringup.watch import GraphWatch
from deepseis_core.gps_time import GpsTime
from deepseis_sim.scenario import Scenario, load_scenario

VICTIMS: Final = (
    *("fusion", "trackers", "acquisition", "motion_state", "seismic_event"),
    *("imu_source", "pvt"),
)
QUAKE_S: Final = 12.0
QUAKE_EVERY_S: Final = 45.0
SATELLITES: Final = 9
SAMPLE_EVERY_S: Final = 1.0
"""Memory and handles, by the clock on the wall [s]."""
JOIN_S: Final = 60.0
"""A process that is not back by then is said not to be [s of samples]."""


@dataclass(frozen=True)
class SoakConfig:
    """How long and how hard.

    Attributes
    ----------
    duration : float
        Of the recording [s].
    pace : float
        Seconds of the recording a second; 0: lockstep, as fast as it goes, nobody is killed.
    every_s : float
        Between disturbances in the mean [s].
    seed : int
    """

    duration: float = 600.0
    pace: float = 1.0
    every_s: float = 20.0
    seed: int = 1


@dataclass
class SoakRun:
    """What a soak test did and found."""

    config: SoakConfig
    disturbances: list[Disturbance]
    record: RunRecord
    truth: CarrierTruth
    resources: Resources = field(default_factory=Resources)
    wall_s: float = 0.0
    restarts: int = 0


def soak_scenario(config: SoakConfig, disturbances: Sequence[Disturbance]) -> Scenario:
    """Return the scenario: 0.5 g at 2 Hz now and then, satellites masked as planned."""
    starts = np.arange(20.0, config.duration - QUAKE_S, QUAKE_EVERY_S)
    motion = ", ".join(
        f"{{kind: circle, radius: 0.03, frequency_hz: 2.0, start: {start:.1f}, "
        f"duration: {QUAKE_S}, ramp: 1.0}}"
        for start in starts
    )
    settings = [
        f"duration={config.duration}", f"motion=[{motion}]", "base=false",
        f"seed={config.seed}", f"sky.satellites={SATELLITES}",
    ]  # fmt: skip
    outages = [item for item in disturbances if item.kind == "outage"]
    if outages:
        scenario = load_scenario("sine-2hz", short=True, settings=settings)
        settings.append(masked(scenario, [(int(o.victim), o.begin, o.end) for o in outages]))
    return load_scenario("sine-2hz", short=True, settings=settings)


def soak_signal(config: SoakConfig, folder: Path) -> SoakRun:
    """Run the soak test.

    Parameters
    ----------
    config : SoakConfig
    folder : Path
        Gets ``clean/`` (removed afterwards), ``input/`` and ``run/``.
    """
    victims = VICTIMS if config.pace else ()
    kinds = ["imu-gap", "if-gap", "no-signal", "outage", *(["kill"] * bool(victims))]
    planned = plan(
        config.duration, config.seed, every_s=config.every_s, kinds=kinds, victims=victims,
        satellites=SATELLITES,
    )  # fmt: skip
    scenario = soak_scenario(config, planned)
    clean, spoilt = folder / "clean", folder / "input"
    simulate(scenario, clean, progress=True)
    faults = [fault for item in planned if (fault := item.fault()) is not None]
    faulty_bag(clean / "bag", spoilt, faults, seed=config.seed)
    for path in (clean / "bag").glob("*.mcap"):
        path.unlink()
    with np.load(clean / "truth.npz") as truth:
        antenna = truth["antenna_ecef_m"][0]
    recorded = Recorded(
        "soak", spoilt / "bag", spoilt / "nav.rnx", CarrierTruth.read(clean / "truth.npz"),
        antenna, scenario.start.week, (0.0, 0.0), (0.0, 0.0),
    )  # fmt: skip
    return _play(config, planned, recorded, scenario.start.time, folder / "run")


def _play(
    config: SoakConfig,
    planned: Sequence[Disturbance],
    recorded: Recorded,
    start: GpsTime,
    folder: Path,
) -> SoakRun:
    """Run the graph, kill whom the plan says, and read what was recorded."""
    folder.mkdir(parents=True)
    graph = replace(
        recorded.config(aided(8.0)),
        mode="realtime" if config.pace else "lockstep",
        record_dir=str(folder / "bag"),
        record_if=False,
        output_dir=str(folder),
        watched=True,
    )
    graph = replace(graph, source={**graph.source, "pace": config.pace or 1.0})
    restarts = Restarts(RestartConfig(limit=8)) if config.pace else None
    run = SoakRun(config, [], RunRecord(RATE_HZ, start.tow_ns), recorded.truth)
    with own_domain() as environment:
        nodes = Supervisor(build_graph(graph), folder, environment=environment, restarts=restarts)
        members = [spec.name for spec in nodes.specs if spec.name != "if_source"]
        with (
            running(nodes),
            GraphWatch(environment, members=members, restarts=restarts) as watch,
        ):
            reaper = Reaper(nodes, restarts, [item for item in planned if item.kind == "kill"])
            due = 0.0

            def poll() -> None:
                nonlocal due
                now = watch.poll() / RATE_HZ
                watch.require_progress()
                reaper.poll(now)
                if monotonic() > due and now > 0.0:
                    due = monotonic() + SAMPLE_EVERY_S
                    run.resources.sample(now, reaper.pids())

            nodes.wait(poll=poll)
            run.wall_s = watch.elapsed()
    run.restarts = restarts.count if restarts is not None else 0
    others = [item for item in planned if item.kind != "kill"]
    run.disturbances = sorted([*others, *reaper.done()], key=lambda item: item.begin)
    run.record.read(folder / "bag", start.to_utc_ns())
    _write_log(folder, run.disturbances)
    return run


class Reaper:
    """Kills processes when their time has come, and notes when they are back."""

    def __init__(
        self, nodes: Supervisor, restarts: Restarts | None, planned: Sequence[Disturbance]
    ) -> None:
        self.nodes, self.restarts, self.left = nodes, restarts, list(planned)
        self.died: list[tuple[str, float]] = []
        self._restarts_before: list[int] = []
        self.back: dict[int, float] = {}

    def pids(self) -> Mapping[str, int]:
        """Return the processes that run, by name."""
        alive = {n: p for n, p in self.nodes.processes.items() if p.poll() is None}
        return {name: process.pid for name, process in alive.items()}

    def poll(self, now: float) -> None:
        """Kill whose turn it is; ``now`` is the source's time [s]."""
        if self.restarts is None:
            return
        missing = self.restarts.missing
        while self.left and self.left[0].begin <= now:
            name = self.left.pop(0).victim
            if name in self.nodes.processes and name not in missing:
                self.died.append((name, now))
                self._restarts_before.append(self._restarts_of(name))
                with contextlib.suppress(ProcessLookupError):
                    self.nodes.processes[name].kill()
                return
        for number, (name, _) in enumerate(self.died):
            again = self._restarts_of(name) > self._restarts_before[number]
            if number not in self.back and again and name not in missing:
                self.back[number] = now

    def _restarts_of(self, name: str) -> int:
        known = self.restarts.fates.get(name) if self.restarts is not None else None
        return 0 if known is None else known.restarts

    def done(self) -> list[Disturbance]:
        """Return the deaths, with the time that each process was away."""
        return [
            Disturbance("kill", when, self.back.get(number, when + JOIN_S) - when, name)
            for number, (name, when) in enumerate(self.died)
        ]


def _write_log(folder: Path, disturbances: Sequence[Disturbance]) -> None:
    lines = [vars(item) for item in disturbances]
    (folder / "disturbances.json").write_text(json.dumps(lines, indent=1) + "\n")
