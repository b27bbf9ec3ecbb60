"""The two rules that tell stillness from motion; `motion_state` puts them to use."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from deepseis_core.config import setting
from deepseis_core.types import FloatArray, MotionKind
from deepseis_ins import motion_state_kernels as kernels
from deepseis_ins.motion_limits import make_limits
from deepseis_ins.motion_noise import AXES, SMALLEST, AxisNoise

THESIS: Final = "thesis"
FAST: Final = "fast"

_MODES = {MotionKind.STATIC: 1, MotionKind.MOVING: 0, MotionKind.UNKNOWN: -1}
_TRIADS = ("gyros", "accelerometers")
_NEVER = 2**62
_LARGEST = 1e9


@dataclass(frozen=True)
class MotionConfig:
    """How stillness and motion are told apart."""

    policy: str = setting(FAST, "decision rule", choices=(FAST, THESIS))
    thresholds: tuple[float, ...] = setting(
        (), "six variances, gyros first [rad^2/s^2, m^2/s^4]; empty: of a still, or the grade's"
    )
    calibration_time: float = setting(
        0.0,
        "still at the start that shows the noise, 0: take the grade's [s]",
        low=0.0,
        high=3600.0,
    )
    window: float = setting(1.0, "of variances [s]", low=0.1, high=60.0)
    static_windows: int = setting(3, "still windows in a row (thesis)", low=1, high=100)
    false_switches_per_day: float = setting(
        0.02, "expected at rest, at most (fast) [1/day]", low=1e-9, high=1e5
    )
    quiet_time: float = setting(5.0, "without motion before still (fast) [s]", low=0.5, high=600.0)
    longest_window: float = setting(8.0, "for slow motion (fast) [s]", low=0.2, high=60.0)
    baseline_time: float = setting(
        60.0, "longest memory of the mean at rest (fast) [s]", low=1.0, high=3600.0
    )
    onset_guard: float = setting(0.05, "put before the onset found (fast) [s]", low=0.0, high=10.0)
    longest_gap: float = setting(0.1, "lost samples that do no harm [s]", low=0.0, high=10.0)


@dataclass(frozen=True)
class MotionDecision:
    """A state, and what it was decided by.

    Attributes
    ----------
    state : MotionKind
    since : int
        Sample from which it holds. MOVING: the first that motion can have touched. UNKNOWN: the
        first that is missing. STATIC: the one that decided.
    decided : int
        Last sample that was looked at for it.
    variance, threshold : ndarray, shape (6,)
        Gyros [rad^2/s^2], accelerometers [m^2/s^4]. `thesis`: of the whole window that ended last.
        `fast`: mean squares over the last 50 ms about the mean at rest; other windows decide too.
    cause : str
        What decided, for people.
    """

    state: MotionKind
    since: int
    decided: int
    variance: FloatArray
    threshold: FloatArray
    cause: str = ""


class FastRule:
    """Tests of innovations over many windows.

    Parameters
    ----------
    config : MotionConfig
    rate_hz : float
    noise : AxisNoise
    state : MotionKind
        At the first sample.
    """

    def __init__(
        self,
        config: MotionConfig,
        rate_hz: float,
        noise: AxisNoise,
        state: MotionKind = MotionKind.UNKNOWN,
    ) -> None:
        self.state, self.since, self.decided_through = state, 0, -1
        self.limits = make_limits(
            noise, rate_hz, config.longest_window, config.quiet_time, config.false_switches_per_day
        )
        self._rate_hz, self._noise = rate_hz, noise
        self._guard = round(config.onset_guard * rate_hz)
        self._gap = round(config.longest_gap * rate_hz)
        self._quiet = max(round(config.quiet_time * rate_hz), 2)
        # A coarse or perfect sensor repeats itself; one with noise that does is dead.
        noisy = bool(np.all(noise.sigma[3:] > 1.01 * SMALLEST[3:]))
        self._frozen = self._gap + 1 if noisy else _NEVER
        white = noise.sigma**2 * noise.colour
        slowest = 1.0 / (config.baseline_time * rate_hz)
        self._drive = np.maximum(noise.drift**2 / (rate_hz * white), slowest**2)
        size = 1 << int(2 * self.limits.lengths[-1]).bit_length()
        self._counters = np.zeros(kernels.COUNTERS, np.int64)
        self._baseline, self._variance = np.zeros(6), np.full(6, -1.0)
        self._previous, self._found = np.full(3, np.nan), np.zeros(3, np.int64)
        self._ring, self._numbers = np.zeros((size, 12)), np.zeros(size, np.int64)
        self._shown = int(self.limits.energy_lengths[0])
        self._tail = np.full((self._shown, 6), np.nan)
        self._rest = np.full(6, np.nan)
        # Compiles the kernels: not when the earth begins to move.
        self._advance(np.empty((0, 6)), 0, 0)
        self._look_back(0, 0)

    def feed(self, first: int, samples: FloatArray) -> list[MotionDecision]:
        """Take samples ``first ..``, shape (m, 6), and return the changes of state."""
        if self.decided_through < 0:
            self.since = first
        elif first > self.decided_through + 1:
            lost = min(first - self.decided_through - 1, self._gap + 1)
            decisions = self._feed(self.decided_through + 1, np.full((lost, 6), np.nan))
            return decisions + self._feed(first, samples)
        return self._feed(first, samples)

    def report(self) -> MotionDecision:
        """Return the present state, decided through the last sample."""
        return self._decision(self.decided_through, self._tail, "")

    def _feed(self, first: int, samples: FloatArray) -> list[MotionDecision]:
        decisions, row = [], 0
        while True:
            row, event = self._advance(samples, row, first)
            if event == kernels.NOTHING:
                break
            cause = self._change(event, first + row - 1)
            tail = self._last_rows(samples[max(0, row - self._shown) : row])
            decisions.append(self._decision(first + row - 1, tail, cause))
        self._tail = self._last_rows(samples[-self._shown :])
        self.decided_through = first + len(samples) - 1
        return decisions

    def _advance(self, samples: FloatArray, row: int, first: int) -> tuple[int, int]:
        limits = self.limits
        after, event = kernels.advance(
            samples, row, first, _MODES[self.state], 1.0 / self._noise.sigma, self._drive,
            limits.clip, self._gap, self._frozen, self._quiet, limits.lengths, limits.strides,
            limits.mean, limits.triad, limits.energy_lengths, limits.energy_strides, limits.energy,
            limits.triad_energy, self._counters, self._baseline, self._variance, self._previous,
            self._ring, self._numbers, self._found,
        )  # fmt: skip
        return int(after), int(event)

    def _change(self, event: int, number: int) -> str:
        """Take an event at a sample over into the state, and say what it was."""
        if event == kernels.QUIET:
            self.state, self.since = MotionKind.STATIC, number
            return f"quiet for {self._quiet / self._rate_hz:g} s"
        if self.state == MotionKind.STATIC:
            self._rest = self._baseline.copy()
        if event == kernels.LOST:
            frozen = int(self._found[0])
            last = int(self._counters[kernels.LAST])
            self.state = MotionKind.UNKNOWN
            self.since = max(self.since, last - frozen + 1)
            return "sensor frozen" if frozen else "samples missing"
        cause = self._cause()
        self.state, self.since = MotionKind.MOVING, max(self.since, self._onset())
        kernels.reset(self._counters, self._ring, self._variance)
        return cause

    def _onset(self) -> int:
        """Return the earliest sample that the motion just found can have touched.

        What grows linearly is noticed by the last two thirds of it: the window's own length is
        put before it, besides the guard.
        """
        kind, number, _ = (int(value) for value in self._found)
        swings = kind in (kernels.ENERGY, kernels.TRIAD_ENERGY)
        lengths = self.limits.energy_lengths if swings else self.limits.lengths
        length, count = int(lengths[number]), int(self._counters[kernels.COUNT])
        first = self._look_back(count, count - length + 1)
        return int(self._numbers[first & (self._numbers.size - 1)]) - length - self._guard

    def _look_back(self, count: int, first: int) -> int:
        limits = self.limits
        found = kernels.look_back(
            count, first, self._ring, limits.lengths, limits.mean[2], limits.triad[2],
            limits.energy_lengths, limits.energy[2], limits.triad_energy[2], self._found,
        )  # fmt: skip
        return int(found)

    def _cause(self) -> str:
        kind, number, axis = (int(value) for value in self._found)
        swings = kind in (kernels.ENERGY, kernels.TRIAD_ENERGY)
        lengths = self.limits.energy_lengths if swings else self.limits.lengths
        who = AXES[axis] if kind in (kernels.MEAN, kernels.ENERGY) else _TRIADS[axis]
        what = "energy" if swings else "mean"
        return f"{who}: {what} over {lengths[number] / self._rate_hz:g} s"

    def _last_rows(self, rows: FloatArray) -> FloatArray:
        return np.concatenate([self._tail, rows])[-self._shown :]

    def _decision(self, number: int, tail: FloatArray, cause: str) -> MotionDecision:
        rest = self._rest if self.state == MotionKind.MOVING else self._baseline
        away = tail - np.where(np.isnan(rest), self._baseline, rest)
        square = np.clip(away, -_LARGEST, _LARGEST) ** 2
        known = np.isfinite(square)
        variance = np.where(known, square, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
        limit = self.limits.energy[1, 0] / self.limits.energy_lengths[0]
        threshold = limit * self._noise.sigma**2
        return MotionDecision(self.state, self.since, number, variance, threshold, cause)


class ThesisRule:
    """Variances over whole windows of the IMU's time against thresholds.

    Parameters
    ----------
    config : MotionConfig
    rate_hz : float
    thresholds : ndarray, shape (6,)
    state : MotionKind
        At the first sample.
    origin : float
        IMU's time at the start of the interval of sample 0 [s].
    """

    def __init__(
        self,
        config: MotionConfig,
        rate_hz: float,
        thresholds: FloatArray,
        state: MotionKind = MotionKind.UNKNOWN,
        origin: float = 0.0,
    ) -> None:
        self.state, self.since, self.decided_through = state, 0, -1
        self.thresholds, self._rate_hz, self._origin = thresholds, rate_hz, origin
        self._config, self._still = config, 0
        self._gap = round(config.longest_gap * rate_hz)
        self._parts: list[FloatArray] = []
        self._next: int | None = None
        self._window = 0
        self._last = (np.full(6, np.nan), -1)

    def feed(self, first: int, samples: FloatArray) -> list[MotionDecision]:
        """Take samples ``first ..``, shape (m, 6), and return the changes of state."""
        if self._next is None:
            self._next, self.since = first, first
            self._window, self.decided_through = self._window_of(first), first - 1
        decisions = []
        for _ in range(2):
            # Windows that end within a gap; after the second nothing changes.
            if first > self._next and self._first_of(self._window + 1) <= first:
                decisions += self._close()
        if first > self._next and self._window_of(first) > self._window:
            self._window = self._window_of(first)
            self.decided_through = self._first_of(self._window) - 1
        end = first + len(samples)
        while first < end:
            until = min(end, self._first_of(self._window + 1))
            self._parts.append(samples[len(samples) - (end - first) : len(samples) - end + until])
            first = until
            if first == self._first_of(self._window + 1):
                decisions += self._close()
        self._next = end
        return decisions

    def report(self) -> MotionDecision:
        """Return the present state, decided through the last whole window."""
        variance, number = self._last
        return MotionDecision(self.state, self.since, number, variance, self.thresholds)

    def _window_of(self, number: int) -> int:
        return int(np.floor((number / self._rate_hz + self._origin) / self._config.window + 1e-9))

    def _first_of(self, window: int) -> int:
        """Return the first sample of a window: the first whose interval starts in it."""
        start = (window * self._config.window - self._origin) * self._rate_hz
        return int(np.ceil(start - 1e-6))

    def _close(self) -> list[MotionDecision]:
        """Judge the window that has ended."""
        first, end = self._first_of(self._window), self._first_of(self._window + 1)
        self._window += 1
        rows = np.concatenate([*self._parts, np.empty((0, 6))])
        rows = rows[np.isfinite(rows[:, 3:]).all(axis=1)]
        self._parts = []
        self.decided_through = end - 1
        variance = rows.var(axis=0, ddof=1) if len(rows) > 1 else np.full(6, np.nan)
        self._last = (variance, end - 1)
        above = np.flatnonzero(variance >= self.thresholds)
        whole = end - first - len(rows) <= self._gap
        self._still = self._still + 1 if whole and not above.size else 0
        if above.size and self.state != MotionKind.MOVING:
            return self._to(MotionKind.MOVING, first, f"{AXES[above[0]]}: variance")
        if self._still >= self._config.static_windows and self.state != MotionKind.STATIC:
            return self._to(MotionKind.STATIC, end - 1, f"{self._still} still windows")
        if not whole and self.state == MotionKind.STATIC:
            return self._to(MotionKind.UNKNOWN, first, "samples missing")
        return []

    def _to(self, state: MotionKind, since: int, cause: str) -> list[MotionDecision]:
        self.state, self.since = state, max(self.since, since)
        variance, number = self._last
        return [MotionDecision(self.state, self.since, number, variance, self.thresholds, cause)]
