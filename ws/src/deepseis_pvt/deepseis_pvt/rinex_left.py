"""RINEX observation files that a process left unfinished when it died."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from typing import Final

from deepseis_core.constants import NS_PER_S
from deepseis_core.gps_time import GpsTime
from deepseis_core.rinex_nav import rinex3_name

ENDING: Final = ".rnx.part"
"""Of a file that still grows."""
LABEL: Final = 60
"""Column at which a header line's label begins."""
END_BYTES: Final = 65_536
"""Looked at of either end: a header, and some epochs [B]."""
HOUR_NS: Final = 3600 * NS_PER_S


@dataclass(frozen=True)
class LeftFile:
    """An unfinished file and what is whole in it.

    Attributes
    ----------
    path : Path
    version : str
        Of RINEX.
    start, last : GpsTime
        First and last whole epoch.
    interval : float
        [s]
    size : int
        Bytes up to the end of the last whole epoch.
    """

    path: Path
    version: str
    start: GpsTime
    last: GpsTime
    interval: float
    size: int

    @classmethod
    def read(cls, path: Path) -> LeftFile | None:
        """Look at a file's two ends; None where it has no whole epoch."""
        with path.open("rb") as file:
            first = file.read(END_BYTES)
        tail = _tail(path)
        begin = path.stat().st_size - len(tail)
        head, found, _ = first.partition(b"END OF HEADER")
        body = len(head) + len(found) + 1
        starts = _epochs(first, body)
        ends = [(time, size) for time, size in _epochs(tail, max(0, body - begin)) if size]
        if not (found and starts and ends):
            return None
        lines = head.decode("ascii", "replace").splitlines()
        fields = {line[LABEL:].strip(): line[:LABEL].split() for line in lines}
        try:
            version, interval = fields["RINEX VERSION / TYPE"][0], float(fields["INTERVAL"][0])
        except (KeyError, ValueError, IndexError):
            return None
        last, size = ends[-1]
        return cls(path, version, starts[0][0], last, interval, begin + size)

    def goes_on(self, time: GpsTime, interval: float, version: str) -> bool:
        """Tell whether an epoch may follow: of the same hour, kind and spacing."""
        same = (version, round(1e3 * interval)) == (self.version, round(1e3 * self.interval))
        hours = {moment.total_ns // HOUR_NS for moment in (self.start, time)}
        return same and len(hours) == 1 and time.diff_ns(self.last) > 0

    def finish(self, station: str) -> Path | None:
        """Give the file its name; None where another one has it, and it stays what it is."""
        seconds = self.last.diff_ns(self.start) / NS_PER_S + self.interval
        name = rinex3_name(station, self.start, seconds, "GO", interval_s=self.interval)
        target = self.path.with_name(name)
        if target.exists():
            return None
        with self.path.open("r+b") as file:
            file.truncate(self.size)
        return self.path.replace(target)


def _tail(path: Path) -> bytes:
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - END_BYTES))
        return file.read()


def _epochs(data: bytes, begin: int) -> list[tuple[GpsTime, int]]:
    """Return times of the epochs in a piece, and where each ends in it; 0: not in it."""
    found, place = list[tuple[GpsTime, int]](), data.find(b"> ", begin)
    while place >= 0:
        line, _, rest = data[place:].partition(b"\n")
        time, count = _epoch_line(line)
        if time is None:
            break
        records = rest.split(b"\n", count)
        whole = len(records) == count + 1
        end = len(data) - len(records[-1]) if whole else 0
        found.append((time, end))
        place = data.find(b"> ", end) if whole else -1
    return found


def _epoch_line(line: bytes) -> tuple[GpsTime | None, int]:
    try:
        words = line.decode("ascii").split()
        year, month, day, hour, minute = map(int, words[1:6])
        second, _, part = words[6].partition(".")
        ns = int(second) * NS_PER_S + int(part.ljust(9, "0"))
        return GpsTime.from_calendar(year, month, day, hour, minute, ns), int(words[8])
    except (ValueError, IndexError):
        return None, 0


def left_files(folder: Path, station: str) -> Iterator[LeftFile]:
    """Yield a station's files that nobody writes to any more.

    Ones without a whole epoch go; one whose header is damaged stays as it is.
    """
    for path in sorted(folder.glob(f"{station}_*{ENDING}")):
        if is_being_written(path):
            continue
        found = LeftFile.read(path)
        if found is not None:
            yield found
        elif not any(end for _, end in _epochs(_tail(path), 0)):
            path.unlink()


def take(file: FileIO) -> None:
    """Keep a file for as long as it is open: what still grows has not been left."""
    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def is_being_written(path: Path) -> bool:
    """Tell whether a process that lives has taken a file."""
    with path.open("rb", buffering=0) as file:
        try:
            take(file)
        except BlockingIOError:
            return True
    return False


def finish_left(folder: Path) -> list[Path]:
    """Finish what dead processes left in a run's folder; returns the files."""
    stations = sorted({path.name.split("_")[0] for path in folder.glob(f"*{ENDING}")})
    found = [(left, name) for name in stations for left in left_files(folder, name)]
    return [path for left, name in found if (path := left.finish(name)) is not None]
