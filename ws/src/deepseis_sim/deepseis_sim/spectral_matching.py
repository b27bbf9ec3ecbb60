"""Bends a sum of enveloped cosines until its response spectrum is the one wanted.

The record is ``a(t) = f(t) Re sum_k A_k exp(j w_k t)``. First the amplitudes are scaled by wanted
over present spectrum, frequency by frequency (this stalls at 10 to 20 %). Then the peaks are
moved one by one, in the manner of Lilhanand and Tseng [1]_: while the moment of an oscillator's
peak stands, its height is a linear function of the amplitudes, so that the least change which
puts all peaks right is a linear problem. Moving one peak may raise another; peaks once seen
therefore stay in the problem as ones that may not grow beyond the target. Peaks far off weigh
more, so that the worst of them is what shrinks.

The ground comes to rest: every change keeps the final velocity and displacement at zero.

References
----------
.. [1] K. Lilhanand and W. S. Tseng, "Development and application of realistic earthquake time
   histories compatible with multiple-damping design spectra", 9th World Conference on Earthquake
   Engineering, 1988; on its wavelets L. Al Atik and N. Abrahamson, Earthquake Spectra 26 (2010).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from deepseis_core.types import FloatArray, IntArray
from deepseis_sim.response_spectrum import peak_responses
from deepseis_sim.spectral_matching_kernel import reversed_responses, solve_positive

ComplexArray = NDArray[np.complex128]

OVERSAMPLING: Final = 4
"""Short oscillators see the record at so many times its rate."""

SHORT_PERIOD: Final = 0.2
"""Oscillators of longer period take the samples as they are [s]."""

RIGID_PERIOD: Final = 0.02
"""What stands for the period where the ground's own peak is meant [s]."""

CONTROL_SHARE: Final = 8
"""Every so many-th period is always worked on, the others where they deviate."""

RATIO_ROUNDS: Final = 3
AIM: Final = 1.01
"""Aimed at, over the target: deviations downwards, where one peak takes over from another, are
sharp cusps, those upwards are blunt."""

WORTH_MOVING: Final = 0.02
"""Deviation from which any oscillator is worked on."""

HELD_FROM: Final = 0.85
HELD_AT: Final = 0.97
"""Lesser peaks above the one, relative to the aim, are kept below the other."""

SAME_PEAK: Final = 1.0 / 40.0
SAME_SWING: Final = 1.0 / 4.0
"""Moments less than so many periods apart are taken for one, and for one swing's."""

SOFTNESS: Final = 0.01
"""What a wish left open costs against changing amplitudes: keeps the change small."""

SHARES: Final = (0.5, 0.25, 1.0)
"""Of a change, tried one after the other: peaks move in time, heights are not quite linear."""


