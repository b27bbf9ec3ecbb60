"""A simulated scenario and the receiver's runs on it, for the acceptance of tracking."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from deepseis_bringup.graph import GraphConfig
from deepseis_bringup.inertial import inertial_parameters
from deepseis_bringup.loop_measures import (
    CarrierTruth,
    LoopFigures,
    Tracks,
    measure,
    thermal_deg,
)
from deepseis_bringup.offline import OfflineChain, Output
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


@dataclass(frozen=True)
class Loop:
    """A way to run the trackers."""

    name: str
    aiding: str
    bandwidth_hz: float
    tracker: Mapping[str, Any]
    imu: str = ""
    fusion: Mapping[str, Any] = field(default_factory=dict)


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
    settings : sequence of str, optional
        Changes of the scenario.
    label : str, optional
        What tells it from others of its name.
    """

    def __init__(
        self,
        name: str,
        folder: Path,
        *,
        short: bool,
        settings: Sequence[str] = (),
        label: str = "",
    ) -> None:
        self.name, self.folder = name, folder / (name + label)
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
            parameters["fusion"] |= {"nav_file": nav, **loop.fusion}
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
        # Left out is what the sky hides, never what the loops lost: that is no number, and misses.
        seen = {item.satellite for item in still if np.isfinite(item.cn0_dbhz)}
        seen &= {item.satellite for item in moving if np.isfinite(item.cn0_dbhz)}
        still, moving = (
            [item for item in part if item.satellite in seen] for part in (still, moving)
        )
        return Outcome(loop, still, moving, found)
