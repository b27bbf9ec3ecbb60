"""What a bag holds, whole or not."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from pathlib import Path

from deepseis_bringup.bags.file_end import file_end
from deepseis_bringup.bags.mcap_recording import HASH_KEY
from deepseis_core.interface import KEY, RECORD, require_interface
from deepseis_core.mcap_scan import Channel, McapScan, Message
from deepseis_frontend.if_bag import TYPE_NAME, bag_files, decode_if_block
from deepseis_frontend.if_stream import Remark


@dataclass
class TopicInfo:
    """One topic of a bag."""

    name: str
    type_name: str
    type_hash: str
    count: int = 0
    start_ns: int = 0
    end_ns: int = 0
    bytes: int = 0

    @property
    def rate_hz(self) -> float:
        """Mean rate over the time from the first message to the last [Hz]."""
        span = self.end_ns - self.start_ns
        return (self.count - 1) * 1e9 / span if span > 0 else 0.0


@dataclass
class BagInfo:
    """What a bag holds."""

    path: Path
    files: list[Path]
    size_bytes: int
    topics: dict[str, TopicInfo] = field(default_factory=dict)
    start_ns: int | None = None
    end_ns: int | None = None
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: list[str] = field(default_factory=list)
    if_remarks: list[Remark] = field(default_factory=list)
    cut_at: int | None = None
    damaged_chunks: int = 0
    passed_over: int = 0
    has_index: bool = True

    @property
    def message_count(self) -> int:
        """Messages on all topics."""
        return sum(topic.count for topic in self.topics.values())

    @property
    def duration(self) -> float:
        """Time from the first message to the last [s]."""
        if self.start_ns is None or self.end_ns is None:
            return 0.0
        return (self.end_ns - self.start_ns) / 1e9

    @property
    def interface_version(self) -> str | None:
        """Version of the messages, or None where the bag does not say."""
        return self.metadata.get(RECORD, {}).get(KEY)

    @property
    def is_whole(self) -> bool:
        """Whether the bag ends as it should and nothing in it is damaged."""
        damaged = self.damaged_chunks or self.passed_over
        return self.has_index and self.cut_at is None and not damaged

    def require_interface(self) -> None:
        """Refuse a bag of another interface version (``InputError`` naming both)."""
        require_interface(self.path, self.metadata)


def bag_info(path: str | Path) -> BagInfo:
    """Read a whole bag and tell what it holds; bags that are cut short or damaged too.

    Raises
    ------
    InputError
        Where there is no bag.
    """
    path = Path(path)
    files = bag_files(path)
    info = BagInfo(path, files, 0)
    gaps: dict[str, _GapFinder] = {}
    for file in files:
        scan, before = McapScan(file, tolerant=True), info.message_count
        for message in scan.messages():
            _count(info, message)
            if message.channel.type_name == TYPE_NAME:
                finder = gaps.setdefault(message.channel.topic, _GapFinder(info.if_remarks))
                finder.look(message)
        for channel in scan.channels.values():
            _topic(info, channel)
        info.metadata |= scan.metadata
        info.attachments += [attachment.name for attachment in scan.attachments]
        info.size_bytes += file.stat().st_size
        info.damaged_chunks += scan.damaged_chunks
        end = file_end(file)
        info.has_index &= end.is_sound
        if end.message_count is not None and not scan.damaged_chunks:
            info.passed_over += max(0, end.message_count - (info.message_count - before))
        info.cut_at = info.cut_at if scan.cut_at is None else scan.cut_at
    return info


def _topic(info: BagInfo, channel: Channel) -> TopicInfo:
    topic = info.topics.get(channel.topic)
    if topic is None:
        type_hash = channel.metadata.get(HASH_KEY, "")
        topic = info.topics[channel.topic] = TopicInfo(channel.topic, channel.type_name, type_hash)
    return topic


def _count(info: BagInfo, message: Message) -> None:
    topic = _topic(info, message.channel)
    time_ns = message.log_time_ns
    topic.start_ns = time_ns if topic.count == 0 else min(topic.start_ns, time_ns)
    topic.end_ns = max(topic.end_ns, time_ns)
    topic.count += 1
    topic.bytes += len(message.data)
    info.start_ns = time_ns if info.start_ns is None else min(info.start_ns, time_ns)
    info.end_ns = time_ns if info.end_ns is None else max(info.end_ns, time_ns)


class _GapFinder:
    """Watches the sample index of one IF topic."""

    def __init__(self, remarks: list[Remark]) -> None:
        self.remarks, self.expected = remarks, -1

    def look(self, message: Message) -> None:
        """Remark samples that are missing before this message, or that come again."""
        topic = message.channel.topic
        try:
            block = decode_if_block(message.data).block
        except (ValueError, struct.error):
            text = f"{topic}: an unreadable message after sample {self.expected - 1}"
            self.remarks.append(Remark("unreadable", self.expected, text))
            return
        index = block.sample_index
        missing = index - self.expected if self.expected >= 0 else 0
        if missing > 0:
            text = f"{topic}: {missing} samples are missing before sample {index}"
            self.remarks.append(Remark("gap", index, text, missing))
        elif missing < 0:
            text = f"{topic}: sample {index} comes after sample {self.expected - 1}"
            self.remarks.append(Remark("back", index, text, missing))
        self.expected = index + block.sample_count
