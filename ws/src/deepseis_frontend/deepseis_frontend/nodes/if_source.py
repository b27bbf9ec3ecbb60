"""Node: plays an IF recording into the graph."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.duration import Duration
from rclpy.node import Node

from deepseis_core.config import setting
from deepseis_core.ros import codecs, diagnostics, qos
from deepseis_core.ros.flow import Flow, FlowConfig
from deepseis_core.ros.main import Process, run
from deepseis_core.ros.parameters import declare, reject_unknown
from deepseis_core.ros.steady import every
from deepseis_core.sample_clock import SampleClock, utc_ns_from_iso
from deepseis_core.types import IfBlock as IfBlockValue
from deepseis_frontend.credits import CreditWindow
from deepseis_frontend.if_open import open_source
from deepseis_frontend.if_soapy import SoapySource
from deepseis_msgs.msg import IfBlock, Watermark


@dataclass(frozen=True)
class SourceConfig:
    """What to play and how fast."""

    file: str = setting(
        "", "raw IF recording, the folder or file of a bag, or soapy:driver=... [path]"
    )
    format: str = setting("", "packing, if no descriptor lies beside the file: preset or text [-]")
    sample_rate_hz: float = setting(0.0, "sampling rate, if no descriptor tells [Hz]", low=0)
    intermediate_frequency_hz: float = setting(0.0, "nominal IF, if no descriptor tells [Hz]")
    start_utc: str = setting(
        "", "coarse UTC of the first sample, ISO 8601; empty: as recorded [-]"
    )
    start_s: float = setting(0.0, "skip so much at the start [s]", low=0)
    length_s: float = setting(0.0, "play so much; 0: all [s]", low=0)
    window_blocks: int = setting(32, "credit window, at least D + 3 blocks [blocks]", low=3)
    members: list[str] = setting([], "flow members that must acknowledge (lockstep) [-]")
    onlookers: list[str] = setting([], "flow members that take no part, waited for at start [-]")
    pace: float = setting(1.0, "realtime pace, times real time [-]", low=0.01, high=100.0)


class IfSourceNode(Node):
    """Out: if/samples, flow/if_source. In: flow/<member>. Parameters: SourceConfig."""

    def __init__(self, process: Process) -> None:
        super().__init__("if_source")
        self.process = process
        flow_config, self.config = declare(self, FlowConfig), declare(self, SourceConfig)
        reject_unknown(self)
        self.source = open_source(self.config)
        given = self.config.start_utc
        start_ns = utc_ns_from_iso(given) if given else self.source.start_utc_ns or 0
        self.clock = SampleClock(start_ns, self.source.sample_rate_hz)
        self.flow = Flow(self, process, "if_source", flow_config)
        self.publisher = self.flow.publish_on("if/samples", IfBlock, qos.STREAM)
        self.diagnostics = self.flow.publish_on("/diagnostics", DiagnosticArray, qos.STREAM)
        self.window = CreditWindow(self.config.members, self.config.window_blocks)
        self.flow.follow(self.config.members, self.on_watermark)
        self.flow.follow(self.config.onlookers, lambda _msg: self.advance())
        self.blocks: Iterator[IfBlockValue] = self.source.blocks()
        self.finished = False
        self.sent, self.last_index, self.reported_s = 0, -1, -1
        self.started_at = 0.0
        self.flow.when_ready(self.advance)
        period = 0.002 if not self.flow.lockstep else 1.0
        every(self, period, self.advance if not self.flow.lockstep else self.look_for_dead)

    def on_watermark(self, msg: Watermark) -> None:
        """Take a member's credit and send what it allows."""
        self.window.acknowledge(msg.node, msg.consumed_through)
        self.advance()

    def members_ready(self) -> bool:
        """Tell whether every member has its endpoints matched, and the onlookers see.

        Asked at the start only: in real time a member may die, and join again, while all others
        go on.
        """
        if self.started_at:
            return True
        others = self.flow.others
        awaited = [*self.config.members, *self.config.onlookers]
        return self.flow.ready and all(m in others and others[m].ready for m in awaited)

    def advance(self) -> None:
        """Send blocks as far as credits (lockstep) or the clock (realtime) allow."""
        if not self.members_ready() or self.process.stopped is not None:
            return
        self.started_at = self.started_at or time.monotonic()
        while not self.finished and self.may_send():
            block = next(self.blocks, None)
            if block is None:
                self.end()
            else:
                self.send(block)
        if self.finished and self.all_ended():
            self.process.stop()

    def may_send(self) -> bool:
        """Tell whether the next block's turn has come."""
        if self.flow.lockstep:
            return self.window.is_open()
        if isinstance(self.source, SoapySource) and self.last_index >= 0:
            return self.source.is_ready()
        played = (self.last_index + 1) / self.source.sample_rate_hz / self.config.pace
        return time.monotonic() - self.started_at >= played

    def send(self, block: IfBlockValue) -> None:
        """Publish one block and say so."""
        utc_ns = self.clock.utc_ns(block.sample_index)
        self.last_index = block.sample_index + block.sample_count - 1
        self.window.send(block.sample_index, self.last_index)
        self.publisher.publish(codecs.IF_BLOCK.encode(block, utc_ns))
        self.sent += 1
        second = int(self.last_index / block.sample_rate_hz)
        if second > self.reported_s:
            self.reported_s = second
            self.report(utc_ns)
        self.flow.send(self.last_index, self.last_index, utc_ns=utc_ns)

    def report(self, utc_ns: int) -> None:
        """Publish the counters."""
        remarks = self.source.remarks
        values = {"blocks": self.sent, "remarks": len(remarks)}
        values |= {r.kind + "_at_sample": r.sample_index for r in remarks[-1:]}
        level = diagnostics.WARN if remarks else diagnostics.OK
        text = remarks[-1].text if remarks else "playing"
        self.diagnostics.publish(diagnostics.encoded("if_source", level, text, values, utc_ns))

    def end(self) -> None:
        """Say that nothing follows."""
        self.finished = True
        self.report(self.clock.utc_ns(self.last_index))
        for remark in self.source.remarks:
            self.get_logger().warning(f"{self.config.file}: {remark.text}")
        self.flow.finish()

    def all_ended(self) -> bool:
        """Tell whether all members have worked through everything."""
        return all(self.flow.others[m].end_of_stream for m in self.config.members)

    def look_for_dead(self) -> None:
        """In lockstep a dead member is an error that names it."""
        for member in self.config.members:
            gone = self.count_publishers(f"flow/{member}") == 0
            if gone and member in self.flow.others and not self.flow.others[member].end_of_stream:
                self.flow.fail(f"{member} has died")
        self.advance()

    def close(self) -> None:
        """Where a signal ended the play, say that nothing follows."""
        stopped = self.process.stopped
        if stopped is None or stopped.status or self.finished or not self.sent:
            return
        self.end()
        self.flow.publisher.wait_for_all_acked(Duration(seconds=1))


def main() -> None:
    """Run the node."""

    def build(process: Process) -> None:
        node = IfSourceNode(process)
        process.add(node)

    run(build, "if_source")


if __name__ == "__main__":
    main()
