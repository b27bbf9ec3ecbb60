"""The bytes of an MCAP file: records, chunks of messages with their index, the summary."""

from __future__ import annotations

import struct
import time
import zlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode

from deepseis_bringup.bags.spilled_bytes import SpilledBytes
from deepseis_bringup.bags.whole_writes import WholeWrites
from deepseis_core.mcap_scan import MAGIC, MESSAGE_HEAD, RECORD_HEAD, Channel


def record_bytes(record: records.McapRecord) -> bytes:
    """Return a record as it stands in a file."""
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


@dataclass
class Single:
    """A record that stands outside chunks, with what the index says of it."""

    data: bytes
    entry: records.MetadataIndex | records.AttachmentIndex | None = None

    @classmethod
    def metadata(cls, name: str, values: Mapping[str, str]) -> Single:
        """Return a metadata record."""
        data = record_bytes(records.Metadata(name, dict(values)))
        return cls(data, records.MetadataIndex(0, len(data), name))

    @classmethod
    def attachment(cls, name: str, data: bytes, media_type: str, time_ns: int) -> Single:
        """Return an attached file."""
        built = record_bytes(records.Attachment(time_ns, time_ns, name, media_type, data))
        length, size = len(built), len(data)
        entry = records.AttachmentIndex(0, length, time_ns, time_ns, size, name, media_type)
        return cls(built, entry)


@dataclass
class Chunk:
    """Messages on their way to the file.

    Attributes
    ----------
    born : float
        When the first message came, monotonic [s].
    data : bytearray
        The messages' records.
    packed : bytes or bytearray or None
        The same compressed, once somebody has done it.
    index : dict
        By channel: log time [ns] and place in ``data`` of each message.
    """

    born: float = field(default_factory=time.monotonic)
    start_ns: int = 2**63
    end_ns: int = 0
    data: bytearray = field(default_factory=bytearray)
    packed: bytes | bytearray | None = None
    index: dict[int, list[tuple[int, int]]] = field(default_factory=dict)

    def add(
        self,
        channel: int,
        sequence: int,
        times_ns: tuple[int, int],
        data: bytes | bytearray | memoryview,
    ) -> None:
        """Add a message; its times are those of logging and of publishing."""
        self.index.setdefault(channel, []).append((times_ns[0], len(self.data)))
        self.start_ns = min(self.start_ns, times_ns[0])
        self.end_ns = max(self.end_ns, times_ns[0])
        self.data += RECORD_HEAD.pack(Opcode.MESSAGE, MESSAGE_HEAD.size + len(data))
        self.data += MESSAGE_HEAD.pack(channel, sequence & 0xFFFFFFFF, *times_ns)
        self.data += data

    def pack(self, compress: Callable[[bytearray], bytes] | None) -> None:
        """Compress the messages, unless it is done."""
        if self.packed is None:
            self.packed = self.data if compress is None else compress(self.data)

    def put(self, out: WholeWrites, compression: str) -> bytes:
        """Put the packed chunk and its messages' index to a file; return its record there."""
        assert self.packed is not None
        name = compression.encode()
        head = struct.pack(
            f"<QQQII{len(name)}sQ",
            self.start_ns,
            self.end_ns,
            len(self.data),
            zlib.crc32(self.data),
            len(name),
            name,
            len(self.packed),
        )
        start = out.position
        out.put(RECORD_HEAD.pack(Opcode.CHUNK, len(head) + len(self.packed)) + head)
        out.put(self.packed)
        index_start, offsets = out.position, {}
        for number, entries in self.index.items():
            offsets[number] = out.position
            out.put(record_bytes(records.MessageIndex(number, entries)))
        index = records.ChunkIndex(
            chunk_length=index_start - start,
            chunk_start_offset=start,
            compression=compression,
            compressed_size=len(self.packed),
            message_end_time=self.end_ns,
            message_index_length=out.position - index_start,
            message_index_offsets=offsets,
            message_start_time=self.start_ns,
            uncompressed_size=len(self.data),
        )
        return record_bytes(index)


