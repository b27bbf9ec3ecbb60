"""Node: fuses IMU and GNSS, and tells the tracking loops the Doppler of the motion."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import Imu

from deepseis_core.config import setting
from deepseis_core.counted import CountedInput, CountedTopics
from deepseis_core.deadline import Deadline
from deepseis_core.imu_grades import grade_named
from deepseis_core.imu_message import decode_imu
from deepseis_core.latency import Arrivals
from deepseis_core.rinex_nav import read_rinex_nav
from deepseis_core.ros import codecs, diagnostics, qos
from deepseis_core.ros.cdr import encode_message
from deepseis_core.ros.codecs import subscribe
from deepseis_core.ros.flow import Flow, FlowConfig
from deepseis_core.ros.main import Process, run
from deepseis_core.ros.odometry import odometry_from_solution
from deepseis_core.ros.parameters import declare, reject_unknown
from deepseis_core.ros.realtime import RealtimeReport
from deepseis_core.ros.steady import every
from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import (
    Ephemeris,
    LdvVelocity,
    MotionState,
    Observations,
    PrecisePosition,
    Pvt,
    Station,
)
from deepseis_ins.fusion_config import FusionConfig
from deepseis_ins.fusion_modes import make_engine
from deepseis_ins.fusion_output import FusionOutput, FusionStatus
from deepseis_ins.ground_motion import displacement_utc_ns
from deepseis_ins.ldv_engine import LdvFusionEngine
from deepseis_ins.ldv_fusion import LdvFusionConfig
from deepseis_ins.loose import LooseConfig
from deepseis_ins.range_config import RangeConfig
from deepseis_ins.rehearsal import rehearse_fusion
from deepseis_ins.tight import TightConfig
from deepseis_ins.tight_engine import TightFusionEngine
from deepseis_msgs.msg import Displacement, DopplerAiding, InsSolution, Watermark

FOLLOWED = ("if_source", "imu_source", "motion_state")
LEVELS = {FusionStatus.RUNNING: diagnostics.OK, FusionStatus.IMU_LOST: diagnostics.ERROR}


@dataclass(frozen=True)
class NodeConfig:
    """The node's place in the graph, and the station."""

    satellites: list[str] = setting([], "satellites to aid; empty: all [-]")
    sample_rate_hz: float = setting(4e6, "IF sampling rate [Hz]", low=1e5)
    start_utc_ns: int = setting(0, "UTC of sample 0 [ns since 1970]")
    imu_rate_hz: float = setting(200.0, "IMU samples a second [Hz]", low=10.0, high=2000.0)
    imu_grade: str = setting("span-fsas", "grade of the IMU (deepseis_core.imu_grades) [-]")
    monument_ecef: list[float] = setting([0.0, 0.0, 0.0], "surveyed monument, ECEF [m]")
    antenna_lever_arm: list[float] = setting(
        [0.0, 0.0, 0.0], "from the monument to the antenna, east, north, up [m]"
    )
    imu_to_antenna: list[float] = setting([0.0, 0.0, 0.0], "lever arm, forward, left, up [m]")
    imu_orientation_xyzw: list[float] = setting(
        [0.0, 0.0, 0.0, 1.0], "surveyed attitude, FLU to ENU; zeros: level it [-]"
    )
    nav_file: str = setting("", "RINEX navigation file: orbits before they are decoded [path]")
    wait_rtk: bool = setting(False, "pvt publishes positions against a base: wait for them too")
    fusion_deadline_ms: float = setting(30.0, "realtime: wait so long for inputs [ms]", low=0)


