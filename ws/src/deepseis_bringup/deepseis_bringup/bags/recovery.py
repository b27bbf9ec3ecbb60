"""Makes a bag whole that was cut short or damaged, and says what was lost, topic by topic."""

from __future__ import annotations

import errno
import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from deepseis_bringup.bags.file_end import file_end
from deepseis_bringup.bags.mcap_file import McapFile
from deepseis_bringup.bags.mcap_recording import METADATA, write_metadata_yaml
from deepseis_core.errors import InputError
from deepseis_core.interface import RECORD
from deepseis_core.mcap_scan import Channel, McapScan
from deepseis_frontend.if_bag import bag_files, mcap_files

KEPT = ".damaged"
"""What the name of a file gets that is kept as it was."""


@dataclass(frozen=True)
class Loss:
    """Messages of one topic that are missing between two that are there.

    ``count`` is how many, by the publisher's sequence numbers; at the end of a file nobody knows
    it: -1. ``after_ns`` is the last stamp before (0: none), ``before_ns`` the first after.
    """

    topic: str
    count: int
    after_ns: int
    before_ns: int


@dataclass(frozen=True)
class Recovery:
    """What became of one file; one without a message that can be read is left as it is."""

    path: Path
    was_whole: bool
    messages: int
    damaged_chunks: int = 0
    cut_at: int | None = None
    lost_bytes: int = 0
    kept_as: Path | None = None
    losses: tuple[Loss, ...] = ()


@dataclass
class _Topic:
    """Where a topic's messages stand in a file."""

    next_number: int = -1
    last_ns: int = 0


@dataclass
class _Tally:
    """Counts messages; notes where sequence numbers leap."""

    count: int = 0
    start_ns: int = 2**63 - 1
    end_ns: int = 0
    counts: dict[int, int] = field(default_factory=dict)
    topics: dict[str, _Topic] = field(default_factory=dict)
    losses: list[Loss] = field(default_factory=list)

    def look(self, channel: Channel, sequence: int, time_ns: int) -> None:
        """Take the next message."""
        self.count += 1
        self.start_ns, self.end_ns = min(self.start_ns, time_ns), max(self.end_ns, time_ns)
        self.counts[channel.id] = self.counts.get(channel.id, 0) + 1
        topic = self.topics.setdefault(channel.topic, _Topic(0))
        missing = sequence - topic.next_number
        if missing > 0:
            self.losses.append(Loss(channel.topic, missing, topic.last_ns, time_ns))
        topic.next_number, topic.last_ns = sequence + 1, time_ns

    def falls_short_of(self, stated: int | None) -> bool:
        """Tell whether more is missing than the leaps of sequence numbers tell."""
        return stated is not None and self.count + sum(x.count for x in self.losses) < stated

    def ended(self, *, early: bool) -> tuple[Loss, ...]:
        """Return the losses; where a file was cut each topic may go on behind its end."""
        tails = [Loss(name, -1, topic.last_ns, 0) for name, topic in self.topics.items()]
        return (*self.losses, *(tails if early else ()))


def recover_bag(
    path: str | Path, *, target: str | Path | None = None, replace: bool = False
) -> list[Recovery]:
    """Make a bag whole: rewrite what can be read of each damaged file, with index and metadata.

    Parameters
    ----------
    path : path
        A bag's folder or an MCAP file.
    target : path, optional
        Folder, new or empty, for a whole bag beside the damaged one, which is only read.
    replace : bool, optional
        Do not keep damaged files. Otherwise each stays beside its successor as
        ``<name>.mcap.damaged``.

    Returns
    -------
    list of Recovery
        One for each file, in order.

    Raises
    ------
    InputError
        There is no bag, not one message in it can be read, or it is being recorded.
    """
    path = Path(path)
    files = _files(path)
    folder = _new_folder(target) if target is not None else None
    alone = len(files) == 1
    results = [_one(file, folder, replace=replace, alone=alone) for file in files]
    if not any(result.messages or result.was_whole for result in results):
        raise InputError(path, "holds no message that can be read")
    home = folder or (path if path.is_dir() else path.parent)
    described = (home / METADATA).is_file()
    rewritten = not all(result.was_whole for result in results)
    if folder is not None or (path.is_dir() and not described) or (described and rewritten):
        _describe(home, [home / item.path.name for item in results if item.messages])
    return results


def _files(path: Path) -> list[Path]:
    """Return a bag's files: all of its folder, also those that its metadata do not name."""
    if not path.is_dir():
        return [path]
    empty = [file for file in path.glob("*.mcap") if not _size(file)]
    files = [*mcap_files(path), *empty]
    if len(files) == len(empty):
        with suppress(InputError):
            bag_files(path)  # names its kind if it is another
        reason = "holds nothing but empty files" if empty else "holds no bag"
        raise InputError(path, reason, "name an MCAP file or a folder with MCAP files")
    return files


def _new_folder(target: str | Path) -> Path:
    folder = Path(target)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise InputError(folder, "is not empty", "name a new folder")
    except OSError as error:
        raise InputError(folder, f"cannot be made: {error.strerror}") from None
    return folder


