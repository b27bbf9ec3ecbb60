"""Bags: written with a limit on what a crash can take, read, described and recovered.

A bag is a folder ``<run>/bag/`` with MCAP files and ``metadata.yaml``; `ros2 bag`, rosbags
and every MCAP reader open it. It carries the interface version, and what the run was made of,
as MCAP metadata records.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Protocol

import yaml
import zstandard
from mcap.exceptions import McapError
from mcap.reader import make_reader

from deepseis_bringup.bags.mcap_file import FLUSH_INTERVAL, McapFile
from deepseis_bringup.bags.ros_definitions import Definitions, TopicQos
from deepseis_core.errors import InputError
from deepseis_core.interface import INTERFACE_VERSION, KEY, RECORD
from deepseis_core.mcap_scan import Channel, McapScan, Message

METADATA: Final = "metadata.yaml"
QOS_KEY: Final = "offered_qos_profiles"
HASH_KEY: Final = "topic_type_hash"
DISTRO: Final = "jazzy"


class BagWriter:
    """Writes a bag; usable as a context manager.

    Parameters
    ----------
    folder : path
        The bag's folder, such as ``<run>/bag``: made, and refused if it holds a bag already.
    records : mapping of mappings, optional
        Metadata records: parameters, versions, station, input hashes, ... The record
        ``deepseis`` gets the interface version.
    definitions : Definitions, optional
        Default: the installed ones.
    compression : {'zstd', 'none'}
        'none' takes a fifth of the processor time and three times the disk (2-bit samples
        in bytes); samples that fill their bits do not compress.
    flush_interval : float
        Longest time that a message waits before it is in the file [s].
    patient, guard, sync_interval
        As of :class:`~deepseis_bringup.bags.mcap_file.McapFile`.

    Raises
    ------
    InputError
        Where the folder holds a bag, or it cannot be written.
    """

    def __init__(
        self,
        folder: str | Path,
        records: Mapping[str, Mapping[str, Any]] | None = None,
        *,
        definitions: Definitions | None = None,
        compression: str = "zstd",
        flush_interval: float = FLUSH_INTERVAL,
        patient: bool = False,
        guard: Callable[[], None] | None = None,
        sync_interval: float = 0.0,
    ) -> None:
        self.folder = Path(folder)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            occupied = (self.folder / METADATA).exists() or any(self.folder.glob("*.mcap"))
        except OSError as error:
            raise InputError(self.folder, f"cannot be made: {error.strerror}") from None
        if occupied:
            raise InputError(self.folder, "holds a bag already", "name another folder")
        self.definitions = definitions or Definitions()
        self.records = {name: dict(values) for name, values in (records or {}).items()}
        self.records[RECORD] = {**self.records.get(RECORD, {}), KEY: INTERFACE_VERSION}
        own = self.records[RECORD]
        self.custom = {f"{RECORD}.{key}": str(value) for key, value in own.items()}
        self.topics: dict[str, tuple[str, TopicQos]] = {}
        self._options: dict[str, Any] = {
            "compression": compression,
            "flush_interval": flush_interval,
            "patient": patient,
            "guard": guard,
            "sync_interval": sync_interval,
        }
        self._numbers: dict[str, int] = {}
        self._closed = False
        self.file = self.open_file("0")

    def open_file(self, number: str, path: Path | None = None) -> McapFile:
        """Make a file of the bag, with its records and all topics declared so far."""
        path = path or self.folder / f"{self.folder.resolve().name}_{number}.mcap"
        file = McapFile(path, **self._options)
        for name in sorted(self.records, key=lambda name: (name != RECORD, name)):
            values = self.records[name].items()
            file.add_metadata(name, {str(key): str(value) for key, value in values})
        for topic in self.topics:
            self._declare(file, topic)
        return file

    def _declare(self, file: McapFile, topic: str) -> int:
        type_name, qos = self.topics[topic]
        metadata = {QOS_KEY: qos.to_yaml()}
        if type_hash := self.definitions.type_hash(type_name):
            metadata[HASH_KEY] = type_hash
        return file.add_channel(topic, type_name, self.definitions.schema(type_name), metadata)

    def add_topic(self, topic: str, type_name: str, qos: TopicQos | None = None) -> None:
        """Declare a topic with the quality of service that its publisher offers."""
        if topic not in self.topics:
            self.topics[topic] = type_name, qos or TopicQos()
            self._numbers[topic] = self._declare(self.file, topic)

    def write(
        self,
        topic: str,
        type_name: str,
        cdr_bytes: bytes | bytearray | memoryview,
        log_time_ns: int,
        publish_time_ns: int,
    ) -> None:
        """Write a serialised message; a topic not declared before is declared."""
        self.add_topic(topic, type_name)
        self.file.write(self._numbers[topic], log_time_ns, publish_time_ns, cdr_bytes)

    def add_metadata(self, name: str, values: Mapping[str, Any]) -> None:
        """Add a metadata record; values become text."""
        self.file.add_metadata(name, {str(key): str(value) for key, value in values.items()})

    def add_attachment(self, name: str, data: bytes, media_type: str = "text/plain") -> None:
        """Attach a file, such as the parameters of the run."""
        self.file.add_attachment(name, data, media_type)

    def close(self) -> None:
        """Finish the file and write ``metadata.yaml``."""
        if not self._closed:
            self._closed = True
            self.file.close()
            write_metadata_yaml(self.folder, [self.file], self.custom)

    def __enter__(self) -> BagWriter:
        """Return the writer."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the bag, whatever happened."""
        self.close()


