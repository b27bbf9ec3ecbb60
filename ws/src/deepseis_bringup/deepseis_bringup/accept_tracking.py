"""Acceptance of the tracking loops: thesis tables 5.3 to 5.6, 5.11 and 5.13, repeated.

Every scenario is simulated once; the receiver then works through it with each loop in one
process (`offline`), and once as a graph over DDS, whose payloads must be the same bytes.

The thesis' bandwidths are those of analog constants (docs/decisions/0006): its conventional loops
are repeated with them. Ours are what they say.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from deepseis_bringup.accept import Acceptance, Goal, Row
from deepseis_bringup.accept_figures import discriminator_figure, error_figure
from deepseis_bringup.graph import GraphConfig
from deepseis_bringup.inertial import inertial_parameters
from deepseis_bringup.loop_measures import (
    CarrierTruth,
    LoopFigures,
    Tracks,
    measure,
    pooled,
    thermal_deg,
)
from deepseis_bringup.offline import OfflineChain, Output, encode
from deepseis_bringup.run_columns import Columns
from deepseis_bringup.simulate import simulate
from deepseis_frontend.if_bag import IfBag
from deepseis_sim.scenario import load_scenario

RATE_HZ: Final = 4.0e6
ELEVATION_DEG: Final = 26.0
"""Of the satellite whose discriminator stands for the thesis' low ones."""
QUANTISING_DB: Final = 0.05
"""Loss of the 4-bit quantiser."""
POLARITY_S: Final = 9.0
"""By then a subframe has told the polarity; before, half a cycle may be put in [s]."""
SETTLED_S: Final = 1.5
"""Left out at both ends of the motion: its ramps."""

Say = Callable[[str], None]


@dataclass(frozen=True)
class Loop:
    """A way to run the trackers."""

    name: str
    aiding: str
    bandwidth_hz: float
    tracker: Mapping[str, Any]
    imu: str = ""


def conventional(bandwidth_hz: float) -> Loop:
    """Return the thesis' conventional loop."""
    settings = {
        "pll_order": 2,
        "pll_bandwidth_hz": bandwidth_hz,
        "loop_design": "analog",
        "relock_s": 0.0,  # a lost loop stays lost, as the thesis shows it
    }
    return Loop(f"conventional {bandwidth_hz:g} Hz", "", bandwidth_hz, settings)


def aided(bandwidth_hz: float, imu: str = "") -> Loop:
    """Return a loop aided by the fusion."""
    name = f"aided {bandwidth_hz:g} Hz" + (f", {imu}" if imu else "")
    settings = {"aided_order": 2, "aided_bandwidth_hz": bandwidth_hz}
    return Loop(name, "fusion", bandwidth_hz, settings, imu)


LOOPS: Final = (conventional(15.0), conventional(8.0), aided(8.0), aided(5.0), aided(3.0))
MEMS: Final = aided(8.0, "mti-g")

PUBLISHED: Final[Mapping[tuple[str, str], tuple[float, float]]] = {
    ("sine-1hz", "conventional 15 Hz"): (28.96, 47.90),
    ("sine-1hz", "conventional 8 Hz"): (46.31, 89.96),
    ("sine-1hz", "aided 8 Hz"): (1.70, 8.25),
    ("sine-1hz", "aided 5 Hz"): (2.03, 8.82),
    ("sine-1hz", "aided 8 Hz, mti-g"): (1.89, 8.88),
    ("sine-2hz", "conventional 15 Hz"): (26.39, 44.46),
    ("sine-2hz", "conventional 8 Hz"): (51.73, 89.90),
    ("sine-2hz", "aided 8 Hz"): (1.81, 7.59),
    ("sine-2hz", "aided 5 Hz"): (2.30, 7.73),
    ("sine-2hz", "aided 8 Hz, mti-g"): (2.00, 7.96),
    ("quake", "conventional 15 Hz"): (3.21, 23.78),
    ("quake", "conventional 8 Hz"): (4.59, 29.51),
    ("quake", "aided 8 Hz"): (1.69, 7.10),
    ("quake", "aided 5 Hz"): (1.94, 8.14),
    ("quake", "aided 8 Hz, mti-g"): (1.76, 8.31),
    ("shake-table", "conventional 15 Hz"): (7.26, 24.92),
    ("shake-table", "conventional 8 Hz"): (18.44, 37.30),
    ("shake-table", "aided 8 Hz"): (4.59, 14.43),
    ("shake-table", "aided 5 Hz"): (5.90, 18.22),
}
"""Thesis: RMS and greatest discriminator output while moving [deg], scenario and loop."""

TABLES: Final = {
    "sine-1hz": "T 5.3 circle 1 Hz",
    "sine-2hz": "T 5.4 circle 2 Hz",
    "quake": "T 5.5 earthquake",
    "shake-table": "T 5.6 shake table",
}


