"""What a bag holds, and how a bag that was cut short becomes whole again."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from deepseis_bringup.mcap_file import McapFile
from deepseis_bringup.mcap_recording import HASH_KEY, METADATA, write_metadata_yaml
from deepseis_core.errors import InputError
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
        return self.has_index and self.cut_at is None and not self.damaged_chunks

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
        scan = McapScan(file, tolerant=True)
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
        info.has_index &= scan.has_end
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


@dataclass(frozen=True)
class Recovery:
    """What became of one file."""

    path: Path
    was_whole: bool
    messages: int
    damaged_chunks: int
    cut_at: int | None
    lost_bytes: int


def recover_bag(path: str | Path) -> list[Recovery]:
    """Make a bag whole: rewrite what can be read of each cut file, with index and metadata.

    A file is replaced only by its finished successor; one that is whole is left alone.

    Raises
    ------
    InputError
        Where there is no bag, or not one message in it can be read.
    """
    path = Path(path)
    results = [_whole(file) or _rewrite(file) for file in bag_files(path)]
    folder = path if path.is_dir() else path.parent
    rewritten = not all(result.was_whole for result in results)
    described = (folder / METADATA).is_file()
    if (path.is_dir() and not described) or (described and rewritten):
        _describe(folder, bag_files(folder))
    return results


def _whole(file: Path) -> Recovery | None:
    """Return a file's state if it has an end and nothing in it is damaged."""
    scan = McapScan(file, tolerant=True)
    count = sum(1 for _ in scan.messages())
    if scan.cut_at is None and not scan.damaged_chunks and scan.has_end:
        return Recovery(file, True, count, 0, None, 0)
    return None


def _rewrite(file: Path) -> Recovery:
    draft = file.with_name(f".{file.name}.recovering")
    draft.unlink(missing_ok=True)
    scan = McapScan(file, tolerant=True)
    try:
        count = _copy(scan, draft)
    except BaseException:
        with suppress(OSError):
            draft.unlink(missing_ok=True)
        raise
    size = file.stat().st_size
    lost = 0 if scan.cut_at is None else size - scan.cut_at
    os.replace(draft, file)
    return Recovery(file, False, count, scan.damaged_chunks, scan.cut_at, lost)


def _copy(scan: McapScan, target: Path) -> int:
    """Copy what can be read into a new file; metadata first, as it was first."""
    messages = scan.messages()
    first = next(messages, None)
    if first is None:
        raise InputError(scan.path, "holds no message that can be read")
    out = McapFile(target, profile=scan.profile)
    done = set(scan.metadata)
    try:
        for name, values in scan.metadata.items():
            out.add_metadata(name, values)
        numbers: dict[int, int] = {}
        for message in _chain(first, messages):
            channel = message.channel
            if channel.id not in numbers:
                numbers[channel.id] = _add(out, channel)
            out.write(
                numbers[channel.id],
                message.log_time_ns,
                message.publish_time_ns,
                message.data,
                message.sequence,
            )
        for name in scan.metadata.keys() - done:
            out.add_metadata(name, scan.metadata[name])
        for item in scan.attachments:
            out.add_attachment(item.name, item.data, item.media_type, item.create_time)
        for number, channel in scan.channels.items():
            if number not in numbers:
                _add(out, channel)
    finally:
        out.close()
    return sum(out.counts.values())


def _chain(first: Message, rest: Iterator[Message]) -> Iterator[Message]:
    yield first
    yield from rest


def _add(out: McapFile, channel: Channel) -> int:
    return out.add_channel(
        channel.topic,
        channel.type_name,
        channel.schema,
        channel.metadata,
        schema_encoding=channel.schema_encoding,
        encoding=channel.encoding,
    )


def _describe(folder: Path, files: list[Path]) -> None:
    """Write ``metadata.yaml`` for a folder that lost or never had one."""
    facts = []
    custom: dict[str, str] = {}
    for file in files:
        scan = McapScan(file, tolerant=True)
        counts: dict[int, int] = {}
        start_ns, end_ns = 2**63 - 1, 0
        for message in scan.messages():
            counts[message.channel.id] = counts.get(message.channel.id, 0) + 1
            start_ns = min(start_ns, message.log_time_ns)
            end_ns = max(end_ns, message.log_time_ns)
        facts.append(_Facts(file, scan.channels, counts, start_ns, end_ns))
        custom |= {f"{RECORD}.{k}": value for k, value in scan.metadata.get(RECORD, {}).items()}
    write_metadata_yaml(folder, facts, custom)


@dataclass
class _Facts:
    """What ``metadata.yaml`` says of one file."""

    path: Path
    channels: dict[int, Channel]
    counts: dict[int, int]
    start_ns: int
    end_ns: int
