"""Node: plays an IMU beside the IF samples, and says how it stands at its station."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
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
from deepseis_frontend.imu_file import ImuFile
from deepseis_frontend.imu_open import open_imu
from deepseis_frontend.nodes.station_bag import read_station
from deepseis_msgs.msg import Station, Watermark


@dataclass(frozen=True)
class SourceConfig:
    """What to play."""

    file: str = setting("", "folder or file of a bag with IF and IMU samples [path]")
    imu_file: str = setting(
        "", "a bag, or text of columns, with the IMU; empty: it is in `file` [path]"
    )
    sample_rate_hz: float = setting(4e6, "with imu_file: IF sampling rate [Hz]", low=1e5)
    start_utc_ns: int = setting(0, "with imu_file: UTC of sample 0 [ns since 1970]")
    imu_grade: str = setting("", "with imu_file: grade of the IMU [-]")
    monument_ecef: list[float] = setting([0.0, 0.0, 0.0], "with imu_file: monument, ECEF [m]")
    antenna_lever_arm: list[float] = setting(
        [0.0, 0.0, 0.0], "with imu_file: from the monument to the antenna, east, north, up [m]"
    )
    imu_to_antenna: list[float] = setting(
        [0.0, 0.0, 0.0], "with imu_file: lever arm, forward, left, up [m]"
    )
    imu_orientation_xyzw: list[float] = setting(
        [0.0, 0.0, 0.0, 0.0], "with imu_file: surveyed attitude, FLU to ENU [-]"
    )


class ImuSourceNode(Node):
    """In: flow/if_source. Out: imu/data_raw, station. Parameters: SourceConfig.

    A sample follows the IF samples of its interval, so it never runs ahead of the signal.
    """

    def __init__(self, process: Process) -> None:
        super().__init__("imu_source")
        self.flow = Flow(self, process, "imu_source", declare(self, FlowConfig))
        self.config = declare(self, SourceConfig)
        reject_unknown(self)
        self.clock = self.clock_of_signal()
        self.source = open_imu(self.config.imu_file or self.config.file, self.clock)
        self.timing = self.source.timing() if isinstance(self.source, ImuFile) else {}
        self.samples: Iterator[ImuSample] = self.source.samples()
        self.next: ImuSample | None = next(self.samples)
        self.publisher = self.flow.publish_on("imu/data_raw", Imu, qos.IMU)
        self.station = self.flow.publish_on("station", Station, qos.LATCHED)
        self.diagnostics = self.flow.publish_on("/diagnostics", DiagnosticArray, qos.STREAM)
        self.sent, self.second = 0, -1
        self.about = self.station_value()
        self.flow.when_ready(self.introduce)
        self.flow.follow(["if_source"], self.on_source)

    def clock_of_signal(self) -> SampleClock:
        """Return the clock of the IF samples."""
        if self.config.imu_file:
            return SampleClock(self.config.start_utc_ns, self.config.sample_rate_hz)
        signal = IfBag(self.config.file)
        return SampleClock(signal.start_utc_ns or 0, signal.sample_rate_hz)

    def station_value(self) -> tuple[StationValue, int] | None:
        """Return how the IMU stands, as the parameters or the bag have it, and since when."""
        config = self.config
        if not config.imu_file:
            return read_station(config.file)
        value = StationValue(
            name=self.get_namespace().strip("/"),
            network="",
            monument_ecef=np.array(config.monument_ecef),
            antenna_lever_arm=np.array(config.antenna_lever_arm),
            imu_to_antenna=np.array(config.imu_to_antenna),
            imu_orientation_xyzw=np.array(config.imu_orientation_xyzw),
            imu=config.imu_grade,
        )
        return value, config.start_utc_ns

    def introduce(self) -> None:
        """Say what the station is, once."""
        if self.about is not None:
            self.station.publish(codecs.STATION.encode(*self.about))

    def on_source(self, msg: Watermark) -> None:
        """Play what belongs to the signal so far."""
        through = msg.valid_through
        if not self.flow.ready or not self.is_present(through):
            return
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

    def is_present(self, through: int) -> bool:
        """Where the graph ran already, leave aside what is past; tell whether the present is."""
        if self.flow.rejoins and self.flow.entry < 0 and self.flow.admits(through + 1):
            self.samples = self.source.samples(through + 2)
            self.next = next(self.samples, None)
        return self.flow.admits(through + 1)

    def report(self, sample_index: int) -> None:
        """Publish the counters before the first sample of every second."""
        second = int(sample_index / self.clock.sample_rate_hz)
        if second > self.second:
            self.second = second
            text = f"playing at {self.source.rate_hz:g} Hz"
            utc_ns = self.clock.utc_ns(sample_index)
            self.diagnostics.publish(
                diagnostics.encoded(
                    "imu_source",
                    diagnostics.OK,
                    text,
                    {"samples": self.sent, **self.timing},
                    utc_ns,
                )
            )


def main() -> None:
    """Run the node."""
    run(lambda process: process.add(ImuSourceNode(process)), "imu_source")


if __name__ == "__main__":
    main()
