"""RINEX 3.05 and 4.02 observation files, written epoch by epoch.

The file grows under a temporary name and takes its long name (which holds the period covered)
when it is closed. After each second of data everything written is handed to the system, so a
killed process loses one second at most; the next one in the same folder goes on with its file.
"""

from __future__ import annotations

import datetime as dt
import os
from dataclasses import dataclass, replace
from io import FileIO
from pathlib import Path
from types import TracebackType

import numpy as np

from deepseis_core.constants import NS_PER_S
from deepseis_core.errors import InputError
from deepseis_core.gps_time import GpsTime
from deepseis_core.rinex_nav import rinex3_name
from deepseis_core.types import FloatArray, Observations
from deepseis_pvt.rinex_left import ENDING, left_files, take

OBSERVATION_TYPES = "C1C L1C D1C S1C"
VERSIONS = ("3.05", "4.02")


@dataclass(frozen=True)
class RinexStation:
    """What the header says of the station.

    ``name`` is the nine-character RINEX station name (site, monument, receiver, country);
    ``position_ecef`` the approximate position [m]; ``antenna_hen`` the antenna's height, east
    and north offset from the marker [m].
    """

    name: str = "DSEI00XXX"
    marker: str = "DEEPSEIS"
    observer: str = ""
    agency: str = ""
    run_by: str = ""
    receiver_number: str = ""
    receiver: str = "DEEPSEIS"
    receiver_version: str = ""
    antenna_number: str = ""
    antenna: str = "UNKNOWN"
    position_ecef: tuple[float, float, float] | None = None
    antenna_hen: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        """Refuse a name that cannot begin a RINEX long file name."""
        if len(self.name) != 9 or not (self.name.isascii() and self.name.isalnum()):
            raise InputError(
                f"station name {self.name!r}", "is not nine letters and digits", "as in DSEI00CHN"
            )


def epoch_line(time: GpsTime, n_satellites: int) -> str:
    """Return the epoch record; seconds to 100 ns from integers.

    Examples
    --------
    >>> epoch_line(GpsTime.from_calendar(2022, 1, 1, 2, 0, 59_980_000_000), 8)
    '> 2022 01 01 02 00 59.9800000  0  8'
    """
    year, month, day, hour, minute, ns = time.to_calendar()
    second, rest = divmod(ns, NS_PER_S)
    date = f"{year:4d} {month:02d} {day:02d} {hour:02d} {minute:02d}"
    return f"> {date} {second:2d}.{rest // 100:07d}  0{n_satellites:3d}"


