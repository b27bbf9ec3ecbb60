"""RINEX by the hour, as archives keep it: a file of observations and of navigation data each."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

from deepseis_core.gps_time import GpsTime
from deepseis_core.rinex_nav import rinex3_name, write_rinex_nav
from deepseis_core.rinex_nav4 import transmit_time, write_rinex_nav4
from deepseis_core.types import Ephemeris, FloatArray, Observations
from deepseis_pvt.rinex_left import HOUR_NS
from deepseis_pvt.rinex_obs import VERSIONS, RinexObsWriter, RinexStation

MOST_WAITING = 8_000_000
"""Characters that may wait for room on a full disk: a minute or two at 50 Hz."""


class RinexHours:
    """Writes hourly observation files as epochs come, navigation files at the end.

    A file covers a whole GPS hour, or what there is of it, and its long name says so.

    Parameters
    ----------
    folder : path
        Where the files go; must exist.
    station : RinexStation
        For headers and names.
    version : {'3.05', '4.02'}, optional
        Of RINEX.
    created : datetime, optional
        UTC for the PGM / RUN BY / DATE line; default now.
    """

    def __init__(
        self,
        folder: Path,
        station: RinexStation,
        version: str = VERSIONS[0],
        created: dt.datetime | None = None,
    ) -> None:
        self.folder, self.station, self.version = folder, station, version
        self.created = created
        self.paths: list[Path] = []
        self._writer = RinexObsWriter(folder, station, created, version)
        self._hour = -1
        self._ephemerides: dict[int, dict[tuple[str, int, float], Ephemeris]] = {}

    def write(self, observations: Observations, position_ecef: FloatArray | None = None) -> None:
        """Append one epoch; `position_ecef` [m] serves a header without a place."""
        hour = GpsTime(observations.week, observations.tow_ns).total_ns // HOUR_NS
        if hour != self._hour:
            self._finish()
            self._hour = hour
        self._writer.write(observations, position_ecef)

    def add(self, ephemeris: Ephemeris) -> None:
        """Take an ephemeris; it belongs to the hour in which it was sent."""
        found = self._ephemerides.setdefault(transmit_time(ephemeris).total_ns // HOUR_NS, {})
        key = (ephemeris.satellite, ephemeris.week, ephemeris.toe)
        if key not in found or ephemeris.iono_alpha:
            found[key] = ephemeris

    def make_room(self) -> int:
        """Give up epochs that could not be written, if too many wait; returns how many."""
        return self._writer.drop() if self._writer.waiting > MOST_WAITING else 0

    def _finish(self) -> None:
        path = self._writer.close()
        if path is not None:
            self.paths.append(path)
            self._writer = RinexObsWriter(self.folder, self.station, self.created, self.version)

    def close(self) -> list[Path]:
        """Finish the files; returns those that were written."""
        self._finish()
        for hour, found in sorted(self._ephemerides.items()):
            start = GpsTime(0, hour * HOUR_NS)
            path = self.folder / rinex3_name(self.station.name, start, 3600, "GN")
            items, leap = list(found.values()), start.leap_seconds()
            if self.version < "4":
                write_rinex_nav(path, items, leap_seconds=leap)
            else:
                write_rinex_nav4(path, items, leap_seconds=leap)
            self.paths.append(path)
        return self.paths
