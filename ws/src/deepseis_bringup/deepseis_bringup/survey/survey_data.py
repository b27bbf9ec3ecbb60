"""What a gravimetric survey is worked out from, out of a bag or straight from the bench."""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from deepseis_bringup.survey.survey_gnss import SurveyGnss, survey_gnss
from deepseis_core.errors import InputError
from deepseis_core.imu_grades import ImuGrade, grade_named
from deepseis_core.imu_message import decode_imu
from deepseis_core.mcap_scan import Channel, McapScan
from deepseis_core.rotation import flu_from_frd
from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import Ephemeris, FloatArray, Observations
from deepseis_frontend.if_bag import bag_files
from deepseis_ins.ldv import LdvRecord
from deepseis_sim.bench import Bench
from deepseis_sim.bench_streams import ImuStream, LdvStream, ObservationStream

NS_CLOCK: Final = SampleClock(0, 1e9)
"""Turns stamps into nanoseconds."""
CHUNK: Final = 10_000
LARGEST_STEP: Final = 1.5
"""Between IMU samples, in intervals: beyond it some are lost."""
TYPES: Final = {
    "imu/data_raw": "sensor_msgs/msg/Imu",
    "ldv/velocity": "deepseis_msgs/msg/LdvVelocity",
    "gnss/observations": "deepseis_msgs/msg/Observations",
    "gnss/ephemeris": "deepseis_msgs/msg/Ephemeris",
    "station": "deepseis_msgs/msg/Station",
}


@dataclass(frozen=True)
class SurveyData:
    """One drive.

    Attributes
    ----------
    name : str
    grade : ImuGrade
    grade_name : str
    imu_time_end : ndarray, shape (m,)
        Since the start [s].
    delta_theta_b, delta_vel_b : ndarray, shape (m, 3)
        Forward-right-down [rad, m/s].
    dt : float
        [s]
    ldv : LdvRecord or None
    gnss : SurveyGnss or None
    """

    name: str
    grade: ImuGrade
    grade_name: str
    imu_time_end: FloatArray
    delta_theta_b: FloatArray
    delta_vel_b: FloatArray
    dt: float
    ldv: LdvRecord | None
    gnss: SurveyGnss | None


def data_of_bench(bench: Bench) -> SurveyData:
    """Take a drive straight from the bench, without a bag."""
    scenario = bench.scenario
    by_kind = {type(stream): stream for stream in bench.streams}
    imu, ldv = by_kind[ImuStream], by_kind[LdvStream]
    observed = by_kind[ObservationStream]
    assert isinstance(imu, ImuStream)
    assert isinstance(ldv, LdvStream)
    assert isinstance(observed, ObservationStream)
    assert scenario.imu is not None
    count = int(scenario.duration * imu.rate_hz)
    made = [
        imu.errors.apply(first, part.delta_theta, part.delta_vel)
        for first in range(0, count, CHUNK)
        for part in [imu.synthesizer.increments(first, min(CHUNK, count - first))]
    ]
    rate = bench.sample_rate_hz
    epochs = observed.receiver.epochs(0, bench_epochs(bench))
    timed = ((float(e.sample_index + e.sample_fraction) / rate, e) for e in epochs)
    orbits = [item.ephemeris for item in bench.model.satellites]
    return SurveyData(
        scenario.name,
        grade_named(scenario.imu.grade),
        scenario.imu.grade,
        np.arange(1, count + 1) / imu.rate_hz,
        flu_from_frd(np.vstack([part.delta_theta for part in made])),
        flu_from_frd(np.vstack([part.delta_vel for part in made])),
        1.0 / imu.rate_hz,
        _ldv_of_bench(ldv, scenario.duration),
        survey_gnss(timed, orbits, flu_from_frd(scenario.lever_arm)),
    )


