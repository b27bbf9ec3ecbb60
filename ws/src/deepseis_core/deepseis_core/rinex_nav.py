"""RINEX navigation files of GPS: versions 2.x, 3.x and 4.00 read, 3.05 written.

Version 4 is written by `rinex_nav4`.

Records of other systems and of CNAV are passed over. Anything malformed is an `InputError` that
names file and line.
"""

from __future__ import annotations

import dataclasses
import gzip
import math
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from deepseis_core.constants import NS_PER_S, S_PER_WEEK
from deepseis_core.errors import DiskError, InputError
from deepseis_core.gps_time import GpsTime
from deepseis_core.lnav import UtcParameters
from deepseis_core.types import Ephemeris

# The numbers of lines 1 to 7 of a record, four a line; None: not kept. The fit interval is last.
_ORBIT = (
    *("iode", "crs", "delta_n", "m0", "cuc", "eccentricity", "cus", "sqrt_a"),
    *("toe", "cic", "omega0", "cis", "i0", "crc", "omega", "omega_dot"),
    *("i_dot", "l2_code", "week", "l2p_flag", "accuracy", "health", "tgd", "iodc"),
    *("transmit_tow", "fit_hours"),
)
_NEEDED = _ORBIT[:17]
_INTEGERS = ("iode", "l2_code", "l2p_flag", "health", "iodc")


@dataclass(frozen=True)
class NavigationFile:
    """What a navigation file holds; ``leap_seconds`` None and empty tuples where it is silent."""

    ephemerides: list[Ephemeris]
    iono_alpha: tuple[float, ...] = ()
    iono_beta: tuple[float, ...] = ()
    leap_seconds: int | None = None
    utc: UtcParameters | None = None
    version: float = 3.05


