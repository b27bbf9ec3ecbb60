"""Smoothing: what later measurements say of what a filter estimated before.

The fixed-interval smoother of Rauch, Tung and Striebel (accelerometer-PPP paper, equations 11
and 12) in terms of errors. A filter that takes its estimates off at once leaves, of step k, the
covariance ``P[k]`` after its measurements and the error ``c[k]`` they took off. With ``P-[k]``
before them and the transition ``Phi`` between, the error that is left in step k is, as far as all
measurements tell::

    d[N] = 0,    d[k] = A[k] (c[k+1] + d[k+1]),    A[k] = P[k] Phi^T (P-[k+1])^-1
    S[N] = P[N], S[k] = P[k] + A[k] (S[k+1] - P-[k+1]) A[k]^T

Nothing of the state itself enters: the same code serves linear filters, the mechanisation's 15
states and whatever has a transition.

What is exact. The estimate before step k+1 errs by ``e-``, that after step k by ``e``; with A as
above ``e - A e-`` is uncorrelated with ``e-``, and with all noise after it. The smoothed error is
``(e - A e-) + A s``, and ``s``, that of step k+1, depends on ``e-`` and later noise only. So S is
the true covariance of the smoothed error *whatever gains the filter used*, if the filter's own
covariances are true. It is the least possible one if the gains were optimal. Where parameters are
considered (`deepseis_core.kalman`) the errors must be those of states and parameters together:
then S is exact, though not the least, and the parameters stay what they were. Smoothing the
states alone, with their block of P, would leave out that the parameters act in the future as
they did before, and S would be wrong.

Covariances may be singular (a reference that *is* the attitude, a constant known exactly): the
inverse is a pseudo-inverse of correlations.

References
----------
.. [1] H. E. Rauch, F. Tung and C. T. Striebel, "Maximum likelihood estimates of linear dynamic
   systems", AIAA Journal 3, 1965.
.. [2] P. D. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
   Systems", 2nd ed., section 3.4.6.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from deepseis_core.errors import InputError
from deepseis_core.types import FloatArray
from deepseis_ins import smoother_kernels as kernels

LONGEST_LAG: Final = 60.0
"""[s]"""


@dataclass(frozen=True)
class FilterStep:
    """What a filter went through from one moment to the next, and its measurements there.

    Attributes
    ----------
    transition : ndarray, shape (n, n)
        Of the errors from the step before, after its measurements, to this, before them.
    before : ndarray, shape (n, n)
        Covariance before the measurements.
    correction : ndarray, shape (n,)
        Error that they made known and that was taken off; zero without any.
    after : ndarray, shape (n, n)
        Covariance after them.
    """

    transition: FloatArray
    before: FloatArray
    correction: FloatArray
    after: FloatArray


@dataclass(frozen=True)
class Steps:
    """Many steps, as the kernels want them: `FilterStep` with an axis of k steps in front."""

    transition: FloatArray
    before: FloatArray
    correction: FloatArray
    after: FloatArray

    @classmethod
    def of(cls, steps: Sequence[FilterStep]) -> Steps:
        """Put steps one after the other."""
        if not steps:
            raise InputError("smoother", "has no steps to work through")
        return cls(
            np.array([step.transition for step in steps]),
            np.array([step.before for step in steps]),
            np.array([step.correction for step in steps]),
            np.array([step.after for step in steps]),
        )


@dataclass(frozen=True)
class Smoothed:
    """Errors left in k states of a filter, to be taken off, and what is left after that.

    Attributes
    ----------
    error : ndarray, shape (k, n)
        Of the state after each step's measurements.
    error_before : ndarray, shape (k, n)
        Of the state before them.
    P : ndarray, shape (k, n, n)
        Covariance of the smoothed state.
    """

    error: FloatArray
    error_before: FloatArray
    P: FloatArray


def smooth(steps: Steps | Sequence[FilterStep]) -> Smoothed:
    """Smooth an interval: every step with all measurements of all steps.

    Examples
    --------
    A constant, unknown before and measured twice with variance 1: 0.4 and then 0.8. The filter
    went to 0.4, then to 0.6; seen from the end it was 0.2 too low at first.

    >>> still = np.eye(1)
    >>> first = FilterStep(still, np.array([[1e9]]), np.array([-0.4]), np.array([[1.0]]))
    >>> second = FilterStep(still, np.array([[1.0]]), np.array([-0.2]), np.array([[0.5]]))
    >>> got = smooth([first, second])
    >>> got.error.ravel().round(3).tolist(), got.P.ravel().round(3).tolist()
    ([-0.2, 0.0], [0.5, 0.5])
    """
    steps = steps if isinstance(steps, Steps) else Steps.of(steps)
    gain = np.empty_like(steps.before)
    kernels.gains_kernel(steps.transition, steps.before, steps.after, gain)
    error, P = np.empty_like(steps.correction), np.empty_like(steps.before)
    kernels.backward_kernel(gain, steps.before, steps.after, steps.correction, error, P)
    return Smoothed(error, error + steps.correction, P)


def between(
    start: FloatArray,
    end: FloatArray,
    position: slice,
    velocity: slice,
    share: FloatArray,
    dt: float,
) -> FloatArray:
    """Return errors between two steps, shape (m, n).

    Without measurements between them the velocity's error goes almost along a straight line, and
    the position's is its integral: what white noise of the acceleration leaves of both is a cubic
    with their values and slopes at the ends. All others go along straight lines.

    Parameters
    ----------
    start : ndarray, shape (n,)
        After the measurements of the first: `Smoothed.error`.
    end : ndarray, shape (n,)
        Before those of the second: `Smoothed.error_before`.
    position, velocity : slice
        Where they stand.
    share : ndarray, shape (m,)
        Time since the first step, over ``dt``.
    dt : float
        Between the steps [s].
    """
    u = np.asarray(share, np.float64)[:, None]
    out = (1.0 - u) * start + u * end
    p, v = (start[position], end[position]), (start[velocity], end[velocity])
    across = p[1] - p[0]
    bend = u * (1.0 - u)
    out[:, position] += bend * ((1.0 - u) * (dt * v[0] - across) - u * (dt * v[1] - across))
    mean = across / dt
    out[:, velocity] += 6.0 * bend * (mean - 0.5 * (v[0] + v[1]))
    return np.asarray(out)


@dataclass(frozen=True)
class LateStep:
    """A step as it is known some time later.

    Attributes
    ----------
    time : float
        Of the step [s].
    error, error_before : ndarray, shape (n,)
        As in `Smoothed`.
    P : ndarray, shape (n, n)
    """

    time: float
    error: FloatArray
    error_before: FloatArray
    P: FloatArray


class FixedLagSmoother:
    """Smooths behind the present: a step comes out once measurements of a lag after it are in.

    What comes out is, to the bit, what `smooth` gives for the steps from there to the newest.

    Parameters
    ----------
    lag : float
        Least time between a step and the newest [s].
    batch : float
        Steps come out together when the oldest has waited so much longer [s]; a backward pass
        costs as much for one as for all.
    """

    def __init__(self, lag: float, batch: float = 0.0) -> None:
        if not 0.0 < lag <= LONGEST_LAG:
            raise InputError("smoother's lag", f"is {lag:g} s", f"above 0, up to {LONGEST_LAG:g}")
        if not 0.0 <= batch <= LONGEST_LAG:
            raise InputError("smoother's batch", f"is {batch:g} s", f"0 to {LONGEST_LAG:g}")
        self.lag, self.batch = lag, batch
        self._released = -np.inf
        self._times: list[float] = []
        self._steps: list[FilterStep] = []
        self._gains: list[FloatArray] = []

    def push(self, time: float, step: FilterStep) -> list[LateStep]:
        """Take the newest step; return those that are old enough now, in order."""
        if self._times and time < self._times[-1]:
            raise InputError("smoother", f"step at {time:g} s comes late", "in order of time")
        if self._steps:
            last = self._steps[-1].after
            self._gains.append(kernels.gain_kernel(last, step.transition, step.before))
        self._times.append(time)
        self._steps.append(step)
        if time - self._times[0] < self.lag + self.batch:
            return []
        return self._release(sum(time - each >= self.lag for each in self._times))

    def flush(self) -> list[LateStep]:
        """Return all that is left, smoothed with what there is; the newest as it is."""
        return self._release(len(self._times))

    def rewind(self, time: float) -> None:
        """Forget the steps at and after a time, which the filter has undone.

        Raises
        ------
        InputError
            One of them has come out already.
        """
        keep = sum(each < time for each in self._times)
        if time <= self._released:
            raise InputError("smoother", f"cannot go back to {time:g} s", "a longer lag")
        del self._times[keep:], self._steps[keep:], self._gains[max(keep - 1, 0) :]

    def _release(self, count: int) -> list[LateStep]:
        """Smooth what is held and let go of so many."""
        if not count:
            return []
        steps = Steps.of(self._steps)
        last = np.zeros_like(self._steps[0].before)
        gain = np.array([*self._gains, last])
        error, P = np.empty_like(steps.correction), np.empty_like(steps.before)
        kernels.backward_kernel(gain, steps.before, steps.after, steps.correction, error, P)
        late = [
            LateStep(self._times[k], error[k], error[k] + steps.correction[k], P[k])
            for k in range(count)
        ]
        self._released = self._times[count - 1]
        del self._times[:count], self._steps[:count], self._gains[:count]
        return late
