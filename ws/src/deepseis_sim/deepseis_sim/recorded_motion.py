"""The ground moves as an accelerometer recorded it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from deepseis_core.config import setting
from deepseis_core.errors import InputError
from deepseis_core.types import FloatArray
from deepseis_sim.accelerogram import ABSENT, Accelerogram, read_accelerogram
from deepseis_sim.integration import ground_motion
from deepseis_sim.merged_motion import delay_between, merge
from deepseis_sim.motion import Kinematics, Motion, MotionConfig, Surroundings
from deepseis_sim.motions_shapes import (
    LONGEST,
    Derivatives,
    Upright,
    check_settings,
    pulse,
    rise_by,
)
from deepseis_sim.uniform_spline import UniformSpline

LOWEST_CORNER_HZ: Final = 1e-3
"""Lower ones would need hours of tails."""


@dataclass(frozen=True)
class RecordedMotion(Upright):
    """A stretch of a record, faded in and out so that the body rests before and after.

    The displacement is multiplied by a window with four continuous derivatives: position,
    velocity and acceleration stay derivatives of each other.

    Attributes
    ----------
    record : UniformSpline
        Displacement [m] over the record's own time, axes east, north, up.
    start, length, fade : float
        First movement, duration, rise and fall of the window [s].
    from_s : float
        Record's time at ``start`` [s].
    factor : float
        What the record is multiplied by.
    offset : ndarray, shape (3,)
        Displacement that remains, east, north, up [m].
    offset_span : tuple of float
        First moment and duration of the offset's rise [s].
    """

    record: UniformSpline
    start: float
    length: float
    fade: float
    from_s: float
    factor: float
    offset: FloatArray
    offset_span: tuple[float, float]

    @property
    def span(self) -> tuple[float, float]:
        """First and last movement [s]."""
        return self.start, self.start + self.length

    def at(self, time: FloatArray) -> Kinematics:
        """Evaluate at times [s], shape (m,)."""
        times = np.asarray(time, np.float64)
        p, v, a = self.record.evaluate(times - self.start + self.from_s)
        w, w1, w2 = _columns(pulse(times, self.start, self.length, self.fade), self.factor)
        position, velocity = w * p, w * v + w1 * p
        acceleration = w * a + 2.0 * w1 * v + w2 * p
        if self.offset.any():
            for total, part in zip(
                (position, velocity, acceleration),
                _columns(rise_by(times, *self.offset_span), self.offset),
                strict=True,
            ):
                total += part
        return Kinematics(position, velocity, acceleration)


def _columns(amount: Derivatives, factor: float | FloatArray) -> Derivatives:
    value, slope, curve = (item[:, np.newaxis] * factor for item in amount)
    return value, slope, curve


@dataclass(frozen=True)
class Recorded:
    """Ground motion of a recorded earthquake.

    Formats are those of `deepseis_sim.accelerogram.read_accelerogram`. The whole record is
    freed of its mean, filtered and integrated; then the used part is cut out, freed of the
    straight line between its ends, and faded in and out. With the displacement that GNSS saw
    the motion is whole (`merged_motion`): it begins at rest and ends where the ground ended up.
    """

    file: str = setting(
        "", "record: a file, one of K-NET's three, a pattern (*) or a folder, from the scenario's"
    )
    hint: str = setting("", "what to say where the file is absent")
    start: float = setting(20.0, "first movement [s]", low=0.0, high=LONGEST)
    from_s: float = setting(
        0.0, "where the used part of the record begins [s]", low=0.0, high=LONGEST
    )
    length_s: float = setting(
        0.0, "length of the used part [s]; 0: to the end", low=0.0, high=LONGEST
    )
    fade_s: float = setting(
        2.0, "rise and fall of the displacement at its ends [s]", low=0.1, high=1000.0
    )
    scale: float = setting(1.0, "factor of the motion", low=-1e3, high=1e3)
    pga: float = setting(
        0.0,
        "if > 0, scales the larger horizontal peak of the used part to this [m/s^2]",
        low=0.0,
        high=1e3,
    )
    low_hz: float = setting(0.01, "low corner of the band-pass [Hz]; 0: none", low=0.0, high=100.0)
    high_hz: float = setting(
        45.0, "high corner of the band-pass [Hz]; 0: none", low=0.0, high=1000.0
    )
    order: int = setting(4, "order of the filter, which runs both ways", low=1, high=8)
    still_s: float = setting(
        0.0,
        "the mean is taken over this time at the beginning [s]; 0: over all",
        low=0.0,
        high=1e4,
    )
    trend_degree: int = setting(
        0, "degree of the polynomial taken off the velocity; 0: none", low=0, high=6
    )
    count_scale: float = setting(
        0.0, "m/s^2 per count, for miniSEED [m/s^2]; 0: the file's", low=-1e3, high=1e3
    )
    azimuth_deg: float = setting(
        0.0,
        "azimuth of the first horizontal axis where the file is silent [deg]",
        low=-360.0,
        high=360.0,
    )
    offset_enu: tuple[float, ...] = setting(
        (0.0, 0.0, 0.0), "displacement that remains: east, north, up [m]", low=-1e3, high=1e3
    )
    offset_at_s: float = setting(
        0.0, "when it begins to come [s after start]", low=0.0, high=LONGEST
    )
    offset_over_s: float = setting(
        0.0, "time it takes to come [s]; 0: until the end", low=0.0, high=LONGEST
    )

    displacement: str = setting(
        "",
        "GNSS displacement of the place, a file, a pattern (*) or a folder: with it the ground "
        "does below the crossover what GNSS saw, and stays where it ended up",
    )
    displacement_scale: float = setting(
        0.0, "metres per count of it [m]; 0: the file's", low=-1e3, high=1e3
    )
    displacement_delay_s: float = setting(
        0.0,
        "the record begins later after the displacement than the files say, by so much [s]",
        low=-LONGEST,
        high=LONGEST,
    )
    crossover_hz: float = setting(
        0.08,
        "with a displacement: its motion below, the record's above, in place of low_hz [Hz]",
        low=LOWEST_CORNER_HZ,
        high=10.0,
    )

    def build(self, around: Surroundings) -> Motion:
        """Read, correct and integrate the record."""
        check_settings("recorded", self)
        self._check()
        path = around.folder / self.file
        found = self._read(path, self.count_scale)
        moved = None
        if self.displacement:
            moved = self._read(around.folder / self.displacement, self.displacement_scale)
        motion = self._motion(found, path, moved)
        return motion if self.pga <= 0 else self._to_peak(motion, found.rate_hz)

    def _read(self, path: Path, scale: float) -> Accelerogram:
        try:
            return read_accelerogram(path, scale=scale or None, azimuth_deg=self.azimuth_deg)
        except InputError as error:
            absent = error.reason == ABSENT
            raise InputError(
                error.what, error.reason, self.hint if absent else error.hint
            ) from None

    def _check(self) -> None:
        wrong = ""
        if not self.file:
            wrong = "file is not set"
        elif 0 < self.low_hz < LOWEST_CORNER_HZ:
            wrong = f"low_hz = {self.low_hz} is below {LOWEST_CORNER_HZ}; 0 is none"
        elif 0 < self.high_hz <= self.low_hz:
            wrong = f"high_hz = {self.high_hz} is not above low_hz = {self.low_hz}"
        elif self.pga > 0 and self.scale != 1.0:
            wrong = "pga and scale are both set"
        elif self.displacement and (self.pga > 0 or self.scale != 1.0 or any(self.offset_enu)):
            wrong = "a displacement says how far it goes: no scale, pga or offset_enu"
        elif len(self.offset_enu) != 3:
            wrong = f"offset_enu has {len(self.offset_enu)} items, not east, north, up"
        if wrong:
            raise InputError("recorded", wrong)

    def _motion(
        self, found: Accelerogram, path: Path, moved: Accelerogram | None
    ) -> RecordedMotion:
        whole = (found.acceleration.shape[0] - 1) / found.rate_hz
        length = self.length_s or whole - self.from_s
        if length <= 0 or self.from_s + length > whole + 0.5 / found.rate_hz:
            asked = f"from_s = {self.from_s:g}, length_s = {self.length_s:g}"
            raise InputError(path, f"the record is {whole:g} s long; asked for: {asked}")
        if length < 2 * self.fade_s:
            raise InputError(
                "recorded", f"{length:g} s are too short for fade_s = {self.fade_s:g}"
            )
        arrival = self.offset_over_s or length - self.offset_at_s
        if any(self.offset_enu) and not 0 < arrival <= length - self.offset_at_s:
            raise InputError("recorded", f"the offset comes later than the record's {length:g} s")
        spline = ground_motion(
            found.acceleration,
            found.rate_hz,
            low_hz=self.low_hz if moved is None else self.crossover_hz,
            high_hz=self.high_hz,
            order=self.order,
            still_s=self.still_s,
            trend_degree=self.trend_degree,
            taper_s=min(self.fade_s, whole / 2),
        )
        offset, offset_span = np.array(self.offset_enu, np.float64), (self.offset_at_s, arrival)
        if moved is not None:
            used = self.from_s, self.from_s + length
            delay = delay_between(found, moved) + self.displacement_delay_s
            whole_motion = merge(spline, moved, delay, self.crossover_hz, self.order, used)
            spline, offset, offset_span = whole_motion.motion, whole_motion.offset, (0.0, length)
        return RecordedMotion(
            record=_used(spline, self.from_s, length),
            start=self.start,
            length=length,
            fade=self.fade_s,
            from_s=self.from_s,
            factor=self.scale,
            offset=offset,
            offset_span=(self.start + offset_span[0], offset_span[1]),
        )

    def _to_peak(self, motion: RecordedMotion, rate_hz: float) -> RecordedMotion:
        time = motion.start + np.arange(0.0, motion.length, 0.25 / rate_hz)
        shaking = replace(motion, offset=np.zeros(3)).at(time).acceleration
        peak = float(np.abs(shaking[:, :2]).max())
        if not peak > 0:
            raise InputError("recorded", "pga is set, but the used part does not move")
        return replace(motion, factor=self.pga / peak)


def _used(spline: UniformSpline, from_s: float, length: float) -> UniformSpline:
    """Cut out what is needed, and make it begin and end at zero by taking off a straight line.

    Amid long-period motion the displacement is far from zero where the used part begins; without
    this the fade would have to carry the body there.
    """
    ends = spline.evaluate([from_s, from_s + length])[0]
    slope = (ends[1] - ends[0]) / length
    first = max(int((from_s - spline.start) / spline.step) - 1, 0)
    last = int((from_s + length - spline.start) / spline.step) + 3
    knots = spline.knots[first:last].copy()
    start = spline.start + first * spline.step
    time = start - from_s + spline.step * np.arange(knots.shape[0])
    knots[:, 0] -= ends[0] + time[:, np.newaxis] * slope
    knots[:, 1] -= slope
    return UniformSpline(start, spline.step, knots)


MOTION_KINDS: Final[Mapping[str, type[MotionConfig]]] = {"recorded": Recorded}
