"""Reading one kind of message out of a bag, for whoever plays it."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from deepseis_core.errors import InputError
from deepseis_core.interface import RECORD, require_interface
from deepseis_core.mcap_scan import LOGGED_EARLY_NS, Channel, McapScan


def is_on(channel: Channel, topic: str) -> bool:
    """Tell whether a channel is a topic, under whatever namespace."""
    return ("/" + channel.topic).endswith("/" + topic)


def bag_values(
    path: Path,
    files: Sequence[Path],
    topics: Mapping[str, tuple[str, Callable[[bytes], Any]]],
    since_ns: int = 0,
) -> Iterator[Any]:
    """Yield what the messages on some topics of a bag say, as recorded.

    Parameters
    ----------
    path : Path
        The bag, for complaints.
    files : sequence of Path
        Its files, in order.
    topics : mapping
        Type that each topic must have, and what decodes its messages: a `ValueError` means that
        one cannot be read.
    since_ns : int, optional
        UTC [ns]: parts of the bag that were written long before this are not read.

    Raises
    ------
    InputError
        A topic has another type, a message cannot be read, or the bag is damaged.
    """

    def topic_of(channel: Channel) -> str:
        return next((topic for topic in topics if is_on(channel, topic)), "")

    def is_wanted(channel: Channel) -> bool:
        topic = topic_of(channel)
        if topic and (channel.type_name != topics[topic][0] or channel.encoding != "cdr"):
            reason = f"{channel.topic} is {channel.type_name} in {channel.encoding}"
            raise InputError(path, reason, f"not {topics[topic][0]}")
        return bool(topic)

    for file in files:
        scan = McapScan(file)
        for message in scan.messages(is_wanted, since_ns=_log_time(file, is_wanted, since_ns)):
            if RECORD in scan.metadata:
                require_interface(file, scan.metadata)
            try:
                value = topics[topic_of(message.channel)][1](bytes(message.data))
            except ValueError as error:
                reason = f"holds an unreadable message on {message.channel.topic}: {error}"
                raise InputError(file, reason) from None
            yield value


def _log_time(file: Path, is_wanted: Callable[[Channel], bool], since_ns: int) -> int:
    """Return the log time [ns] before which no message of a stamp has been written."""
    first = next(McapScan(file).messages(is_wanted), None) if since_ns else None
    if first is None:
        return 0
    seconds, nanoseconds = struct.unpack_from("<iI", first.data, 4)
    return since_ns + first.log_time_ns - (seconds * 10**9 + nanoseconds) - LOGGED_EARLY_NS


def later(path: Path, what: str, sample_index: int, last: int, hint: str) -> int:
    """Return a sample index that comes after the last one.

    Raises
    ------
    InputError
        It does not.
    """
    if sample_index <= last:
        raise InputError(path, f"{what} at {sample_index} comes after that at {last}", hint)
    return sample_index