def _one(file: Path, folder: Path | None, *, replace: bool, alone: bool) -> Recovery:
    """Recover one file, in place or into a folder."""
    if not _size(file) and not alone:
        return Recovery(file, was_whole=False, messages=0)
    with _not_in_use(file):
        whole = _whole(file, alone=alone)
        if whole is not None and (folder is None or not whole.messages):
            return whole
        try:
            return _rewrite(file, folder, whole, replace=replace)
        except OSError as error:
            raise InputError(file, f"cannot be recovered: {error.strerror or error}") from None


def _size(file: Path) -> int:
    try:
        return file.stat().st_size
    except OSError as error:
        raise InputError(file, error.strerror or str(error)) from None


@contextmanager
def _not_in_use(file: Path) -> Iterator[None]:
    """Refuse a file that a recorder has open (it holds a lock; see `McapFile`)."""
    try:
        stream = file.open("rb")
    except OSError as error:
        raise InputError(file, error.strerror or str(error)) from None
    with stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno in (errno.EAGAIN, errno.EACCES):
                reason = "is being recorded"
                raise InputError(file, reason, "end the recorder first") from None
        yield


def _whole(file: Path, *, alone: bool) -> Recovery | None:
    """Return the state of a file that need not be rewritten, or that holds nothing."""
    try:
        scan = McapScan(file, tolerant=True)
    except InputError:
        if alone:
            raise
        return Recovery(file, was_whole=False, messages=0, lost_bytes=_size(file))
    count = sum(1 for _ in scan.messages())
    end = file_end(file)
    is_read = scan.cut_at is None and not scan.damaged_chunks
    if is_read and end.is_sound and end.message_count in (None, count):
        return Recovery(file, was_whole=True, messages=count)
    if not count:
        return Recovery(file, was_whole=False, messages=0, lost_bytes=_size(file))
    return None


def _rewrite(
    file: Path, folder: Path | None, whole: Recovery | None, *, replace: bool
) -> Recovery:
    size = _size(file)
    draft = (folder or file.parent) / f".{file.name}.recovering"
    draft.unlink(missing_ok=True)
    scan = McapScan(file, tolerant=True)
    try:
        tally = _copy(scan, draft)
        short = scan.cut_at is not None or tally.falls_short_of(file_end(file).message_count)
        _sync(draft)
        kept = _keep(file) if folder is None and not replace else None
        os.replace(draft, (folder or file.parent) / file.name)
    except BaseException:
        with suppress(OSError):
            draft.unlink(missing_ok=True)
        raise
    return Recovery(
        file,
        was_whole=whole is not None,
        messages=tally.count,
        damaged_chunks=scan.damaged_chunks,
        cut_at=scan.cut_at,
        lost_bytes=0 if scan.cut_at is None else size - scan.cut_at,
        kept_as=kept,
        losses=tally.ended(early=short),
    )


def _keep(file: Path) -> Path:
    """Give a damaged file a second name, under which it stays when it is replaced."""
    number = 0
    while True:
        kept = file.with_name(f"{file.name}{KEPT}{number or ''}")
        try:
            os.link(file, kept)
            return kept
        except FileExistsError:
            number += 1
        except OSError:  # a file system without hard links
            os.rename(file, kept)
            return kept


def _sync(path: Path) -> None:
    """See that a file is on the disk before it replaces another."""
    with path.open("rb") as stream:
        os.fsync(stream.fileno())


def _copy(scan: McapScan, target: Path) -> _Tally:
    """Copy what can be read into a new file; metadata first, as it was first."""
    tally = _Tally()
    messages = scan.messages()
    first = next(messages, None)
    out = McapFile(target, profile=scan.profile)
    done = set(scan.metadata)
    try:
        for name, values in scan.metadata.items():
            out.add_metadata(name, values)
        numbers: dict[int, int] = {}
        for message in (item for part in ([first], messages) for item in part):
            if message is None:
                break
            channel = message.channel
            if channel.id not in numbers:
                numbers[channel.id] = _add(out, channel)
            tally.look(channel, message.sequence, message.log_time_ns)
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
    return tally


def _add(out: McapFile, channel: Channel) -> int:
    return out.add_channel(
        channel.topic,
        channel.type_name,
        channel.schema,
        channel.metadata,
        schema_encoding=channel.schema_encoding,
        encoding=channel.encoding,
    )


@dataclass
class _Facts:
    """What ``metadata.yaml`` says of one file."""

    path: Path
    channels: dict[int, Channel]
    counts: dict[int, int]
    start_ns: int
    end_ns: int


def _describe(folder: Path, files: list[Path]) -> None:
    """Write ``metadata.yaml`` for a folder that lost or never had one."""
    facts = []
    custom: dict[str, str] = {}
    for file in files:
        scan, tally = McapScan(file, tolerant=True), _Tally()
        for message in scan.messages():
            tally.look(message.channel, message.sequence, message.log_time_ns)
        facts.append(_Facts(file, scan.channels, tally.counts, tally.start_ns, tally.end_ns))
        custom |= {f"{RECORD}.{k}": value for k, value in scan.metadata.get(RECORD, {}).items()}
    write_metadata_yaml(folder, facts, custom)
