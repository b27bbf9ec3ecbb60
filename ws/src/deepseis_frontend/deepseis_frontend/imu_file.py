"""IMU samples out of a text file of columns, on the clock of the IF samples.

What the columns mean is said in a YAML file beside it, ``<file>.yaml``::

    time: {column: t, unit: s}             # s, ms, us or ns; since sample 0 of the IF recording
    accelerometer: {columns: [ax, ay, az], unit: m/s^2}
    gyroscope: {columns: [gx, gy, gz], unit: deg/s}
    axes: [x, -y, -z]                      # forward, left, up in terms of the columns (here FRD)

Columns are named as in the file's header, or numbered from 1. Units ``m/s`` and ``rad`` or ``deg``
are increments of velocity and angle over a sample's interval. ``installation`` says how the IMU
stands at its station (`Installation`), unless the station's own file does. With
``time: {zero_utc: ...}`` time 0 is that UTC instead: as good as the IF's own ``start_utc``.
With ``time: {column: n, unit: count, triggers: file}`` a column counts the IMU's samples, and the
file has pairs of such a count and the IF sample latched with it (`deepseis_frontend.imu_clock`).
``time: {offset: ...}`` shifts all times by what ``deepseis align`` has found.
"""

from __future__ import annotations

import csv
import math
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Final, TextIO

import numpy as np

from deepseis_core.config import setting
from deepseis_core.errors import InputError
from deepseis_core.sample_clock import SampleClock, utc_ns_from_iso
from deepseis_core.types import FloatArray, ImuSample
from deepseis_core.yaml_config import fill, read_yaml
from deepseis_frontend.imu_clock import ImuClock, fit_imu_clock

Vector = tuple[float, float, float]
TIME_UNITS: Final = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "count": 1.0}
FORCE_UNITS: Final = {"m/s^2": 1.0, "g": 9.80665, "mg": 9.80665e-3, "m/s": 1.0}
RATE_UNITS: Final = {"rad/s": 1.0, "deg/s": math.pi / 180, "rad": 1.0, "deg": math.pi / 180}
INCREMENTS: Final = ("m/s", "rad", "deg")
STAMPS: Final = {"end": 0.0, "middle": 0.5, "begin": 1.0}
"""Where in its interval a sample is stamped; the part of it that is still to come."""
LOOKED_AT: Final = 400
"""Samples from which the rate is told."""
PLAUSIBLE: Final = (3.0, 60.0)
"""Of the median specific force: gravity, even while shaken [m/s^2]."""


@dataclass(frozen=True)
class TimeColumn:
    """When a sample is."""

    column: str = setting("t", "name, or number from 1 [-]")
    unit: str = setting("s", "of the column [-]", choices=tuple(TIME_UNITS))
    zero_utc: str = setting("", "UTC of time 0, ISO 8601; empty: sample 0 of the IF [-]")
    triggers: str = setting(
        "", "unit count: text of pairs, IMU count and IF sample, beside the file [-]"
    )
    offset: float = setting(0.0, "to be added to all times, as `align` finds it [s]")


@dataclass(frozen=True)
class ForceColumns:
    """Specific force, gravity in it."""

    columns: tuple[str, str, str]
    unit: str = setting("m/s^2", "of the columns [-]", choices=tuple(FORCE_UNITS))


@dataclass(frozen=True)
class RateColumns:
    """Rate of turn."""

    columns: tuple[str, str, str]
    unit: str = setting("rad/s", "of the columns [-]", choices=tuple(RATE_UNITS))


@dataclass(frozen=True)
class Installation:
    """How an IMU stands at its station, where no bag says so."""

    grade: str = setting("", "grade of the IMU (deepseis_core.imu_grades); empty: not said [-]")
    monument_ecef: Vector = setting((0.0, 0.0, 0.0), "surveyed monument, ECEF [m]")
    antenna_lever_arm: Vector = setting(
        (0.0, 0.0, 0.0), "from the monument to the antenna, east, north, up [m]"
    )
    imu_to_antenna: Vector = setting((0.0, 0.0, 0.0), "lever arm, forward, left, up [m]")
    orientation_xyzw: tuple[float, float, float, float] = setting(
        (0.0, 0.0, 0.0, 0.0), "surveyed attitude, FLU to ENU; zeros: north is to be found [-]"
    )