def bench_epochs(bench: Bench) -> int:
    """Return how many epochs of observations a run has."""
    rate_hz = bench.scenario.observations.rate_hz
    late_ns = -bench.start.total_ns % (10**9 // rate_hz)
    return max(int((bench.scenario.duration - late_ns / 1e9) * rate_hz), 0)


def _ldv_of_bench(stream: LdvStream, duration: float) -> LdvRecord:
    synthesizer = stream.synthesizer
    count = int(duration * synthesizer.config.rate_hz)
    made = [
        synthesizer.chunk(first, min(CHUNK, count - first)) for first in range(0, count, CHUNK)
    ]
    return LdvRecord.from_beams(
        np.concatenate([part.time for part in made]),
        np.vstack([part.beam_velocity for part in made]),
        np.vstack([part.beam_velocity_sd for part in made]),
        synthesizer.elevation,
        np.concatenate([part.quality for part in made]),
    )


def data_of_bag(path: Path, grade: str = "") -> SurveyData:
    """Read a drive: the folder of a run, of a bag, or an MCAP file.

    Parameters
    ----------
    path : Path
    grade : str, optional
        Of the IMU, where the bag's station does not name it.

    Raises
    ------
    InputError
        Something is missing or damaged.
    """
    bag = path / "bag" if (path / "bag").is_dir() else path
    reader = _Reader(bag)
    for file in bag_files(bag):
        reader.read(file)
    return reader.finish(path.name, grade)


class _Reader:
    """Gathers the messages of a bag."""

    def __init__(self, bag: Path) -> None:
        self.bag, self.store = bag, get_typestore(Stores.EMPTY)
        self.imu: list[tuple[int, FloatArray, FloatArray]] = []
        self.ldv: list[tuple[Any, ...]] = []
        self.elevation = np.zeros(2)
        self.observations: list[tuple[int, Observations]] = []
        self.ephemerides: list[Ephemeris] = []
        self.station: Any = None

    def read(self, file: Path) -> None:
        """Take all that is wanted of a file."""
        for message in McapScan(file).messages(self._wanted):
            topic = _topic(message.channel)
            try:
                if topic == "imu/data_raw":
                    sample, stamp = decode_imu(message.data, NS_CLOCK)
                    row = sample.angular_velocity.copy(), sample.linear_acceleration.copy()
                    self.imu.append((stamp, *row))
                else:
                    self._take(topic, self._decoded(message.channel, message.data))
            except (struct.error, ValueError) as error:
                raise InputError(file, f"holds an unreadable {topic}: {error}") from None

    def _wanted(self, channel: Channel) -> bool:
        return TYPES.get(_topic(channel)) == channel.type_name and channel.encoding == "cdr"

    def _decoded(self, channel: Channel, data: memoryview) -> Any:
        if channel.type_name not in self.store.types:
            found = get_types_from_msg(channel.schema.decode(), channel.type_name)
            self.store.register({k: v for k, v in found.items() if k not in self.store.types})
        definition = self.store.get_msgdef(channel.type_name)
        return definition.deserialize_cdr_le(bytes(data[4:]), 0, definition.cls, self.store)[0]

    def _take(self, topic: str, message: Any) -> None:
        if topic == "ldv/velocity":
            self.elevation = np.array(message.beam_elevation)
            beams = np.array(message.beam_velocity), np.array(message.beam_velocity_sd)
            self.ldv.append((_stamp(message), *beams, float(message.quality)))
        elif topic == "gnss/observations":
            names = [item.name for item in dataclasses.fields(Observations)]
            values = {name: getattr(message, name) for name in names}
            values["satellites"] = tuple(values["satellites"])
            self.observations.append((_stamp(message), Observations(**values)))
        elif topic == "gnss/ephemeris":
            names = [item.name for item in dataclasses.fields(Ephemeris)]
            values = {name: getattr(message, name) for name in names}
            values |= {name: tuple(values[name]) for name in ("iono_alpha", "iono_beta")}
            self.ephemerides.append(Ephemeris(**values))
        else:
            self.station = message

    def finish(self, name: str, grade: str) -> SurveyData:
        """Put everything on one scale of time, that of the first IMU sample's beginning."""
        if len(self.imu) < 2:
            raise InputError(self.bag, "holds no IMU samples", "topic imu/data_raw")
        if not self.ldv and not self.observations:
            reason = "holds neither ldv/velocity nor gnss/observations"
            raise InputError(self.bag, reason, "gravity needs a velocity from outside")
        if self.station is None and not grade:
            raise InputError(self.bag, "does not say what IMU it is of", "--grade navigation")
        stamps = np.array([row[0] for row in self.imu])
        dt_ns = float(np.median(np.diff(stamps)))
        dt = round(1e-9 * dt_ns, 9)
        steps = np.diff(stamps) / dt_ns
        if not (steps > 0.0).all() or (steps > LARGEST_STEP).any():
            late = int(np.flatnonzero((steps <= 0.0) | (steps > LARGEST_STEP))[0])
            when = (stamps[late] - stamps[0]) * 1e-9
            raise InputError(self.bag, f"lacks IMU samples {when:.3f} s after the first")
        zero = int(stamps[0] - dt_ns)
        arm = np.zeros(3) if self.station is None else np.array(self.station.imu_to_antenna)
        grade_name = grade or str(self.station.imu)
        return SurveyData(
            name,
            grade_named(grade_name),
            grade_name,
            np.arange(1.0, stamps.size + 1.0) * dt,
            flu_from_frd(np.array([row[1] for row in self.imu])) * dt,
            flu_from_frd(np.array([row[2] for row in self.imu])) * dt,
            dt,
            self._ldv(zero),
            self._gnss(zero, flu_from_frd(arm)),
        )

    def _ldv(self, zero: int) -> LdvRecord | None:
        if not self.ldv:
            return None
        stamps, beams, sds, quality = zip(*self.ldv, strict=True)
        time = (np.array(stamps) - zero) * 1e-9
        columns = np.array(beams), np.array(sds, np.float64)
        return LdvRecord.from_beams(time, *columns, self.elevation, np.array(quality))

    def _gnss(self, zero: int, lever_arm_b: FloatArray) -> SurveyGnss | None:
        if not self.observations or not self.ephemerides:
            return None
        return survey_gnss(self._timed(zero), self.ephemerides, lever_arm_b)

    def _timed(self, zero: int) -> Iterator[tuple[float, Observations]]:
        for stamp, epoch in self.observations:
            yield (stamp - zero) * 1e-9, epoch


def _topic(channel: Channel) -> str:
    """Return which of the wanted topics it is, without the station's name; else its own name."""
    own = "/" + channel.topic.strip("/")
    return next((name for name in TYPES if own.endswith(f"/{name}")), own)


def _stamp(message: Any) -> int:
    return int(message.header.stamp.sec) * 10**9 + int(message.header.stamp.nanosec)
