"""Accelerograms of CSMIP (volumes 1 and 2) and of the COSMOS format, version 1.20.

Sources: California Strong Motion Instrumentation Program, "Standard tape format for CSMIP
strong-motion data tapes" (OSMS 85-03); COSMOS, "Strong-motion data format" (version 1.20, 2001).
"""

from __future__ import annotations

import re
from typing import Final

import numpy as np

from deepseis_core.types import FloatArray
from deepseis_sim.accelerogram_formats import (
    STANDARD_GRAVITY,
    Channel,
    Lines,
    direction_of,
    unix_ns,
)

_ZONES: Final = {"PDT": -7.0, "PST": -8.0, "UTC": 0.0, "GMT": 0.0}
_UNKNOWN: Final = -999
_STATION: Final = r"station no\.?\s*(\d+)\s+([\d.]+)([NS])[, ]\s*([\d.]+)([EW])"
_SERIES: Final = r"^\s*(\d+)\s+points of (?:\w+ )?(accel|veloc|displ)\w* data.*?([\d.]+)\s*sec"


def read_csmip(lines: Lines) -> list[Channel]:
    """Read CSMIP's volume 1 (uncorrected) or 2 (corrected, with velocity and displacement)."""
    channels = []
    while _skip_to_block(lines):
        channels.append(_csmip_channel(lines))
    return channels


def _skip_to_block(lines: Lines) -> bool:
    """Pass blank lines and end marks; whether more follows."""
    while (line := lines.peek()) is not None:
        if line.strip() and not line.startswith("/&") and not line.lower().startswith("end-of-"):
            return True
        lines.position += 1
    return False


def _csmip_channel(lines: Lines) -> Channel:
    corrected = (lines.peek() or "").lower().startswith("corrected accelerogram")
    text = lines.take(25 if corrected else 13, "header")
    first = lines.position - len(text)
    label = next((row for row in text if re.match(r"\s*chan\s*\d+:", row, re.I)), text[0])
    named = lines.match(r"chan\s*\d+:\s*(.*?)\s*(?:\bdeg\b.*|\s{2}.*)?$", label, "channel")[1]
    parsed = direction_of(named)
    if parsed is None:
        raise lines.error(f"unknown direction {named!r}", first + text.index(label))
    lines.take(7, "header")  # 100 integers, which say nothing that the text does not
    if corrected or _announced(lines):
        series, step = _even_series(lines)
    else:
        series, step = _timed_series(lines, "\n".join(text))
    station = re.search(_STATION, "\n".join(text), re.IGNORECASE)
    return Channel(
        direction=parsed[0],
        acceleration=parsed[1] * series["accel"],
        rate_hz=1.0 / step,
        source=f"CSMIP V{2 if corrected else 1}",
        station=station[1] if station else "",
        start_utc_ns=_csmip_start("\n".join(text)),
        latitude_deg=_signed(station[2], station[3]) if station else None,
        longitude_deg=_signed(station[4], station[5]) if station else None,
        corrected=corrected,
        velocity=parsed[1] * series["veloc"] if "veloc" in series else None,
        displacement=parsed[1] * series["displ"] if "displ" in series else None,
    )


def _announced(lines: Lines) -> bool:
    """Whether evenly spaced samples follow the numbers of the header."""
    ahead = lines.lines[lines.position : lines.position + 20]
    return any(re.match(_SERIES, row, re.IGNORECASE) for row in ahead)


def _even_series(lines: Lines) -> tuple[dict[str, FloatArray], float]:
    """Take the reals of the header and then all evenly spaced series; returns their step [s]."""
    for _ in range(20):
        if re.match(_SERIES, lines.take(1, "header")[0], re.IGNORECASE):
            break
    else:
        raise lines.error("no 'points of accel data' where the samples should begin")
    lines.position -= 1
    series: dict[str, FloatArray] = {}
    step = 0.0
    while (found := re.match(_SERIES, lines.peek() or "", re.IGNORECASE)) is not None:
        (line,) = lines.take(1, "header")
        here = lines.positive(found[3], "interval")
        step = step or here
        count = lines.count(found[1])
        if here != step or (series and count != next(iter(series.values())).size):
            raise lines.error("velocity or displacement has other times than the acceleration")
        width = re.search(r"\(\d+f(\d{1,3})\.", line, re.IGNORECASE)
        values = lines.numbers(count, found[2].lower(), int(width[1]) if width else 10)
        series[found[2].lower()] = _unit(line) * values
    if "accel" not in series:
        raise lines.error("no series of acceleration")
    return series, step


def _timed_series(lines: Lines, text: str) -> tuple[dict[str, FloatArray], float]:
    """Take pairs of time and acceleration, 10F7.3, and put them on an even grid.

    The times of digitised film are uneven by a few milliseconds in a minute.
    """
    lines.take(7, "header")  # 50 reals
    count = lines.count(lines.match(r"no\. of points\s*=\s*(\d+)", text, "number of points")[1])
    pairs = lines.numbers(2 * count, "time and acceleration", 7).reshape(-1, 2)
    time, values = pairs.T
    if not (np.diff(time) > 0).all():
        raise lines.error("times do not grow")
    step = 1.0 / max(float(np.round(1.0 / np.median(np.diff(time)))), 1.0)
    if time[-1] - time[0] > 2 * count * step:
        raise lines.error("times leave a gap")
    grid = time[0] + step * np.arange(int((time[-1] - time[0]) / step + 1e-6) + 1)
    unit = _unit(lines.match(r"units of \w* ?accel are (.*)", text, "unit of acceleration")[1])
    return {"accel": unit * np.interp(grid, time, values)}, float(step)