@dataclass
class Summary:
    """What stands at the end of a file: schemas, channels, statistics, and where all is.

    Attributes
    ----------
    channels : dict
        Topics by number.
    counts : dict
        Messages by number of the topic.
    start_ns, end_ns : int
        First and last log time of a message [ns].
    chunks : SpilledBytes
        Records of the chunks, as they stand in the file: five a second, for days, until it is
        closed.
    chunk_count : int
    entries : list
        Of the records outside chunks.
    """

    chunks: SpilledBytes
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    start_ns: int = 2**63 - 1
    end_ns: int = 0
    chunk_count: int = 0
    entries: list[records.MetadataIndex | records.AttachmentIndex] = field(default_factory=list)
    _schemas: dict[tuple[str, bytes], records.Schema] = field(default_factory=dict)

    def declare(self, channel: Channel) -> bytes:
        """Take a channel; return its record, after its schema's where that is new."""
        key, built = (channel.type_name, channel.schema), b""
        schema = self._schemas.get(key)
        if schema is None:
            number = len(self._schemas) + 1
            schema = records.Schema(
                number, channel.schema, channel.schema_encoding, channel.type_name
            )
            self._schemas[key] = schema
            built = record_bytes(schema)
        self.channels[channel.id] = channel
        self.counts[channel.id] = 0
        return built + record_bytes(self._channel(channel))

    def add_chunk(self, record: bytes) -> None:
        """Take what `Chunk.put` returned."""
        self.chunks.add(record)
        self.chunk_count += 1

    def count(self, channel: int, log_time_ns: int) -> int:
        """Count a message; return how many its channel had before."""
        before = self.counts[channel]
        self.counts[channel] = before + 1
        self.start_ns = min(self.start_ns, log_time_ns)
        self.end_ns = max(self.end_ns, log_time_ns)
        return before

    def put(self, out: WholeWrites) -> None:
        """Put all of it to a file, which then is complete."""
        out.put(record_bytes(records.DataEnd(0)))
        start = out.position
        summary, offsets = b"", b""
        for opcode, built in self._groups():
            if built:
                where = start + len(summary)
                offsets += record_bytes(records.SummaryOffset(opcode, where, len(built)))
            summary += built
        footer_head = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, start + len(summary))
        crc = zlib.crc32(footer_head, zlib.crc32(summary + offsets))
        out.put(summary + offsets + footer_head + struct.pack("<I", crc) + MAGIC)

    def _channel(self, channel: Channel) -> records.Channel:
        schema = self._schemas[channel.type_name, channel.schema]
        about = channel.topic, channel.encoding, channel.metadata
        return records.Channel(channel.id, *about, schema.id)

    def _groups(self) -> list[tuple[int, bytes]]:
        """Return the records of the summary by kind."""

        def together(members: Iterable[records.McapRecord]) -> bytes:
            return b"".join(record_bytes(member) for member in members)

        metadata = [e for e in self.entries if isinstance(e, records.MetadataIndex)]
        attachments = [e for e in self.entries if isinstance(e, records.AttachmentIndex)]
        return [
            (Opcode.SCHEMA, together(self._schemas.values())),
            (Opcode.CHANNEL, together(map(self._channel, self.channels.values()))),
            (Opcode.STATISTICS, together([self._statistics(len(metadata), len(attachments))])),
            (Opcode.CHUNK_INDEX, self.chunks.take()),
            (Opcode.ATTACHMENT_INDEX, together(attachments)),
            (Opcode.METADATA_INDEX, together(metadata)),
        ]

    def _statistics(self, metadata: int, attachments: int) -> records.Statistics:
        messages = sum(self.counts.values())
        return records.Statistics(
            attachment_count=attachments,
            channel_count=len(self.channels),
            channel_message_counts={k: n for k, n in self.counts.items() if n},
            chunk_count=self.chunk_count,
            message_count=messages,
            message_end_time=self.end_ns,
            message_start_time=self.start_ns if messages else 0,
            metadata_count=metadata,
            schema_count=len(self._schemas),
        )
