"""Nodes: one per satellite, hosted in this process; they share one IF subscription."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from deepseis_core.config import setting
from deepseis_core.deadline import Deadline
from deepseis_core.errors import InputError
from deepseis_core.latency import Arrivals
from deepseis_core.ros import codecs, diagnostics, qos
from deepseis_core.ros.cdr import encode_message
from deepseis_core.ros.codecs import subscribe
from deepseis_core.ros.flow import Flow, FlowConfig
from deepseis_core.ros.main import Process
from deepseis_core.ros.parameters import declare, reject_unknown
from deepseis_core.ros.realtime import RealtimeReport
from deepseis_core.ros.steady import every
from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import AcquisitionResult, Aiding, IfBlock
from deepseis_msgs.msg import AcquisitionRequest, Ephemeris, TrackingEpochs, Watermark
from deepseis_tracking.channel import TrackingConfig
from deepseis_tracking.engine import BlockOutput, SlotConfig, TrackingEngine, check_satellites
from deepseis_tracking.rehearsal import rehearse_decoding


@dataclass(frozen=True)
class HostConfig:
    """What this process waits for."""

    wait_acquisition: bool = setting(True, "the graph has an acquisition node [-]")
    aiding: bool = setting(False, "the graph has a node that publishes aiding/doppler [-]")
    aiding_deadline_ms: float = setting(50.0, "realtime: wait so long for aiding [ms]", low=0)


class SatelliteNode(Node):
    """Out: tracking/<sat>/epochs, gnss/ephemeris, acquisition/request of one satellite."""

    def __init__(self, satellite: str, flow: Flow) -> None:
        super().__init__(
            f"tracker_{satellite.lower()}", start_parameter_services=False, enable_rosout=False
        )
        self.satellite = satellite
        publish_on = flow.publish_on
        self.epochs = publish_on(f"tracking/{satellite}/epochs", TrackingEpochs, qos.STREAM, self)
        self.ephemeris = publish_on("gnss/ephemeris", Ephemeris, qos.LATCHED, self)
        self.request = publish_on("acquisition/request", AcquisitionRequest, qos.LATCHED, self)


class TrackerHost:
    """In: if/samples, acquisition/result, aiding/doppler. Out: those of every `SatelliteNode`."""

    def __init__(self, process: Process, node: Node, satellites: list[str] | None) -> None:
        self.process, self.node = process, node
        self.name = node.get_name()
        flow_config, self.config = declare(node, FlowConfig), declare(node, HostConfig)
        slots, loops = declare(node, SlotConfig), declare(node, TrackingConfig)
        reject_unknown(node)
        names = check_satellites(satellites or slots.satellites)
        self.flow = Flow(node, process, self.name, flow_config)
        try:
            self.engine = TrackingEngine(
                names,
                loops,
                slots,
                wait_acquisition=self.config.wait_acquisition,
                wait_aiding=self.config.aiding,
                script=self.flow.script,
            )
        except ValueError as error:
            raise InputError(f"parameters of {self.name}", str(error)) from None
        self.engine.compile()
        if not self.flow.lockstep:
            rehearse_decoding(slots.reference_week)
        self.satellites = {name: SatelliteNode(name, self.flow) for name in names}
        for satellite_node in self.satellites.values():
            process.add(satellite_node)
        self.diagnostics = self.flow.publish_on("/diagnostics", DiagnosticArray, qos.STREAM)
        self.clock: SampleClock | None = None
        self.second, self.spoken = -1, 0
        self.deadline = Deadline(1e-3 * self.config.aiding_deadline_ms)
        self.flow.follow(["if_source"], self.on_source)
        if self.config.wait_acquisition:
            self.flow.follow(["acquisition"], self.on_acquisition)
        self.realtime = None if self.flow.lockstep else self.realtime_report()
        self.came = {"imu_to_use": Arrivals(), "aiding_to_use": Arrivals()}
        self.subscriptions = self.subscribe()
        if not self.flow.lockstep:
            every(node, 0.01, self.on_deadline)

    def subscribe(self) -> list[Any]:
        """Subscribe to the inputs."""
        node = self.node
        made = [subscribe(node, codecs.IF_BLOCK, "if/samples", self.on_if_block, qos.STREAM)]
        if self.config.wait_acquisition:
            results = codecs.ACQUISITION_RESULT
            made.append(
                subscribe(node, results, "acquisition/result", self.on_result, qos.LATCHED)
            )
        if self.config.aiding:
            aiding = codecs.DOPPLER_AIDING
            made.append(subscribe(node, aiding, "aiding/doppler", self.on_aiding, qos.STREAM))
        if self.config.aiding and not self.flow.lockstep:
            self.flow.follow(["imu_source"], self.on_imu)
        return made

    def realtime_report(self) -> RealtimeReport:
        """Make the report of misses, and of latencies if there is aiding."""
        texts = {"imu_to_use": "from IMU sample to use", "aiding_to_use": "from aiding to use"}
        return RealtimeReport(
            self.node,
            self.name,
            texts if self.config.aiding else {},
            self.config.aiding_deadline_ms,
        )

    def on_imu(self, msg: Watermark) -> None:
        """Note when IMU samples were there: it is the fusion that works with them."""
        self.came["imu_to_use"].note(msg.valid_through, time.monotonic())

    def note(self, output: BlockOutput) -> None:
        """Real time: note what a block lacked, and how old its aiding is by now."""
        if self.realtime is None:
            return
        block = output.block
        last = block.sample_index + block.sample_count - 1
        for what, through in output.missed.items():
            self.realtime.misses.note(what, block.sample_index, block.sample_count, through)
        now = time.monotonic()
        for key, meter in self.realtime.meters.items() if "aiding" not in output.missed else ():
            came = self.came[key].of(last)
            if came is not None:
                meter.add(now - came)

    def on_if_block(self, block: IfBlock, utc_ns: int) -> None:
        """Queue the block; work through all that the inputs' watermarks allow."""
        if not self.flow.admits(block.sample_index):
            return
        if self.flow.rejoins and self.engine.joined_at < 0:
            self.engine.join(block.sample_index, block.sample_rate_hz)
        self.deadline.arrived(block.sample_index + block.sample_count - 1)
        self.engine.push_block(block)
        if self.clock is None:
            rate = block.sample_rate_hz
            self.clock = SampleClock.from_sample(block.sample_index, utc_ns, rate)
        self.work()

    def on_result(self, result: AcquisitionResult, _utc_ns: int) -> None:
        """Take an acquisition result."""
        self.engine.push_result(result)
        self.work()

    def on_acquisition(self, msg: Watermark) -> None:
        """Take the acquisition's watermark."""
        self.engine.acquisition_valid(msg.valid_through, msg.event_count)
        self.work()

    def on_aiding(self, aiding: Aiding, _utc_ns: int) -> None:
        """Take aiding."""
        self.came["aiding_to_use"].note(aiding.valid_through, time.monotonic())
        self.engine.push_aiding(aiding)
        self.work()

    def on_source(self, _msg: Watermark) -> None:
        """Look whether the stream has ended."""
        self.work()

    def on_deadline(self) -> None:
        """Realtime: wait no longer than the deadline, but for the first acquisition."""
        overdue = self.deadline.look()
        while self.engine.next_through() <= overdue:
            if self.engine.waiting_for() == "acquisition" and not self.engine.is_tracking:
                break
            self.work(force=True)

    def work(self, *, force: bool = False) -> None:
        """Work through all blocks whose inputs are there and publish."""
        while (output := self.engine.advance(force=force)) is not None:
            self.note(output)
            force = False
            self.publish(output)
        if self.engine.blocks:
            self.flow.flush()
        source = self.flow.others.get("if_source")
        if source is None or not source.end_of_stream or self.flow.ended:
            return
        if self.engine.done_through >= source.valid_through or self.flow.came_too_late:
            if self.realtime is not None and self.clock is not None:
                self.realtime.finish(self.clock.utc_ns(self.engine.done_through))
            self.flow.finish()

    def publish(self, output: BlockOutput) -> None:
        """Publish what one block gave, the watermark last."""
        block, clock = output.block, self.clock
        assert clock is not None
        utc_ns = clock.utc_ns(block.sample_index)
        for ephemeris in output.ephemerides:
            stamp = clock.utc_ns(ephemeris.effective_sample_index)
            self.satellites[ephemeris.satellite].ephemeris.publish(
                codecs.EPHEMERIS.encode(ephemeris, stamp)
            )
        for satellite, sample_index in output.requests:
            stamp = clock.utc_ns(sample_index)
            request = codecs.acquisition_request(satellite, sample_index, stamp)
            self.satellites[satellite].request.publish(encode_message(request))
        for epochs in output.epochs:
            data = codecs.TRACKING_EPOCHS.encode(epochs, utc_ns)
            self.satellites[epochs.satellite].epochs.publish(data)
        self.spoken += len(output.epochs)
        last = block.sample_index + block.sample_count - 1
        second = int(last / block.sample_rate_hz)
        if second > self.second:
            self.second = second
            self.report(utc_ns)
        self.flow.send(
            last,
            last,
            event_count=self.engine.request_count,
            observation_count=self.spoken,
            utc_ns=utc_ns,
        )

    def report(self, utc_ns: int) -> None:
        """Publish the counters."""
        level, text, values = self.engine.health()
        level_byte = diagnostics.WARN if level else diagnostics.OK
        self.diagnostics.publish(diagnostics.encoded(self.name, level_byte, text, values, utc_ns))
        if self.realtime is not None:
            self.realtime.publish(utc_ns)
