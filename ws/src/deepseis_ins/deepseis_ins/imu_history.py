"""The last seconds of IMU increments, in order and without holes.

Samples come in any order and are put in rows, one for every interval of the IMU; rows of samples
that are missing are made up and flagged:

- a few missing ones between two that are there: a straight line between these;
- a few that are late at the end: the last one goes on;
- more: the mean over some seconds before, in which shaking averages out and gravity, the Earth's
  rate and the biases remain.

What a row holds depends on the samples alone, not on when they came: a late one that arrives
after all puts everything where it would have been.
"""

from __future__ import annotations

import math
from bisect import bisect_right, insort
from dataclasses import dataclass
from enum import IntFlag
from typing import Final

import numpy as np
from numpy.typing import NDArray

from deepseis_core.errors import InputError
from deepseis_core.imu_grades import STANDARD_GRAVITY, ImuGrade
from deepseis_core.rotation import flu_from_frd
from deepseis_core.types import FloatArray, ImuSample, IntArray
from deepseis_ins.fusion_config import FusionConfig

_AT_RANGE = 0.999
"""Of the range: a rate so large is taken as clipped."""
_IMPOSSIBLE = 1.1
"""Of that: no sensor gives so much, it was lost on the way."""
FLAT_ROWS: Final = 3
"""So many equal forces in a row are a sensor at the end of its range."""
_ROWS = 4096
"""Room for rows, at least."""


def _sample_index(sample: ImuSample) -> int:
    return sample.sample_index


class RowFlag(IntFlag):
    """What is wrong with a row."""

    MISSING = 1
    CLIPPED = 2
    BRIDGED = 4
    """Made up between two samples that are there."""


@dataclass(frozen=True)
class Unknown:
    """Variances that faulty rows add at their end, of each axis.

    Attributes
    ----------
    velocity, attitude, position : float
        [m^2/s^2, rad^2, m^2]
    moved : float
        Covariance of position and velocity [m^2/s].
    """

    velocity: float = 0.0
    attitude: float = 0.0
    position: float = 0.0
    moved: float = 0.0


NOTHING: Final = Unknown()
_MADE_UP = int(RowFlag.MISSING | RowFlag.BRIDGED)


