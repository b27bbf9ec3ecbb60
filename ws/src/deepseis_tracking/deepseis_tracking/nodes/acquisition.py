"""Node: searches for satellites that nobody tracks."""

from __future__ import annotations

from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from deepseis_core.config import setting
from deepseis_core.deadline import Deadline
from deepseis_core.ros import codecs, diagnostics, qos
from deepseis_core.ros.codecs import subscribe
from deepseis_core.ros.flow import Flow, FlowConfig
from deepseis_core.ros.main import Process, run
from deepseis_core.ros.parameters import declare, reject_unknown
from deepseis_core.ros.realtime import RealtimeReport
from deepseis_core.ros.steady import every
from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import AcquisitionResult as AcquisitionResultValue
from deepseis_core.types import IfBlock
from deepseis_msgs.msg import AcquisitionRequest, AcquisitionResult, Watermark
from deepseis_tracking.acquisition import AcquisitionConfig
from deepseis_tracking.acquisition_engine import AcquisitionEngine, RetryConfig
from deepseis_tracking.acquisition_windows import Forecast, WarmStart
from deepseis_tracking.engine import SlotConfig, check_satellites
from deepseis_tracking.rehearsal import rehearse_search


@dataclass(frozen=True)
class PeersConfig:
    """Whose requests to wait for."""

    trackers: list[str] = setting([], "flow members that make requests [-]")
    tracker_deadline_ms: float = setting(150.0, "realtime: wait so long for a tracker [ms]", low=0)


class AcquisitionNode(Node):
    """In: if/samples, acquisition/request. Out: acquisition/result."""

    def __init__(self, process: Process) -> None:
        super().__init__("acquisition")
        self.flow = Flow(self, process, "acquisition", declare(self, FlowConfig))
        slots, search = declare(self, SlotConfig), declare(self, AcquisitionConfig)
        retry, self.peers = declare(self, RetryConfig), declare(self, PeersConfig)
        forecast = Forecast(declare(self, WarmStart))
        reject_unknown(self)
        self.engine = AcquisitionEngine(
            check_satellites(slots.satellites), search, slots, retry, forecast, self.flow.script
        )
        if not self.flow.lockstep:
            rehearse_search(search)
        self.engine.expect_trackers(self.peers.trackers, counting=not self.flow.rejoins)
        self.publisher = self.flow.publish_on("acquisition/result", AcquisitionResult, qos.LATCHED)
        self.diagnostics = self.flow.publish_on("/diagnostics", DiagnosticArray, qos.STREAM)
        self.clock: SampleClock | None = None
        self.second, self.announced = -1, -1
        self.deadline = Deadline(1e-3 * self.peers.tracker_deadline_ms)
        self.realtime = None if self.flow.lockstep else RealtimeReport(self, "acquisition")
        self.flow.follow(self.peers.trackers, self.on_tracker)
        self.flow.follow(["if_source"], lambda _msg: self.work())
        subscribe(self, codecs.IF_BLOCK, "if/samples", self.on_if_block, qos.STREAM)
        self.create_subscription(
            AcquisitionRequest, "acquisition/request", self.on_request, qos.LATCHED
        )
        if not self.flow.lockstep:
            every(self, 0.02, self.on_deadline)

    def on_if_block(self, block: IfBlock, utc_ns: int) -> None:
        """Queue the block."""
        if not self.flow.admits(block.sample_index):
            return
        if self.clock is None:
            rate = block.sample_rate_hz
            self.clock = SampleClock.from_sample(block.sample_index, utc_ns, rate)
            self.engine.clock = self.clock
        self.deadline.arrived(block.sample_index + block.sample_count - 1)
        self.engine.push_block(block)
        self.work()

    def on_request(self, msg: AcquisitionRequest) -> None:
        """Queue the request of a channel that lost its signal."""
        self.engine.push_request(msg.satellite, msg.sample_index, self.tracker_of(msg.satellite))
        self.work()

    def tracker_of(self, satellite: str) -> str:
        """Name the flow member that runs a satellite's channel: its own process, or the host."""
        own = f"trackers_{satellite.lower()}"
        return own if own in self.engine.trackers else next(iter(self.engine.trackers), "")

    def on_tracker(self, msg: Watermark) -> None:
        """Take a tracker process' watermark."""
        self.engine.tracker_valid(msg.node, msg.valid_through, msg.event_count)
        self.work()

    def on_deadline(self) -> None:
        """Realtime: do not wait longer for a tracker, which may have died."""
        overdue = self.deadline.look()
        self.work()
        while self.engine.next_through() <= overdue:
            self.work(force=True)

    def step(self, *, force: bool) -> list[AcquisitionResultValue] | None:
        """Work through one block; in real time note what was not waited for."""
        block = self.engine.blocks[0] if self.engine.blocks else None
        results = self.engine.advance(force=force)
        if results is not None and block is not None and self.realtime is not None:
            for name, through in self.engine.missed.items():
                self.realtime.misses.note(name, block.sample_index, block.sample_count, through)
        return results

    def work(self, *, force: bool = False) -> None:
        """Work through all that the watermarks allow and publish."""
        engine, clock = self.engine, self.clock
        while (results := self.step(force=force)) is not None and clock is not None:
            force = False
            for result in results:
                stamp = clock.utc_ns(result.sample_index)
                self.publisher.publish(codecs.ACQUISITION_RESULT.encode(result, stamp))
            utc_ns = clock.utc_ns(engine.consumed_through)
            second = int(engine.consumed_through / clock.sample_rate_hz)
            if second > self.second:
                self.second = second
                self.report(utc_ns)
            self.flow.send(
                engine.valid_through,
                engine.consumed_through,
                event_count=engine.result_count,
                utc_ns=utc_ns,
            )
            if engine.valid_through > self.announced:
                self.announced = engine.valid_through
                self.flow.flush()
        source = self.flow.others.get("if_source")
        if source is None or not source.end_of_stream or self.flow.ended:
            return
        if engine.consumed_through >= source.valid_through or self.flow.came_too_late:
            if self.realtime is not None and clock is not None:
                self.realtime.finish(clock.utc_ns(engine.consumed_through))
            self.flow.finish()

    def report(self, utc_ns: int) -> None:
        """Publish the counters."""
        counters = self.engine.counters
        text = f"{counters['found']} found"
        self.diagnostics.publish(
            diagnostics.encoded("acquisition", diagnostics.OK, text, counters, utc_ns)
        )
        if self.realtime is not None:
            self.realtime.publish(utc_ns)


def main() -> None:
    """Run the node."""
    run(lambda process: process.add(AcquisitionNode(process)), "acquisition")


if __name__ == "__main__":
    main()