class FusionNode(Node):
    """In: imu/data_raw, motion/state, gnss/pvt, gnss/precise, gnss/rtk, gnss/ephemeris.

    Coupling tight: gnss/observations too; coupling ldv: ldv/velocity.

    Out: aiding/doppler, ins/solution, ins/odometry, seismo/displacement.
    """

    def __init__(self, process: Process) -> None:
        super().__init__("fusion")
        self.flow = Flow(self, process, "fusion", declare(self, FlowConfig))
        self.config = declare(self, NodeConfig)
        fusion, loose = declare(self, FusionConfig), declare(self, LooseConfig)
        tight, ranges = declare(self, TightConfig), declare(self, RangeConfig)
        ldv = declare(self, LdvFusionConfig)
        reject_unknown(self)
        config = self.config
        rate_hz, imu_rate_hz = config.sample_rate_hz, config.imu_rate_hz
        settings: dict[str, Any] = {"loose": loose, "tight": tight, "ranges": ranges, "ldv": ldv}
        grade = grade_named(config.imu_grade)
        self.engine = make_engine(
            fusion,
            grade,
            rate_hz,
            self.station(),
            imu_rate_hz,
            script=self.flow.script,
            **settings,
        )
        if not self.flow.lockstep:
            rehearse_fusion(fusion, grade, rate_hz, imu_rate_hz, **settings)
        self.load_navigation()
        self.clock = SampleClock(config.start_utc_ns, config.sample_rate_hz)
        counting = not self.flow.rejoins
        followed = FOLLOWED + ("ldv_source",) * isinstance(self.engine, LdvFusionEngine)
        self.inputs = {name: CountedInput(counting=counting) for name in followed}
        topics = ["positions", "orbits", "precise", *["rtk"] * config.wait_rtk]
        topics += ["ranges"] * isinstance(self.engine, TightFusionEngine)
        self.gnss = CountedTopics(topics, counting=counting)
        self.motions = 0
        self.second = -1
        self.deadline = Deadline(1e-3 * config.fusion_deadline_ms)
        self.arrivals = Arrivals()
        self.advertise()
        self.listen()

    def advertise(self) -> None:
        """Create the publishers."""
        publish_on = self.flow.publish_on
        self.aiding = publish_on("aiding/doppler", DopplerAiding, qos.STREAM)
        self.solution = publish_on("ins/solution", InsSolution, qos.STREAM)
        self.odometry = publish_on("ins/odometry", Odometry, qos.STREAM)
        self.motion = publish_on("seismo/displacement", Displacement, qos.STREAM)
        self.diagnostics = publish_on("/diagnostics", DiagnosticArray, qos.STREAM)

    def listen(self) -> None:
        """Subscribe to the inputs and to how far others are."""
        self.create_subscription(Imu, "imu/data_raw", self.on_imu, qos.IMU, raw=True)
        subscribe(self, codecs.MOTION_STATE, "motion/state", self.on_motion, qos.LATCHED)
        subscribe(self, codecs.PVT, "gnss/pvt", self.on_pvt, qos.STREAM)
        subscribe(self, codecs.PRECISE_POSITION, "gnss/precise", self.on_precise, qos.STREAM)
        if self.config.wait_rtk:
            subscribe(self, codecs.PRECISE_POSITION, "gnss/rtk", self.on_rtk, qos.STREAM)
        subscribe(self, codecs.EPHEMERIS, "gnss/ephemeris", self.on_ephemeris, qos.LATCHED)
        if isinstance(self.engine, TightFusionEngine):
            observed = codecs.OBSERVATIONS, "gnss/observations", self.on_observations
            subscribe(self, *observed, qos.STREAM)
        if isinstance(self.engine, LdvFusionEngine):
            subscribe(self, codecs.LDV_VELOCITY, "ldv/velocity", self.on_ldv, qos.STREAM)
        self.flow.follow(self.inputs, self.on_watermark)
        self.flow.follow(["pvt"], self.on_pvt_watermark)
        self.realtime: RealtimeReport | None = None
        if not self.flow.lockstep:
            meters = {"imu_to_aiding": "from IMU sample to aiding"}
            deadline_ms = self.config.fusion_deadline_ms
            self.realtime = RealtimeReport(self, "fusion", meters, deadline_ms)
            every(self, 0.005, self.on_deadline)

    def station(self) -> Station:
        """Return the station as the parameters have it."""
        config = self.config
        return Station(
            name=self.get_namespace().strip("/"),
            network="",
            monument_ecef=np.array(config.monument_ecef),
            antenna_lever_arm=np.array(config.antenna_lever_arm),
            imu_to_antenna=np.array(config.imu_to_antenna),
            imu_orientation_xyzw=np.array(config.imu_orientation_xyzw),
            imu=config.imu_grade,
        )

    def load_navigation(self) -> None:
        """Preload orbits."""
        if not self.config.nav_file:
            return
        file = read_rinex_nav(self.config.nav_file)
        for ephemeris in file.ephemerides:
            self.engine.push_ephemeris(ephemeris)
        if isinstance(self.engine, TightFusionEngine) and file.iono_alpha:
            self.engine.push_klobuchar(file.iono_alpha, file.iono_beta)

    def on_imu(self, data: bytes) -> None:
        """Take an IMU sample."""
        sample = decode_imu(data, self.clock)[0]
        self.arrivals.note(sample.sample_index, time.monotonic())
        self.engine.push_imu(sample)
        self.inputs["imu_source"].received(sample.sample_index - 1)
        self.work()

    def on_motion(self, state: MotionState, _utc_ns: int) -> None:
        """Take a decision on motion."""
        self.engine.push_motion(state)
        self.inputs["motion_state"].received()
        self.work()

    def on_pvt(self, pvt: Pvt, _utc_ns: int) -> None:
        """Take a position."""
        self.engine.push_pvt(pvt)
        self.gnss.received("positions", pvt.sample_index)
        self.work()

    def on_precise(self, position: PrecisePosition, _utc_ns: int) -> None:
        """Take a precise position."""
        self.engine.push_precise(position)
        self.gnss.received("precise", position.sample_index)
        self.work()

    def on_rtk(self, position: PrecisePosition, _utc_ns: int) -> None:
        """Take a position against a base."""
        self.engine.push_rtk(position)
        self.gnss.received("rtk", position.sample_index)
        self.work()

    def on_observations(self, observations: Observations, _utc_ns: int) -> None:
        """Take an epoch of ranges."""
        assert isinstance(self.engine, TightFusionEngine)
        self.engine.push_observations(observations)
        self.gnss.received("ranges", observations.sample_index)
        self.work()

    def on_ldv(self, value: LdvVelocity, _utc_ns: int) -> None:
        """Take a measurement of the velocimeter."""
        assert isinstance(self.engine, LdvFusionEngine)
        self.engine.push_ldv(value)
        self.inputs["ldv_source"].received()
        self.work()

    def on_ephemeris(self, ephemeris: Ephemeris, _utc_ns: int) -> None:
        """Take an orbit."""
        self.engine.push_ephemeris(ephemeris)
        self.gnss.received("orbits")
        self.work()

    def on_watermark(self, msg: Watermark) -> None:
        """Take how far another node is."""
        waits = self.flow.rejoins and self.flow.entry < 0 and not msg.end_of_stream
        if waits and msg.node == "if_source" and self.flow.admits(msg.valid_through + 1):
            self.engine.join(self.flow.entry)
        count = 0 if msg.node == "if_source" else msg.event_count
        if msg.node == "if_source" and self.realtime is not None:
            self.deadline.arrived(msg.valid_through)
        self.inputs[msg.node].announced(count, msg.valid_through)
        self.work()

    def on_pvt_watermark(self, msg: Watermark) -> None:
        """Take how far positions are, and what belongs to them."""
        counts = {
            "positions": msg.event_count,
            "orbits": msg.ephemeris_count,
            "precise": msg.precise_count,
            "rtk": msg.precise_count,
            "ranges": msg.observation_count,
        }
        self.gnss.announced(counts, msg.valid_through)
        self.work()

    def on_deadline(self) -> None:
        """Realtime: do not wait longer for what is late."""
        self.deadline.look()
        self.work()

    def is_overdue(self) -> bool:
        """Whether the next span is not to be waited for."""
        return self.engine.next_sample + self.engine.block - 1 <= self.deadline.overdue_through

    def work(self) -> None:
        """Publish all spans that are due."""
        engine, inputs = self.engine, self.inputs
        if self.flow.rejoins and self.flow.entry < 0:
            return self.look_for_end()
        engine.source_valid(inputs["if_source"].valid_through)
        engine.imu_valid(inputs["imu_source"].valid_through + 1)
        engine.motion_valid(inputs["motion_state"].valid_through)
        if isinstance(engine, LdvFusionEngine):
            engine.ldv_valid(inputs["ldv_source"].valid_through)
        engine.pvt_valid(self.gnss.valid_through)
        while (output := engine.advance(self.is_overdue())) is not None:
            self.publish(output)
        self.look_for_end()

    def look_for_end(self) -> None:
        """Finish when the source has."""
        source = self.flow.others.get("if_source")
        if source is None or not source.end_of_stream or self.flow.ended:
            return
        if self.engine.valid_through >= source.valid_through or self.flow.came_too_late:
            if self.realtime is not None:
                self.realtime.finish(self.clock.utc_ns(self.engine.valid_through))
            self.flow.finish()

    def publish(self, output: FusionOutput) -> None:
        """Publish a span."""
        through = self.engine.valid_through
        first = self.clock.utc_ns(output.aiding.knot_sample_index)
        self.aiding.publish(codecs.DOPPLER_AIDING.encode(output.aiding, first))
        self.note(through + 1)
        solution = output.solution
        if len(solution.sample_index):
            utc_ns = self.clock.utc_ns(int(solution.sample_index[0]))
            self.solution.publish(codecs.INS_SOLUTION.encode(solution, utc_ns, "map"))
            utc_ns = self.clock.utc_ns(int(solution.sample_index[-1]))
            self.odometry.publish(encode_message(odometry_from_solution(solution, utc_ns)))
        for motion in output.motion:
            self.motions += 1
            utc_ns = displacement_utc_ns(motion)
            self.motion.publish(codecs.DISPLACEMENT.encode(motion, utc_ns, "map"))
        self.report(output, through)
        utc_ns = self.clock.utc_ns(through)
        self.flow.send(through, through, event_count=self.motions, utc_ns=utc_ns)

    def note(self, end: int) -> None:
        """Real time: note what a span lacked, and how long ago its last IMU sample came."""
        if self.realtime is None:
            return
        block = self.engine.block
        for what, through in self.engine.missed.items():
            self.realtime.misses.note(what, end - block, block, through)
        came = self.arrivals.of(end)
        if came is not None:
            self.realtime.meters["imu_to_aiding"].add(time.monotonic() - came)

    def report(self, output: FusionOutput, through: int) -> None:
        """Publish the counters, once a second of samples and when the status changes."""
        second = int(through / self.clock.sample_rate_hz)
        if second > self.second:
            self.second = second
            level = LEVELS.get(output.status, diagnostics.WARN)
            values: dict[str, object] = dict(self.engine.statistics)
            if self.engine.oscillator is not None:
                values |= self.engine.oscillator.report()
            if isinstance(self.engine, LdvFusionEngine):
                values |= self.engine.report()
            utc_ns = self.clock.utc_ns(through)
            self.diagnostics.publish(
                diagnostics.encoded("fusion", level, str(output.status), values, utc_ns)
            )
            if self.realtime is not None:
                self.realtime.publish(utc_ns)


def main() -> None:
    """Run the node."""
    run(lambda process: process.add(FusionNode(process)), "fusion")


if __name__ == "__main__":
    main()