def _unit(text: str) -> float:
    """Return what one unit of acceleration, velocity or displacement named in a text is in SI."""
    lowered = text.lower()
    if "cm" in lowered:
        return 0.01
    if "g/10" in lowered:
        return STANDARD_GRAVITY / 10.0
    return STANDARD_GRAVITY * (1e-3 if re.search(r"\bmg\b", lowered) else 1.0)


def _csmip_start(text: str) -> int | None:
    pattern = r"(?:trigger|start)\s+time:\s*(\d+)/(\d+)/(\d+),\s*(\d+):(\d+):([\d.]+)\s*(\w+)"
    found = re.search(pattern, text, re.IGNORECASE)
    if found is None or found[7].upper() not in _ZONES:
        return None
    month, day, year, hour, minute = (int(found[i]) for i in range(1, 6))
    if year < 100:
        year += 1900 if year > 30 else 2000
    try:
        second = float(found[6])
    except ValueError:
        return None
    return unix_ns((year, month, day, hour, minute, second), _ZONES[found[7].upper()])


def _signed(text: str, side: str) -> float | None:
    try:
        return float(text) * (-1.0 if side.upper() in "SW" else 1.0)
    except ValueError:
        return None


def read_cosmos(lines: Lines) -> list[Channel]:
    """Read COSMOS files; series other than acceleration in physical units are passed over."""
    channels = []
    while _skip_to_block(lines):
        channel = _cosmos_channel(lines)
        if channel is not None:
            channels.append(channel)
    return channels


def _cosmos_block(lines: Lines, name: str) -> FloatArray:
    """Take a header such as ``100 Integer-header values follow on 10 lines, Format= (10I8)``."""
    (line,) = lines.take(1, f"the {name} header")
    pattern = rf"^\s*(\d{{1,6}})\s+{name}-header values.*Format\s*=\s*\(\d+[A-Z](\d{{1,3}})"
    found = lines.match(pattern, line, f"announcement of {name} header values")
    values = lines.numbers(int(found[1]), f"the {name} header", int(found[2]))
    if values.size < 63:
        raise lines.error(f"the {name} header has {values.size} values, not 100")
    return values


def _cosmos_channel(lines: Lines) -> Channel | None:
    text = lines.take(1, "header")
    rows = int(
        lines.match(r"\(Format v\S+ with ([1-9]\d?) text lines", text[0], "COSMOS header")[1]
    )
    lines.take(rows - 1, "header")
    whole, real = _cosmos_block(lines, "Integer"), _cosmos_block(lines, "Real")
    (line,) = lines.take(1, "header")
    comments = lines.match(r"^\s*(\d{1,6})\s+Comment", line, "announcement of comments")
    lines.take(int(comments[1]), "comments")
    (line,) = lines.take(1, "header")
    pattern = r"^\s*(\d+)\s+(\w+).*units\s*=\s*([^,]+?)\s*,.*Format\s*=\s*\(\d+[A-Z](\d{1,3})"
    data = lines.match(pattern, line, "announcement of data")
    values = lines.numbers(lines.count(data[1]), "data", int(data[4]))
    if not data[2].lower().startswith("accel"):
        return None
    if "count" in data[3].lower():
        raise lines.error("counts (volume 0); volume 1 or 2 in physical units is needed")
    direction, sign = _cosmos_direction(lines, int(whole[53]))
    start = [*whole[[39, 41, 42, 43, 44]].tolist(), max(float(real[29]), 0.0)]
    known = real[0] != _UNKNOWN and real[1] != _UNKNOWN
    return Channel(
        direction=direction,
        acceleration=sign * _unit(data[3]) * values,
        rate_hz=1000.0 / lines.positive(str(real[61]), "sampling interval in ms"),
        source=f"COSMOS V{int(whole[0])}",
        start_utc_ns=unix_ns(start, 0.0) if whole[39] > 0 else None,
        latitude_deg=float(real[0]) if known else None,
        longitude_deg=float(real[1]) if known else None,
        corrected=bool(whole[0] >= 2),
    )


def _cosmos_direction(lines: Lines, code: int) -> tuple[float | str, float]:
    """Direction and sign of COSMOS' table 7: azimuths, and codes from 400 on."""
    named: dict[int, tuple[float | str, float]] = {400: ("up", 1.0), 401: ("up", -1.0)}
    named |= {402: ("up", 1.0), 500: ("h1", 1.0), 501: ("h2", 1.0), 600: ("h1", 1.0)}
    named |= {601: ("h2", 1.0), 700: ("h1", 1.0), 701: ("h2", 1.0)}
    if code in named:
        return named[code]
    if 0 <= code <= 360:
        return float(code % 360), 1.0
    raise lines.error(f"direction {code} of the channel is not known")
