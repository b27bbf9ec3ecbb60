"""What a station's first minutes hold for its commissioning."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from deepseis_bringup.commission.align import imu_series, run_clock
from deepseis_bringup.export.convert_bag import ConvertBag
from deepseis_core.errors import InputError
from deepseis_core.imu_grades import ImuGrade, grade_named
from deepseis_core.rotation import matrix_from_quat
from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import (
    FloatArray,
    ImuSample,
    Observations,
    PrecisePosition,
    Pvt,
    PvtStatus,
    Station,
)
from deepseis_ins.mounting import ImuSeries

WINDOW_S = 1.0
SHORTEST_S = 2.0
"""Of an IMU's record; a shorter one tells nothing, and is left aside [s]."""
STILL_RATIO = 2.5
"""Of the quietest fifth of the windows, beyond which a window is not still."""
MOVES = 0.05
"""R.m.s. of the specific force's change in a window that surely moves [m/s^2]."""


@dataclass(frozen=True)
class Windows:
    """Samples of an IMU by whole seconds since the first of them.

    Attributes
    ----------
    second : ndarray, shape (n,)
        Numbers of the windows.
    force, rate : ndarray, shape (n, 3)
        Means [m/s^2, rad/s].
    change : ndarray, shape (n,)
        R.m.s. change of the force within a window [m/s^2].
    whole : ndarray of bool, shape (n,)
        No more than a fiftieth of its samples is missing.
    of_sample : ndarray, shape (m,)
        Number of each sample's window.
    """

    second: NDArray[np.int64]
    force: FloatArray
    rate: FloatArray
    change: FloatArray
    whole: NDArray[np.bool_]
    of_sample: NDArray[np.int64]


def windows_of(time: FloatArray, force: FloatArray, rate: FloatArray, size: int) -> Windows:
    """Return the windows of samples at times since the first one, ``size`` of them a window."""
    number = np.floor(time / WINDOW_S + 1e-9).astype(np.int64)
    second, group, count = np.unique(number, return_inverse=True, return_counts=True)

    def mean(values: FloatArray) -> FloatArray:
        sums = [np.bincount(group, weights=column) for column in values.T]
        return np.stack(sums, axis=1) / count[:, None]

    centre = mean(force)
    change = np.sqrt(mean((force - centre[group]) ** 2).sum(axis=1))
    some, missing = count >= 0.5 * size, size - count
    whole = missing <= max(1.0, 0.02 * size)
    return Windows(second[some], centre[some], mean(rate)[some], change[some], whole[some], number)


@dataclass
class StationData:
    """Values of one station, IMU samples forward-left-up, all by sample index."""

    clock: SampleClock
    station: Station
    imu: list[ImuSample] = field(default_factory=list)
    pvt: list[Pvt] = field(default_factory=list)
    precise: list[PrecisePosition] = field(default_factory=list)
    rtk: list[PrecisePosition] = field(default_factory=list)
    observations: list[Observations] = field(default_factory=list)

    @property
    def grade(self) -> ImuGrade:
        """Of the IMU."""
        return grade_named(self.station.imu)

    @property
    def C_enu_b(self) -> FloatArray | None:  # noqa: N802
        """Surveyed attitude, forward-left-up to east-north-up; None: not surveyed."""
        quat = np.asarray(self.station.imu_orientation_xyzw, np.float64)
        return matrix_from_quat(quat) if np.any(quat) else None

    @cached_property
    def placed(self) -> list[Pvt]:
        """Epochs of PVT that have a position."""
        return [p for p in self.pvt if p.status != PvtStatus.NONE]

    @property
    def imu_rate_hz(self) -> float:
        """Samples a second."""
        ends = np.array([s.sample_index for s in self.imu[:2000]])
        return round(self.clock.sample_rate_hz / float(np.median(np.diff(ends))), 3)

    def series(self) -> ImuSeries:
        """Return the IMU's increments."""
        return imu_series(self.imu, self.clock, self.imu_rate_hz)

    @cached_property
    def windows(self) -> Windows:
        """The IMU by seconds of its own time; those that lack half their samples are left out."""
        ends = np.array([s.sample_index for s in self.imu], np.int64)
        size = round(WINDOW_S * self.imu_rate_hz)
        return windows_of(
            (ends - ends[0]) / self.clock.sample_rate_hz,
            np.array([s.linear_acceleration for s in self.imu]),
            np.array([s.angular_velocity for s in self.imu]),
            size,
        )

    @property
    def has_imu(self) -> bool:
        """Whether there is an IMU, with a second of data somewhere."""
        return bool(self.imu) and self.windows.second.size > 0

    def still(self) -> NDArray[np.bool_]:
        """Tell of each window of the IMU whether it is still, shape (n,) of bool.

        The quietest ones are, and what is not much louder.
        """
        change = self.windows.change
        return np.asarray(change < max(STILL_RATIO * float(np.quantile(change, 0.2)), 1e-12))

    def moves(self) -> bool:
        """Tell whether some seconds surely move: well over the noise of the others."""
        change = self.windows.change
        quiet = float(np.quantile(change, 0.2))
        return int(np.sum(change > max(MOVES, 1.5 * quiet))) >= 4

    def is_still_at(self, sample_index: int) -> bool:
        """Tell whether the window of a sample is still; one without IMU data is not."""
        if not self.has_imu:
            return False
        since = (sample_index - self.imu[0].sample_index) / self.clock.sample_rate_hz
        return int(since // WINDOW_S) in self._still_seconds

    @cached_property
    def _still_seconds(self) -> set[int]:
        return set(self.windows.second[self.still()].tolist())


TOPICS = ("station", "imu/data_raw", "gnss/pvt", "gnss/precise", "gnss/rtk", "gnss/observations")


def read_station_data(bag: Path, longest_s: float) -> StationData:
    """Read the beginning of a station's bag.

    Raises
    ------
    InputError
        The bag does not describe its station, or its clock is not known.
    """
    clock = run_clock(bag)
    found: StationData | None = None
    waiting: list[tuple[str, object]] = []
    last = longest_s * clock.sample_rate_hz
    for topic, value, utc_ns in ConvertBag(bag).values(TOPICS):
        if topic == "station":
            found = found or StationData(clock, value)
            continue
        if topic == "imu/data_raw":
            index = clock.sample_at(utc_ns)
            value = ImuSample(index, value.angular_velocity, value.linear_acceleration,
                              value.angular_velocity_variance,
                              value.linear_acceleration_variance)  # fmt: skip
        if value.sample_index <= last:
            waiting.append((topic, value))
    if found is None:
        raise InputError(bag, "does not describe its station", "it needs an IMU's installation")
    lists = {
        "imu/data_raw": found.imu,
        "gnss/pvt": found.pvt,
        "gnss/precise": found.precise,
        "gnss/rtk": found.rtk,
        "gnss/observations": found.observations,
    }
    for topic, value in waiting:
        lists[topic].append(value)  # type: ignore[attr-defined]
    if found.imu and _length_s(found) < SHORTEST_S:
        found.imu.clear()
    return found


def _length_s(data: StationData) -> float:
    """Return how long the IMU has been heard [s]."""
    first, last = data.imu[0].sample_index, data.imu[-1].sample_index
    return (last - first) / data.clock.sample_rate_hz
