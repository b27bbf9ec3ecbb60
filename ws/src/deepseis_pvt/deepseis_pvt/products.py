"""Files a station leaves: RINEX observation and navigation data of a run."""

from __future__ import annotations

from pathlib import Path

from deepseis_core.errors import DiskError
from deepseis_core.gps_time import GpsTime
from deepseis_core.rinex_nav import rinex3_name, write_rinex_nav
from deepseis_core.types import Ephemeris, Observations, Pvt, PvtStatus
from deepseis_pvt.rinex_hours import RinexHours
from deepseis_pvt.rinex_obs import RinexStation


class RinexProducts:
    """RINEX observation files by the hour as the epochs come, navigation file at the end.

    Parameters
    ----------
    folder : path
        Where the files go.
    station : RinexStation
        For headers and names.
    patient : bool
        Wait for room on a full disk: some minutes of epochs are held, then they are lost.

    Attributes
    ----------
    lost : int
        Epochs that were.

    Raises
    ------
    DiskError
        The disk does not take them.
    """

    def __init__(
        self, folder: str | Path, station: RinexStation, *, patient: bool = False
    ) -> None:
        self.patient, self.lost = patient, 0
        self.folder, self.station = Path(folder), station
        self.observations = RinexHours(self.folder, station)
        self.ephemerides: dict[tuple[str, int, float], Ephemeris] = {}
        self.start: GpsTime | None = None
        self.end = GpsTime(0, 0)

    def write(self, observations: Observations, pvt: Pvt | None) -> None:
        """Take one epoch."""
        position = pvt.position_ecef if pvt and pvt.status != PvtStatus.NONE else None
        try:
            self.observations.write(observations, position)
        except OSError as error:
            if not self.patient:
                raise self._failure(error) from None
            self.lost += self.observations.make_room()
        self.end = GpsTime(observations.week, observations.tow_ns)
        self.start = self.start or self.end

    def add(self, ephemeris: Ephemeris) -> None:
        """Take an ephemeris that was received."""
        key = (ephemeris.satellite, ephemeris.week, ephemeris.toe)
        if key not in self.ephemerides or ephemeris.iono_alpha:
            self.ephemerides[key] = ephemeris

    def close(self) -> list[Path]:
        """Finish the files; returns those that were written."""
        try:
            written = self.observations.close()
        except OSError as error:
            raise self._failure(error) from None
        if self.ephemerides and self.start is not None:
            seconds = max(1.0, self.end.diff_ns(self.start) * 1e-9)
            name = rinex3_name(self.station.name, self.start, seconds, "GN")
            found = [self.ephemerides[key] for key in sorted(self.ephemerides)]
            iono = next((e for e in found if e.iono_alpha), None)
            header = {"iono_alpha": iono.iono_alpha, "iono_beta": iono.iono_beta} if iono else {}
            write_rinex_nav(self.folder / name, found, **header)
            written.append(self.folder / name)
        return written

    def _failure(self, error: OSError) -> DiskError:
        return DiskError(self.folder, f"RINEX cannot be written: {error.strerror or error}")
