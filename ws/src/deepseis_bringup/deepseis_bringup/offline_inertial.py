"""The inertial half of the graph in one process, without nodes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from deepseis_core.errors import InputError
from deepseis_core.imu_grades import grade_named
from deepseis_core.rinex_nav import read_rinex_nav
from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import Ephemeris, ImuSample, Pvt, Station
from deepseis_frontend.imu_open import open_imu
from deepseis_ins.event_engine import EventConfig, EventEngine
from deepseis_ins.fusion_config import FusionConfig
from deepseis_ins.fusion_engine import FusionEngine
from deepseis_ins.fusion_output import FusionOutput
from deepseis_ins.ground_motion import displacement_utc_ns
from deepseis_ins.loose import LooseConfig
from deepseis_ins.motion_engine import MotionEngine, MotionEngineConfig
from deepseis_ins.motion_state import MotionConfig
from deepseis_ins.onset import OnsetConfig

Pick = Callable[[type[Any], Mapping[str, Any]], Any]


class InertialChain:
    """IMU, motion state, fusion and events of a graph's description.

    Parameters
    ----------
    file : str
        Where the IMU is.
    clock : SampleClock
        Of its IF samples.
    given : mapping
        Parameters of ``fusion``, ``motion_state`` and ``seismic_event``.
    pick : callable
        Fills a settings dataclass from parameters.

    Attributes
    ----------
    motion, fusion, events
        The engines, to be looked at.
    """

    def __init__(
        self, file: str, clock: SampleClock, given: Mapping[str, Mapping[str, Any]], pick: Pick
    ) -> None:
        self.clock, known = clock, dict(given.get("fusion", {}))
        if "imu_grade" not in known:
            raise InputError(file, "the inertial half needs parameters", "inertial_parameters")
        rate, grade = float(known["imu_rate_hz"]), grade_named(known["imu_grade"])
        self.samples = open_imu(file, clock).samples()
        self.next: ImuSample | None = next(self.samples)
        detector = dict(given.get("motion_state", {}))
        self.motion = MotionEngine(
            pick(MotionEngineConfig, detector),
            pick(MotionConfig, detector),
            grade,
            rate,
            clock.sample_rate_hz,
        )
        self.fusion = FusionEngine(
            pick(FusionConfig, known),
            grade,
            clock.sample_rate_hz,
            _station(known),
            rate,
            loose=pick(LooseConfig, known),
        )
        events = given.get("seismic_event", {})
        self.events = EventEngine(
            pick(EventConfig, events),
            pick(OnsetConfig, events),
            "",
            np.array(known["monument_ecef"]),
        )
        if known.get("nav_file"):
            for ephemeris in read_rinex_nav(known["nav_file"]).ephemerides:
                self.fusion.push_ephemeris(ephemeris)

    def push_pvt(self, pvt: Pvt) -> None:
        """Take a position."""
        self.fusion.push_pvt(pvt)

    def push_position(self, topic: str, value: Any) -> None:
        """Take what pvt publishes, if it is a position that the fusion listens to."""
        if topic == "gnss/pvt":
            self.push_pvt(value)
        elif topic == "gnss/precise":
            self.fusion.push_precise(value)

    def push_ephemeris(self, ephemeris: Ephemeris) -> None:
        """Take an orbit that was decoded."""
        self.fusion.push_ephemeris(ephemeris)

    def pvt_valid(self, through: int) -> None:
        """All positions through this sample have been pushed."""
        self.fusion.pvt_valid(through)

    def advance(self, through: int) -> Iterator[tuple[str, Any, int]]:
        """Yield topic, value and UTC [ns] of all that follows from samples up to ``through``."""
        while self.next is not None and self.next.sample_index <= through + 1:
            sample, self.next = self.next, next(self.samples, None)
            self.motion.push(sample)
            self.fusion.push_imu(sample)
            yield "imu/data_raw", sample, self.clock.utc_ns(sample.sample_index)
        for valid, states in self.motion.advance(through + 1):
            for state in states:
                self.fusion.push_motion(state)
                yield "motion/state", state, self.clock.utc_ns(state.sample_index)
            self.fusion.motion_valid(valid)
        self.fusion.source_valid(through)
        self.fusion.imu_valid(through + 1)
        while (output := self.fusion.advance()) is not None:
            yield from self._said(output)

    def _said(self, output: FusionOutput) -> Iterator[tuple[str, Any, int]]:
        aiding, solution = output.aiding, output.solution
        yield "aiding/doppler", aiding, self.clock.utc_ns(aiding.knot_sample_index)
        if len(solution.sample_index):
            yield "ins/solution", solution, self.clock.utc_ns(int(solution.sample_index[0]))
        for motion in output.motion:
            yield "seismo/displacement", motion, displacement_utc_ns(motion)
            for report in self.events.push(motion):
                yield "seismo/event", report.event, report.utc_ns


def _station(known: Mapping[str, Any]) -> Station:
    return Station(
        name="",
        network="",
        monument_ecef=np.array(known["monument_ecef"]),
        antenna_lever_arm=np.array(known["antenna_lever_arm"]),
        imu_to_antenna=np.array(known["imu_to_antenna"]),
        imu_orientation_xyzw=np.array(known["imu_orientation_xyzw"]),
        imu=str(known["imu_grade"]),
    )
