"""What a shaken ground does to oscillators: the elastic response spectrum of a record.

An oscillator of natural frequency ``w`` and damping ratio ``xi`` on a ground that accelerates by
``a`` is displaced against it by ``u``::

    u'' + 2 xi w u' + w^2 u = -a(t),    at rest before the record

Within a step the record is a straight line, for which the solution is known in closed form, so
that the recursion over the steps is exact (Nigam and Jennings 1969 [1]_). Where an oscillator's
period spans few steps, steps are divided: the line stays the same, but a peak between two samples
is not missed. What happens after the record's end does not count: append zeros where it matters.

References
----------
.. [1] N. C. Nigam and P. C. Jennings, "Calculation of response spectra from strong-motion
   earthquake records", Bull. Seism. Soc. Am. 59 (1969), 909-922.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from deepseis_core.errors import InputError
from deepseis_core.types import FloatArray, IntArray

STEPS_PER_PERIOD: Final = 32
"""At least so many steps make a period: the peak of a sine is met within 0.5 %."""

MOST_DIVISIONS: Final = 64
"""Parts of a step at most: shorter periods than half a step follow the ground anyway."""


@dataclass(frozen=True)
class ResponseSpectrum:
    """Greatest responses, one per period.

    Attributes
    ----------
    sd, sv : ndarray, shape (m,)
        Displacement [m] and velocity [m/s] against the ground.
    sa_pseudo : ndarray, shape (m,)
        Pseudo-acceleration ``w^2 sd`` [m/s^2]: the spring's force over the mass.
    sa : ndarray, shape (m,)
        Absolute acceleration of the mass [m/s^2].
    """

    sd: FloatArray
    sv: FloatArray
    sa_pseudo: FloatArray
    sa: FloatArray


@dataclass(frozen=True)
class Peaks:
    """When each oscillator is furthest out.

    ``pseudo_acceleration``, shape (m,), is ``-w^2 u`` at that moment [m/s^2], with its sign (a
    slow push of the ground is followed with its own); ``time``, shape (m,), counts from the
    first sample [s].
    """

    pseudo_acceleration: FloatArray
    time: FloatArray


def response_spectrum(
    acceleration: ArrayLike, step: float, periods: ArrayLike, damping: float = 0.05
) -> ResponseSpectrum:
    """Return the elastic response spectrum of a record.

    Parameters
    ----------
    acceleration : array_like, shape (n,)
        Of the ground [m/s^2], straight between samples.
    step : float
        Between samples [s].
    periods : array_like, shape (m,)
        Undamped natural periods [s]; 0 is the ground itself.
    damping : float
        Ratio ``xi``, 0 to below 1.

    Raises
    ------
    InputError
        Where the record or a parameter makes no sense.

    Examples
    --------
    >>> push = response_spectrum(np.ones(1000), 0.01, [1.0], damping=0.0)
    >>> push.sa_pseudo.round(3)  # a sudden steady push throws a spring twice as far
    array([2.])
    """
    record, T = _checked(acceleration, step, periods, damping)
    greatest = np.zeros((3, T.size))
    for chosen, parts in _groups(T, step):
        coefficients = _recursion(T[chosen], step / parts, damping)
        out = np.zeros((3, chosen.size))
        _greatest(record, parts, coefficients, _damping_rates(T[chosen], damping), out)
        greatest[:, chosen] = out
    w2 = _squared_frequency(T)
    ground = np.max(np.abs(record))
    sa_pseudo = np.where(T > 0.0, w2 * greatest[0], ground)
    sa = np.where(T > 0.0, greatest[2], ground)
    return ResponseSpectrum(greatest[0], greatest[1], sa_pseudo, sa)


def peak_responses(
    acceleration: ArrayLike, step: float, periods: ArrayLike, damping: float = 0.05
) -> Peaks:
    """Return each oscillator's greatest pseudo-acceleration, and when it comes about.

    Parameters as in `response_spectrum`.
    """
    record, T = _checked(acceleration, step, periods, damping)
    value, time = np.zeros(T.size), np.zeros(T.size)
    w2 = _squared_frequency(T)
    for chosen, parts in _groups(T, step):
        coefficients = _recursion(T[chosen], step / parts, damping)
        u, index = np.zeros(chosen.size), np.zeros(chosen.size)
        _furthest(record, parts, coefficients, u, index)
        value[chosen], time[chosen] = -w2[chosen] * u, index * (step / parts)
    at = int(np.argmax(np.abs(record)))
    rigid = T == 0.0
    value[rigid], time[rigid] = record[at], at * step
    return Peaks(value, time)


def _checked(
    acceleration: ArrayLike, step: float, periods: ArrayLike, damping: float
) -> tuple[FloatArray, FloatArray]:
    """Return record and periods as arrays; raise InputError where they are none."""
    record = np.ascontiguousarray(acceleration, dtype=np.float64)
    T = np.asarray(periods, dtype=np.float64)
    if record.ndim != 1 or record.size < 2 or not np.all(np.isfinite(record)):
        raise InputError("response spectrum", "the record is not a row of two or more numbers")
    if T.ndim != 1 or not np.all((T >= 0.0) & np.isfinite(T)):
        raise InputError("response spectrum", "the periods are not a row of numbers from 0 on")
    if not 0.0 < step < np.inf:
        raise InputError("response spectrum", f"the step of {step} s is not positive")
    if not 0.0 <= damping < 1.0:
        raise InputError("response spectrum", f"the damping of {damping} is not within 0 and 1")
    return record, T


def _squared_frequency(T: FloatArray) -> FloatArray:
    """Return ``w^2`` [1/s^2], 0 where the period is 0."""
    return (np.where(T > 0.0, 2.0 * np.pi, 0.0) / np.where(T > 0.0, T, 1.0)) ** 2


def _groups(T: FloatArray, step: float) -> list[tuple[IntArray, int]]:
    """Return which periods need a step divided into how many parts (powers of two)."""
    needed = STEPS_PER_PERIOD * step / np.where(T > 0.0, T, np.inf)
    parts = 2.0 ** np.ceil(np.log2(np.clip(needed, 1.0, MOST_DIVISIONS)))
    return [
        (np.flatnonzero((parts == count) & (T > 0.0)), int(count)) for count in np.unique(parts)
    ]


def _damping_rates(T: FloatArray, damping: float) -> FloatArray:
    """Return ``(2 xi w, w^2)``, shape (2, m)."""
    w = 2.0 * np.pi / T
    return np.stack([2.0 * damping * w, w * w])


def _recursion(T: FloatArray, h: float, xi: float) -> FloatArray:
    """Return the exact recursion over a step ``h``, shape (8, m).

    Its coefficients::

        u1 = c0 u + c1 v + c2 a + c3 a1
        v1 = c4 u + c5 v + c6 a + c7 a1

    ``a`` and ``a1`` being the ground's acceleration at the step's ends. The particular solution
    for a ramp is ``-(a + s t) / w^2 + 2 xi s / w^3``, ``s = (a1 - a) / h``; the rest of the
    motion decays freely.
    """
    w = 2.0 * np.pi / T
    wd = w * np.sqrt(1.0 - xi * xi)
    decay, cosine = np.exp(-xi * w * h), np.cos(wd * h)
    sine = np.sin(wd * h) / wd
    # free decay over the step from displacement or velocity 1
    uu, uv = decay * (cosine + xi * w * sine), decay * sine
    vu, vv = -w * w * uv, decay * (cosine - xi * w * sine)
    # for a and a1: particular solution at both ends, its slope, and the free decay that
    # starts it from rest
    lag, slope = 2.0 * xi / (w**3 * h), 1.0 / (w * w * h)
    start, end, rate = (
        (-1.0 / w**2 - lag, lag),
        (-lag, -1.0 / w**2 + lag),
        (slope, -slope),
    )
    rows = [uu, uv]
    rows += [end[k] - uu * start[k] - uv * rate[k] for k in (0, 1)]
    rows += [vu, vv]
    rows += [rate[k] - vu * start[k] - vv * rate[k] for k in (0, 1)]
    return np.stack(rows)


@njit(cache=True, nogil=True)
def _greatest(
    record: FloatArray, parts: int, c: FloatArray, rates: FloatArray, out: FloatArray
) -> None:
    """Fill ``out`` (3, m) with the greatest displacement, velocity, absolute acceleration."""
    m = c.shape[1]
    u, v = np.zeros(m), np.zeros(m)
    for i in range(1, record.size):
        before, rise = record[i - 1], (record[i] - record[i - 1]) / parts
        for part in range(parts):
            a = before + rise * part
            a1 = before + rise * (part + 1)
            for k in range(m):
                x = c[0, k] * u[k] + c[1, k] * v[k] + c[2, k] * a + c[3, k] * a1
                y = c[4, k] * u[k] + c[5, k] * v[k] + c[6, k] * a + c[7, k] * a1
                u[k], v[k] = x, y
                z = abs(rates[0, k] * y + rates[1, k] * x)
                x, y = abs(x), abs(y)
                out[0, k] = x if x > out[0, k] else out[0, k]
                out[1, k] = y if y > out[1, k] else out[1, k]
                out[2, k] = z if z > out[2, k] else out[2, k]


@njit(cache=True, nogil=True)
def _furthest(
    record: FloatArray, parts: int, c: FloatArray, furthest: FloatArray, when: FloatArray
) -> None:
    """Fill in each oscillator's furthest displacement, with its sign, and its (divided) step.

    Steps are counted in floating point so that the loop over the oscillators becomes vector
    instructions.
    """
    m = c.shape[1]
    u, v = np.zeros(m), np.zeros(m)
    for i in range(1, record.size):
        before, rise = record[i - 1], (record[i] - record[i - 1]) / parts
        for part in range(parts):
            a = before + rise * part
            a1 = before + rise * (part + 1)
            now = float((i - 1) * parts + part + 1)
            for k in range(m):
                x = c[0, k] * u[k] + c[1, k] * v[k] + c[2, k] * a + c[3, k] * a1
                v[k] = c[4, k] * u[k] + c[5, k] * v[k] + c[6, k] * a + c[7, k] * a1
                u[k] = x
                when[k] = now if abs(x) > abs(furthest[k]) else when[k]
                furthest[k] = x if abs(x) > abs(furthest[k]) else furthest[k]
