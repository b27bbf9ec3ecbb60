"""What the inertial half of the graph has to know of a recording: IMU, station, clock."""

from __future__ import annotations

from itertools import islice
from pathlib import Path
from typing import Any

from deepseis_core.errors import InputError
from deepseis_core.geodesy import ecef_from_enu
from deepseis_core.imu_grades import GRADES
from deepseis_core.imu_message import decode_imu
from deepseis_core.mcap_scan import McapScan
from deepseis_core.sample_clock import SampleClock
from deepseis_frontend.if_bag import bag_files
from deepseis_frontend.if_stream import IfSource
from deepseis_frontend.imu_bag import TOPIC, ImuBag
from deepseis_frontend.nodes.station_bag import LOOKED_AT, read_station


def is_bag(path: Path) -> bool:
    """Tell whether a path names a bag."""
    return path.suffix == ".mcap" or (path.is_dir() and any(path.glob("*.mcap")))


def has_imu(path: Path) -> bool:
    """Tell whether a bag begins with samples of an IMU that has gyroscopes.

    Only the first messages are looked at; what is wrong with an IMU that is there comes out when
    it is read (`inertial_parameters`).
    """
    if not is_bag(path):
        return False
    first = McapScan(bag_files(path)[0], tolerant=True).messages()
    for message in islice(first, LOOKED_AT):
        if ("/" + message.channel.topic).endswith("/" + TOPIC):
            try:
                sample, _ = decode_imu(message.data, SampleClock(0, 1.0))
            except ValueError:
                return True  # no Imu: its reader says what is wrong
            return sample.angular_velocity_variance >= 0.0
    return False


def inertial_parameters(path: Path, source: IfSource) -> dict[str, dict[str, Any]]:
    """Return parameters of ``motion_state``, ``fusion`` and ``seismic_event`` for a bag.

    Raises
    ------
    InputError
        The bag has no IMU or no station, or an IMU of unknown grade.
    """
    clock = _clock(source)
    imu, about = ImuBag(path, clock), read_station(path)
    if about is None:
        raise InputError(path, "does not describe its station", "lever arm, orientation, grade")
    station, _ = about
    if station.imu not in GRADES:
        hint = "known: " + ", ".join(GRADES)
        raise InputError(path, f"has an IMU of unknown grade {station.imu!r}", hint)
    common = {
        "start_utc_ns": clock.start_utc_ns,
        "imu_rate_hz": imu.rate_hz,
        "imu_grade": station.imu,
    }
    geometry = {
        "monument_ecef": station.monument_ecef.tolist(),
        "antenna_lever_arm": station.antenna_lever_arm.tolist(),
        "imu_to_antenna": station.imu_to_antenna.tolist(),
        "imu_orientation_xyzw": station.imu_orientation_xyzw.tolist(),
    }
    return {
        "motion_state": common,
        "fusion": {**common, **geometry},
        "seismic_event": {
            "start_utc_ns": clock.start_utc_ns,
            "monument_ecef": geometry["monument_ecef"],
        },
    }


def assistance(bag: Path) -> dict[str, dict[str, Any]]:
    """Return what lets a station start at once: its place, and orbits beside its bag.

    Parameters of ``pvt``, ``acquisition`` and ``fusion``; empty if there is no ``nav.rnx`` in the
    bag's folder or the bag does not describe its station.
    """
    nav, about = bag.resolve().parent / "nav.rnx", read_station(bag)
    if not nav.is_file() or about is None:
        return {}
    station, _ = about
    antenna = ecef_from_enu(station.antenna_lever_arm, station.monument_ecef)
    orbits = {"nav_file": str(nav)}
    known = {**orbits, "position_ecef": antenna.tolist()}
    return {"pvt": known, "acquisition": dict(known), "fusion": orbits}


def _clock(source: IfSource) -> SampleClock:
    return SampleClock(source.start_utc_ns or 0, source.sample_rate_hz)
