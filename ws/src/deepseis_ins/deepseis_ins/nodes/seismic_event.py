"""Node: events with their growing peaks, from ground motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from deepseis_core.config import setting
from deepseis_core.counted import CountedInput
from deepseis_core.errors import InputError
from deepseis_core.ros import codecs, diagnostics, qos
from deepseis_core.ros.codecs import subscribe
from deepseis_core.ros.flow import Flow, FlowConfig
from deepseis_core.ros.main import Process, run
from deepseis_core.ros.parameters import declare, plain, reject_unknown
from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import Displacement
from deepseis_ins.event_engine import EventConfig, EventEngine, Report
from deepseis_ins.onset import OnsetConfig
from deepseis_msgs.msg import SeismicEvent, Watermark


@dataclass(frozen=True)
class NodeConfig:
    """The node's place in the graph."""

    sample_rate_hz: float = setting(4e6, "IF sampling rate [Hz]", low=1e5)
    start_utc_ns: int = setting(0, "UTC of sample 0 [ns since 1970]")
    monument_ecef: list[float] = setting([0.0, 0.0, 0.0], "surveyed monument, ECEF [m]")


class SeismicEventNode(Node):
    """In: seismo/displacement; parameter ``hypocentre``, also in mid-run. Out: seismo/event."""

    def __init__(self, process: Process) -> None:
        super().__init__("seismic_event")
        self.flow = Flow(self, process, "seismic_event", declare(self, FlowConfig))
        self.config, events = declare(self, NodeConfig), declare(self, EventConfig)
        onset = declare(self, OnsetConfig)
        reject_unknown(self)
        config = self.config
        self.engine = EventEngine(
            events, onset, self.get_namespace().strip("/"), np.array(config.monument_ecef)
        )
        self.clock = SampleClock(config.start_utc_ns, config.sample_rate_hz)
        self.events = self.flow.publish_on("seismo/event", SeismicEvent, qos.LATCHED)
        self.diagnostics = self.flow.publish_on("/diagnostics", DiagnosticArray, qos.STREAM)
        self.motion = CountedInput(counting=not self.flow.rejoins)
        self.second, self.said = -1, 0
        subscribe(self, codecs.DISPLACEMENT, "seismo/displacement", self.on_motion, qos.STREAM)
        self.flow.follow(["fusion"], self.on_fusion)
        self.add_on_set_parameters_callback(self.on_parameters)

    def on_motion(self, motion: Displacement, _utc_ns: int) -> None:
        """Take ground motion."""
        if not self.flow.admits(motion.valid_through):
            return
        self.publish(self.engine.push(motion))
        self.report(motion.valid_through)
        self.motion.received()
        self.tell()

    def on_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        """Take a hypocentre that was found meanwhile; nothing else can be changed."""
        for given in parameters:
            if given.name != "hypocentre":
                continue
            if self.flow.ended:
                return SetParametersResult(successful=False, reason="the run is over")
            try:
                self.publish(self.engine.locate(plain(given.value)))
            except InputError as error:
                return SetParametersResult(successful=False, reason=str(error))
            self.tell()
        return SetParametersResult(successful=True)

    def publish(self, reports: list[Report]) -> None:
        """Publish reports."""
        for report in reports:
            self.said += 1
            self.events.publish(codecs.SEISMIC_EVENT.encode(report.event, report.utc_ns))

    def report(self, through: int) -> None:
        """Publish the counters with the first ground motion of a second of samples."""
        second = int(through / self.clock.sample_rate_hz)
        if second == self.second:
            return
        self.second = second
        text = "event" if self.engine.event is not None else "quiet"
        counts = {"events": self.engine.events, "reports": self.said}
        utc_ns = self.clock.utc_ns(through)
        self.diagnostics.publish(
            diagnostics.encoded("seismic_event", diagnostics.OK, text, counts, utc_ns)
        )

    def on_fusion(self, msg: Watermark) -> None:
        """Take how far the ground motion is."""
        self.motion.announced(msg.event_count, msg.valid_through)
        self.tell()

    def tell(self) -> None:
        """Say how far everything is."""
        through = self.motion.valid_through
        if through >= 0:
            utc_ns = self.clock.utc_ns(through)
            self.flow.send(through, through, event_count=self.said, utc_ns=utc_ns)
        fusion = self.flow.others.get("fusion")
        if fusion is None or not fusion.end_of_stream or self.flow.ended:
            return
        if 0 <= fusion.valid_through <= through or self.flow.came_too_late:
            self.flow.finish()


def main() -> None:
    """Run the node."""
    run(lambda process: process.add(SeismicEventNode(process)), "seismic_event")


if __name__ == "__main__":
    main()
