"""A recorded bag in the formats of seismology and geodesy, or as plain tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from deepseis_bringup.export.convert_csv import CsvFolder, CsvHandlers, imu_description
from deepseis_bringup.export.convert_rtcm import to_nmea, to_rtcm
from deepseis_bringup.export.convert_survey import ConvertOptions, Say, Survey, survey
from deepseis_bringup.export.fdsn_channels import (
    NETWORK,
    Place,
    displacement_channels,
    imu_channels,
    place_of_station,
)
from deepseis_bringup.export.imu_series import ImuGathering
from deepseis_bringup.export.quakeml import StationEvent, write_quakeml
from deepseis_bringup.export.sds import SdsArchive
from deepseis_bringup.export.series_export import SeriesSet
from deepseis_bringup.export.stationxml import write_stationxml
from deepseis_bringup.export.true_time import TrueTime
from deepseis_core.constants import WGS84_A
from deepseis_core.errors import InputError
from deepseis_core.gps_time import LEAP_SECONDS_EXPIRE_UNIX_NS, GpsTime
from deepseis_core.types import Displacement, Station
from deepseis_ins.ground_motion import PreciseMotion
from deepseis_pvt.rinex_hours import RinexHours
from deepseis_pvt.rinex_obs import RinexStation

DEFAULT_STATION: Final = "DSEI"


def convert(path: Path, to: str, folder: Path, options: ConvertOptions, say: Say) -> list[Path]:
    """Write a bag in another format; returns what was written, the most telling first.

    Raises
    ------
    InputError
        The format is not known, or the bag holds nothing for it.
    """
    if to not in FORMATS:
        raise InputError(f"--to {to}", "is not a format", "one of " + ", ".join(FORMATS))
    known = survey(path)
    if known.newest_utc_ns > LEAP_SECONDS_EXPIRE_UNIX_NS:
        say("the table of leap seconds ends before this recording: its last value is used")
    written = FORMATS[to](known, folder, options, say)
    if not known.bag.is_whole:
        say(f"{path} is cut short or damaged: what can be read was converted")
    if not written:
        raise InputError(path, f"holds nothing for {to}", "see: deepseis info BAG")
    return written


def place_of(known: Survey, options: ConvertOptions, say: Say) -> Place:
    """Return codes and coordinates: the user's, the station's, or stand-ins that are said."""
    station = known.station
    if station is None:
        position = known.first_position
        if position is None:
            say("no surveyed place and no position: latitude and longitude are zero")
            position = np.array([WGS84_A, 0.0, 0.0])
        if not options.network or not options.station:
            code, name = options.network or NETWORK, options.station or DEFAULT_STATION
            say(f"the bag names no network and station: {code}.{name}")
        zero, level = np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])
        station = Station(DEFAULT_STATION, "", position, zero, zero, level)
    return place_of_station(station, options.network, options.station)


def to_miniseed(known: Survey, folder: Path, options: ConvertOptions, say: Say) -> list[Path]:
    """Write an SDS archive, its StationXML, and QuakeML if there were events."""
    place = place_of(known, options, say)
    archive = SdsArchive(folder, place)
    series = SeriesSet(archive.write, options.alias)
    imu = ImuGathering()
    events: list[StationEvent] = []
    topics = (motion_topic(known), "imu/data_raw", "seismo/event")
    precise = PreciseMotion()
    for topic, value, utc_ns in known.bag.values(topics):
        if topic == "seismo/displacement":
            push_displacement(series, known.time, value)
        elif topic == "gnss/precise":
            for shown in precise.take(value, value.sample_index):
                push_displacement(series, known.time, shown)
        elif topic == "imu/data_raw":
            for batch in imu.push(value, utc_ns):
                push_imu(series, known, *batch)
        else:
            events.append(value)
    for batch in imu.finish():
        push_imu(series, known, *batch)
    if imu.count and not known.time.known:
        say("no position tells the clock: IMU times are those of its stamps")
    epochs = series.finish()
    written = []
    if epochs:
        written.append(folder / f"{place.network}.{place.station}.xml")
        write_stationxml(written[0], place, epochs, known.station)
    if events:
        written.append(folder / "events.xml")
        write_quakeml(written[-1], place, events)
    gaps = series.gaps()
    if gaps.gaps or gaps.repeated:
        say(f"{gaps.gaps} gaps, {gaps.missing} samples missing, {gaps.repeated} came again")
    return written + list(archive.paths)


def motion_topic(known: Survey) -> str:
    """Return where the bag's ground motion is: a station without a fusion has phases alone."""
    fused = next(known.bag.values(("seismo/displacement",)), None) is not None
    return "seismo/displacement" if fused else "gnss/precise"


