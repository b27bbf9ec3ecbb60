"""Node: plays the velocimeter of a bag beside its IF samples."""

from __future__ import annotations

from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from deepseis_core.config import setting
from deepseis_core.ros import codecs, diagnostics, qos
from deepseis_core.ros.flow import Flow, FlowConfig
from deepseis_core.ros.main import Process, run
from deepseis_core.ros.parameters import declare, reject_unknown
from deepseis_core.sample_clock import SampleClock
from deepseis_frontend.if_bag import IfBag
from deepseis_frontend.ldv_bag import LdvBag
from deepseis_msgs.msg import LdvVelocity, Watermark


@dataclass(frozen=True)
class SourceConfig:
    """What to play."""

    file: str = setting("", "folder or file of a bag with IF samples and a velocimeter [path]")


class LdvSourceNode(Node):
    """In: flow/if_source. Out: ldv/velocity. Parameters: SourceConfig.

    A measurement follows the IF samples of its interval, so it never runs ahead of the signal.
    """

    def __init__(self, process: Process) -> None:
        super().__init__("ldv_source")
        self.flow = Flow(self, process, "ldv_source", declare(self, FlowConfig))
        config = declare(self, SourceConfig)
        reject_unknown(self)
        signal = IfBag(config.file)
        self.clock = SampleClock(signal.start_utc_ns or 0, signal.sample_rate_hz)
        self.measurements = LdvBag(config.file).measurements()
        self.next = next(self.measurements, None)
        self.publisher = self.flow.publish_on("ldv/velocity", LdvVelocity, qos.STREAM)
        self.diagnostics = self.flow.publish_on("/diagnostics", DiagnosticArray, qos.STREAM)
        self.sent, self.second = 0, -1
        self.flow.follow(["if_source"], self.on_source)

    def on_source(self, msg: Watermark) -> None:
        """Play what belongs to the signal so far."""
        through = msg.valid_through
        while self.next is not None and self.next.valid_through <= through + 1:
            self.report(self.next.sample_index)
            utc_ns = self.clock.utc_ns(self.next.sample_index)
            self.publisher.publish(codecs.LDV_VELOCITY.encode(self.next, utc_ns))
            self.sent += 1
            self.next = next(self.measurements, None)
        if through >= 0:
            utc_ns = self.clock.utc_ns(through)
            self.flow.send(through, through, event_count=self.sent, utc_ns=utc_ns)
        if msg.end_of_stream and not self.flow.ended:
            self.flow.finish()

    def report(self, sample_index: int) -> None:
        """Publish the counters before the first measurement of every second."""
        second = int(sample_index / self.clock.sample_rate_hz)
        if second > self.second:
            self.second = second
            utc_ns = self.clock.utc_ns(sample_index)
            self.diagnostics.publish(
                diagnostics.encoded(
                    "ldv_source", diagnostics.OK, "playing", {"measurements": self.sent}, utc_ns
                )
            )


def main() -> None:
    """Run the node."""
    run(lambda process: process.add(LdvSourceNode(process)), "ldv_source")


if __name__ == "__main__":
    main()