class FileFacts(Protocol):
    """What ``metadata.yaml`` says of one file (:class:`McapFile` has it)."""

    @property
    def path(self) -> Path:
        """Where it is."""

    @property
    def channels(self) -> dict[int, Channel]:
        """Topics by number."""

    @property
    def counts(self) -> dict[int, int]:
        """Messages by number of the topic."""

    @property
    def start_ns(self) -> int:
        """First log time [ns]."""

    @property
    def end_ns(self) -> int:
        """Last log time [ns]."""


class _Dumper(yaml.SafeDumper):
    """Writes equal parts out again instead of referring to the first."""

    def ignore_aliases(self, data: Any) -> bool:
        """Use no references."""
        return True


def write_metadata_yaml(
    folder: Path, files: Sequence[FileFacts], custom: Mapping[str, str]
) -> None:
    """Write a bag's ``metadata.yaml`` (version 9), at once or not at all."""
    topics: dict[str, dict[str, Any]] = {}
    for file in files:
        for number, channel in file.channels.items():
            new = {"topic_metadata": _topic_metadata(channel), "message_count": 0}
            topic = topics.setdefault(channel.topic, new)
            topic["message_count"] += file.counts.get(number, 0)
    start = min((file.start_ns for file in files if any(file.counts.values())), default=0)
    end = max((file.end_ns for file in files), default=0)
    facts = {
        "version": 9,
        "storage_identifier": "mcap",
        **_span(start, end, sum(sum(file.counts.values()) for file in files)),
        "topics_with_message_count": list(topics.values()),
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.path.name for file in files],
        "files": [{"path": file.path.name, **_file_span(file)} for file in files],
        "custom_data": dict(custom) or None,
        "ros_distro": DISTRO,
    }
    text = yaml.dump({"rosbag2_bagfile_information": facts}, Dumper=_Dumper, sort_keys=False)
    draft = folder / f".{METADATA}"
    draft.write_text(text, encoding="utf-8")
    os.replace(draft, folder / METADATA)


def _file_span(file: FileFacts) -> dict[str, Any]:
    count = sum(file.counts.values())
    return _span(file.start_ns if count else 0, file.end_ns, count)


def _span(start_ns: int, end_ns: int, count: int) -> dict[str, Any]:
    return {
        "duration": {"nanoseconds": max(end_ns - start_ns, 0)},
        "starting_time": {"nanoseconds_since_epoch": start_ns},
        "message_count": count,
    }


def _topic_metadata(channel: Channel) -> dict[str, Any]:
    try:
        qos = yaml.safe_load(channel.metadata.get(QOS_KEY, "")) or []
    except yaml.YAMLError:
        qos = []
    return {
        "name": channel.topic,
        "type": channel.type_name,
        "serialization_format": channel.encoding,
        "offered_qos_profiles": qos,
        "type_description_hash": channel.metadata.get(HASH_KEY, ""),
    }


def read_messages(files: Iterable[Path], topics: Iterable[str] | None = None) -> Iterator[Message]:
    """Yield the messages of finished bag files in order of log time, in bounded memory.

    Raises
    ------
    InputError
        Where a file is damaged or has no index.
    """
    wanted = None if topics is None else set(topics)
    for path in files:
        channels: dict[int, Channel] = {}
        McapScan(path)
        try:
            with path.open("rb") as stream:
                reader = make_reader(stream, validate_crcs=True)
                for schema, channel, message in reader.iter_messages(wanted):
                    known = channels.get(channel.id)
                    if known is None:
                        known = channels[channel.id] = Channel(
                            channel.id,
                            channel.topic,
                            schema.name if schema else "",
                            schema.encoding if schema else "",
                            schema.data if schema else b"",
                            channel.message_encoding,
                            dict(channel.metadata),
                        )
                    yield Message(
                        known,
                        message.log_time,
                        message.publish_time,
                        message.sequence,
                        memoryview(message.data),
                    )
        except (
            McapError,
            zstandard.ZstdError,
            struct.error,
            LookupError,
            ValueError,
            OSError,
            MemoryError,
            OverflowError,
            RuntimeError,
        ) as error:
            reason = f"cannot be read to its end: {str(error) or type(error).__name__}"
            raise InputError(path, reason, "try: deepseis recover BAG") from None