@dataclass(frozen=True)
class CosineSum:
    """Records of the form ``f(t) Re sum_k A_k exp(j w_k t)``, ``w_k = 2 pi k / duration``.

    Attributes
    ----------
    envelope : ndarray, shape (OVERSAMPLING n,)
        ``f`` at :data:`OVERSAMPLING` times the rate of the n samples.
    step : float
        Between samples [s].
    bins : ndarray of int, shape (k,)
        The frequencies' numbers.
    """

    envelope: FloatArray
    step: float
    bins: IntArray

    @property
    def size(self) -> int:
        """Samples n of a record."""
        return self.envelope.size // OVERSAMPLING

    @property
    def time(self) -> FloatArray:
        """Of the samples, shape (n,) [s]."""
        return np.arange(self.size, dtype=np.float64) * self.step

    @property
    def frequencies_hz(self) -> FloatArray:
        """Of the cosines, shape (k,)."""
        return self.bins / (self.size * self.step)

    def fine_samples(self, amplitudes: ComplexArray) -> FloatArray:
        """Return the record, shape (OVERSAMPLING n,), at a fine step."""
        n = self.envelope.size
        lines = np.zeros(n // 2 + 1, dtype=np.complex128)
        lines[self.bins] = amplitudes * (n / 2)
        return self.envelope * fft.irfft(lines, n)

    def functional(self, weights: FloatArray) -> ComplexArray:
        """Turn weights of samples (m, n) into rows ``R`` (m, k): sums are ``Re conj(R) A``."""
        spectra = fft.rfft(weights * self.envelope[::OVERSAMPLING], axis=1)
        return np.ascontiguousarray(spectra[:, self.bins])

    def rest_rows(self) -> ComplexArray:
        """Rows (2, k) of the velocity and displacement at the end, each of unit norm."""
        left = self.size * self.step - self.time
        rows = self.functional(np.stack([np.ones_like(left), left]))
        return rows / np.linalg.norm(rows, axis=1, keepdims=True)


@dataclass(frozen=True)
class Goal:
    """What is wanted.

    ``periods`` [s], shape (m,), ascending, the first 0 for the ground's own peak; ``spectrum``
    pseudo-acceleration [m/s^2], shape (m,); ``damping`` ratio; ``tolerance``, relative.
    """

    periods: FloatArray
    spectrum: FloatArray
    damping: float
    tolerance: float


@dataclass(frozen=True)
class Match:
    """Outcome: ``amplitudes`` (k,) and the worst relative ``deviation`` from the target."""

    amplitudes: ComplexArray
    deviation: float


@dataclass(frozen=True)
class _Swings:
    """Peaks over the aim, with their signs, and when [s]; both (m,)."""

    height: FloatArray
    time: FloatArray

    @property
    def excess(self) -> FloatArray:
        """By how much each oscillator's peak exceeds the aim (m,)."""
        return np.abs(self.height) - 1.0

    @property
    def badness(self) -> float:
        """One figure that the worst deviations dominate."""
        return float(np.mean(self.excess**10) ** 0.1)

    def deviation(self) -> float:
        """Worst relative deviation from the target itself."""
        return float(np.max(np.abs((self.excess + 1.0) * AIM - 1.0)))


def match_spectrum(
    series: CosineSum, amplitudes: ComplexArray, goal: Goal, *, rounds: int
) -> Match:
    """Change amplitudes until the response spectrum is within the tolerance.

    Parameters
    ----------
    series : CosineSum
    amplitudes : ndarray of complex, shape (k,)
        To begin with.
    goal : Goal
    rounds : int
        At most so many; the best is returned also where it is not good enough.
    """
    amplitudes = _scale(series, amplitudes, goal)
    swings = _swings(series, amplitudes, goal)
    best = Match(amplitudes, swings.deviation())
    problem = _Problem(series, goal, np.abs(amplitudes))
    for _ in range(rounds):
        if best.deviation <= goal.tolerance:
            break
        change = problem.change(amplitudes, swings)
        amplitudes, swings = _step(series, amplitudes, change, goal, swings.badness)
        if swings.deviation() < best.deviation:
            best = Match(amplitudes, swings.deviation())
    return best


def _scale(series: CosineSum, amplitudes: ComplexArray, goal: Goal) -> ComplexArray:
    """Scale amplitudes by wanted over present spectrum, and bring the ground to rest."""
    at = np.log(1.0 / series.frequencies_hz)
    rest = series.rest_rows()
    amplitudes = _at_rest(rest, amplitudes)
    for _ in range(RATIO_ROUNDS):
        excess = _swings(series, amplitudes, goal).excess[1:]
        ratio = np.interp(at, np.log(goal.periods[1:]), 1.0 / (1.0 + excess))
        amplitudes = _at_rest(rest, amplitudes * ratio)
    return amplitudes


def _at_rest(rest: ComplexArray, amplitudes: ComplexArray) -> ComplexArray:
    """Make the least relative change that ends at rest where it began."""
    weight = np.abs(amplitudes)
    rows, now = _real(rest * weight), np.sum(_real(rest) * _real(amplitudes), axis=1)
    gram = np.einsum("ik,jk->ij", rows, rows)
    return amplitudes - _complex(np.einsum("i,ik->k", solve_positive(gram, now), rows)) * weight


def _swings(series: CosineSum, amplitudes: ComplexArray, goal: Goal) -> _Swings:
    """Return the peaks of all oscillators."""
    fine = series.fine_samples(amplitudes)
    short = int(np.searchsorted(goal.periods, SHORT_PERIOD))
    parts = [
        peak_responses(record, step, periods, goal.damping)
        for record, step, periods in (
            (fine, series.step / OVERSAMPLING, goal.periods[:short]),
            (fine[::OVERSAMPLING], series.step, goal.periods[short:]),
        )
    ]
    height = np.concatenate([part.pseudo_acceleration for part in parts])
    time = np.concatenate([part.time for part in parts])
    return _Swings(height / (AIM * goal.spectrum), time)


def _step(
    series: CosineSum, amplitudes: ComplexArray, change: ComplexArray, goal: Goal, badness: float
) -> tuple[ComplexArray, _Swings]:
    """Go as far along the change as does good: the first much better, else the best."""
    tried = []
    for share in SHARES:
        there = amplitudes + share * change
        swings = _swings(series, there, goal)
        tried.append((swings.badness, there, swings))
        if swings.badness < 0.7 * badness:
            break
    _, there, swings = min(tried, key=lambda item: item[0])
    return there, swings


@dataclass
class _Problem:
    """The linear problem of one round, and the peaks that it has met.

    Rows are peaks, in units of the aim, as functions of the amplitudes in units of ``weight``
    (so the least change is least in relation); the first two are the ground's rest.
    """

    series: CosineSum
    goal: Goal
    weight: FloatArray
    rows: FloatArray = field(init=False)
    gram: FloatArray = field(init=False)
    oscillator: IntArray = field(init=False)
    time: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        """Begin with the ground's rest alone."""
        rows = _real(self.series.rest_rows() * self.weight)
        self.rows = _on_grid(rows / np.linalg.norm(rows, axis=1, keepdims=True))
        self.gram = self.rows @ self.rows.T
        self.oscillator, self.time = np.array([-1, -1]), np.zeros(2)
        self._length = np.maximum(self.goal.periods, RIGID_PERIOD)

    def change(self, amplitudes: ComplexArray, swings: _Swings) -> ComplexArray:
        """Return the least change that puts all peaks right, as far as heights are linear."""
        self._meet(swings)
        wanted, held = self._wanted(amplitudes, swings)
        gram, need = self.gram[np.ix_(held, held)], wanted[held]
        importance = np.clip((need / WORTH_MOVING) ** 2, 0.3, 30.0)
        softness = SOFTNESS * np.trace(gram[2:, 2:]) / need.size / importance
        softness[:2] = 0.0
        solution = np.zeros(wanted.size)
        solution[held] = solve_positive(gram + np.diag(softness), need)
        return _complex(np.einsum("i,ij->j", solution, self.rows)) * self.weight

    def _meet(self, swings: _Swings) -> None:
        """Take up peaks not met before; they replace those of the same swing."""
        chosen = np.abs(swings.excess) > WORTH_MOVING
        chosen[::CONTROL_SHARE] = True
        oscillator = np.flatnonzero(chosen)
        time = swings.time[oscillator]
        known = self._distance(oscillator, time)
        fresh = ~np.any(known < SAME_PEAK, axis=1)
        if not fresh.any():
            return
        stays = ~np.any(known[fresh] < SAME_SWING, axis=0)
        rows = self._peak_rows(oscillator[fresh], time[fresh])
        kept = self.rows[stays]
        cross = rows @ kept.T
        self.gram = np.block([[self.gram[np.ix_(stays, stays)], cross.T], [cross, rows @ rows.T]])
        self.rows = np.concatenate([kept, rows])
        self.oscillator = np.concatenate([self.oscillator[stays], oscillator[fresh]])
        self.time = np.concatenate([self.time[stays], time[fresh]])

    def _distance(self, oscillator: IntArray, time: FloatArray) -> FloatArray:
        """Distances of peaks (m,) from those met (p,) in periods; endless between oscillators."""
        apart = np.abs(time[:, np.newaxis] - self.time) / self._length[oscillator, np.newaxis]
        return np.where(oscillator[:, np.newaxis] == self.oscillator, apart, np.inf)

    def _peak_rows(self, oscillator: IntArray, time: FloatArray) -> FloatArray:
        """Rows of the responses of oscillators at moments, over the aim."""
        series, goal = self.series, self.goal
        weights = np.zeros((time.size, series.size))
        reversed_responses(goal.periods[oscillator], goal.damping, time, series.step, weights)
        for i in np.flatnonzero(oscillator == 0):
            weights[i] = np.sinc((series.time - time[i]) / series.step)
        aim = AIM * goal.spectrum[oscillator, np.newaxis]
        return _on_grid(_real(series.functional(weights) * (self.weight / aim)))

    def _wanted(self, amplitudes: ComplexArray, swings: _Swings) -> tuple[FloatArray, IntArray]:
        """Return by how much each row should change, and the rows that matter.

        Peaks meet the aim; lesser ones met before stay a little below it.
        """
        height = np.einsum("ij,j->i", self.rows, _real(amplitudes / self.weight))
        wanted = np.sign(height) * np.minimum(0.0, HELD_AT - np.abs(height))
        matters = np.abs(height) > HELD_FROM
        every = np.arange(swings.height.size)
        distance = self._distance(every, swings.time)
        row = np.argmin(distance, axis=1)
        met = distance[every, row] < SAME_PEAK
        wanted[row[met]] = (np.sign(swings.height) - swings.height)[met]
        matters[row[met]] = True
        wanted[:2], matters[:2] = -height[:2], True
        return wanted, np.flatnonzero(matters)


def _real(rows: ComplexArray) -> Any:
    """View complex columns as pairs of real ones, so that ``Re conj(R) A`` is a product."""
    return np.ascontiguousarray(rows).view(np.float64)


def _on_grid(rows: FloatArray) -> FloatArray:
    """Round to multiples of 2^-24.

    Products of rows are then exact in whatever order they are added up, so that a seed gives the
    same bytes with any number of threads.
    """
    return np.ldexp(np.round(np.ldexp(rows, 24)), -24)


def _complex(columns: FloatArray) -> Any:
    return np.ascontiguousarray(columns).view(np.complex128)
