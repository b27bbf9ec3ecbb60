"""The inertial half of the graph in one process, without nodes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from deepseis_core.errors import InputError
from deepseis_core.imu_grades import grade_named
from deepseis_core.rinex_nav import read_rinex_nav
from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import Ephemeris, ImuSample, LdvVelocity, Pvt, Station
from deepseis_frontend.imu_open import open_imu
from deepseis_frontend.ldv_bag import LdvBag
from deepseis_ins.event_engine import EventConfig, EventEngine
from deepseis_ins.fusion_config import FusionConfig
from deepseis_ins.fusion_modes import make_engine
from deepseis_ins.fusion_output import FusionOutput
from deepseis_ins.ground_motion import displacement_utc_ns
from deepseis_ins.ldv_engine import LdvFusionEngine
from deepseis_ins.ldv_fusion import LdvFusionConfig
from deepseis_ins.loose import LooseConfig
from deepseis_ins.motion_engine import MotionEngine, MotionEngineConfig
from deepseis_ins.motion_state import MotionConfig
from deepseis_ins.onset import OnsetConfig
from deepseis_ins.range_config import RangeConfig
from deepseis_ins.tight import TightConfig
from deepseis_ins.tight_engine import TightFusionEngine

Pick = Callable[[type[Any], Mapping[str, Any]], Any]


class InertialChain:
    """IMU, velocimeter, motion state, fusion and events of a graph's description.

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
    samples : iterator of ImuSample, optional
        In place of those in the file.

    Attributes
    ----------
    motion, fusion, events
        The engines, to be looked at.
    """

    def __init__(
        self,
        file: str,
        clock: SampleClock,
        given: Mapping[str, Mapping[str, Any]],
        pick: Pick,
        samples: Iterator[ImuSample] | None = None,
    ) -> None:
        self.clock, known = clock, dict(given.get("fusion", {}))
        if "imu_grade" not in known:
            raise InputError(file, "the inertial half needs parameters", "inertial_parameters")
        rate, grade = float(known["imu_rate_hz"]), grade_named(known["imu_grade"])
        self.samples = open_imu(file, clock).samples() if samples is None else samples
        self.next: ImuSample | None = next(self.samples)
        detector = dict(given.get("motion_state", {}))
        self.motion = MotionEngine(
            pick(MotionEngineConfig, detector),
            pick(MotionConfig, detector),
            grade,
            rate,
            clock.sample_rate_hz,
        )
        self.fusion = make_engine(
            pick(FusionConfig, known),
            grade,
            clock.sample_rate_hz,
            _station(known),
            rate,
            loose=pick(LooseConfig, known),
            tight=pick(TightConfig, known),
            ranges=pick(RangeConfig, known),
            ldv=pick(LdvFusionConfig, known),
        )
        events = given.get("seismic_event", {})
        self.events = EventEngine(
            pick(EventConfig, events),
            pick(OnsetConfig, events),
            "",
            np.array(known["monument_ecef"]),
        )
        if known.get("nav_file"):
            navigation = read_rinex_nav(known["nav_file"])
            for ephemeris in navigation.ephemerides:
                self.fusion.push_ephemeris(ephemeris)
            if isinstance(self.fusion, TightFusionEngine) and navigation.iono_alpha:
                self.fusion.push_klobuchar(navigation.iono_alpha, navigation.iono_beta)
        self._velocities: Iterator[LdvVelocity] = iter(())
        if isinstance(self.fusion, LdvFusionEngine):
            self._velocities = LdvBag(file).measurements()
        self._next_velocity = next(self._velocities, None)

    def push_pvt(self, pvt: Pvt) -> None:
        """Take a position."""
        self.fusion.push_pvt(pvt)

    def push_position(self, topic: str, value: Any) -> None:
        """Take what pvt publishes, if it is a position that the fusion listens to."""
        if topic == "gnss/pvt":
            self.push_pvt(value)
        elif topic == "gnss/precise":
            self.fusion.push_precise(value)
        elif topic == "gnss/rtk":
            self.fusion.push_rtk(value)
        elif topic == "gnss/observations" and isinstance(self.fusion, TightFusionEngine):
            self.fusion.push_observations(value)

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
        yield from self._played(through)
        for valid, states in self.motion.advance(through + 1):
            for state in states:
                self.fusion.push_motion(state)
                yield "motion/state", state, self.clock.utc_ns(state.sample_index)
            self.fusion.motion_valid(valid)
        self.fusion.source_valid(through)
        self.fusion.imu_valid(through + 1)
        while (output := self.fusion.advance()) is not None:
            yield from self._said(output)

    def _played(self, through: int) -> Iterator[tuple[str, Any, int]]:
        """Play the velocimeter through a sample."""
        while self._next_velocity is not None and self._next_velocity.valid_through <= through + 1:
            value, self._next_velocity = self._next_velocity, next(self._velocities, None)
            assert isinstance(self.fusion, LdvFusionEngine)
            self.fusion.push_ldv(value)
            yield "ldv/velocity", value, self.clock.utc_ns(value.sample_index)
        if isinstance(self.fusion, LdvFusionEngine):
            self.fusion.ldv_valid(through)

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
