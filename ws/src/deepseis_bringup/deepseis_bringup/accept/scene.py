"""A recording with its truth and the receiver's runs on it, for the acceptance of tracking."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from deepseis_bringup.accept.loop_measures import (
    CarrierTruth,
    LoopFigures,
    Tracks,
    measure,
    thermal_deg,
)
from deepseis_bringup.accept.tables import Acceptance
from deepseis_bringup.base import with_base
from deepseis_bringup.graph import GraphConfig
from deepseis_bringup.inertial import inertial_parameters
from deepseis_bringup.offline import OfflineChain, Output
from deepseis_bringup.report.run_columns import Columns
from deepseis_bringup.simulation.simulate import simulate
from deepseis_core.types import FloatArray, Pvt
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
class Work:
    """What a group of tables gets: a folder for its files, the form, where lines and pictures go.

    ``say`` is told what is done.
    """

    folder: Path
    short: bool
    acceptance: Acceptance
    say: Say = lambda _text: None

    def run(self, scene: Recorded, loop: Loop) -> Outcome:
        """Work through a recording with a loop, and say so."""
        self.say(f"{scene.name}: {loop.name}")
        return scene.run(loop)


@dataclass(frozen=True)
class Loop:
    """A way to run the trackers; ``nodes`` are parameters of others, by kind."""

    name: str
    aiding: str
    bandwidth_hz: float
    tracker: Mapping[str, Any]
    imu: str = ""
    fusion: Mapping[str, Any] = field(default_factory=dict)
    nodes: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


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


@dataclass
class Outcome:
    """What one loop did with one recording.

    ``loss_db`` is what the recording's quantiser takes of the truth's C/N0.
    """

    loop: Loop
    still: list[LoopFigures]
    moving: list[LoopFigures]
    tracks: Mapping[str, Columns] = field(default_factory=dict)
    pvts: Sequence[Pvt] = ()
    loss_db: float = QUANTISING_DB

    def satellite(self) -> LoopFigures:
        """Return the figures, moving, of the satellite nearest to `ELEVATION_DEG`."""
        return min(self.moving, key=lambda item: abs(item.elevation_deg - ELEVATION_DEG))

    def ratios(self) -> list[float]:
        """Return true phase error over thermal limit of every satellite, moving."""
        return [
            item.own_rms / thermal_deg(self.loop.bandwidth_hz, item.cn0_dbhz - self.loss_db)
            for item in self.moving
        ]

    def held(self) -> int:
        """Count the satellites that were locked throughout the motion, without a slip."""
        return sum(item.locked > 0.99 and not item.slips for item in self.moving)


@dataclass
class Recorded:
    """An input bag with its truth.

    Attributes
    ----------
    name : str
    bag : Path
        With samples, station and IMU.
    nav_file : Path
        Orbits, RINEX.
    truth : CarrierTruth
    antenna_ecef : ndarray, shape (3,)
        Where the antenna stands at first [m].
    week : int
        GPS week.
    still, moving : tuple of float
        Spans to be measured [s].
    loss_db : float
        What the quantiser takes of the truth's C/N0.
    settings : mapping of mappings
        Parameters of nodes that the recording needs.
    base : bool
        Solve against the base in the bag, too.
    """

    name: str
    bag: Path
    nav_file: Path
    truth: CarrierTruth
    antenna_ecef: FloatArray
    week: int
    still: tuple[float, float]
    moving: tuple[float, float]
    loss_db: float = QUANTISING_DB
    settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    base: bool = False

    def config(self, loop: Loop) -> GraphConfig:
        """Return the graph for a loop, with the orbits and the place a station knows."""
        known = {"nav_file": str(self.nav_file), "position_ecef": self.antenna_ecef.tolist()}
        week = {"reference_week": self.week}
        parameters: dict[str, dict[str, Any]] = {
            "pvt": dict(known),
            "acquisition": {**known, **week},
            "tracker": {**week, **loop.tracker},
        }
        if loop.aiding == "fusion":
            parameters |= self.inertial()
            parameters["fusion"] |= loop.fusion
        for kind, more in self.settings.items():
            if kind in parameters:
                parameters[kind] |= more
        for kind, more in loop.nodes.items():
            parameters[kind] |= more
        config = GraphConfig(
            source={"file": str(self.bag)},
            sample_rate_hz=RATE_HZ,
            satellites=self.truth.satellites,
            aiding=loop.aiding,
            parameters=parameters,
        )
        return with_base(config) if self.base else config

    def inertial(self) -> dict[str, dict[str, Any]]:
        """Return the parameters of ``motion_state`` and ``fusion``."""
        parameters = inertial_parameters(self.bag, IfBag(self.bag))
        parameters["fusion"]["nav_file"] = str(self.nav_file)
        return parameters

    def run(
        self,
        loop: Loop,
        listen: Callable[[Output], None] | None = None,
        beside: Loop | None = None,
    ) -> Outcome:
        """Work through the recording with a loop, in this process.

        The fusion of ``beside`` runs along on the same inputs, without aiding the loops.
        """
        tracks, pvts = Tracks(), []
        chain = OfflineChain(self.config(loop))
        if beside is not None:
            chain.beside.append(chain.make_inertial(self.config(beside)))
        for output in chain.run():
            if output.topic.startswith("tracking/"):
                tracks.add(output.value)
            elif output.topic == "gnss/pvt":
                pvts.append(output.value)
            if listen is not None:
                listen(output)
        found = tracks.finish()
        still, moving = (
            measure(found, self.truth, RATE_HZ, span, self.still)
            for span in (self.still, self.moving)
        )
        # Left out is what the sky hides, never what the loops lost: that is no number, and misses.
        seen = {item.satellite for item in still if np.isfinite(item.cn0_dbhz)}
        seen &= {item.satellite for item in moving if np.isfinite(item.cn0_dbhz)}
        still, moving = (
            [item for item in part if item.satellite in seen] for part in (still, moving)
        )
        return Outcome(loop, still, moving, found, pvts, self.loss_db)


class Scene(Recorded):
    """A scenario, simulated.

    Parameters
    ----------
    name : str
        Scenario.
    folder : Path
        For its files.
    short : bool
        Its short form.
    settings : sequence of str, optional
        Changes of the scenario.
    label : str, optional
        What tells it from others of its name.
    base : bool, optional
        Solve against the base, too.
    """

    def __init__(
        self,
        name: str,
        folder: Path,
        *,
        short: bool,
        settings: Sequence[str] = (),
        label: str = "",
        base: bool = False,
    ) -> None:
        place = folder / (name + label)
        self.scenario = load_scenario(name, short=short, settings=settings)
        simulate(self.scenario, place, progress=False)
        summary = json.loads((place / "summary.json").read_text())
        begin, end = summary["motion_begin_s"], summary["motion_end_s"]
        still, moving = (begin - 11.0, begin - 0.5), (begin + SETTLED_S, end - SETTLED_S)
        if begin == end:  # nothing ever moves
            still = moving = (0.0, self.scenario.duration)
        self.stands_in = bool(summary["motion_stands_in"])
        self.truth_file = place / "truth.npz"
        with np.load(self.truth_file) as truth:
            antenna = truth["antenna_ecef_m"][0]
        super().__init__(
            name,
            place / "bag",
            place / "nav.rnx",
            CarrierTruth.read(self.truth_file),
            antenna,
            self.scenario.start.week,
            (max(POLARITY_S, still[0]), still[1]),
            moving,
            base=base,
        )
