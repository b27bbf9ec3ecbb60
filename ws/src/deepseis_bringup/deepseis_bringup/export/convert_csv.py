"""CSV of what a bag holds: one plain file for each kind, a header line with units, UTC first."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final, TextIO

import numpy as np

from deepseis_bringup.export.quakeml import StationEvent
from deepseis_bringup.export.true_time import TrueTime
from deepseis_bringup.export.utc_pieces import UtcMoment
from deepseis_core.errors import InputError
from deepseis_core.gps_time import GpsTime
from deepseis_core.types import (
    Displacement,
    DisplacementSource,
    Ephemeris,
    ImuSample,
    IntArray,
    Observations,
    Pvt,
    PvtStatus,
    Station,
)

Row = Iterable[object]
_AXES: Final = ("east", "north", "up")


def _triples(name: str, unit: str) -> list[str]:
    return [f"{name}_{axis}_{unit}" for axis in _AXES]


TIME: Final = ("utc", "gps_week", "tow_ns")
HEADERS: Final[Mapping[str, tuple[str, ...]]] = {
    "seismo/displacement": (
        *TIME,
        *_triples("displacement", "m"),
        *_triples("velocity", "m_s"),
        *_triples("acceleration", "m_s2"),
        *_triples("displacement_sd", "m"),
        *_triples("velocity_sd", "m_s"),
        *_triples("acceleration_sd", "m_s2"),
    ),
    "imu/data_raw": (
        *TIME,
        *(f"acceleration_{axis}_m_s2" for axis in ("forward", "left", "up")),
        *(f"rotation_{axis}_rad_s" for axis in ("forward", "left", "up")),
    ),
    "gnss/observations": (
        *TIME,
        "satellite",
        "pseudorange_m",
        "carrier_phase_cycles",
        "carrier_doppler_hz",
        "cn0_dbhz",
        "lli",
    ),
    "gnss/pvt": (
        *TIME,
        "status",
        *(f"position_{axis}_m" for axis in "xyz"),
        *(f"velocity_{axis}_m_s" for axis in "xyz"),
        "clock_bias_m",
        "clock_drift_m_s",
        "satellites",
        "pdop",
    ),
    "seismo/event": (
        "utc",
        "event_id",
        "onset_utc",
        "ended",
        "onset_ratio",
        "peak_displacement_m",
        "peak_velocity_m_s",
        "peak_acceleration_m_s2",
        "hypocentral_distance_m",
        "magnitude",
        "magnitude_sd",
    ),
    "gnss/ephemeris": ("satellite", "gps_week", "toe_s", "iode", "health", "transmit_tow_s"),
}
"""Columns by topic."""


def time_cells(gps_ns: int) -> tuple[str, int, int]:
    """Return UTC to the nanosecond, and exact GPS time.

    Examples
    --------
    >>> time_cells(GpsTime.from_calendar(2022, 1, 1, 2, 0, 7).total_ns)
    ('2022-01-01T01:59:42.000000007Z', 2190, 525600000000007)
    """
    time = GpsTime(0, gps_ns)
    return UtcMoment.of_gps_ns(gps_ns).iso(9), time.week, time.tow_ns


def displacement_rows(value: Displacement, gps_ns: IntArray) -> Iterator[Row]:
    """Yield a row for each epoch of a batch."""
    n = len(gps_ns)
    names = ("displacement", "velocity", "acceleration")
    columns = []
    for name in (*names, *(f"{name}_sd" for name in names)):
        array = np.asarray(getattr(value, name), np.float64).reshape(-1, 3)
        columns.append(array if len(array) == n else np.full((n, 3), np.nan))
    for time, row in zip(gps_ns.tolist(), np.hstack(columns).tolist(), strict=True):
        motion, sigmas = row[:9], row[9:]
        yield (
            *time_cells(time),
            *(f"{x:.9f}" for x in motion),
            *(f"{x:.7g}" for x in sigmas),
        )


def imu_row(sample: ImuSample, gps_ns: int) -> Row:
    """Return the row of an IMU sample."""
    values = (*sample.linear_acceleration.tolist(), *sample.angular_velocity.tolist())
    return (*time_cells(gps_ns), *(f"{x:.9f}" for x in values))


def observation_rows(o: Observations) -> Iterator[Row]:
    """Yield a row for each satellite; the time is the receiver's, as in RINEX."""
    time = time_cells(GpsTime(o.week, o.tow_ns).total_ns)
    for k, satellite in enumerate(o.satellites):
        yield (
            *time,
            satellite,
            f"{o.pseudorange[k]:.4f}",
            f"{o.carrier_phase_cycles[k]:.5f}",
            f"{o.carrier_doppler_hz[k]:.4f}",
            f"{o.cn0_dbhz[k]:.3f}",
            int(o.lli[k]),
        )


def pvt_row(p: Pvt) -> Row:
    """Return the row of a position; the time is the receiver's."""
    numbers = (*p.position_ecef, *p.velocity_ecef, p.clock_bias, p.clock_drift)
    return (
        *time_cells(GpsTime(p.week, p.tow_ns).total_ns),
        PvtStatus(p.status).name.lower(),
        *(f"{x:.5f}" for x in numbers),
        " ".join(p.satellites),
        f"{p.pdop:.2f}",
    )