@dataclass(frozen=True)
class ImuFormat:
    """What the columns of a file are; the module's text explains it."""

    accelerometer: ForceColumns
    gyroscope: RateColumns
    time: TimeColumn = setting(TimeColumn(), "when a sample is")
    axes: tuple[str, str, str] = setting(("x", "y", "z"), "forward, left, up; such as -y [-]")
    stamp: str = setting("end", "of its interval, where it is stamped [-]", choices=tuple(STAMPS))
    header_lines: int = setting(1, "before the data; the last names the columns [-]", low=0)
    delimiter: str = setting(",", "between columns; blank: any white space [-]")
    installation: Installation | None = setting(None, "how the IMU stands at its station")


class ImuFile:
    """The IMU of a text file.

    Parameters
    ----------
    path : path
        The file; its format lies beside it.
    clock : SampleClock
        Of the IF samples.

    Attributes
    ----------
    rate_hz : float
        Samples a second, as the times tell.

    Raises
    ------
    InputError
        The file or its description cannot be used: the line is named.
    """

    def __init__(self, path: str | Path, clock: SampleClock) -> None:
        self.path, self.clock = Path(path), clock
        beside = Path(f"{path}.yaml")
        if not beside.is_file():
            raise InputError(self.path, f"has no {beside.name} beside it", "see docs/formats.md")
        self.format = fill(ImuFormat, read_yaml(beside))
        self._turn = axes_matrix(beside, self.format.axes)
        zero = self.format.time.zero_utc
        self._zero_ns = utc_ns_from_iso(zero) - clock.start_utc_ns if zero else 0
        self._zero_ns += round(self.format.time.offset * 1e9)
        self.imu_clock = self._triggered(beside)
        times = [t for t, _ in islice(self._rows(), LOOKED_AT)]
        if len(times) < 2:
            raise InputError(self.path, "holds less than two samples")
        self.dt = float(np.median(np.diff(times)))
        self.rate_hz = told_rate(self.dt)
        self._require_gravity()

    def samples(self, since: int = 0) -> Iterator[ImuSample]:
        """Yield the samples from a sample of the IF on.

        Raises
        ------
        InputError
            A line cannot be understood, or goes back in time.
        """
        force_unit, rate_unit = self.format.accelerometer.unit, self.format.gyroscope.unit
        force_scale = FORCE_UNITS[force_unit] / (self.dt if force_unit in INCREMENTS else 1.0)
        rate_scale = RATE_UNITS[rate_unit] / (self.dt if rate_unit in INCREMENTS else 1.0)
        shift_ns = self._zero_ns + round(STAMPS[self.format.stamp] * self.dt * 1e9)
        for seconds, values in self._rows():
            utc_ns = self.clock.start_utc_ns + shift_ns + round(seconds * 1e9)
            sample = self.clock.sample_at(utc_ns)
            if sample < since:
                continue
            rate, force = self._turn @ values[3:], self._turn @ values[:3]
            yield ImuSample(sample, rate_scale * rate, force_scale * force, 0.0, 0.0)

    def _triggered(self, beside: Path) -> ImuClock | None:
        """Return the line through the trigger counts, if the times are counts."""
        given = self.format.time
        if (given.unit == "count") != bool(given.triggers):
            raise InputError(beside, "unit count and triggers come together")
        if not given.triggers:
            return None
        path = self.path.parent / given.triggers
        try:
            with warnings.catch_warnings(action="ignore", category=UserWarning):  # it is empty
                pairs = np.loadtxt(path, delimiter=",", comments="#", ndmin=2)
        except (OSError, ValueError) as error:
            reason = " ".join(str(error).split())
            raise InputError(path, f"holds no pairs of counts: {reason}") from None
        if pairs.shape[1:] != (2,):
            raise InputError(path, "holds no pairs of counts", "IMU count, IF sample")
        return fit_imu_clock(pairs[:, 0], pairs[:, 1])

    def _seconds(self, time: float) -> float:
        """Turn a line's time into seconds since sample 0."""
        if self.imu_clock is None:
            return time * TIME_UNITS[self.format.time.unit]
        return float(self.imu_clock.sample_at(time)) / self.clock.sample_rate_hz

    def timing(self) -> dict[str, float]:
        """Return what is known of the clock that stamps it, for the diagnostics."""
        clock = self.imu_clock
        if clock is None:
            return {}
        rate = self.clock.sample_rate_hz
        return {
            "rate_measured_hz": round(clock.rate_hz(rate), 7),
            "rate_sd_hz": float(f"{clock.rate_sd_hz(rate):.2g}"),
            "time_sd_us": round(1e6 * float(clock.sd_at(clock.count)) / rate, 3),
            "trigger_jitter_us": round(1e6 * clock.jitter / rate, 3),
            "trigger_outliers": clock.outliers,
        }

    def _require_gravity(self) -> None:
        found = islice(self.samples(), LOOKED_AT)
        norms = [float(np.linalg.norm(item.linear_acceleration)) for item in found]
        if not norms:
            raise InputError(self.path, "ends before the IF recording begins")
        require_gravity(self.path, norms, "is the accelerometer's unit right?")

    def _rows(self) -> Iterator[tuple[float, FloatArray]]:
        """Yield time [s] and the six values of every line, in the columns' units."""
        try:
            with self.path.open(encoding="utf-8", newline="") as file:
                yield from self._lines(file)
        except (OSError, UnicodeDecodeError, csv.Error) as error:
            raise InputError(self.path, f"cannot be read: {error}") from None

    def _lines(self, file: TextIO) -> Iterator[tuple[float, FloatArray]]:
        given = self.format
        names = [given.time.column, *given.accelerometer.columns, *given.gyroscope.columns]
        columns: list[int] = []
        header: list[str] = []
        last = -math.inf
        for number, cells in enumerate(self._cells(file), start=1):
            if number <= given.header_lines:
                header = [cell.strip() for cell in cells]
                continue
            if not any(cells):
                continue
            columns = columns or [self._column(name, header) for name in names]
            values = self._numbers(number, cells, columns, names)
            if values[0] <= last:
                reason = f"line {number}: time {values[0]:g} comes after {last:g}"
                raise InputError(self.path, reason)
            last = float(values[0])
            yield self._seconds(last), values[1:]

    def _cells(self, file: TextIO) -> Iterator[list[str]]:
        if not self.format.delimiter.strip():
            return (line.split() for line in file)
        return iter(csv.reader(file, delimiter=self.format.delimiter, skipinitialspace=True))

    def _column(self, name: str, header: list[str]) -> int:
        if name in header:
            return header.index(name)
        if name.isdigit() and int(name) > 0:
            return int(name) - 1
        known = ", ".join(header)[:300]
        raise InputError(self.path, f"has no column {name!r}", f"it has: {known}")

    def _numbers(
        self, number: int, cells: list[str], columns: list[int], names: list[str]
    ) -> FloatArray:
        out = np.empty(len(columns))
        for k, (column, name) in enumerate(zip(columns, names, strict=True)):
            text = cells[column] if column < len(cells) else ""
            try:
                out[k] = float(text)
            except ValueError:
                out[k] = math.nan
            if not math.isfinite(out[k]):
                raise InputError(self.path, f"line {number}: {name} is {text!r}, not a number")
        return out


