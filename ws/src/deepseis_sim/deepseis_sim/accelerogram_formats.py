"""Text formats of accelerograms: K-NET and KiK-net, GeoNet, PEER AT2; and what all readers share.

A reader is given the lines of a file and returns its channels in SI units, in the directions the
instrument had. Numbers stand in columns of fixed width that may touch, so they are cut by width
where the format has one. CSMIP and COSMOS are in `accelerogram_csmip`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final

import numpy as np

from deepseis_core.errors import InputError
from deepseis_core.types import FloatArray

STANDARD_GRAVITY: Final = 9.80665
"""The unit g of accelerograms [m/s^2]."""

KNET_DELAY_S: Final = 15.0
"""K-NET's "Record Time" is that of the trigger: the first sample is this much earlier."""


@dataclass(frozen=True)
class Channel:
    """One component of a record, as the file gives it.

    Attributes
    ----------
    direction : float or str
        Azimuth from north to east [deg], or "up", or "h1", "h2" where only the order is known.
    acceleration : ndarray, shape (m,)
        [m/s^2].
    velocity, displacement : ndarray, shape (m,), or None
        [m/s], [m], where the file publishes them.
    start_utc_ns : int or None
        Unix time of the first sample.
    """

    direction: float | str
    acceleration: FloatArray
    rate_hz: float
    source: str
    station: str = ""
    start_utc_ns: int | None = None
    latitude_deg: float | None = None
    longitude_deg: float | None = None
    corrected: bool = False
    velocity: FloatArray | None = None
    displacement: FloatArray | None = None


class Lines:
    """Lines of a text file under a cursor; whatever is wrong names file and line."""

    def __init__(self, path: Path, text: str) -> None:
        self.path, self.lines, self.position = path, text.rstrip("\x1a\0").splitlines(), 0

    def error(self, reason: str, line: int | None = None) -> InputError:
        """Return the error to raise about a line, counted from 0: the last one taken."""
        number = (self.position - 1 if line is None else line) + 1
        return InputError(f"{self.path}, line {max(number, 1)}", reason)

    def peek(self) -> str | None:
        """Return the next line without taking it; None at the end."""
        return self.lines[self.position] if self.position < len(self.lines) else None

    def take(self, count: int, what: str) -> list[str]:
        """Take whole lines."""
        taken = self.lines[self.position : self.position + count]
        if len(taken) < count:
            raise self.error(f"the file ends within {what}", len(self.lines) - 1)
        self.position += count
        return taken

    def numbers(self, count: int, what: str, width: int = 0) -> FloatArray:
        """Take lines until they hold ``count`` numbers, of a width or set apart by blanks."""
        values: list[float] = []
        while len(values) < count:
            (line,) = self.take(1, f"{what}: {len(values)} of {count} values")
            line = line.rstrip()
            cut = range(0, len(line), width) if width else ()
            fields = [line[i : i + width] for i in cut] if width else line.split()
            try:
                row = [float(item) for item in fields]
            except ValueError:
                raise self.error(f"not numbers of {what}: {line.strip()[:40]!r}") from None
            if not all(map(math.isfinite, row)):
                raise self.error(f"not finite: {line.strip()[:40]!r}")
            values += row
        if len(values) > count:
            raise self.error(f"{len(values)} values of {what} where {count} are announced")
        return np.asarray(values, np.float64)

    def match(self, pattern: str, line: str, what: str) -> re.Match[str]:
        """Match a pattern, in capitals or not, anywhere in a line just taken."""
        found = re.search(pattern, line, re.IGNORECASE)
        if found is None:
            raise self.error(f"no {what} in {line.strip()[:60]!r}")
        return found

    def positive(self, text: str, what: str) -> float:
        """Return a number that must be positive."""
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not 0.0 < value < math.inf:
            raise self.error(f"{what} is {text.strip()!r}")
        return value

    def count(self, text: str) -> int:
        """Return an announced number of samples: at least two."""
        value = self.positive(text, "number of samples")
        if value < 2 or value != int(value):
            raise self.error(f"number of samples is {text.strip()!r}")
        return int(value)