def satellite_line(
    satellite: str, code: float, phase: float, doppler: float, cn0: float, lli: int
) -> str:
    """Return one satellite's record: C1C, L1C with LLI, D1C, S1C; unknown values blank.

    Examples
    --------
    >>> satellite_line("G05", 21487708.6921, 112918674.5844, -2685.48, 40.26, 1)
    'G05  21487708.692   112918674.58416     -2685.480          40.260'
    """
    strength = min(max(int(cn0 // 6), 1), 9)
    marks = f"{lli if lli else ' '}{strength}"
    carrier = f"{phase:14.3f}{marks}" if phase == phase else " " * 16
    return f"{satellite}{code:14.3f}  {carrier}{doppler:14.3f}  {cn0:14.3f}"


def epoch_text(observations: Observations, time: GpsTime) -> str:
    """Return an epoch's records, satellites in order of their names."""
    o = observations
    columns = (
        o.pseudorange.tolist(),
        o.carrier_phase_cycles.tolist(),
        o.carrier_doppler_hz.tolist(),
        o.cn0_dbhz.tolist(),
        o.lli.tolist(),
    )
    lines = sorted(map(satellite_line, o.satellites, *columns))
    return "\n".join([epoch_line(time, len(lines)), *lines, ""])


def header_lines(
    station: RinexStation,
    start: GpsTime,
    interval: float,
    created: dt.datetime,
    version: str = "3.05",
) -> list[str]:
    """Return the header of a GPS-only observation file, one line each.

    Version 4 no longer knows phase shifts; all else of a GPS file is the same.
    """
    s = station
    year, month, day, hour, minute, ns = start.to_calendar()
    x, y, z = s.position_ecef or (0.0, 0.0, 0.0)
    height, east, north = s.antenna_hen
    seconds = f"{ns // NS_PER_S:5d}.{ns % NS_PER_S // 100:07d}"
    first = f"{year:6d}{month:6d}{day:6d}{hour:6d}{minute:6d}{seconds}"
    n_types = len(OBSERVATION_TYPES.split())
    run = f"{'DeepSeis':<20.20}{s.run_by:<20.20}{created:%Y%m%d %H%M%S} UTC"
    receiver = f"{s.receiver_number:<20.20}{s.receiver:<20.20}{s.receiver_version:<20.20}"
    records = [
        (f"{version:>9}{'':11}{'OBSERVATION DATA':<20}{'G: GPS':<20}", "RINEX VERSION / TYPE"),
        (run, "PGM / RUN BY / DATE"),
        (f"{s.marker:<60.60}", "MARKER NAME"),
        (f"{'GEODETIC':<20}", "MARKER TYPE"),
        (f"{s.observer:<20.20}{s.agency:<40.40}", "OBSERVER / AGENCY"),
        (receiver, "REC # / TYPE / VERS"),
        (f"{s.antenna_number:<20.20}{s.antenna:<20.20}", "ANT # / TYPE"),
        (f"{x:14.4f}{y:14.4f}{z:14.4f}", "APPROX POSITION XYZ"),
        (f"{height:14.4f}{east:14.4f}{north:14.4f}", "ANTENNA: DELTA H/E/N"),
        (f"G  {n_types:3d} {OBSERVATION_TYPES}", "SYS / # / OBS TYPES"),
        ("DBHZ", "SIGNAL STRENGTH UNIT"),
        (f"{interval:10.3f}", "INTERVAL"),
        (f"{first}     GPS", "TIME OF FIRST OBS"),
        (f"{0:6d}", "RCV CLOCK OFFS APPL"),
        *[(f"G L1C {0:8.5f}", "SYS / PHASE SHIFT")] * (version < "4"),
        (f"{start.leap_seconds():6d}", "LEAP SECONDS"),
        ("", "END OF HEADER"),
    ]
    return [f"{text:<60.60}{label}" for text, label in records]


class RinexObsWriter:
    """Writes ``Observations`` to one file; a context manager.

    Parameters
    ----------
    folder : path
        Where the file goes; must exist.
    station : RinexStation
        For the header and the file's name.
    created : datetime, optional
        UTC for the PGM / RUN BY / DATE line; default now.
    version : {'3.05', '4.02'}, optional
        Of RINEX.
    """

    def __init__(
        self,
        folder: str | os.PathLike[str],
        station: RinexStation | None = None,
        created: dt.datetime | None = None,
        version: str = VERSIONS[0],
    ) -> None:
        if version not in VERSIONS:
            raise InputError(f"RINEX version {version}", "is not written", " or ".join(VERSIONS))
        self.version = version
        self.folder = Path(folder)
        if not self.folder.is_dir():
            raise InputError(self.folder, "is not a folder", "make it, or name another one")
        self.station = station or RinexStation()
        self.created = created or dt.datetime.now(dt.UTC)
        self.path: Path | None = None
        self._file: FileIO | None = None
        self._size = 0
        self._start: GpsTime | None = None
        self._last = GpsTime(0, 0)
        self._interval = 1.0
        self._waiting = ""

    def write(self, observations: Observations, position_ecef: FloatArray | None = None) -> None:
        """Append one epoch. Epochs without satellites are left out: readers stumble over them.

        ``position_ecef`` [m] serves the header where the station's own is not known; the header
        waits for it for half a second of data at most.
        """
        o = observations
        if not o.satellites:
            return
        time = GpsTime(o.week, o.tow_ns)
        self._start, self._interval = self._start or time, o.interval
        text = epoch_text(o, time)
        if self._file is None:
            self._waiting += text
            known = position_ecef is not None or self.station.position_ecef is not None
            if known or time.diff_ns(self._start) >= NS_PER_S // 2:
                self._open(position_ecef)
        else:
            self._waiting += text
        before, self._last = self._last, time
        if self._file and time.total_ns // NS_PER_S != before.total_ns // NS_PER_S:
            self.flush()

    @property
    def waiting(self) -> int:
        """Characters that are not in the file yet."""
        return len(self._waiting)

    def flush(self) -> None:
        """Write the whole epochs that wait; where that fails they go on waiting.

        Raises
        ------
        OSError
            Nothing of them is in the file.
        """
        if self._file is None:
            return
        data = memoryview(self._waiting.encode("ascii"))
        size = self._size + len(data)
        try:
            while len(data):
                data = data[self._file.write(data) :]
        except OSError:
            self._file.truncate(self._size)
            self._file.seek(self._size)
            raise
        self._size, self._waiting = size, ""

    def drop(self) -> int:
        """Give up the epochs that wait behind others; returns how many."""
        if not self._size:
            return 0
        dropped, self._waiting = self._waiting.count("> "), ""
        return dropped

    def close(self) -> Path | None:
        """Finish the file and give it its name; None if there was no epoch."""
        if self._waiting and self._file is None:
            self._open(None)
        if self._file is None or self.path is None or self._start is None:
            return None
        self.flush()
        self._file.close()
        self._file = None
        seconds = self._last.diff_ns(self._start) / NS_PER_S + self._interval
        name = rinex3_name(
            self.station.name, self._start, seconds, "GO", interval_s=self._interval
        )
        self.path = self.path.replace(self.folder / name)
        return self.path

    def _open(self, position: FloatArray | None) -> None:
        assert self._start is not None
        if self._go_on():
            return
        year, month, day, hour, minute, ns = self._start.to_calendar()
        stamp = f"{year:04d}{month:02d}{day:02d}{hour:02d}{minute:02d}{ns // NS_PER_S:02d}"
        self.path = self.folder / f"{self.station.name}_{stamp}{ENDING}"
        station = self.station
        if station.position_ecef is None and position is not None and np.isfinite(position).all():
            x, y, z = map(float, position)
            station = replace(station, position_ecef=(x, y, z))
        header = header_lines(station, self._start, self._interval, self.created, self.version)
        self._file, self._size = self.path.open("wb", buffering=0), 0
        take(self._file)
        self._waiting = "\n".join(header) + "\n" + self._waiting
        self.flush()

    def _go_on(self) -> bool:
        """Go on with what one that died has left of this hour; what it left of others, finish."""
        assert self._start is not None
        for left in left_files(self.folder, self.station.name):
            if self._file or not left.goes_on(self._start, self._interval, self.version):
                left.finish(self.station.name)
                continue
            self.path, self._start, self._size = left.path, left.start, left.size
            self._file = self.path.open("r+b", buffering=0)
            take(self._file)
            self._file.truncate(self._size)
            self._file.seek(self._size)
        if self._file is not None:
            self.flush()
        return self._file is not None

    def __enter__(self) -> RinexObsWriter:
        """Return the writer."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close: the epochs before an error are whole."""
        self.close()