def told_rate(interval: float) -> float:
    """Return the rate [Hz] of a median interval [s]; times are rounded, a whole one is not."""
    rate = 1.0 / interval
    return round(rate, 3) if abs(round(rate, 3) - rate) < 1e-5 * rate else rate


def require_gravity(path: Path, norms: Sequence[float], hint: str) -> None:
    """Refuse sizes of specific forces [m/s^2] whose median is not that of gravity."""
    middle = float(np.median(norms))
    if not PLAUSIBLE[0] < middle < PLAUSIBLE[1]:
        reason = f"has a specific force of {middle:.3g} m/s^2, gravity is 9.8"
        raise InputError(path, reason, hint)


def axes_matrix(where: object, axes: tuple[str, ...]) -> FloatArray:
    """Return the matrix from the columns to forward-left-up.

    Examples
    --------
    >>> axes_matrix("a.yaml", ("y", "x", "-z")).astype(int).tolist()
    [[0, 1, 0], [1, 0, 0], [0, 0, -1]]
    """
    out = np.zeros((3, 3))
    for row, text in enumerate(axes):
        name = text.strip().lstrip("+-")
        if name not in ("x", "y", "z"):
            raise InputError(where, f"axes has {text!r}", "x, y, z, -x, -y or -z")
        out[row, "xyz".index(name)] = -1.0 if text.strip().startswith("-") else 1.0
    if abs(np.linalg.det(out) - 1.0) > 1e-9:
        reason = f"axes {', '.join(axes)} are not right-handed"
        raise InputError(where, reason, "forward, left, up, each of x, y, z once")
    return out