def direction_of(text: str) -> tuple[float | str, float] | None:
    """Read a direction as records write it; with it the sign that makes it so (down: -1).

    Examples
    --------
    >>> direction_of("N28W"), direction_of("90 DEG"), direction_of("DOWN")
    ((332.0, 1.0), (90.0, 1.0), ('up', -1.0))
    """
    word = re.sub(r"[^A-Z0-9.]", "", text.upper()).removesuffix("DEG")
    named: dict[str, float | str] = {"NS": 0.0, "N": 0.0, "EW": 90.0, "E": 90.0}
    named |= {"S": 180.0, "W": 270.0, "H1": "h1", "H2": "h2"}
    if word in named:
        return named[word], 1.0
    if word in ("UP", "UD", "Z", "V", "VER", "VERT", "VERTICAL"):
        return "up", 1.0
    if word in ("DOWN", "DWN", "DN"):
        return "up", -1.0
    if quadrant := re.fullmatch(r"([NS])(\d{1,2}(?:\.\d+)?)([EW])", word):
        angle = float(quadrant[2])
        east = angle if quadrant[1] == "N" else 180.0 - angle
        return (east if quadrant[3] == "E" else -east) % 360.0, 1.0
    if re.fullmatch(r"\d{1,3}(\.\d*)?", word) and float(word) <= 360.0:
        return float(word) % 360.0, 1.0
    return None