@dataclass
class Outcome:
    """What one loop did in one scenario."""

    loop: Loop
    still: list[LoopFigures]
    moving: list[LoopFigures]
    tracks: Mapping[str, Columns] = field(default_factory=dict)

    def satellite(self) -> LoopFigures:
        """Return the figures, moving, of the satellite nearest to `ELEVATION_DEG`."""
        return min(self.moving, key=lambda item: abs(item.elevation_deg - ELEVATION_DEG))

    def ratios(self) -> list[float]:
        """Return true phase error over thermal limit of every satellite, moving."""
        return [
            item.own_rms / thermal_deg(self.loop.bandwidth_hz, item.cn0_dbhz - QUANTISING_DB)
            for item in self.moving
        ]


class Scene:
    """One simulated scenario and its runs.

    Parameters
    ----------
    name : str
        Scenario.
    folder : Path
        For its files.
    short : bool
        Its short form.
    satellites : int
        How many to track, in the order of names.
    """

    def __init__(self, name: str, folder: Path, *, short: bool, imu: str = "") -> None:
        settings = [f"imu.grade={imu}"] if imu else []
        self.name, self.folder = name, folder / (name + imu)
        self.scenario = load_scenario(name, short=short, settings=settings)
        simulate(self.scenario, self.folder, progress=False)
        self.truth = CarrierTruth.read(self.folder / "truth.npz")
        summary = json.loads((self.folder / "summary.json").read_text())
        begin, end = summary["motion_begin_s"], summary["motion_end_s"]
        self.still = (max(POLARITY_S, begin - 11.0), begin - 0.5)
        self.moving = (begin + SETTLED_S, end - SETTLED_S)
        self.stands_in = bool(summary["motion_stands_in"])

    def config(self, loop: Loop) -> GraphConfig:
        """Return the graph for a loop, with the orbits and the place a station knows."""
        bag, nav = self.folder / "bag", str(self.folder / "nav.rnx")
        with np.load(self.folder / "truth.npz") as truth:
            antenna = truth["antenna_ecef_m"][0].tolist()
        known = {"nav_file": nav, "position_ecef": antenna}
        week = {"reference_week": self.scenario.start.week}
        parameters: dict[str, dict[str, Any]] = {
            "pvt": dict(known),
            "acquisition": {**known, **week},
            "tracker": {**week, **loop.tracker},
        }
        if loop.aiding == "fusion":
            parameters |= inertial_parameters(bag, IfBag(bag))
            parameters["fusion"]["nav_file"] = nav
        return GraphConfig(
            source={"file": str(bag)},
            sample_rate_hz=RATE_HZ,
            satellites=self.truth.satellites,
            aiding=loop.aiding,
            parameters=parameters,
        )

    def run(self, loop: Loop, listen: Callable[[Output], None] | None = None) -> Outcome:
        """Work through the scenario with a loop, in this process."""
        tracks = Tracks()
        for output in OfflineChain(self.config(loop)).run():
            if output.topic.startswith("tracking/"):
                tracks.add(output.value)
            if listen is not None:
                listen(output)
        found = tracks.finish()
        still, moving = (
            measure(found, self.truth, RATE_HZ, span, self.still)
            for span in (self.still, self.moving)
        )
        held = {item.satellite for item in still if item.locked > 0.99}
        still, moving = (
            [item for item in part if item.satellite in held] for part in (still, moving)
        )
        return Outcome(loop, still, moving, found)


def accept_tracking(folder: Path, *, short: bool, say: Say = lambda _text: None) -> Acceptance:
    """Repeat the thesis' tables of tracking.

    Parameters
    ----------
    folder : Path
        Gets ``tracking.csv`` and ``tracking.html``.
    short : bool
        Short forms of the scenarios.
    say : callable, optional
        Told what is done.
    """
    form = "short forms" if short else "full forms"
    acceptance = Acceptance("tracking", f"Tracking loops under earthquakes, {form}")
    with tempfile.TemporaryDirectory(dir=folder, prefix=".input.") as place:
        for name in TABLES:
            say(f"{name}: simulating")
            scene = Scene(name, Path(place), short=short)
            outcomes = [_run(scene, loop, say) for loop in LOOPS]
            if name != "shake-table":
                say(f"{name}: simulating with {MEMS.imu}")
                other = Scene(name, Path(place), short=short, imu=MEMS.imu)
                outcomes.append(_run(other, MEMS, say))
            if scene.stands_in:
                acceptance.remarks.append(f"{name}: an artificial motion stands in.")
            for outcome in outcomes:
                acceptance.add(*_rows(scene, outcome, short))
            acceptance.add(*_mems_rows(scene, outcomes))
            acceptance.figures.append((TABLES[name], _figures(scene, outcomes)))
            if name == "sine-2hz":
                say(f"{name}: over DDS")
                acceptance.add(_same_bytes(scene, aided(8.0), Path(place) / "dds"))
    acceptance.write(folder)
    return acceptance


