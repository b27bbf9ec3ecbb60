"""Node: records every topic of the graph, byte for byte, into a bag of MCAP files."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from deepseis_bringup.bags.archive import Archive, ArchiveConfig
from deepseis_bringup.bags.archive_report import disk_report
from deepseis_bringup.bags.recording_queue import (
    StampOrder,
    about_whom,
    event_span,
    if_block_end,
    speaker_of,
    stamp_of_cdr,
    status_name,
)
from deepseis_bringup.bags.ros_definitions import TopicQos
from deepseis_core.config import setting
from deepseis_core.errors import InputError
from deepseis_core.ros import diagnostics, qos
from deepseis_core.ros.cdr import message_class
from deepseis_core.ros.convert import ns_from_stamp
from deepseis_core.ros.flow import Flow, FlowConfig
from deepseis_core.ros.main import Process, run
from deepseis_core.ros.parameters import declare, reject_unknown
from deepseis_core.ros.steady import every
from deepseis_core.status_names import is_of
from deepseis_msgs.msg import Watermark

LEVELS = (diagnostics.OK, diagnostics.WARN, diagnostics.ERROR)
LASTING = ("station", "gnss/ephemeris", "motion/state")
"""Topics whose last message holds until the next."""
SHARED_WAIT_NS = 1_000_000_000
"""Realtime: a message of a shared topic waits so long for a node that hangs."""


@dataclass(frozen=True)
class RecorderConfig:
    """What to record, and where."""

    directory: str = setting("", "folder of the bag, made new [path]")
    topics: list[str] = setting([], "entries: topic type qos, and shared if several publish [-]")
    members: list[str] = setting([], "flow members whose end is the end of the recording [-]")
    records: str = setting("", "metadata records of the bag: JSON object of objects [-]")
    compression: str = setting("zstd", "of the bag's chunks [-]", choices=("zstd", "none"))
    pace_member: str = setting("pvt", "without IF, acknowledge as far as this member [-]")


class RecorderNode(Node):
    """In: all topics given. Out: the bag, flow/recorder, in realtime /diagnostics of the disk.

    Parameters: RecorderConfig, ArchiveConfig.
    """

    def __init__(self, process: Process) -> None:
        super().__init__("recorder")
        self.flow = Flow(self, process, "recorder", declare(self, FlowConfig))
        self.config = declare(self, RecorderConfig)
        self.archive = declare(self, ArchiveConfig)
        reject_unknown(self)
        if not self.config.directory:
            raise InputError("parameter directory of recorder", "is empty", "name a new folder")
        records = json.loads(self.config.records or "{}")
        self.writer = Archive(
            self.config.directory,
            records,
            config=self.archive,
            keys={self.resolve_topic_name(topic): about_whom for topic in LASTING},
            compression=self.config.compression,
            patient=not self.flow.lockstep,
        )
        self.began_ns = 0
        if not self.flow.lockstep:
            self.reports = self.create_publisher(DiagnosticArray, "/diagnostics", qos.STREAM)
            every(self, 1.0, self.report)
        self.records_if = False
        self.last_if = -1
        self.types: dict[str, str] = {}
        limit_ns = 0 if self.flow.lockstep else SHARED_WAIT_NS
        self.order = StampOrder([*self.config.members, "if_source"], limit_ns)
        for entry in self.config.topics:
            topic, type_name, profile, *shared = entry.split()
            self.records_if |= topic == "if/samples"
            self.record(topic, type_name, profile, shared=bool(shared and self.config.members))
        self.flow.follow(self.config.members, self.on_member)
        self.flow.follow(["if_source"], self.put_in_order)

    def record(self, topic: str, type_name: str, profile: str, *, shared: bool) -> None:
        """Subscribe to a topic's bytes; those of a shared one are put in order first."""
        name = self.resolve_topic_name(topic)
        chosen = qos.BY_NAME[profile]
        durability = "transient_local" if profile == "latched" else "volatile"
        offered = TopicQos(durability=durability, depth=chosen.depth)
        self.writer.add_topic(name, type_name, offered)
        self.types[name] = type_name
        is_if, is_event = topic == "if/samples", topic.endswith("seismo/event")
        is_common, space = topic == "/diagnostics", self.get_namespace()

        def on_bytes(cdr: bytes, _info: Any = None) -> None:
            stamp_ns = stamp_of_cdr(cdr)
            if is_common and not is_of(status_name(cdr), space):
                return
            if shared:
                member = speaker_of(cdr, self.order.members)
                self.order.push(name, member, stamp_ns, cdr)
                self.write(self.order.due())
                return
            self.writer.write(name, type_name, cdr, stamp_ns, stamp_ns)
            if is_event:
                self.writer.keep(*event_span(cdr))
            if is_if:
                self.acknowledge_if(cdr, stamp_ns)

        self.create_subscription(message_class(type_name), topic, on_bytes, chosen, raw=True)

    def acknowledge_if(self, cdr: bytes, utc_ns: int) -> None:
        """Give the source its credit."""
        self.last_if = if_block_end(cdr)
        self.flow.send(self.last_if, self.last_if, utc_ns=utc_ns)

    def on_member(self, msg: Watermark) -> None:
        """Acknowledge without IF; end when everybody has."""
        self.put_in_order(msg)
        if not self.records_if and msg.node == self.config.pace_member:
            self.flow.send(msg.consumed_through, msg.consumed_through)
        others = self.flow.others
        names = self.config.members
        ended = all(n in others and others[n].end_of_stream for n in names)
        if names and ended and not self.flow.ended:
            self.flow.finish()

    def put_in_order(self, msg: Watermark) -> None:
        """Take a watermark; write the messages of shared topics that nothing can precede."""
        stamp_ns = ns_from_stamp(msg.header.stamp)
        self.order.heard(msg.node, stamp_ns, msg.shared_count, ended=msg.end_of_stream)
        self.write(self.order.due())

    def write(self, messages: Iterable[tuple[str, int, bytes]]) -> None:
        """Write messages: topic, stamp, bytes."""
        for name, stamp_ns, cdr in messages:
            self.writer.write(name, self.types[name], cdr, stamp_ns, stamp_ns)

    def report(self) -> None:
        """Say how disk and archive are."""
        state = self.writer.state()
        self.began_ns = self.began_ns or state.oldest_ns
        if state.newest_ns:
            found = disk_report(self.archive, state, self.began_ns)
            level = LEVELS[found.level]
            self.reports.publish(
                diagnostics.encoded("recorder", level, found.text, found.values, state.newest_ns)
            )

    def close(self) -> None:
        """Finish the bag."""
        self.write(self.order.due(everything=True))
        self.writer.close()


def main() -> None:
    """Run the node."""
    run(lambda process: process.add(RecorderNode(process)), "recorder")


if __name__ == "__main__":
    main()