def unix_ns(stamp: Sequence[float], zone: float) -> int | None:
    """Return Unix nanoseconds of (year, month, day, hour, minute, second); None if it is none.

    ``zone`` is what the clock is ahead of UTC [h].
    """
    try:
        year, month, day, hour, minute, second = stamp
        midnight = datetime(int(year), int(month), int(day), tzinfo=UTC)
        since = timedelta(hours=hour - zone, minutes=minute, microseconds=round(second * 1e6))
        passed = midnight + since - datetime(1970, 1, 1, tzinfo=UTC)
    except (ValueError, OverflowError):
        return None
    return (passed // timedelta(microseconds=1)) * 1000


def read_knet(lines: Lines) -> list[Channel]:
    """Read one component of K-NET or KiK-net: 17 lines of header, then counts.

    Its mean is not zero. KiK-net numbers its directions 1 to 3 below ground, 4 to 6 above.
    """
    header = {line[:18].strip().lower(): line[18:].strip() for line in lines.take(17, "header")}

    def field(name: str, pattern: str) -> re.Match[str]:
        return lines.match(pattern, header.get(name, ""), f"usable field {name!r}")

    rate = lines.positive(field("sampling freq(hz)", r"^([\d.]+)")[1], "sampling rate")
    scale = field("scale factor", r"^([\d.]+)\(gal\)/([\d.]+)$")
    gain = 0.01 * lines.positive(scale[1], "scale") / lines.positive(scale[2], "scale")
    duration = lines.positive(field("duration time(s)", r"^([\d.]+)$")[1], "duration")
    if duration * rate > 1e8:
        raise lines.error(f"a duration of {duration:g} s")
    direction = field("dir.", r"^(N-S|E-W|U-D|[1-6])$")[1]
    if direction.isdigit():
        direction = ("N-S", "E-W", "U-D")[(int(direction) - 1) % 3]
    parsed = direction_of(direction)
    assert parsed is not None
    stamp = [float(item) for item in re.findall(r"\d+", header.get("record time", ""))]
    triggered = unix_ns(stamp, 9.0)
    start = None if triggered is None else triggered - round(KNET_DELAY_S * 1e9)
    counts = lines.numbers(round(duration * rate), "counts")
    return [
        Channel(
            direction=parsed[0],
            acceleration=gain * counts,
            rate_hz=rate,
            source="K-NET",
            station=header.get("station code", ""),
            start_utc_ns=start,
            latitude_deg=_number(header.get("station lat.")),
            longitude_deg=_number(header.get("station long.")),
        )
    ]


def _number(text: str | None) -> float | None:
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def read_geonet(lines: Lines) -> list[Channel]:
    """Read GeoNet's V1A or V2A: per component 16 lines of text, 10 of numbers, then 10F8.1.

    V1A holds raw acceleration, V2A corrected acceleration, velocity and displacement, all of
    them in mm.
    """
    channels = []
    while (line := lines.peek()) is not None:
        if not line.strip():
            lines.position += 1
            continue
        channels.append(_geonet_component(lines))
    return channels


def _geonet_component(lines: Lines) -> Channel:
    text = lines.take(16, "header")
    if not re.match(r"\s*(Unc|C)orrected accelerogram", text[0]):
        raise lines.error("no header of a component", lines.position - 16)
    count = lines.count(lines.match(r"Number of points\s+(\d+)", text[9], "number of points")[1])
    step = lines.match(r"at (?:intervals of )?\s*([\d.]+)\s*s", text[10], "interval")[1]
    name = lines.match(r"Component\s+(\S+)", text[12], "component")[1]
    parsed = direction_of(name)
    if parsed is None:
        raise lines.error(f"unknown direction {name!r}", lines.position - 4)
    numbers = [
        [_number(row[i : i + 8]) for i in range(0, 80, 8)] for row in lines.take(10, "header")
    ]
    site = re.match(
        r"Site\s+(\S+)\s+(\d+) +(\d+) +(\d+)([NS])\s+(\d+) +(\d+) +(\d+)([EW])", text[1]
    )
    series: dict[str, FloatArray] = {"Acceleration": lines.numbers(count, "acceleration", 8)}
    for row in text[14:16]:
        if (found := re.match(r"(Velocity|Displacement):", row)) is not None:
            series[found[1]] = lines.numbers(count, found[1].lower(), 8)
    scaled = {key: 1e-3 * parsed[1] * value for key, value in series.items()}
    return Channel(
        direction=parsed[0],
        acceleration=scaled["Acceleration"],
        rate_hz=1.0 / lines.positive(step, "interval"),
        source="GeoNet V2A" if text[0].lstrip().startswith("C") else "GeoNet V1A",
        station=site[1] if site else "",
        start_utc_ns=_geonet_start(numbers),
        latitude_deg=_degrees(site.groups()[1:5]) if site else None,
        longitude_deg=_degrees(site.groups()[5:9]) if site else None,
        corrected=text[0].lstrip().startswith("C"),
        velocity=scaled.get("Velocity"),
        displacement=scaled.get("Displacement"),
    )


def _geonet_start(rows: list[list[float | None]]) -> int | None:
    """Time of the first sample.

    That of the record is in the last two columns of four lines, at last in ms; a corrected one
    begins so much earlier as the second number of the seventh line says (zeros before it).
    """
    places = ((0, 8), (0, 9), (1, 8), (1, 9), (3, 8), (3, 9), (6, 1))
    stamp = [value for i, j in places if (value := rows[i][j]) is not None]
    if len(stamp) < len(places):
        return None
    return unix_ns([*stamp[:5], stamp[5] / 1000.0 - stamp[6]], 0.0)


def _degrees(sexagesimal: tuple[str, ...]) -> float:
    degrees, minutes, seconds = (float(item) for item in sexagesimal[:3])
    angle = degrees + minutes / 60.0 + seconds / 3600.0
    return -angle if sexagesimal[3] in "SW" else angle


def read_at2(lines: Lines) -> list[Channel]:
    """Read one component of PEER's AT2: four lines of header, then g in free columns.

    The direction is the last field of the second line or, in files that leave it out, the end
    of the file's name (``...090.AT2``, ``...-UP.AT2``). Newer files write ``NPTS= 3000, DT= .01
    SEC``, older ones ``3000 .01 NPTS, DT``. The start is not given.
    """
    header = lines.take(4, "header")
    place = header[1].split(",")
    stem = lines.path.stem
    ending = re.search(r"(\d{3}|UP|DWN|DN|VER|[A-Z])$", stem.upper())
    parsed = direction_of(place[-1]) if len(place) > 1 else None
    parsed = parsed or (direction_of(ending[1]) if ending else None)
    if parsed is None:
        raise lines.error(f"no direction at the end of {header[1].strip()!r} nor of the name", 1)
    if (new := re.search(r"NPTS\s*=\s*(\d+)\W+DT\s*=\s*([\d.]+)", header[3])) is not None:
        points, step = new.groups()
    else:
        points, step = lines.match(r"^\s*(\d+)\s+([\d.]+)", header[3], "NPTS and DT").groups()
    values = lines.numbers(lines.count(points), "acceleration")
    return [
        Channel(
            direction=parsed[0],
            acceleration=STANDARD_GRAVITY * parsed[1] * values,
            rate_hz=1.0 / lines.positive(step, "DT"),
            source="PEER AT2",
            station=place[-2].strip() if len(place) > 2 else "",
            corrected=True,
        )
    ]