class _Lines:
    """The lines of a file with their place, and the errors that name it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.number = 0
        self._lines = _read_text(path).splitlines()

    def take(self) -> str | None:
        """Return the next line, None at the end."""
        if self.number >= len(self._lines):
            return None
        self.number += 1
        return self._lines[self.number - 1]

    def peek(self) -> str | None:
        return self._lines[self.number] if self.number < len(self._lines) else None

    def error(self, reason: str, hint: str = "") -> InputError:
        return InputError(f"{self.path}, line {self.number}", reason, hint)

    def real(self, text: str, what: str, *, blank: float | None = None) -> float:
        """Read a number with D, d, E or e before its exponent."""
        stripped = text.strip()
        if not stripped and blank is not None:
            return blank
        try:
            value = float(stripped.upper().replace("D", "E"))
        except ValueError:
            raise self.error(f"{what}: {stripped!r} is not a number") from None
        if not abs(value) < 1e30:
            raise self.error(f"{what}: {stripped!r} is not finite")
        return value

    def integer(self, text: str, what: str) -> int:
        try:
            return int(text)
        except ValueError:
            raise self.error(f"{what}: {text.strip()!r} is not a whole number") from None


def _read_text(path: Path) -> str:
    try:
        content = path.read_bytes()
        if content[:2] == b"\x1f\x8b":
            content = gzip.decompress(content)
    except OSError as error:
        raise InputError(path, error.strerror or str(error), "name a RINEX file") from None
    except EOFError:
        raise InputError(path, "the gzip file is cut short") from None
    return content.decode("latin-1")


def read_rinex_nav(path: str | os.PathLike[str]) -> NavigationFile:
    """Read the GPS LNAV ephemerides of a RINEX navigation file, plain or gzip.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    NavigationFile
        Ephemerides in the file's order; each carries the file's ionosphere parameters.

    Raises
    ------
    InputError
        If the file cannot be read, is no navigation file, or a record is malformed.
    """
    lines = _Lines(Path(path))
    version = _read_version(lines)
    header = _Header(version=version)
    header.read(lines)
    records = list(_records_2(lines) if version < 3 else _records_3(lines, header))
    iono: dict[str, Any] = {"iono_alpha": header.iono_alpha, "iono_beta": header.iono_beta}
    return NavigationFile(
        ephemerides=[dataclasses.replace(record, **iono) for record in records],
        iono_alpha=header.iono_alpha,
        iono_beta=header.iono_beta,
        leap_seconds=header.leap_seconds,
        utc=header.utc,
        version=version,
    )


def _read_version(lines: _Lines) -> float:
    line = lines.take() or ""
    hint = "name a GPS navigation file"
    if line[60:].strip() != "RINEX VERSION / TYPE":
        raise lines.error("this is not a RINEX file", hint)
    if line[20:21] != "N":
        raise lines.error(f"RINEX type {line[20:40].strip()!r} is not GPS navigation data", hint)
    version = lines.real(line[:9], "RINEX version")
    if not 2 <= version < 5:
        raise lines.error(f"RINEX version {version:g} is not 2, 3 or 4")
    return version


@dataclass
class _Header:
    """What the header, and in version 4 the body, say about ionosphere and UTC."""

    version: float
    iono_alpha: tuple[float, ...] = ()
    iono_beta: tuple[float, ...] = ()
    leap_seconds: int | None = None
    utc: UtcParameters | None = None

    def read(self, lines: _Lines) -> None:
        while (line := lines.take()) is not None:
            label = line[60:].strip()
            if label == "END OF HEADER":
                if self.utc is not None and self.leap_seconds is not None:
                    leap = self.leap_seconds
                    self.utc = dataclasses.replace(self.utc, leap_s=leap, leap_lsf_s=leap)
                return
            self._line(lines, line, label)
        raise lines.error("the file ends within its header")

    def _line(self, lines: _Lines, line: str, label: str) -> None:
        key = line[:4]
        if label == "ION ALPHA":
            self.iono_alpha = _reals(lines, line, 2, 12, 4, label)
        elif label == "ION BETA":
            self.iono_beta = _reals(lines, line, 2, 12, 4, label)
        elif label == "IONOSPHERIC CORR" and key == "GPSA":
            self.iono_alpha = _reals(lines, line, 5, 12, 4, label)
        elif label == "IONOSPHERIC CORR" and key == "GPSB":
            self.iono_beta = _reals(lines, line, 5, 12, 4, label)
        elif label.startswith("DELTA-UTC"):
            self.utc = _utc(lines, (line[3:22], line[22:41], line[41:50], line[50:59]))
        elif label == "TIME SYSTEM CORR" and key == "GPUT":
            self.utc = _utc(lines, (line[5:22], line[22:38], line[38:45], line[45:50]))
        elif label == "LEAP SECONDS":
            self.leap_seconds = lines.integer(line[:6], label)


def _utc(lines: _Lines, texts: tuple[str, str, str, str]) -> UtcParameters:
    a0, a1, tot = (lines.real(text, "UTC parameters") for text in texts[:3])
    return UtcParameters(a0=a0, a1=a1, tot=tot, week_t=lines.integer(texts[3], "UTC week"))


def _reals(
    lines: _Lines, line: str, first: int, width: int, count: int, what: str
) -> tuple[float, ...]:
    columns = range(first, first + width * count, width)
    return tuple(lines.real(line[at : at + width], what) for at in columns)


def _records_2(lines: _Lines) -> Iterator[Ephemeris]:
    while (line := lines.take()) is not None:
        if not line.strip():
            continue
        prn = lines.integer(line[:2], "satellite")
        date = [line[at : at + 3] for at in range(2, 17, 3)] + [line[17:22]]
        yield _record(lines, f"G{prn:02d}", date, line[22:], 3)


def _records_3(lines: _Lines, header: _Header) -> Iterator[Ephemeris]:
    wanted = header.version < 4
    gps = False  # the lines at hand belong to a GPS record
    while (line := lines.take()) is not None:
        if line.startswith(">"):
            wanted = line[2:5] == "EPH" and line[6:7] == "G" and line[10:14] == "LNAV"
            if line[2:5] == "ION" and line[6:7] == "G" and line[10:14] == "LNAV":
                _read_iono_4(lines, header)
        elif line.startswith("G") and wanted:
            prn = lines.integer(line[1:3], "satellite")
            date = [line[4:8], *(line[at : at + 2] for at in range(9, 23, 3))]
            yield _record(lines, f"G{prn:02d}", date, line[23:], 4)
            gps = True
            continue
        elif gps and line.strip() and line.startswith(" "):
            raise lines.error("a GPS record has more than eight lines")
        gps = False


def _read_iono_4(lines: _Lines, header: _Header) -> None:
    what = "ionosphere record"
    texts = [lines.take() or "" for _ in range(3)]
    values = _reals(lines, texts[0], 23, 19, 3, what) + _reals(lines, texts[1], 4, 19, 4, what)
    values += _reals(lines, texts[2], 4, 19, 1, what)
    header.iono_alpha, header.iono_beta = values[:4], values[4:8]


def _record(lines: _Lines, satellite: str, date: list[str], clock: str, indent: int) -> Ephemeris:
    """Read the rest of a record whose first line has been cut into date and clock."""
    if not 1 <= int(satellite[1:]) <= 32:
        raise lines.error(f"{satellite} is not a GPS satellite")
    toc = _toc(lines, date)
    af = _reals(lines, clock, 0, 19, 3, f"clock of {satellite}")
    values: dict[str, Any] = dict(zip(("af0", "af1", "af2"), af, strict=True))
    for i in range(7):
        line = lines.peek()
        if line is None or line[:indent].strip() or not line.strip():
            raise lines.error(f"the record of {satellite} ends after {i + 1} of 8 lines")
        lines.take()
        for name, at in zip(_ORBIT[4 * i : 4 * i + 4], range(indent, 80, 19), strict=False):
            blank = None if name in _NEEDED else 0.0
            what = f"{name} of {satellite}"
            values[name] = lines.real(line[at : at + 19], what, blank=blank)
    return _ephemeris(lines, satellite, toc, values)


def _toc(lines: _Lines, date: list[str]) -> GpsTime:
    year, month, day, hour, minute = (lines.integer(text, "date") for text in date[:5])
    if year < 100:
        year += 1900 if year >= 80 else 2000
    ns = round(lines.real(date[5], "date") * NS_PER_S)
    try:
        return GpsTime.from_calendar(year, month, day, hour, minute, ns)
    except ValueError:
        raise lines.error(f"{' '.join(text.strip() for text in date)!r} is no date") from None


def _ephemeris(lines: _Lines, satellite: str, toc: GpsTime, values: dict[str, Any]) -> Ephemeris:
    """Check a record's values and name them."""
    limits = {"eccentricity": (0, 0.5), "sqrt_a": (2000, 8000), "toe": (0, S_PER_WEEK)}
    for name, (low, high) in limits.items():
        if not low <= values[name] <= high:
            raise lines.error(f"{name} of {satellite} = {values[name]:g} is impossible")
    # The week of toe follows from toc: files differ in what their week means (1024, 0, toc's).
    del values["week"]
    week = toc.week - round((values["toe"] - toc.tow_s()) / S_PER_WEEK)
    integers: dict[str, Any] = {name: int(values.pop(name)) for name in _INTEGERS}
    fit_interval_flag = int(values.pop("fit_hours") > 4)
    return Ephemeris(
        satellite=satellite,
        week=week,
        toc=toc.tow_s(),
        fit_interval_flag=fit_interval_flag,
        **integers,
        **values,
    )


