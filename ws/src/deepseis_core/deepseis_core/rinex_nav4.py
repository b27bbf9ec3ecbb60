"""RINEX 4.02 navigation files of GPS LNAV, written; `rinex_nav` reads them.

The header is short: what versions 2 and 3 say there of the ionosphere is a record of its own
(IGS and RTCM, "RINEX version 4.02", appendix A).
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path

from deepseis_core.constants import NS_PER_S
from deepseis_core.gps_time import GpsTime
from deepseis_core.lnav import transmit_week
from deepseis_core.rinex_nav import format_record, write_whole
from deepseis_core.types import Ephemeris


def transmit_time(ephemeris: Ephemeris) -> GpsTime:
    """Return when the message was sent, from its seconds of week and the week of toe."""
    tow = ephemeris.transmit_tow
    return GpsTime(transmit_week(ephemeris, tow), round(tow * NS_PER_S))


def format_rinex_nav4(
    ephemerides: Iterable[Ephemeris],
    *,
    leap_seconds: int,
    run_by: str = "",
    date: str | None = None,
) -> str:
    """Return the text of a RINEX 4.02 GPS navigation file.

    Parameters
    ----------
    ephemerides : iterable of Ephemeris
        Each set of Klobuchar parameters among them becomes one ionosphere record.
    leap_seconds : int
        GPS minus UTC [s]; version 4 requires it.
    run_by : str, optional
        Agency for the PGM / RUN BY / DATE line.
    date : str, optional
        Date of that line, "YYYYMMDD HHMMSS UTC"; else now.
    """
    ephemerides = sorted(ephemerides, key=lambda item: (item.week, item.toe, item.satellite))
    date = date or f"{datetime.now(UTC):%Y%m%d %H%M%S} UTC"
    header = [
        (f"{4.02:9.2f}{'':11}{'NAVIGATION DATA':20}{'G: GPS':20}", "RINEX VERSION / TYPE"),
        (f"{'DeepSeis':20}{run_by[:20]:20}{date:20}", "PGM / RUN BY / DATE"),
        (f"{leap_seconds:6d}", "LEAP SECONDS"),
        ("", "END OF HEADER"),
    ]
    text = "".join(f"{content:60}{label:20}".rstrip() + "\n" for content, label in header)
    said: set[tuple[float, ...]] = set()
    for item in ephemerides:
        text += f"> EPH {item.satellite} LNAV\n{format_record(item)}"
        iono = (*item.iono_alpha, *item.iono_beta)
        if len(iono) == 8 and iono not in said:
            said.add(iono)
            text += _ionosphere(item, iono)
    return text


def _ionosphere(item: Ephemeris, values: tuple[float, ...]) -> str:
    year, month, day, hour, minute, ns = transmit_time(item).to_calendar()
    date = f"{year:4d} {month:02d} {day:02d} {hour:02d} {minute:02d} {ns // NS_PER_S:02d}"
    numbers = [f"{value + 0.0: .12E}" for value in (*values, 0.0)]  # the last: valid everywhere
    lines = (f"    {date}{''.join(numbers[:3])}", *_rows(numbers[3:]))
    return f"> ION {item.satellite} LNAV\n" + "".join(f"{line}\n" for line in lines)


def _rows(numbers: list[str]) -> list[str]:
    return ["    " + "".join(numbers[k : k + 4]) for k in range(0, len(numbers), 4)]


def write_rinex_nav4(
    path: str | os.PathLike[str], ephemerides: Iterable[Ephemeris], *, leap_seconds: int
) -> None:
    """Write a RINEX 4.02 GPS navigation file, whole or not at all."""
    write_whole(Path(path), format_rinex_nav4(ephemerides, leap_seconds=leap_seconds))
