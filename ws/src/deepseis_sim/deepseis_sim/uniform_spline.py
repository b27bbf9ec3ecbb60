"""A smooth path through equidistant samples: position, velocity and acceleration that agree.

On every interval the acceleration is a cubic and the position its double integral, a quintic; the
whole is C^4 in position and C^2 in acceleration. The three that come out are derivatives of one
polynomial, so that an inertial sensor that sees the acceleration and an antenna that sees the
position are on the same path to rounding.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numba import njit
from numpy.typing import ArrayLike
from scipy.interpolate import make_interp_spline
from scipy.linalg import solveh_banded

from deepseis_core.types import FloatArray


@njit(cache=True, nogil=True)
def _evaluate(  # type: ignore[no-untyped-def]
    start, step, knots, time, position, velocity, acceleration
):
    """Evaluate at each time; outside the knots velocity is constant and acceleration zero."""
    n_knots, _, n_axes = knots.shape
    last = n_knots - 1
    end = start + last * step
    for m in range(time.size):
        t = time[m]
        if start <= t <= end:
            i = min(int((t - start) / step), last - 1)
            u = t - (start + i * step)
            for k in range(n_axes):
                a, s = knots[i, 2, k], knots[i, 3, k]
                d = (knots[i + 1, 3, k] - s) / step
                b = (knots[i + 1, 2, k] - a) / step - step * (0.5 * s + step * d / 6.0)
                p, v = knots[i, 0, k], knots[i, 1, k]
                acceleration[m, k] = a + u * (b + u * (s / 2.0 + u * d / 6.0))
                velocity[m, k] = v + u * (a + u * (b / 2.0 + u * (s / 6.0 + u * d / 24.0)))
                position[m, k] = p + u * (
                    v + u * (a / 2.0 + u * (b / 6.0 + u * (s / 24.0 + u * d / 120.0)))
                )
        else:  # also where the time is not a number
            i = last if t > end else 0
            u = t - (end if t > end else start)
            for k in range(n_axes):
                position[m, k] = knots[i, 0, k] + u * knots[i, 1, k]
                velocity[m, k] = knots[i, 1, k]
                acceleration[m, k] = 0.0


@dataclass(frozen=True)
class UniformSpline:
    """Piecewise quintic position on a uniform grid of knots.

    Before the first knot and after the last one the velocity is that of the nearest knot.

    Attributes
    ----------
    start : float
        Time of the first knot [s].
    step : float
        Distance of the knots [s].
    knots : ndarray, shape (n, 4, k)
        Position and its derivatives of order 1, 2 and 4 at the knots; k axes, mostly three
        [m, m/s, m/s^2, m/s^4]. The fourth derivative is linear between knots, which makes the
        rest of the quintic.

    Examples
    --------
    >>> pulse = np.sin(np.linspace(0, 2 * np.pi, 201))[:, np.newaxis] ** 2
    >>> spline = UniformSpline.from_acceleration(0.0, 0.01, pulse)
    >>> position, velocity, acceleration = spline.evaluate([-1.0, 2.0, 3.0])
    >>> velocity.ravel().round(3).tolist()
    [0.0, 1.0, 1.0]
    """

    start: float
    step: float
    knots: FloatArray

    @classmethod
    def from_acceleration(
        cls, start: float, step: float, acceleration: ArrayLike, *, velocity: ArrayLike = 0.0
    ) -> Self:
        """Integrate samples of acceleration twice, exactly, as a natural cubic spline.

        Parameters
        ----------
        start, step : float
            Time of the first sample and distance of samples [s].
        acceleration : array_like, shape (n, k)
            Samples [m/s^2]; where the first and last are zero the acceleration is continuous.
        velocity : array_like, shape (k,) or ()
            Velocity at the first sample [m/s]; the position there is zero.
        """
        a = _samples(start, step, acceleration)
        s = natural_second_derivatives(a, step)
        v = _running_sum(velocity, step / 2 * (a[:-1] + a[1:]) - step**3 / 24 * (s[:-1] + s[1:]))
        moved = step**2 / 6 * (2 * a[:-1] + a[1:]) - step**4 / 360 * (8 * s[:-1] + 7 * s[1:])
        p = _running_sum(0.0, step * v[:-1] + moved)
        return cls(float(start), float(step), np.stack((p, v, a, s), axis=1))

    @classmethod
    def from_positions(
        cls, start: float, step: float, positions: ArrayLike, *, end_velocities: ArrayLike = 0.0
    ) -> Self:
        """Interpolate positions by a quintic spline whose acceleration is zero at both ends.

        Parameters
        ----------
        start, step : float
            Time of the first sample and distance of samples [s].
        positions : array_like, shape (n, k)
            Samples [m].
        end_velocities : array_like, shape (2, k) or ()
            Velocity at the first and last sample [m/s]; zero leaves it at rest outside.
        """
        x = _samples(start, step, positions)
        ends = np.broadcast_to(np.asarray(end_velocities, np.float64), (2, x.shape[1]))
        zero = np.zeros(x.shape[1])
        grid = np.arange(x.shape[0], dtype=np.float64)  # in steps: derivatives stay well scaled
        conditions: Any = tuple([(1, rate * step), (2, zero)] for rate in ends)
        spline = make_interp_spline(grid, x, k=5, bc_type=conditions)
        scaled = [spline(grid, order) / step**order for order in (1, 2, 4)]
        return cls(float(start), float(step), np.stack((x, *scaled), axis=1))

    @property
    def end(self) -> float:
        """Time of the last knot [s]."""
        return self.start + (self.knots.shape[0] - 1) * self.step

    def evaluate(self, time: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return position, velocity and acceleration, each (m, k), at times [s], (m,)."""
        times = np.ascontiguousarray(np.atleast_1d(np.asarray(time, np.float64)))
        out = np.empty((3, times.size, self.knots.shape[2]))
        _evaluate(self.start, self.step, self.knots, times, out[0], out[1], out[2])
        return out[0], out[1], out[2]


def natural_second_derivatives(samples: FloatArray, step: float) -> FloatArray:
    """Second derivatives at the knots of the natural cubic spline through samples (n, k)."""
    second = np.zeros_like(samples)
    if samples.shape[0] > 2:
        bands = np.ones((2, samples.shape[0] - 2))
        bands[1] = 4.0
        bent = np.diff(samples, n=2, axis=0) * (6.0 / step**2)
        second[1:-1] = solveh_banded(bands, bent, lower=False, check_finite=False)
    return second


def _running_sum(first: ArrayLike, increments: FloatArray) -> FloatArray:
    head = np.broadcast_to(np.asarray(first, np.float64), (1, increments.shape[1]))
    return np.cumsum(np.concatenate((head, increments)), axis=0)


def _samples(start: float, step: float, samples: ArrayLike) -> FloatArray:
    x = np.asarray(samples, np.float64)
    if x.ndim != 2 or x.shape[0] < 2:
        raise ValueError(f"samples have shape {x.shape}; at least two rows of axes are needed")
    if not (np.isfinite(start) and np.isfinite(step) and step > 0 and np.isfinite(x).all()):
        raise ValueError("samples, start and step must be finite, the step positive")
    return x