def format_rinex_nav(
    ephemerides: Iterable[Ephemeris],
    *,
    iono_alpha: tuple[float, ...] = (),
    iono_beta: tuple[float, ...] = (),
    leap_seconds: int | None = None,
    run_by: str = "",
    date: str | None = None,
) -> str:
    """Return the text of a RINEX 3.05 GPS navigation file.

    Parameters
    ----------
    ephemerides : iterable of Ephemeris
    iono_alpha, iono_beta : tuple of float, length 4, optional
        Klobuchar parameters; else those of the last ephemeris that has them.
    leap_seconds : int, optional
        GPS minus UTC [s].
    run_by : str, optional
        Agency for the PGM / RUN BY / DATE line.
    date : str, optional
        Date of that line, "YYYYMMDD HHMMSS UTC"; else now.
    """
    ephemerides = sorted(ephemerides, key=lambda item: (item.week, item.toe, item.satellite))
    for item in ephemerides:
        iono_alpha, iono_beta = iono_alpha or item.iono_alpha, iono_beta or item.iono_beta
    date = date or f"{datetime.now(UTC):%Y%m%d %H%M%S} UTC"
    header = [
        (f"{3.05:9.2f}{'':11}{'N: GNSS NAV DATA':20}{'G: GPS':20}", "RINEX VERSION / TYPE"),
        (f"{'DeepSeis':20}{run_by[:20]:20}{date:20}", "PGM / RUN BY / DATE"),
    ]
    for key, values in (("GPSA", iono_alpha), ("GPSB", iono_beta)):
        if values:
            text = "".join(f"{value:12.4E}" for value in values)
            header.append((f"{key} {text}", "IONOSPHERIC CORR"))
    if leap_seconds is not None:
        header.append((f"{leap_seconds:6d}", "LEAP SECONDS"))
    header.append(("", "END OF HEADER"))
    text = "".join(f"{content:60}{label:20}".rstrip() + "\n" for content, label in header)
    return text + "".join(format_record(item) for item in ephemerides)


