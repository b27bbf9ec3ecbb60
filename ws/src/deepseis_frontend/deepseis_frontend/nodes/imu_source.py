"""Node: plays the IMU of a bag, and what the bag says of the station, beside its IF samples."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from sensor_msgs.msg import Imu

from deepseis_core.config import setting
from deepseis_core.imu_message import encode_imu
from deepseis_core.ros import codecs, diagnostics, qos
from deepseis_core.ros.flow import Flow, FlowConfig
from deepseis_core.ros.main import Process, run
from deepseis_core.ros.parameters import declare, reject_unknown
from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import ImuSample
from deepseis_core.types import Station as StationValue
from deepseis_frontend.if_bag import IfBag
from deepseis_frontend.imu_bag import ImuBag
from deepseis_frontend.nodes.station_bag import read_station
from deepseis_msgs.msg import Station, Watermark


@dataclass(frozen=True)
class SourceConfig:
    """What to play."""

    file: str = setting("", "folder or file of a bag with IF and IMU samples [path]")


class ImuSourceNode(Node):
    """In: flow/if_source. Out: imu/data_raw, station. Parameters: SourceConfig.

    A sample follows the IF samples of its interval, so it never runs ahead of the signal.
    """

    def __init__(self, process: Process) -> None:
        super().__init__("imu_source")
        self.flow = Flow(self, process, "imu_source", declare(self, FlowConfig))
        self.config = declare(self, SourceConfig)
        reject_unknown(self)
        signal = IfBag(self.config.file)
        self.clock = SampleClock(signal.start_utc_ns or 0, signal.sample_rate_hz)
        self.source = ImuBag(self.config.file, self.clock)
        self.samples: Iterator[ImuSample] = self.source.samples()
        self.next: ImuSample | None = next(self.samples)
        self.publisher = self.flow.publish_on("imu/data_raw", Imu, qos.STREAM)
        self.station = self.flow.publish_on("station", Station, qos.LATCHED)
        self.diagnostics = self.flow.publish_on("/diagnostics", DiagnosticArray, qos.STREAM)
        self.sent, self.second = 0, -1
        self.about: tuple[StationValue, int] | None = read_station(self.config.file)
        self.flow.when_ready(self.introduce)
        self.flow.follow(["if_source"], self.on_source)

    def introduce(self) -> None:
        """Say what the station is, once."""
        if self.about is not None:
            self.station.publish(codecs.STATION.encode(*self.about))

    def on_source(self, msg: Watermark) -> None:
        """Play what belongs to the signal so far."""
        through = msg.valid_through
        while self.next is not None and self.next.sample_index <= through + 1:
            self.report(self.next.sample_index)
            utc_ns = self.clock.utc_ns(self.next.sample_index)
            self.publisher.publish(encode_imu(self.next, utc_ns))
            self.sent += 1
            self.next = next(self.samples, None)
        if through >= 0:
            utc_ns = self.clock.utc_ns(through)
            self.flow.send(through, through, event_count=self.sent, utc_ns=utc_ns)
        if msg.end_of_stream and not self.flow.ended:
            self.flow.finish()

    def report(self, sample_index: int) -> None:
        """Publish the counters before the first sample of every second."""
        second = int(sample_index / self.clock.sample_rate_hz)
        if second > self.second:
            self.second = second
            text = f"playing at {self.source.rate_hz:g} Hz"
            utc_ns = self.clock.utc_ns(sample_index)
            self.diagnostics.publish(
                diagnostics.encoded(
                    "imu_source", diagnostics.OK, text, {"samples": self.sent}, utc_ns
                )
            )


def main() -> None:
    """Run the node."""
    run(lambda process: process.add(ImuSourceNode(process)), "imu_source")


if __name__ == "__main__":
    main()
