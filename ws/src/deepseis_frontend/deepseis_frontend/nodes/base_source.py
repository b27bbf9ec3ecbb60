"""Node: plays the base station of a bag beside its IF samples."""

from __future__ import annotations

from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from deepseis_core.config import setting
from deepseis_core.gps_time import GpsTime
from deepseis_core.ros import codecs, diagnostics, qos
from deepseis_core.ros.flow import Flow, FlowConfig
from deepseis_core.ros.main import Process, run
from deepseis_core.ros.parameters import declare, reject_unknown
from deepseis_core.sample_clock import SampleClock
from deepseis_frontend.if_bag import IfBag
from deepseis_frontend.nodes.base_bag import BaseBag
from deepseis_msgs.msg import Observations, Watermark


@dataclass(frozen=True)
class SourceConfig:
    """What to play."""

    file: str = setting("", "folder or file of a bag with IF samples and a base [path]")


class BaseSourceNode(Node):
    """In: flow/if_source. Out: base/observations. Parameters: SourceConfig.

    An epoch follows the IF samples of its time, so it never runs ahead of the signal; that there
    is none is said by the watermark, and nobody waits for a base that is silent.
    """

    def __init__(self, process: Process) -> None:
        super().__init__("base_source")
        self.flow = Flow(self, process, "base_source", declare(self, FlowConfig))
        config = declare(self, SourceConfig)
        reject_unknown(self)
        signal = IfBag(config.file)
        self.clock = SampleClock(signal.start_utc_ns or 0, signal.sample_rate_hz)
        self.epochs = BaseBag(config.file).epochs()
        self.next = next(self.epochs, None)
        self.publisher = self.flow.publish_on("base/observations", Observations, qos.STREAM)
        self.diagnostics = self.flow.publish_on("/diagnostics", DiagnosticArray, qos.STREAM)
        self.sent, self.second = 0, -1
        self.flow.follow(["if_source"], self.on_source)

    def on_source(self, msg: Watermark) -> None:
        """Play what belongs to the signal so far."""
        through = msg.valid_through
        while self.next is not None and self.next.sample_index <= through:
            self.report(self.next.sample_index)
            utc_ns = GpsTime(self.next.week, self.next.tow_ns).to_utc_ns()
            self.publisher.publish(codecs.OBSERVATIONS.encode(self.next, utc_ns))
            self.sent += 1
            self.next = next(self.epochs, None)
        if through >= 0:
            utc_ns = self.clock.utc_ns(through)
            self.flow.send(through, through, event_count=self.sent, utc_ns=utc_ns)
        if msg.end_of_stream and not self.flow.ended:
            self.flow.finish()

    def report(self, sample_index: int) -> None:
        """Publish the counters before the first epoch of every second."""
        second = int(sample_index / self.clock.sample_rate_hz)
        if second > self.second:
            self.second = second
            utc_ns = self.clock.utc_ns(sample_index)
            self.diagnostics.publish(
                diagnostics.encoded(
                    "base_source", diagnostics.OK, "playing", {"epochs": self.sent}, utc_ns
                )
            )


def main() -> None:
    """Run the node."""
    run(lambda process: process.add(BaseSourceNode(process)), "base_source")


if __name__ == "__main__":
    main()
