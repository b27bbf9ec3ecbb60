"""The last seconds of IMU increments, in order and without holes.

Samples come in any order and are put in rows, one for every interval of the IMU; rows of samples
that are missing are made up and flagged:

- up to ``bridge_s`` between two that are there: a straight line between these;
- up to ``extrapolate_s`` at the end: the last one goes on;
- more: the mean over some seconds before, in which shaking averages out and gravity, the Earth's
  rate and the biases remain.

How far off the first two may be is tried on the rows before (`imu_bridge`).

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
from deepseis_ins.imu_bridge import held_off2, line, line_off2

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
    HELD = 8
    """Made up at the end: the last sample goes on."""


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
_MADE_UP = int(RowFlag.MISSING | RowFlag.BRIDGED | RowFlag.HELD)
_NOT_WHOLE = RowFlag.MISSING | RowFlag.HELD | RowFlag.CLIPPED
_ANGLES, _VELOCITIES = slice(0, 3), slice(3, 6)


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
        self._held_rows = round(config.extrapolate_s * imu_rate_hz)
        self._bridged_rows = round(config.bridge_s * imu_rate_hz)
        self._mean_rows = max(1, round(config.missing_mean_s * imu_rate_hz))
        self._tried_rows = round(config.bridge_memory_s * imu_rate_hz)
        self._to_increments = np.hstack([flu_from_frd(np.full(3, self.dt))] * 2)
        ranges = np.repeat([grade.gyros.range, grade.accelerometers.range], 3)
        self._limits = _AT_RANGE * self.dt * ranges
        self._beyond_gravity = 1.15 * STANDARD_GRAVITY * self.dt
        noise = grade.accelerometers.walk * self.dt**0.5
        self._has_noise = noise > 3.0 * grade.accelerometers.resolution
        walks = config.missing_walk, np.radians(config.missing_angle_walk_deg)
        self._missing2: FloatArray = self.dt * np.square(walks)
        self._held2: FloatArray = self._missing2 * (config.held_walk / config.missing_walk) ** 2
        self._clipped2 = self.dt * config.clipped_walk**2
        self._pending: list[ImuSample] = []
        self._index: IntArray = np.zeros(_ROWS, np.int64)
        self._delta: FloatArray = np.zeros((_ROWS, 6))
        self._flags: NDArray[np.uint8] = np.zeros(_ROWS, np.uint8)
        self._off2: FloatArray = np.zeros((_ROWS, 2))  # variances of velocity and angle
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
        self._make_up(self._anchor, int((through - start) / self.step), None)

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

    def restart(self) -> None:
        """Forget all rows; the next sample is the first again."""
        self.first, self.end, self._anchor = 0, 0, -1

    def is_whole(self, begin: int, end: int) -> bool:
        """Return whether rows are there, measured or at least bridged, and not clipped."""
        held = self.first <= begin and end <= self.end
        return held and not self.count(begin, end, _NOT_WHOLE)

    def unknown(self, begin: int, end: int) -> Unknown:
        """Return what faulty rows leave unknown at the end of the last of them."""
        flags = self._flags[max(begin - self.first, 0) : max(end - self.first, 0)]
        if not flags.any():
            return NOTHING
        late = self.dt * (len(flags) - np.arange(len(flags)) - 0.5)
        off2 = self._off2[max(begin - self.first, 0) : max(end - self.first, 0)]
        velocity = off2[:, 0] + self._clipped2 * ((flags & int(RowFlag.CLIPPED)) != 0)
        # Of a row itself: a walk of white noise has moved by dt^2 / 3 of its velocity's variance.
        moved2 = float((velocity * (late**2 + self.dt**2 / 12.0)).sum())
        moved = float((velocity * late).sum())
        return Unknown(float(velocity.sum()), float(off2[:, 1].sum()), moved2, moved)

    def forget(self, before: int) -> None:
        """Drop rows before a number that nobody will ask for again."""
        # What missing data are made of must stay, and moving the rest must pay.
        before = min(before, self._anchor - max(self._mean_rows, self._tried_rows))
        gone = before - self.first
        if gone < _ROWS // 2:
            return
        kept = self.end - before
        for array in (self._index, self._delta, self._flags, self._off2):
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
        changed = self._make_up(self._anchor, ahead - 1, delta)
        self._write(number, sample.sample_index, delta)
        if number >= known:
            return changed
        self.counts["late"] += 1
        self.counts["missing"] -= known - number - 1  # `fill` makes them up from this one
        self.end = number + 1
        return number if changed is None else changed

    def _place_late(self, number: int, sample: ImuSample, delta: FloatArray) -> int | None:
        """Put a sample between others, and make up anew what was made up without it."""
        if number < self.first or not self._made_up(number):
            self.counts["dropped"] += 1
            return None
        self.counts["late"] += 1
        anchor = self._anchor
        self._write(number, sample.sample_index, delta)
        self._anchor, begin = anchor, number
        while begin > self.first and self._made_up(begin - 1):
            begin -= 1
        self._make_up_anew(begin)
        return begin

    def _make_up_anew(self, begin: int) -> None:
        """Make up all rows again from one on: what they are made of has changed."""
        flags = self._flags[begin - self.first : self.end - self.first]
        made = (flags & _MADE_UP) != 0
        edges = begin + np.flatnonzero(np.diff(made, prepend=False, append=False))
        for first, end in edges.reshape(-1, 2).tolist():
            if first > self.first:
                following = self.rows(end, end + 1)[0] if end < self.end else None
                self._make_up(first - 1, end - first, following, again=True)

    def _made_up(self, number: int) -> bool:
        return bool(self._flags[number - self.first] & _MADE_UP)

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
        row = self._room(number + 1) - 1
        self._index[row], self._delta[row], self._flags[row] = sample_index, delta, flags
        self._off2[row] = 0.0

    def _room(self, end: int) -> int:
        """Let rows go on up to ``end`` if they do not yet; return its place in the arrays."""
        self.end, row = max(self.end, end), end - self.first
        while row > len(self._index):
            room = 2 * len(self._index)
            self._index, self._flags = np.resize(self._index, room), np.resize(self._flags, room)
            self._delta = np.resize(self._delta, (room, 6))
            self._off2 = np.resize(self._off2, (room, 2))
        return row

    def _make_up(
        self, before: int, count: int, following: FloatArray | None, *, again: bool = False
    ) -> int | None:
        """Make up ``count`` rows after row ``before``, up to ``following`` if it is there.

        Returns
        -------
        int or None
            The first that is no longer what it was.
        """
        known = 0 if again else min(self.end - before - 1, count)
        if count <= 0 or (count <= known and following is None):
            return None
        self.counts["missing"] += 0 if again else count - known
        last = self._delta[before - self.first].copy()
        if count > (self._held_rows if following is None else self._bridged_rows):
            # Rows that were more than may be held are means already.
            first = known if known > self._held_rows else 0
            rows, flag, off2 = self._mean(before), RowFlag.MISSING, self._missing2
        elif following is None:
            first, rows, flag = 0, last, RowFlag.HELD
            off2 = self._off2_of(before, count, None) + self._held2
        else:
            first, rows, flag = 0, line(last, following, count), RowFlag.BRIDGED
            off2 = self._off2_of(before, count, following - last)
        self._fill(before, (first, count), rows, int(flag), off2)
        return before + 1 if known > first else None

    def _fill(
        self, before: int, span: tuple[int, int], rows: FloatArray, flags: int, off2: FloatArray
    ) -> None:
        """Fill some of the rows after row ``before``."""
        after = before + 1 - self.first
        self._room(before + 1 + span[1])
        made = slice(after + span[0], after + span[1])
        later = self.step * np.arange(span[0] + 1, span[1] + 1)
        self._index[made] = self.sample_index(before) + later.astype(np.int64)
        self._delta[made] = rows
        self._flags[made], self._off2[made] = flags, off2

    def _off2_of(self, before: int, count: int, jump: FloatArray | None) -> FloatArray:
        """Return variances, velocity's and angle's, that each of some made up rows adds."""
        rows, measured = self._recent(before, self._tried_rows, int(RowFlag.MISSING))
        if jump is None:
            off2 = held_off2(rows, measured, count)
        else:
            off2 = line_off2(rows, measured, count, jump)
        if off2 is None:
            return self._missing2
        return np.array([off2[_VELOCITIES].max(), off2[_ANGLES].max()]) / count

    def _mean(self, before: int) -> FloatArray:
        rows, measured = self._recent(before, self._mean_rows, _MADE_UP)
        return np.asarray(rows[measured].mean(axis=0))

    def _recent(
        self, through: int, count: int, without: int
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return the last ``count`` rows up to one, and which have none of some flags."""
        held = slice(max(0, through + 1 - count - self.first), through + 1 - self.first)
        return self._delta[held], (self._flags[held] & without) == 0