def push_displacement(series: SeriesSet, time: TrueTime, value: Displacement) -> None:
    """Put a batch of ground motion into its series."""
    if value.interval <= 0 or not len(value.tow_ns):
        return
    rate_hz = round(1.0 / value.interval, 6)
    week_ns = GpsTime(value.week, 0).total_ns
    gps_ns = time.of_receiver(week_ns + np.asarray(value.tow_ns, np.int64))
    channels = displacement_channels(value.source, value.smoothed, rate_hz)
    series.displacement(value, gps_ns, channels)


def push_imu(series: SeriesSet, known: Survey, rate_hz: float, utc_ns: Any, values: Any) -> None:
    """Put IMU samples into their series, each at the middle of its interval."""
    half_ns = round(0.5e9 / rate_hz)
    gps_ns = known.time.of_stamps(utc_ns) - half_ns
    channels = imu_channels(known.station, rate_hz)
    for columns, (quantity, codes) in zip(
        (slice(0, 3), slice(3, 6)), channels.items(), strict=True
    ):
        series.push(("imu", quantity), codes, gps_ns, values[:, columns], {})


def to_rinex(known: Survey, folder: Path, options: ConvertOptions, _say: Say) -> list[Path]:
    """Write hourly observation and navigation files."""
    name = options.rinex_name or _nine_characters(known.station)
    about: dict[str, Any] = {"name": name}
    if (s := known.station) is not None:
        about |= {"marker": s.name or "DEEPSEIS", "receiver": s.receiver or "DEEPSEIS"}
        about |= {"receiver_number": s.receiver_serial, "antenna_number": s.antenna_serial}
        about |= {"antenna": s.antenna or "UNKNOWN"}
        east, north, up = s.antenna_lever_arm.tolist()
        about |= {
            "position_ecef": tuple(s.monument_ecef.tolist()),
            "antenna_hen": (up, east, north),
        }
    hours = RinexHours(folder, RinexStation(**about), options.rinex_version)
    for topic, value, _ in known.bag.values(("gnss/observations", "gnss/ephemeris")):
        if topic == "gnss/ephemeris":
            hours.add(value)
        else:
            hours.write(value, known.first_position)
    return hours.close()


def _nine_characters(station: Station | None) -> str:
    """Return the long name's first part: four of the station's letters, 00, country unknown."""
    letters = "".join(c for c in (station.name if station else "").upper() if c.isalnum())
    return f"{letters[:4]:X<4}00XXX" if letters else "DSEI00XXX"


def to_csv(known: Survey, folder: Path, _options: ConvertOptions, _say: Say) -> list[Path]:
    """Write a table for each kind of value."""
    with CsvFolder(folder) as out:
        handlers = CsvHandlers(out, known.time)
        for topic, value, utc_ns in known.bag.values(handlers.by_topic):
            handlers.by_topic[topic](value, utc_ns)
        handlers.finish()
    if "imu" in out.paths:
        text = imu_description(handlers.imu_week, known.station)
        Path(f"{out.paths['imu']}.yaml").write_text(text, encoding="utf-8")
    return list(out.paths.values())


FORMATS: Final[Mapping[str, Callable[[Survey, Path, ConvertOptions, Say], list[Path]]]] = {
    "miniseed": to_miniseed,
    "rinex": to_rinex,
    "csv": to_csv,
    "rtcm": to_rtcm,
    "nmea": to_nmea,
}
