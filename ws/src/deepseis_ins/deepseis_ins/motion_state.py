"""Tell whether the station is still or moving.

Two rules. `thesis` (thesis 3.4.3, equations 3.40..3.42): the variances of six axes over whole
seconds of the IMU's time, against twice the RMS of such variances at rest; one at or above its
threshold is motion at once, three seconds in a row below are stillness. `fast`: sums of
innovations over windows from two samples to seconds (`motion_state_kernels`) against limits from
the number of false switches that may be (`motion_limits`); quiet for 5 s is stillness.

A motion's beginning is looked for in what came before its discovery, with a guard: a constraint
that was used since then is to be undone. Stillness holds from the sample where it was decided.
What no accelerometer feels, constant velocity, passes for stillness.

`fast` at 200 Hz, one axis, from the true onset to the end of the deciding sample, median / 95 %
[ms], by benchmarks/bench_motion_state.py. A filter that knows the motion, at the same probability
of a false alarm, needs as long at the median, to two samples or a seventh, where nothing swings
within the window and no drift hides it. STIM300's noise is that of the thesis: its bias wanders
by 0.001 g in half a minute; with its maker's third of the white noise, steps of 0.01 g take 11.

=============  ==========  ===========  ==========
acceleration    SPAN-FSAS      STIM300       MTi-G
=============  ==========  ===========  ==========
step 0.001 g    125 / 197        hidden    2480 / -
step 0.002 g      33 / 52        hidden   517 / 877
step 0.005 g      11 / 13     217 / 396    80 / 118
step 0.01 g        9 / 11      49 / 79     23 / 33
step 0.1 g         7 / 10       8 / 11      8 / 10
0.01 g 0.5 Hz     75 / 88    268 / 318   190 / 225
0.01 g 1 Hz       48 / 56    172 / 206   122 / 141
0.01 g 2 Hz       32 / 37    112 / 140     79 / 94
0.01 g 5 Hz       20 / 23     77 / 230     48 / 58
0.01 g 10 Hz      15 / 18    179 / 319     35 / 88
=============  ==========  ===========  ==========

The sines start at zero: after 50 ms that of 0.5 Hz has reached 0.0016 g.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from deepseis_core.config import check
from deepseis_core.errors import InputError
from deepseis_core.imu_errors import ImuFlag
from deepseis_core.imu_grades import ImuGrade
from deepseis_core.types import FloatArray, MotionKind
from deepseis_ins.motion_noise import (
    Calibration,
    calibrate,
    noise_of_grade,
    noise_of_thresholds,
    thresholds_of_noise,
)
from deepseis_ins.motion_rules import (
    FAST,
    THESIS,
    FastRule,
    MotionConfig,
    MotionDecision,
    ThesisRule,
)

__all__ = ["FAST", "THESIS", "MotionConfig", "MotionDecision", "MotionDetector"]

LOWEST_RATE_HZ: Final = 40.0
"""A variance of fewer samples a second exceeds twice its expectation now and then."""

FEWEST_WINDOWS: Final = 4
"""Of a calibration."""


class MotionDetector:
    """Decides whether a station is still, sample by sample, however they are cut into chunks.

    Its noise is, in this order, that of given thresholds, of a still of ``calibration_time`` at
    the start (until then the state is not known, and MOVING if the still was none, whereupon the
    next is tried), or of the grade. With a grade its bias drift is known too, and a still must
    agree with it.

    Parameters
    ----------
    config : MotionConfig
    rate_hz : float
        IMU samples a second [Hz].
    grade : ImuGrade, optional
    origin : float, optional
        IMU's time at the start of the interval of sample 0 [s]: `thesis` windows begin on whole
        seconds of it.

    Raises
    ------
    InputError
        A setting or the rate is out of range, or nothing tells the noise.
    """

    def __init__(
        self,
        config: MotionConfig,
        rate_hz: float,
        grade: ImuGrade | None = None,
        *,
        origin: float = 0.0,
    ) -> None:
        try:
            check(config)
        except ValueError as error:
            raise InputError("motion detector", str(error)) from None
        if not LOWEST_RATE_HZ <= rate_hz <= 1e5:
            raise InputError(
                "motion detector", f"{rate_hz} Hz is no rate", f"{LOWEST_RATE_HZ:g} Hz or more"
            )
        self.config, self.rate_hz, self.origin = config, float(rate_hz), origin
        self.calibration: Calibration | None = None
        self._window = max(2, round(config.window * rate_hz))
        self._expected = None if grade is None else noise_of_grade(grade, rate_hz)
        self._rule: FastRule | ThesisRule | None = None
        self._wanted = round(config.calibration_time * rate_hz)
        self._still, self._gathered = np.empty((self._wanted, 6)), 0
        self._state, self._since = MotionKind.UNKNOWN, 0
        self._next: int | None = None
        if config.thresholds:
            drift = np.zeros(6) if self._expected is None else self._expected.drift
            noise = noise_of_thresholds(config.thresholds, drift)
            self.calibration = Calibration(noise, np.array(config.thresholds))
        elif not self._wanted and self._expected is not None:
            thresholds = thresholds_of_noise(self._expected, self._window)
            self.calibration = Calibration(self._expected, thresholds)
        elif self._wanted < FEWEST_WINDOWS * self._window:
            raise InputError(
                "motion detector",
                "nothing tells the noise of the IMU",
                f"thresholds, a grade, or calibration_time >= {FEWEST_WINDOWS} windows",
            )
        if self.calibration is not None:
            self._rule = self._make_rule(self.calibration)

    @property
    def state(self) -> MotionKind:
        """Present state."""
        return self._state if self._rule is None else self._rule.state

    @property
    def decided_through(self) -> int | None:
        """Last sample whose state is decided; a motion found later may reach back before it."""
        if self._next is None:
            return None
        return self._next - 1 if self._rule is None else self._rule.decided_through

    def report(self) -> MotionDecision:
        """Return the present state as a decision, with the present variances."""
        if self._rule is not None and self._next is not None:
            return self._rule.report()
        nothing = np.full(6, np.nan)
        last = -1 if self._next is None else self._next - 1
        return MotionDecision(self.state, self._since, last, nothing, nothing, "calibrating")

    def push(
        self,
        first_sample_number: int,
        omega: ArrayLike | None,
        force: ArrayLike,
        flags: ArrayLike | None = None,
    ) -> list[MotionDecision]:
        """Take the next samples, and return the changes of state that they make.

        Parameters
        ----------
        first_sample_number : int
            Of the IMU; samples that are left out count as lost.
        omega : array_like, shape (m, 3), optional
            Angular rate, mean over the interval [rad/s]; None or not a number: there is none.
        force : array_like, shape (m, 3)
            Specific force [m/s^2]; not a number: the sample is lost.
        flags : array_like of int, shape (m,), optional
            Bits of `deepseis_core.imu_errors.ImuFlag`. Clipped samples count as they are: far off.
        """
        samples = _rows(omega, force, flags)
        first = int(first_sample_number)
        if self._next is not None and first < self._next:
            raise InputError(
                "IMU samples", f"start at number {first}", f"{self._next} is the next one"
            )
        if not len(samples):
            return []
        gap = self._next is not None and first > self._next
        if self._next is None:
            self._since = first
        self._next = first + len(samples)
        if self._rule is not None:
            return self._rule.feed(first, samples)
        if gap:
            self._gathered = 0
        return self._calibrate(first, samples)

    def _calibrate(self, first: int, samples: FloatArray) -> list[MotionDecision]:
        """Gather a still without gaps; judge it when it is long enough."""
        decisions: list[MotionDecision] = []
        lost = np.flatnonzero(~np.isfinite(samples[:, 3:]).all(axis=1))
        row = 0
        while row < len(samples) and self._rule is None:
            ahead = lost[np.searchsorted(lost, row) :]
            until = int(ahead[0]) if ahead.size else len(samples)
            if until == row:
                self._gathered, row = 0, row + 1
                continue
            count = min(until - row, self._wanted - self._gathered)
            self._still[self._gathered : self._gathered + count] = samples[row : row + count]
            self._gathered, row = self._gathered + count, row + count
            if self._gathered == self._wanted:
                decisions += self._judge(first + row)
        if self._rule is not None and row < len(samples):
            decisions += self._rule.feed(first + row, samples[row:])
        return decisions

    def _judge(self, end: int) -> list[MotionDecision]:
        """Calibrate with the still that ends before sample ``end``."""
        found = calibrate(self._still, self.rate_hz, self._window, self._expected)
        self.calibration = found
        if found.noise is not None:
            self._rule = self._make_rule(found)
            decisions = self._rule.feed(end - self._wanted, self._still)
            self._still = np.empty((0, 6))
            # Before its end there was nothing to decide with.
            return [
                MotionDecision(d.state, d.since if d.state == MotionKind.MOVING else end - 1,
                               end - 1, d.variance, d.threshold, d.cause)
                for d in decisions[-1:]
            ]  # fmt: skip
        half = self._wanted // 2
        self._still[: self._wanted - half] = self._still[half:].copy()
        self._gathered = self._wanted - half
        if self._state == MotionKind.MOVING:
            return []
        self._state = MotionKind.MOVING
        nothing = np.full(6, np.nan)
        return [
            MotionDecision(
                self._state, self._since, end - 1, nothing, found.thresholds,
                f"no still: {found.problem}",
            )
        ]  # fmt: skip

    def _make_rule(self, found: Calibration) -> FastRule | ThesisRule:
        if self.config.policy == THESIS:
            return ThesisRule(
                self.config, self.rate_hz, found.thresholds, self._state, self.origin
            )
        assert found.noise is not None
        return FastRule(self.config, self.rate_hz, found.noise, self._state)


def _rows(omega: ArrayLike | None, force: ArrayLike, flags: ArrayLike | None) -> FloatArray:
    """Return one row of six a sample; what is not there is not a number."""
    forces = np.asarray(force, np.float64)
    if forces.ndim != 2 or forces.shape[1] != 3:
        raise InputError("specific forces", f"have shape {forces.shape}", "one row of three each")
    rows = np.full((len(forces), 6), np.nan)
    rows[:, 3:] = forces
    if omega is not None:
        rates = np.asarray(omega, np.float64)
        if rates.shape != forces.shape:
            raise InputError(
                "angular rates", f"have shape {rates.shape}", f"{forces.shape}, as the forces"
            )
        rows[:, :3] = rates
    if flags is not None:
        bits = np.asarray(flags)
        if bits.shape != forces.shape[:1]:
            raise InputError("IMU flags", f"have shape {bits.shape}", "one a sample")
        rows[(bits.astype(np.int64) & int(ImuFlag.NO_GYROS)) != 0, :3] = np.nan
    return rows