def event_row(e: StationEvent) -> Row:
    """Return the row of a report on an event."""
    utc, onset = (
        UtcMoment.of_gps_ns(GpsTime.from_utc_ns(ns).total_ns).iso()
        for ns in (e.utc_ns, e.onset_utc_ns)
    )
    return (
        *(utc, e.event_id, onset, e.ended, e.onset_ratio),
        *(e.peak_displacement, e.peak_velocity, e.peak_acceleration),
        *(e.hypocentral_distance, e.magnitude, e.magnitude_sd),
    )


def ephemeris_row(e: Ephemeris) -> Row:
    """Return the row of an ephemeris: which one; RINEX holds all of it."""
    return (e.satellite, e.week, e.toe, e.iode, e.health, e.transmit_tow)


class CsvFolder:
    """CSV files made as their first row comes; a context manager."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.paths: dict[str, Path] = {}
        self._files = ExitStack()
        self._writers: dict[str, Any] = {}

    def write(self, name: str, topic: str, rows: Iterable[Row]) -> None:
        """Append rows to ``name``.csv, whose columns are those of the topic."""
        if name not in self._writers:
            path = self.folder / f"{name}.csv"
            try:
                file: TextIO = path.open("x", encoding="utf-8", newline="")
            except OSError as error:
                raise InputError(path, f"cannot be made: {error.strerror}") from None
            self._files.enter_context(file)
            self._writers[name] = csv.writer(file, lineterminator="\n")
            self._writers[name].writerow(HEADERS[topic])
            self.paths[name] = path
        self._writers[name].writerows(rows)

    def __enter__(self) -> CsvFolder:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the files."""
        self._files.close()


def displacement_name(value: Displacement) -> str:
    """Return the file's name: source, and whether smoothed."""
    source = DisplacementSource(value.source).name.lower()
    return f"displacement_{source}" + "_smoothed" * value.smoothed


IMU_BATCH: Final = 4096


class CsvHandlers:
    """What takes the values of each topic, with the stamp of the message; `finish` when done."""

    def __init__(self, out: CsvFolder, time: TrueTime) -> None:
        self.out, self.time = out, time
        self._imu: list[tuple[int, ImuSample]] = []
        self.imu_week = -1
        self.by_topic: dict[str, Callable[[Any, int], None]] = {
            "seismo/displacement": self.displacement,
            "imu/data_raw": self.imu,
            "gnss/observations": lambda v, _: out.write(
                "observations", "gnss/observations", observation_rows(v)
            ),
            "gnss/pvt": lambda v, _: out.write("positions", "gnss/pvt", [pvt_row(v)]),
            "seismo/event": lambda v, _: out.write("events", "seismo/event", [event_row(v)]),
            "gnss/ephemeris": lambda v, _: out.write(
                "ephemerides", "gnss/ephemeris", [ephemeris_row(v)]
            ),
        }

    def displacement(self, value: Displacement, _utc_ns: int) -> None:
        """Take a batch of ground motion."""
        week_ns = GpsTime(value.week, 0).total_ns
        gps_ns = self.time.of_receiver(week_ns + np.asarray(value.tow_ns, np.int64))
        rows = displacement_rows(value, gps_ns)
        self.out.write(displacement_name(value), "seismo/displacement", rows)

    def imu(self, sample: ImuSample, utc_ns: int) -> None:
        """Take an IMU sample; its row follows with a batch of others."""
        self._imu.append((utc_ns, sample))
        if len(self._imu) >= IMU_BATCH:
            self.finish()

    def finish(self) -> None:
        """Write the IMU samples that wait."""
        if self._imu:
            stamps = np.array([utc_ns for utc_ns, _ in self._imu], np.int64)
            times = self.time.of_stamps(stamps).tolist()
            samples = (sample for _, sample in self._imu)
            self.imu_week = self.imu_week if self.imu_week >= 0 else GpsTime(0, times[0]).week
            self.out.write("imu", "imu/data_raw", map(imu_row, samples, times))
        self._imu = []


def imu_description(week: int, station: Station | None) -> str:
    """Return what makes ``imu.csv`` an input of `process`: the description beside it.

    Times count from the beginning of the GPS week of the first sample.
    """
    zero = UtcMoment.of_gps_ns(GpsTime(week, 0).total_ns).iso(0)
    names = HEADERS["imu/data_raw"][len(TIME) :]
    lines = [
        "# What the columns of imu.csv are (docs/formats.md).",
        f'time: {{column: tow_ns, unit: ns, zero_utc: "{zero}", offset: 0.0}}',
        f"accelerometer: {{columns: [{', '.join(names[:3])}], unit: m/s^2}}",
        f"gyroscope: {{columns: [{', '.join(names[3:])}], unit: rad/s}}",
    ]
    if station is not None and station.imu:
        lines.append("installation:")
        lines.append(f'  grade: "{station.imu}"')
        for name in ("imu_to_antenna", "orientation_xyzw"):
            values = getattr(station, name.replace("orientation", "imu_orientation"))
            lines.append(f"  {name}: [{', '.join(repr(float(v)) for v in values)}]")
    return "\n".join(lines) + "\n"