class ImuHistory:
    """Rows of increments, numbered from the first sample on.

    Parameters
    ----------
    config : FusionConfig
    grade : ImuGrade
        For its ranges.
    imu_rate_hz, sample_rate_hz : float
        [Hz]

    Attributes
    ----------
    counts : dict of str to int
        ``samples`` taken, ``missing`` rows, ``late`` samples that still found their place,
        ``dropped`` ones (too late, twice there, impossible), ``clipped`` ones.
    """

    def __init__(
        self, config: FusionConfig, grade: ImuGrade, imu_rate_hz: float, sample_rate_hz: float
    ) -> None:
        if not 0.0 < imu_rate_hz < sample_rate_hz:
            raise InputError("IMU rate", f"{imu_rate_hz} Hz", f"above 0, below {sample_rate_hz}")
        self.dt = 1.0 / imu_rate_hz
        self.step = sample_rate_hz / imu_rate_hz
        self._short = round(config.extrapolate_s * imu_rate_hz)
        self._mean_rows = max(1, round(config.missing_mean_s * imu_rate_hz))
        self._to_increments = np.hstack([flu_from_frd(np.full(3, self.dt))] * 2)
        ranges = np.repeat([grade.gyros.range, grade.accelerometers.range], 3)
        self._limits = _AT_RANGE * self.dt * ranges
        self._beyond_gravity = 1.15 * STANDARD_GRAVITY * self.dt
        noise = grade.accelerometers.walk * self.dt**0.5
        self._has_noise = noise > 3.0 * grade.accelerometers.resolution
        walks = np.array([config.missing_walk, config.clipped_walk, config.bridged_walk])
        angle_walk = np.radians(config.missing_angle_walk_deg)
        self._walk2: list[float] = (walks**2).tolist()
        self._turn2 = float(angle_walk**2), float((angle_walk * walks[2] / walks[0]) ** 2)
        self._pending: list[ImuSample] = []
        self._index: IntArray = np.zeros(_ROWS, np.int64)
        self._delta: FloatArray = np.zeros((_ROWS, 6))
        self._flags: NDArray[np.uint8] = np.zeros(_ROWS, np.uint8)
        self.first, self.end = 0, 0
        self._anchor = -1  # last row of a sample that is there
        self.counts = dict.fromkeys(("samples", "missing", "late", "dropped", "clipped"), 0)

    def push(self, sample: ImuSample) -> None:
        """Take a sample, in any order."""
        insort(self._pending, sample, key=_sample_index)

    def take(self, through: int) -> int | None:
        """Put samples up to sample index ``through`` in their rows.

        Returns
        -------
        int or None
            Number of the first row that is no longer what it was.
        """
        count = bisect_right(self._pending, through, key=_sample_index)
        due = self._pending[:count]
        del self._pending[:count]
        changed = [self._place(item) for item in due]
        return min((number for number in changed if number is not None), default=None)

    def fill(self, through: int) -> None:
        """Make up rows so that none is missing up to sample index ``through``."""
        if self._anchor < 0:
            return
        start = self.sample_index(self._anchor)
        self._bridge(int((through - start) / self.step), None)

    def sample_index(self, number: int) -> int:
        """Return the sample index at the end of a row."""
        return int(self._index[number - self.first])

    def number_at(self, sample_index: int) -> int:
        """Return the last row that ends at or before a sample; ``first - 1`` if none does."""
        held = self._index[: self.end - self.first]
        return self.first + int(np.searchsorted(held, sample_index, "right")) - 1

    def indices(self, begin: int, end: int) -> IntArray:
        """Return the sample indices at the ends of rows; the caller may keep them."""
        return self._index[begin - self.first : end - self.first].copy()

    def increments(self, begin: int, end: int) -> tuple[FloatArray, FloatArray]:
        """Return angles [rad] and velocities [m/s] of rows, forward-right-down, (m, 3) each."""
        rows = self.rows(begin, end)
        return rows[:, :3], rows[:, 3:]

    def rows(self, begin: int, end: int) -> FloatArray:
        """Return the same in one array, shape (m, 6); like them a view that soon changes."""
        return self._delta[begin - self.first : end - self.first]

    def count(self, begin: int, end: int, flag: RowFlag) -> int:
        """Return how many rows have a flag."""
        rows = self._flags[max(begin - self.first, 0) : max(end - self.first, 0)]
        return int(np.count_nonzero(rows & int(flag)))

    def missing_at_end(self) -> int:
        """Return how many rows after the last sample are made up."""
        return max(self.end - 1 - self._anchor, 0)

    def restart(self) -> None:
        """Forget all rows; the next sample is the first again."""
        self.first, self.end, self._anchor = 0, 0, -1

    def is_whole(self, begin: int, end: int) -> bool:
        """Return whether rows are there, measured or at least bridged, and not clipped."""
        held = self.first <= begin and end <= self.end
        return held and not self.count(begin, end, RowFlag.MISSING | RowFlag.CLIPPED)

    def unknown(self, begin: int, end: int) -> Unknown:
        """Return what faulty rows leave unknown at the end of the last of them."""
        flags = self._flags[max(begin - self.first, 0) : max(end - self.first, 0)]
        if not flags.any():
            return NOTHING
        walk2, turn2, late = 0.0, 0.0, self.dt * (len(flags) - np.arange(len(flags)) - 0.5)
        rates = np.zeros(len(flags))
        kinds = RowFlag.MISSING, RowFlag.CLIPPED, RowFlag.BRIDGED
        turns = self._turn2[0], 0.0, self._turn2[1]
        for flag, of_velocity, of_turn in zip(kinds, self._walk2, turns, strict=True):
            there = (flags & int(flag)) != 0
            rates += of_velocity * there
            turn2 += of_turn * self.dt * int(np.count_nonzero(there))
        rates *= self.dt
        walk2 = float(rates.sum())
        # Of a row itself: a walk of white noise has moved by dt^2 / 3 of its velocity's variance.
        moved2 = float((rates * (late**2 + self.dt**2 / 12.0)).sum())
        return Unknown(walk2, turn2, moved2, float((rates * late).sum()))

    def forget(self, before: int) -> None:
        """Drop rows before a number that nobody will ask for again."""
        # What missing data are made of must stay, and moving the rest must pay.
        before = min(before, self._anchor - self._mean_rows)
        gone = before - self.first
        if gone < _ROWS // 2:
            return
        kept = self.end - before
        for array in (self._index, self._delta, self._flags):
            array[:kept] = array[gone : gone + kept]
        self.first = before

    def _place(self, sample: ImuSample) -> int | None:
        """Put a sample in its row; return the row if it was there already, made up."""
        delta = np.empty(6)
        delta[:3], delta[3:] = sample.angular_velocity, sample.linear_acceleration
        delta *= self._to_increments
        size = np.abs(delta)
        if not math.isfinite(size.sum()) or (size > _IMPOSSIBLE * self._limits).any():
            self.counts["dropped"] += 1
            return None
        if self._anchor < 0:
            self._write(0, sample.sample_index, delta)
            return None
        ahead = round((sample.sample_index - self.sample_index(self._anchor)) / self.step)
        number = self._anchor + ahead
        if ahead <= 0:
            return self._place_late(number, sample, delta)
        known = self.end
        self._bridge(ahead - 1, delta)
        self._write(number, sample.sample_index, delta)
        return self._first_changed(known, number)

    def _first_changed(self, known: int, number: int) -> int | None:
        """Return the first row made up before a sample that has just come, if any was."""
        if number >= known:
            return None
        self.counts["late"] += 1
        while number - 1 >= self.first and self._made_up(number - 1):
            number -= 1
        return number

    def _made_up(self, number: int) -> bool:
        return bool(self._flags[number - self.first] & _MADE_UP)

    def _place_late(self, number: int, sample: ImuSample, delta: FloatArray) -> int | None:
        row = number - self.first
        if row < 0 or not self._made_up(number):
            self.counts["dropped"] += 1
            return None
        self.counts["late"] += 1
        anchor = self._anchor
        self._write(number, sample.sample_index, delta)
        self._anchor = anchor
        return number

    def _write(self, number: int, sample_index: int, delta: FloatArray) -> None:
        clipped = bool((np.abs(delta) >= self._limits).any())
        if not clipped and self._is_flat(delta, number):
            clipped = True
            before = slice(number - FLAT_ROWS + 1 - self.first, number - self.first)
            self._flags[before] |= int(RowFlag.CLIPPED)
        self.counts["samples"] += 1
        self.counts["clipped"] += clipped
        self._set(number, sample_index, delta, int(RowFlag.CLIPPED) if clipped else 0)
        self._anchor = number

    def _is_flat(self, delta: FloatArray, number: int) -> bool:
        """Tell whether a force beyond gravity repeats itself to the last digit.

        No sensor with noise does that, but at an end of its range that nobody has told.
        """
        high = np.abs(delta[3:]) > self._beyond_gravity
        first = number - FLAT_ROWS + 1 - self.first
        if not high.any() or not self._has_noise or first < 0:
            return False
        before = self._delta[first : number - self.first, 3:]
        return bool((high & (before == delta[3:]).all(axis=0)).any())

    def _set(self, number: int, sample_index: int, delta: FloatArray, flags: int) -> None:
        row = number - self.first
        if row >= len(self._index):
            room = 2 * len(self._index)
            self._index = np.resize(self._index, room)
            self._delta = np.resize(self._delta, (room, 6))
            self._flags = np.resize(self._flags, room)
        self._index[row], self._delta[row], self._flags[row] = sample_index, delta, flags
        self.end = max(self.end, number + 1)

    def _bridge(self, count: int, following: FloatArray | None) -> None:
        """Make up ``count`` rows after the last sample, and before ``following`` if there is."""
        if count <= 0:
            return
        start = self.sample_index(self._anchor)
        last = self._delta[self._anchor - self.first].copy()
        known, made = self.end - self._anchor - 1, 0
        if count > self._short:
            rows = np.broadcast_to(self._mean(), (count, 6))
            made = known if known > self._short else 0  # those are such already
            flags = RowFlag.MISSING
        elif following is None:
            rows, flags = np.broadcast_to(last, (count, 6)), RowFlag.MISSING
        else:
            share = np.arange(1, count + 1)[:, None] / (count + 1.0)
            rows, flags = last + share * (following - last), RowFlag.BRIDGED
        self.counts["missing"] += max(0, count - known)
        for k in range(made, count):
            index = start + int((k + 1) * self.step)
            self._set(self._anchor + k + 1, index, rows[k], int(flags))

    def _mean(self) -> FloatArray:
        rows = slice(max(0, self._anchor + 1 - self._mean_rows - self.first), None)
        held = slice(rows.start, self._anchor + 1 - self.first)
        there = (self._flags[held] & _MADE_UP) == 0
        return np.asarray(self._delta[held][there].mean(axis=0))