def _run(scene: Scene, loop: Loop, say: Say) -> Outcome:
    say(f"{scene.name}: {loop.name}")
    return scene.run(loop)


def _rows(scene: Scene, outcome: Outcome, short: bool) -> list[Row]:
    table, loop = TABLES[scene.name], outcome.loop
    moving = outcome.satellite()
    scenario = f"{scene.name}, {loop.name}"
    published = PUBLISHED.get((scene.name, loop.name), (None, None))
    rms_goal = max_goal = None
    if loop.aiding == "" and scene.name.startswith("sine") and published[0] is not None:
        rms_goal = Goal.within(0.15, published[0])
        max_goal = Goal.within(0.15, published[1] or 0.0)
    if loop.aiding:
        max_goal = Goal.at_most(round(4.5 * moving.discriminator_rms, 2))
    rows = [
        Row(table, scenario, f"discriminator RMS, {moving.satellite}", "deg",
            moving.discriminator_rms, published[0], rms_goal),
        Row(table, scenario, f"discriminator greatest, {moving.satellite}", "deg",
            moving.discriminator_max, published[1], max_goal),
    ]  # fmt: skip
    if not loop.aiding:
        kept = sum(item.locked > 0.99 and not item.slips for item in outcome.moving)
        rows.append(
            Row(table, scenario, "satellites held without slip", "-", float(kept),
                limit=float(len(outcome.moving)))
        )  # fmt: skip
        return rows
    quiet = pooled(item.discriminator_rms for item in outcome.still)
    loud = pooled(item.discriminator_rms for item in outcome.moving)
    ratios = outcome.ratios()
    limit = thermal_deg(loop.bandwidth_hz, moving.cn0_dbhz - QUANTISING_DB)
    slips = sum(item.slips for item in outcome.moving)
    worst = max(outcome.moving, key=lambda item: item.own_rms)
    return [
        *rows,
        Row(table, scenario, "discriminator RMS moving / still, all satellites", "-",
            loud / quiet, goal=Goal.at_most(1.12 if short else 1.05), limit=1.0),
        Row(table, scenario, f"true phase error, {moving.satellite}", "deg",
            moving.own_rms, limit=limit),
        Row(table, scenario, "true phase error / thermal limit, all satellites", "-",
            pooled(ratios), goal=Goal.at_most(1.10), limit=1.0),
        Row(table, scenario, f"the same, worst satellite, {worst.satellite}", "-",
            max(ratios), limit=1.0),
        Row(table, scenario, "true phase error with the common part, all satellites", "deg",
            pooled(item.error_rms for item in outcome.moving)),
        Row(table, scenario, "slips while moving", "-", float(slips), goal=Goal.at_most(0.0)),
    ]  # fmt: skip


def _mems_rows(scene: Scene, outcomes: list[Outcome]) -> list[Row]:
    by_name = {outcome.loop.name: outcome for outcome in outcomes}
    if MEMS.name not in by_name:
        return []
    ours = [
        pooled(item.discriminator_rms for item in by_name[name].moving)
        for name in (MEMS.name, aided(8.0).name)
    ]
    table = "T 5.13 IMU grade" if scene.name == "quake" else "T 5.11 IMU grade"
    printed = [PUBLISHED[scene.name, name][0] for name in (MEMS.name, aided(8.0).name)]
    return [
        Row(table, scene.name, "discriminator RMS, MTi-G less SPAN-FSAS, all satellites", "deg",
            ours[0] - ours[1], round(printed[0] - printed[1], 2), Goal.at_most(0.05)),
    ]  # fmt: skip


def _figures(scene: Scene, outcomes: list[Outcome]) -> list[Any]:
    satellite = outcomes[0].satellite().satellite
    tracks = {outcome.loop.name: outcome.tracks[satellite] for outcome in outcomes}
    return [
        discriminator_figure(scene.name, satellite, tracks, RATE_HZ, scene.moving),
        error_figure(scene.name, outcomes, scene.truth, RATE_HZ, scene.still, scene.moving),
    ]


def _same_bytes(scene: Scene, loop: Loop, folder: Path) -> Row:
    """Run the graph over DDS and compare its payloads with the chain's, topic by topic."""
    from deepseis_bringup.graph_payloads import run_graph

    payloads: dict[str, list[bytes]] = {}

    def listen(output: Output) -> None:
        if output.topic != "if/samples":
            payloads.setdefault(output.topic, []).append(encode(output))

    scene.run(loop, listen)
    recorded = run_graph(scene.config(loop), folder)
    differing = [
        topic
        for topic, messages in sorted(payloads.items())
        if sorted(recorded.get(topic, [])) != sorted(messages)
    ]
    text = "same bytes" if not differing else "differs: " + ", ".join(differing)
    return Row(
        "DDS", f"{scene.name}, {loop.name}", "graph over DDS against the chain in one process",
        "topics", float(len(differing)), text, Goal.at_most(0.0),
    )  # fmt: skip
