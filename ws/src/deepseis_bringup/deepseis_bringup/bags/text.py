"""Says in words what a bag holds and what became of one that was recovered."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from deepseis_bringup.bags.info import BagInfo, TopicInfo
from deepseis_bringup.bags.recovery import Loss, Recovery

FIRST_GPS_SECOND = 315_964_800
"""Of 1980-01-06 [s since 1970]."""
MANY = 4
"""From so many topics on those that end together are told in one line."""
TOGETHER_NS = 1_000_000_000
NUMBERS = ("messages", "Hz", "first [s]", "last [s]", "MB")


def size_text(count: float) -> str:
    """Write a number of bytes in decimal units.

    Examples
    --------
    >>> size_text(1_234_567)
    '1.23 MB'
    """
    unit = 0
    while count >= 999.5 and unit < 4:
        count, unit = count / 1000.0, unit + 1
    return f"{count:.3g} {('B', 'kB', 'MB', 'GB', 'TB')[unit]}"


def utc_text(utc_ns: int) -> str:
    """Write UTC nanoseconds since 1970 to the millisecond; nobody recorded GPS before 1980.

    Examples
    --------
    >>> utc_text(1_640_995_200_500_000_000)
    '2022-01-01 00:00:00.500 UTC'
    """
    seconds, ns = divmod(utc_ns, 10**9)
    if seconds < FIRST_GPS_SECOND:
        return "at an unknown time"
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%d %H:%M:%S}.{ns // 10**6:03d} UTC"


def info_lines(info: BagInfo) -> list[str]:
    """Return what is to be said of the bag as a whole."""
    lines = [
        f"{info.path}: {len(info.files)} MCAP file{'s' * (len(info.files) != 1)}, "
        f"{size_text(info.size_bytes)}, {info.message_count} messages, {info.duration:.3f} s"
    ]
    if info.start_ns is not None:
        lines.append(f"starts {utc_text(info.start_ns)} by the coarse clock")
    version = info.interface_version
    if info.duration > 1.0:
        rate = info.size_bytes / info.duration
        lines.append(f"{size_text(rate)} a second, {size_text(rate * 86_400)} a day")
    lines.append(f"interface version {version}" if version else "not recorded by DeepSeis")
    if info.attachments:
        lines.append("attachments: " + ", ".join(info.attachments))
    return lines + damage_lines(info)


def damage_lines(info: BagInfo) -> list[str]:
    """Return what is wrong with a bag."""
    lines = []
    if info.cut_at is not None:
        lines.append(f"CUT SHORT after {size_text(info.cut_at)}: deepseis recover {info.path}")
    elif not info.has_index:
        lines.append(f"HAS NO INDEX: deepseis recover {info.path}")
    if info.damaged_chunks:
        lines.append(f"{info.damaged_chunks} DAMAGED CHUNKS, their messages are lost")
    if info.passed_over:
        lines.append(
            f"{info.passed_over} MESSAGES LESS THAN IT SAYS: deepseis recover {info.path}"
        )
    lines += [remark.text for remark in info.if_remarks]
    return lines or ["whole, no samples missing"]


def _row(topic: TopicInfo, start_ns: int) -> tuple[str, ...]:
    rate = f"{topic.rate_hz:.2f}" if topic.count > 1 else ""
    first = (topic.start_ns - start_ns) / 1e9 if topic.count else 0.0
    last = (topic.end_ns - start_ns) / 1e9 if topic.count else 0.0
    times = (f"{first:.3f}", f"{last:.3f}") if topic.count else ("", "")
    return topic.name, topic.type_name, str(topic.count), rate, *times, f"{topic.bytes / 1e6:.3f}"


def show_info(info: BagInfo, console: Console | None = None) -> None:
    """Print what a bag holds: a table where a person reads, tabs where a program does.

    Parameters
    ----------
    info : BagInfo
        From `bag_info.bag_info`.
    console : Console, optional
        Default: standard output.
    """
    console = console or Console(highlight=False)
    for line in info_lines(info):
        console.print(line, markup=False, soft_wrap=True)
    start_ns = info.start_ns or 0
    rows = [_row(info.topics[name], start_ns) for name in sorted(info.topics)]
    if not console.is_terminal:
        for row in (("topic", "type", *NUMBERS), *rows):
            print("\t".join(row), file=console.file)  # rich would make blanks of the tabs
        return
    table = Table(box=SIMPLE_HEAD, padding=(0, 1))
    table.add_column("topic", no_wrap=True)
    table.add_column("type", overflow="fold")
    for title in NUMBERS:
        table.add_column(title.replace("[", r"\["), justify="right", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    console.print(table)


def recovery_lines(results: Sequence[Recovery]) -> list[str]:
    """Return a line for each file of a bag that was recovered, and one for each loss in it."""
    lines = []
    for result in results:
        text = f"{result.path}: {result.messages} messages"
        if result.was_whole:
            lines.append(f"{text}, was whole, left as it is")
            continue
        if not result.messages:
            lines.append(f"{text} can be read, left as it is ({size_text(result.lost_bytes)})")
            continue
        lost = [f"{size_text(result.lost_bytes)} at the end"] * (result.lost_bytes > 0)
        lost += [f"{result.damaged_chunks} damaged chunks"] * (result.damaged_chunks > 0)
        lines.append(f"{text} kept, lost: {' and '.join(lost) or 'nothing'}")
        lines += [f"  {line}" for line in _loss_lines(result.losses)]
        if result.kept_as is not None:
            lines.append(f"  the damaged file is {result.kept_as}")
    return lines


def _loss_lines(losses: Sequence[Loss]) -> list[str]:
    """Say each loss; topics that end together, as all do where a file is cut, in one line."""
    last = max((loss.after_ns for loss in losses if loss.count < 0), default=0)
    ends = [x for x in losses if x.count < 0 and last - x.after_ns <= TOGETHER_NS]
    if len(ends) < MANY:
        return [loss_text(loss) for loss in losses]
    first = min(loss.after_ns for loss in ends)
    text = f"{len(ends)} topics: nothing after {utc_text(first)} to {utc_text(last)}"
    return [text, *(loss_text(loss) for loss in losses if loss not in ends)]


def loss_text(loss: Loss) -> str:
    """Say what is missing of a topic, and between which stamps.

    Examples
    --------
    >>> loss_text(Loss("/gnss/pvt", 3, 1_640_995_200_100_000_000, 1_640_995_200_500_000_000))
    '/gnss/pvt: 3 lost between 2022-01-01 00:00:00.100 UTC and 2022-01-01 00:00:00.500 UTC'
    """
    after = utc_text(loss.after_ns) if loss.after_ns else "the start"
    if loss.count < 0:
        return f"{loss.topic}: nothing after {after}"
    return f"{loss.topic}: {loss.count} lost between {after} and {utc_text(loss.before_ns)}"
