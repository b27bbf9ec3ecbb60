"""What the inertial half of the graph has to know of a recording: IMU, station, clock."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from deepseis_core.errors import InputError
from deepseis_core.geodesy import ecef_from_enu
from deepseis_core.imu_grades import GRADES, grade_named
from deepseis_core.imu_message import decode_imu
from deepseis_core.sample_clock import SampleClock
from deepseis_frontend.if_bag import first_messages
from deepseis_frontend.if_stream import IfSource
from deepseis_frontend.imu_bag import TOPIC
from deepseis_frontend.imu_file import ImuFile, Installation
from deepseis_frontend.imu_open import is_bag, open_imu
from deepseis_frontend.imu_rosbag import ImuRosbag
from deepseis_frontend.nodes.station_bag import LOOKED_AT, read_station

TOLD_BY_SOURCE = frozenset(
    (
        *("start_utc_ns", "start_s", "sample_rate_hz", "imu_rate_hz", "imu_grade"),
        *("monument_ecef", "antenna_lever_arm", "imu_to_antenna", "imu_orientation_xyzw"),
    )
)
"""Parameters of the inertial half that a recording tells by itself."""


def has_imu(path: Path) -> bool:
    """Tell whether a bag begins with samples of an IMU that has gyroscopes.

    Only the first messages are looked at; what is wrong with an IMU that is there comes out when
    it is read (`inertial_parameters`).
    """
    if not is_bag(path):
        return False
    for message in first_messages(path, LOOKED_AT):
        if ("/" + message.channel.topic).endswith("/" + TOPIC):
            try:
                sample, _ = decode_imu(message.data, SampleClock(0, 1.0))
            except ValueError:
                return True  # no Imu: its reader says what is wrong
            return sample.angular_velocity_variance >= 0.0
    return False


def inertial_parameters(
    path: Path, source: IfSource, given: Installation | None = None
) -> dict[str, dict[str, Any]]:
    """Return parameters of ``motion_state``, ``fusion`` and ``seismic_event``.

    Parameters
    ----------
    path : Path
        Where the IMU is: a bag, or a text file of columns.
    source : IfSource
        The IF samples, whose clock is that of the IMU too.
    given : Installation, optional
        How it stands; without, the bag or the file's description has to say so.

    Raises
    ------
    InputError
        There is no IMU, nobody says how it stands, or its grade is not known.
    """
    clock = _clock(source)
    imu = open_imu(path, clock)
    stands = given
    if stands is None and isinstance(imu, ImuFile | ImuRosbag):
        stands = imu.format.installation
    stands = stands or _described(path)
    if not stands.grade:
        raise InputError(path, "has no grade of the IMU", "known: " + ", ".join(GRADES))
    try:
        grade_named(stands.grade)
    except InputError as error:
        raise InputError(path, f"{error.what} {error.reason}", error.hint) from None
    common = {
        "start_utc_ns": clock.start_utc_ns,
        "imu_rate_hz": imu.rate_hz,
        "imu_grade": stands.grade,
    }
    geometry = {
        "monument_ecef": list(stands.monument_ecef),
        "antenna_lever_arm": list(stands.antenna_lever_arm),
        "imu_to_antenna": list(stands.imu_to_antenna),
        "imu_orientation_xyzw": list(stands.orientation_xyzw),
    }
    return {
        "motion_state": common,
        "fusion": {**common, **geometry},
        "seismic_event": {
            "start_utc_ns": clock.start_utc_ns,
            "monument_ecef": geometry["monument_ecef"],
        },
    }


def installed_parameters(
    path: Path, source: IfSource, given: Installation | None, antenna_ecef: Sequence[float]
) -> dict[str, dict[str, Any]]:
    """Return the same for an IMU that is not in the source's bag; ``imu_source`` says it all on.

    Where no monument is given, the antenna's surveyed place tells it.

    Raises
    ------
    InputError
        As `inertial_parameters`; or the station's place is not known.
    """
    found = inertial_parameters(path, source, given)
    fusion = found["fusion"]
    if not any(fusion["monument_ecef"]):
        if not any(antenna_ecef):
            hint = "monument_ecef, or the antenna's position"
            raise InputError(path, "the station's place is not known", hint)
        down = -np.array(fusion["antenna_lever_arm"])
        fusion["monument_ecef"] = ecef_from_enu(down, np.array(antenna_ecef)).tolist()
        found["seismic_event"]["monument_ecef"] = fusion["monument_ecef"]
    known = {name: value for name, value in fusion.items() if name != "imu_rate_hz"}
    found["imu_source"] = {**known, "sample_rate_hz": source.sample_rate_hz}
    return found


def _described(path: Path) -> Installation:
    """Return how the IMU of a bag stands, as the bag says."""
    about = read_station(path) if is_bag(path) else None
    if about is None:
        raise InputError(path, "does not describe its station", "lever arm, orientation, grade")
    station, _ = about

    def numbers(values: Any) -> Any:
        return tuple(float(value) for value in values)

    return Installation(
        station.imu,
        numbers(station.monument_ecef),
        numbers(station.antenna_lever_arm),
        numbers(station.imu_to_antenna),
        numbers(station.imu_orientation_xyzw),
    )


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