def format_record(item: Ephemeris) -> str:
    """Return the eight lines of a GPS LNAV record, the same in versions 3 and 4."""
    week = item.week + round((item.toe - item.toc) / S_PER_WEEK)
    year, month, day, hour, minute, ns = GpsTime(week, round(item.toc * NS_PER_S)).to_calendar()
    date = f"{year:4d} {month:02d} {day:02d} {hour:02d} {minute:02d} {ns // NS_PER_S:02d}"
    values = dataclasses.asdict(item) | {"fit_hours": 6.0 if item.fit_interval_flag else 4.0}
    numbers = [f"{values[name] + 0.0: .12E}" for name in ("af0", "af1", "af2", *_ORBIT)]
    text = f"{item.satellite} {date}{''.join(numbers[:3])}\n"
    for i in range(3, len(numbers), 4):
        text += f"    {''.join(numbers[i : i + 4])}\n"
    return text


def write_rinex_nav(
    path: str | os.PathLike[str], ephemerides: Iterable[Ephemeris], **header: Any
) -> None:
    """Write a RINEX 3.05 GPS navigation file, whole or not at all.

    Parameters
    ----------
    path : path-like
    ephemerides : iterable of Ephemeris
    **header
        Keyword arguments of `format_rinex_nav`.
    """
    write_whole(Path(path), format_rinex_nav(ephemerides, **header))


def write_whole(path: Path, text: str) -> None:
    """Write a text file, whole or not at all."""
    part = path.with_name(path.name + ".part")
    try:
        part.write_text(text, encoding="ascii")
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise DiskError(path, f"cannot be written: {error.strerror or error}") from None


def rinex3_name(
    station: str,
    start: GpsTime,
    duration_s: float,
    kind: str,
    *,
    interval_s: float | None = None,
    source: str = "R",
) -> str:
    """Return the name that RINEX 3.05 asks for.

    Parameters
    ----------
    station : str
        Nine characters: site, monument, receiver, country ("DEEP00XXX").
    start : GpsTime
        First epoch, nominal.
    duration_s : float
        Length [s], rounded up to whole minutes, hours or days.
    kind : str
        "GN" GPS navigation, "GO" GPS observations, ...
    interval_s : float, optional
        Epoch interval [s]; observation files need it, navigation files have none.
    source : str, optional
        "R" receiver, "S" stream, "U" unknown.

    References
    ----------
    RINEX 3.05, table A1.

    Examples
    --------
    >>> start = GpsTime.from_calendar(2022, 1, 1, 2)
    >>> rinex3_name("DEEP00XXX", start, 3600, "GN")
    'DEEP00XXX_R_20220010200_01H_GN.rnx'
    >>> rinex3_name("DEEP00XXX", start, 40, "GO", interval_s=0.02)
    'DEEP00XXX_R_20220010200_01M_50Z_GO.rnx'
    """
    if len(station) != 9 or not station.isalnum():
        raise InputError(station, "a station's name has nine letters and digits", "DEEP00XXX")
    year, _, _, hour, minute, _ = start.to_calendar()
    when = f"{year:04d}{start.day_of_year():03d}{hour:02d}{minute:02d}"
    parts = [station.upper(), source, when, _period(duration_s)]
    if interval_s is not None:
        parts.append(_interval(interval_s))
    return "_".join([*parts, kind]) + ".rnx"


def _period(duration_s: float) -> str:
    minutes = max(1, math.ceil(duration_s / 60))
    return _two_digits(minutes, (("D", 1440), ("H", 60), ("M", 1)))


def _interval(interval_s: float) -> str:
    if interval_s >= 1:
        return _two_digits(round(interval_s), (("D", 86_400), ("H", 3600), ("M", 60), ("S", 1)))
    rate = 1 / interval_s
    return f"{round(rate):02d}Z" if rate < 99.5 else f"{round(rate / 100):02d}C"


def _two_digits(count: int, units: tuple[tuple[str, int], ...]) -> str:
    """Return count in the largest unit that divides it, else the smallest that has room."""
    for unit, size in units:
        if count % size == 0 and count // size <= 99:
            return f"{count // size:02d}{unit}"
    for unit, size in reversed(units):
        if -(-count // size) <= 99:
            return f"{-(-count // size):02d}{unit}"
    return "00U"
