"""IF blocks out of a recorded bag (MCAP), without ROS.

Gaps of ``sample_index`` are remarked and left open; a bag that ``kill -9`` cut short is read as
far as it goes. Blocks are views of the bag's chunks, nothing is copied.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import yaml

from deepseis_core.errors import InputError
from deepseis_core.if_format import IfFormat
from deepseis_core.interface import RECORD, require_interface
from deepseis_core.mcap_scan import Channel, McapScan, Message
from deepseis_core.types import IfBlock
from deepseis_frontend.if_stream import Remark

TOPIC: Final = "if/samples"
TYPE_NAME: Final = "deepseis_msgs/msg/IfBlock"
FIELDS: Final = (
    "std_msgs/Header header",
    "int64 sample_index",
    "uint32 sample_count",
    "float64 sample_rate_hz",
    "float64 intermediate_frequency_hz",
    "string format",
    "uint8[] data",
)
"""The definition that :func:`decode_if_block` reads; another one is refused."""

EARLIEST_UTC_NS: Final = 315_964_800 * 10**9  # 1980-01-06: earlier stamps are no clock
CDR_LITTLE_ENDIAN: Final = b"\x00\x01"


class StampedBlock(NamedTuple):
    """A block with the time in its header."""

    stamp_ns: int
    block: IfBlock


class _Cdr:
    """Reads CDR values at their alignment, which counts from behind the four-byte head."""

    def __init__(self, data: memoryview) -> None:
        if bytes(data[:2]) != CDR_LITTLE_ENDIAN:
            raise ValueError("not plain little-endian CDR")
        self.data, self.position = data[4:], 0

    def number(self, code: str) -> Any:
        """Read one number of a ``struct`` code."""
        size = struct.calcsize("<" + code)
        start = -(-self.position // size) * size
        self.position = start + size
        return struct.unpack_from("<" + code, self.data, start)[0]

    def octets(self) -> memoryview:
        """Read a counted sequence of bytes without copying it."""
        count = self.number("I")
        part = self.data[self.position : self.position + count]
        if len(part) != count:
            raise ValueError("shorter than its own length says")
        self.position += count
        return part

    def text(self) -> str:
        """Read a string."""
        return bytes(self.octets()).rstrip(b"\0").decode()


def decode_if_block(data: memoryview | bytes) -> StampedBlock:
    """Decode the CDR bytes of an ``IfBlock`` message; ``data`` of the block is a view.

    Raises
    ------
    ValueError, struct.error
        Where the bytes are no such message.
    """
    cdr = _Cdr(memoryview(data))
    seconds, nanoseconds = cdr.number("i"), cdr.number("I")
    cdr.text()
    index, count = cdr.number("q"), cdr.number("I")
    rate, frequency = cdr.number("d"), cdr.number("d")
    packing = cdr.text()
    block = IfBlock(
        sample_index=index,
        sample_count=count,
        sample_rate_hz=rate,
        intermediate_frequency_hz=frequency,
        format=packing,
        data=np.frombuffer(cdr.octets(), np.uint8),
    )
    return StampedBlock(seconds * 10**9 + nanoseconds, block)


def bag_files(path: str | Path) -> list[Path]:
    """List the MCAP files of a bag: the file itself, or those of a bag's folder in order.

    Raises
    ------
    InputError
        Where there are none.
    """
    path = Path(path)
    if not path.is_dir():
        return [path]
    index = path / "metadata.yaml"
    if not index.is_file():
        files = mcap_files(path)
    else:
        try:
            facts = yaml.safe_load(index.read_text(encoding="utf-8"))[
                "rosbag2_bagfile_information"
            ]
            storage, names = facts["storage_identifier"], facts["relative_file_paths"]
            files = [path / Path(str(name)).name for name in names]
        except (
            *(OSError, ValueError, KeyError, TypeError, RecursionError),
            yaml.YAMLError,
        ) as error:
            reason = " ".join(str(error).split())
            raise InputError(index, f"is not a bag's metadata: {reason}") from None
        if storage != "mcap":
            raise InputError(path, f"holds a bag in {storage!r} storage", "convert it to mcap")
    if not files:
        raise InputError(path, "holds no bag", "name an MCAP file or a folder with metadata.yaml")
    return files


def mcap_files(folder: Path) -> list[Path]:
    """List a folder's MCAP files in the order in which they were recorded.

    They end in a number; one that has none, as the head of a ring, comes first. Empty ones, left
    by a loss of power, do not count.
    """

    def order(path: Path) -> tuple[int, str]:
        number = re.search(r"_(\d{1,18})$", path.stem)
        return (int(number[1]) if number else -1), path.name

    found = [f for f in folder.glob("*.mcap") if not f.name.startswith(".")]
    return sorted((f for f in found if f.stat().st_size), key=order)


def first_messages(path: str | Path, count: int) -> Iterator[Message]:
    """Yield the first messages of a bag, damaged or not, over as many files as they take."""
    messages = (
        message for file in bag_files(path) for message in McapScan(file, tolerant=True).messages()
    )
    return islice(messages, count)


class IfBag:
    """The IF samples of a bag as an :class:`~deepseis_frontend.if_stream.IfSource`.

    Parameters
    ----------
    path : path
        MCAP file or bag folder.
    topic : str, optional
        Name of the topic, where the bag holds IF of several stations.

    Raises
    ------
    InputError
        Where there is no bag, no IF in it, or IF of another interface version.
    """

    def __init__(self, path: str | Path, topic: str | None = None) -> None:
        self.path = Path(path)
        self.files = bag_files(path)
        self._requested = topic
        self._found: str | None = topic
        self.remarks: list[Remark] = []
        self._known: set[int] = set()
        self.total_samples: int | None = None  # a pass over the bag would be needed
        first = next(self._messages(), None)
        if first is None:
            wanted = topic or f"topic ending in {TOPIC}"
            hint = "`process` and `record_if: false` leave them out: run the recording itself"
            raise InputError(self.path, f"holds no IF samples: no message on {wanted}", hint)
        block = first.block
        self.topic = self._found
        self.format = IfFormat.from_text(block.format)
        self.sample_rate_hz = block.sample_rate_hz
        self.intermediate_frequency_hz = block.intermediate_frequency_hz
        self.first_sample = block.sample_index
        self.start_utc_ns = self._start_utc_ns(first)

    def blocks(self) -> Iterator[IfBlock]:
        """Yield the recorded blocks as they are.

        Raises
        ------
        InputError
            Where samples go back in time, change their format, or the bag is damaged.
        """
        self.remarks.clear()
        expected = self.first_sample
        for _, block in self._messages():
            self._require_same_stream(block)
            missing = block.sample_index - expected
            if missing < 0:
                raise InputError(
                    self.path,
                    f"IF sample {block.sample_index} comes after sample {expected - 1}",
                    "the bag holds two runs, or a clock that was reset",
                )
            if missing:
                text = f"{missing} samples are missing before sample {block.sample_index}"
                self.remarks.append(Remark("gap", block.sample_index, text, missing))
            expected = block.sample_index + block.sample_count
            yield block
        if self._cut_at is not None:
            text = f"the bag is cut at byte {self._cut_at}"
            self.remarks.append(Remark("short_end", expected, text))

    def _messages(self) -> Iterator[StampedBlock]:
        self._cut_at: int | None = None
        self._found = self._requested
        for file in self.files:
            self._known.clear()
            scan = McapScan(file)
            for message in scan.messages(self._is_wanted):
                if RECORD in scan.metadata:
                    require_interface(file, scan.metadata)
                try:
                    yield decode_if_block(message.data)
                except (ValueError, struct.error) as error:
                    raise InputError(
                        file, f"holds an unreadable message on {message.channel.topic}: {error}"
                    ) from None
            self._cut_at = scan.cut_at

    def _is_wanted(self, channel: Channel) -> bool:
        if self._requested is not None:
            wanted = channel.topic == self._requested
        else:
            wanted = ("/" + channel.topic).endswith("/" + TOPIC)
        if not wanted:
            return False
        if self._found is None:
            self._found = channel.topic
        if channel.topic != self._found:
            raise InputError(
                self.path,
                f"holds IF of several stations: {self._found}, {channel.topic}",
                "name one",
            )
        self._require_known(channel)
        return True

    def _require_known(self, channel: Channel) -> None:
        if channel.type_name != TYPE_NAME or channel.encoding != "cdr":
            raise InputError(
                self.path, f"{channel.topic} is {channel.type_name} in {channel.encoding}, not IF"
            )
        if channel.schema_encoding == "ros2msg" and channel.id not in self._known:
            if definition(channel.schema) != FIELDS:
                raise InputError(
                    self.path, f"{channel.topic} was recorded with another definition of IfBlock"
                )
            self._known.add(channel.id)

    def _require_same_stream(self, block: IfBlock) -> None:
        if (
            block.sample_rate_hz != self.sample_rate_hz
            or block.intermediate_frequency_hz != self.intermediate_frequency_hz
            or IfFormat.from_text(block.format) != self.format
        ):
            raise InputError(
                self.path,
                f"the IF stream changes at sample {block.sample_index} to {block.format}, "
                f"{block.sample_rate_hz} Hz, IF {block.intermediate_frequency_hz} Hz",
            )
        if block.data.size != self.format.bytes_for(block.sample_count):
            raise InputError(
                self.path,
                f"the block at sample {block.sample_index} has {block.data.size} bytes "
                f"for {block.sample_count} samples of {block.format}",
            )

    def _start_utc_ns(self, first: StampedBlock) -> int | None:
        if first.stamp_ns < EARLIEST_UTC_NS:
            return None
        return first.stamp_ns - round(first.block.sample_index / self.sample_rate_hz * 1e9)


def definition(schema: bytes) -> tuple[str, ...]:
    """Return the fields of a ``ros2msg`` schema's own message, without comments."""
    lines = []
    for line in schema.decode("utf-8", "replace").splitlines():
        if line.startswith("==="):
            break
        words = line.partition("#")[0].split()
        if words:
            lines.append(" ".join(words))
    return tuple(lines)
