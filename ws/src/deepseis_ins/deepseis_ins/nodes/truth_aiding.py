"""Node: aiding from the truth, for the test bench only."""

from __future__ import annotations

from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from deepseis_core.config import setting
from deepseis_core.errors import InputError
from deepseis_core.gps_time import GpsTime
from deepseis_core.rinex_nav import read_rinex_nav
from deepseis_core.ros import codecs, diagnostics, qos
from deepseis_core.ros.flow import Flow, FlowConfig
from deepseis_core.ros.main import Process, run
from deepseis_core.ros.parameters import declare, reject_unknown
from deepseis_core.sample_clock import SampleClock, utc_ns_from_iso
from deepseis_ins.truth_aider import TruthAider, TruthAiderConfig
from deepseis_ins.truth_motion import TruthMotion
from deepseis_msgs.msg import DopplerAiding, Watermark


@dataclass(frozen=True)
class NodeConfig:
    """Files and place in time."""

    truth_file: str = setting("", "motion of the antenna (deepseis_ins.truth_motion) [path]")
    position_ecef: list[float] = setting(
        [0.0, 0.0, 0.0], "still antenna, if the file has no motion; zeros: none [m]"
    )
    nav_file: str = setting("", "RINEX navigation file [path]")
    start_utc: str = setting(
        "", "UTC of sample 0, ISO 8601, to some seconds; empty: as the truth file says [-]"
    )
    satellites: list[str] = setting([], "satellites to aid; empty: all [-]")


class TruthAidingNode(Node):
    """In: flow/if_source, flow/pvt. Out: aiding/doppler. Parameters: NodeConfig and aider's."""

    def __init__(self, process: Process) -> None:
        super().__init__("truth_aiding")
        self.flow = Flow(self, process, "truth_aiding", declare(self, FlowConfig))
        self.config, aider = declare(self, NodeConfig), declare(self, TruthAiderConfig)
        reject_unknown(self)
        self.aider = self.make_aider(aider)
        start = self.aider.predictor.start
        self.clock = SampleClock(start.to_utc_ns(), aider.sample_rate_hz)
        self.publisher = self.flow.publish_on("aiding/doppler", DopplerAiding, qos.STREAM)
        self.diagnostics = self.flow.publish_on("/diagnostics", DiagnosticArray, qos.STREAM)
        self.second, self.spans = -1, 0
        self.flow.follow(["if_source"], self.on_source)
        if self.flow.lockstep:
            self.flow.follow(["pvt"], self.on_pvt)

    def make_aider(self, config: TruthAiderConfig) -> TruthAider:
        """Read the files."""
        for name in ("truth_file", "nav_file"):
            if not getattr(self.config, name):
                raise InputError(f"parameter {name} of truth_aiding", "is empty", "name a file")
        position = self.config.position_ecef
        truth = TruthMotion(self.config.truth_file, position if any(position) else None)
        start = truth.start
        if self.config.start_utc:
            start = GpsTime.from_utc_ns(utc_ns_from_iso(self.config.start_utc))
        if start is None:
            raise InputError(truth.path, "does not tell when it starts", "set start_utc")
        ephemerides = read_rinex_nav(self.config.nav_file).ephemerides
        satellites = self.config.satellites or [item.satellite for item in ephemerides]
        return TruthAider(
            config, truth.trajectory, start, ephemerides, satellites, wait_pvt=self.flow.lockstep
        )

    def on_source(self, msg: Watermark) -> None:
        """Take how far the source is."""
        if self.flow.rejoins and self.flow.entry < 0:
            if msg.end_of_stream or not self.flow.admits(msg.valid_through + 1):
                return self.look_for_end()
            self.aider.join(self.flow.entry)
        self.aider.source_valid(msg.valid_through)
        self.work()

    def on_pvt(self, msg: Watermark) -> None:
        """Take how far PVT is complete."""
        self.aider.pvt_valid(msg.valid_through)
        self.work()

    def work(self) -> None:
        """Publish all spans that are due."""
        while (aiding := self.aider.advance()) is not None:
            utc_ns = self.clock.utc_ns(aiding.knot_sample_index)
            self.publisher.publish(codecs.DOPPLER_AIDING.encode(aiding, utc_ns))
            self.spans += 1
            through = self.aider.valid_through
            self.report(aiding.satellites)
            self.flow.send(through, through, utc_ns=self.clock.utc_ns(through))
        self.look_for_end()

    def look_for_end(self) -> None:
        """Finish when the source has."""
        source = self.flow.others.get("if_source")
        if source is None or not source.end_of_stream or self.flow.ended:
            return
        if self.aider.valid_through >= source.valid_through or self.flow.came_too_late:
            self.flow.finish()

    def report(self, satellites: tuple[str, ...]) -> None:
        """Publish the counters, once a second of samples."""
        through = self.aider.valid_through
        second = int(through / self.clock.sample_rate_hz)
        if second <= self.second:
            return
        self.second = second
        level = diagnostics.OK if satellites else diagnostics.WARN
        text = f"aiding {len(satellites)}: {' '.join(satellites)}"
        utc_ns = self.clock.utc_ns(through)
        self.diagnostics.publish(
            diagnostics.encoded("truth_aiding", level, text, {"spans": self.spans}, utc_ns)
        )


def main() -> None:
    """Run the node."""
    run(lambda process: process.add(TruthAidingNode(process)), "truth_aiding")


if __name__ == "__main__":
    main()
