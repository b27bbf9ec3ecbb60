"""Node: tells whether the station is still or moves."""

from __future__ import annotations

from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from sensor_msgs.msg import Imu

from deepseis_core.config import setting
from deepseis_core.counted import CountedInput
from deepseis_core.imu_grades import grade_named
from deepseis_core.imu_message import decode_imu
from deepseis_core.ros import codecs, diagnostics, qos
from deepseis_core.ros.flow import Flow, FlowConfig
from deepseis_core.ros.main import Process, run
from deepseis_core.ros.parameters import declare, reject_unknown
from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import MotionKind
from deepseis_ins.motion_engine import MotionEngine, MotionEngineConfig
from deepseis_ins.motion_state import MotionConfig
from deepseis_ins.rehearsal import rehearse_motion
from deepseis_msgs.msg import MotionState, Watermark


@dataclass(frozen=True)
class NodeConfig:
    """The node's place in the graph."""

    sample_rate_hz: float = setting(4e6, "IF sampling rate [Hz]", low=1e5)
    start_utc_ns: int = setting(0, "UTC of sample 0 [ns since 1970]")
    imu_rate_hz: float = setting(200.0, "IMU samples a second [Hz]", low=10.0, high=2000.0)
    imu_grade: str = setting("span-fsas", "grade of the IMU (deepseis_core.imu_grades) [-]")


class MotionStateNode(Node):
    """In: imu/data_raw. Out: motion/state. Parameters: NodeConfig and the detector's."""

    def __init__(self, process: Process) -> None:
        super().__init__("motion_state")
        self.flow = Flow(self, process, "motion_state", declare(self, FlowConfig))
        self.config, detector = declare(self, NodeConfig), declare(self, MotionConfig)
        engine = declare(self, MotionEngineConfig)
        reject_unknown(self)
        config, grade = self.config, grade_named(self.config.imu_grade)
        rates = config.imu_rate_hz, config.sample_rate_hz
        self.engine = MotionEngine(engine, detector, grade, *rates)
        if not self.flow.lockstep:
            rehearse_motion(engine, detector, grade, *rates)
        self.clock = SampleClock(config.start_utc_ns, config.sample_rate_hz)
        self.publisher = self.flow.publish_on("motion/state", MotionState, qos.LATCHED)
        self.diagnostics = self.flow.publish_on("/diagnostics", DiagnosticArray, qos.STREAM)
        self.imu = CountedInput(counting=not self.flow.rejoins)
        self.said, self.second = 0, -1
        self.create_subscription(Imu, "imu/data_raw", self.on_imu, qos.IMU, raw=True)
        self.flow.follow(["imu_source"], self.on_source)

    def on_imu(self, data: bytes) -> None:
        """Take a sample."""
        sample = decode_imu(data, self.clock)[0]
        if not self.flow.admits(sample.sample_index):
            return
        if self.flow.entry == sample.sample_index:
            self.engine.join(sample.sample_index)
        self.engine.push(sample)
        self.imu.received(sample.sample_index - 1)
        self.work()

    def on_source(self, msg: Watermark) -> None:
        """Take how far the IMU is."""
        self.imu.announced(msg.event_count, msg.valid_through)
        self.work()

    def work(self) -> None:
        """Decide all that can be decided, and say so."""
        if self.flow.rejoins and self.flow.entry < 0:
            return self.look_for_end()
        for through, states in self.engine.advance(self.imu.valid_through + 1):
            for state in states:
                self.said += 1
                utc_ns = self.clock.utc_ns(state.sample_index)
                self.publisher.publish(codecs.MOTION_STATE.encode(state, utc_ns))
            self.report(through)
            utc_ns = self.clock.utc_ns(through)
            self.flow.send(through, through - 1, event_count=self.said, utc_ns=utc_ns)
        self.look_for_end()

    def look_for_end(self) -> None:
        """Finish when the IMU has."""
        source = self.flow.others.get("imu_source")
        if source is None or not source.end_of_stream or self.flow.ended:
            return
        if self.imu.valid_through >= source.valid_through or self.flow.came_too_late:
            self.flow.finish()

    def report(self, through: int) -> None:
        """Publish the counters, once a second of samples."""
        second = int(through / self.clock.sample_rate_hz)
        if second > self.second:
            self.second = second
            state = self.engine.detector.state
            level = diagnostics.WARN if state == MotionKind.MOVING else diagnostics.OK
            values = {"switches": self.engine.switches, "policy": self.engine.policy}
            utc_ns = self.clock.utc_ns(through)
            self.diagnostics.publish(
                diagnostics.encoded("motion_state", level, state.name.lower(), values, utc_ns)
            )


def main() -> None:
    """Run the node."""
    run(lambda process: process.add(MotionStateNode(process)), "motion_state")


if __name__ == "__main__":
    main()
