"""Random processes that are functions of (seed, stream, sample index).

White noise is drawn in whole blocks, each from its own ``default_rng([seed, stream, block])``;
recursive processes run through the blocks one after the other and keep their state at the
beginning of each. So a value does not depend on how a run is cut into chunks, any span can be
asked for again, and an hour at 1 kHz leaves 900 small states behind.

The first-order Gauss-Markov process (thesis 3.13; A. Gelb, "Applied Optimal Estimation", 1974,
section 3.8) of standard deviation ``sigma`` and correlation time ``T`` is discretised exactly::

    x[0]     = sigma w,                             stationary from the first sample
    x[k + 1] = a x[k] + sigma sqrt(1 - a^2) w[k],   a = exp(-step / T)

Flicker noise, one-sided density ``level / f``, is a sum of such processes of equal variance whose
correlation times form a geometric series (M. S. Keshner, "1/f noise", Proc. IEEE 70, 1982).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from deepseis_core.errors import InputError
from deepseis_core.types import FloatArray

BLOCK: Final = 4096
"""Samples that are drawn together."""

FLICKER_RATIO: Final = 10.0**0.5
"""Between neighbouring correlation times: the density ripples by 2 / cosh(pi^2 / ln r), 0.08 %."""


class StreamedNoise(ABC):
    """Noise of several columns, made block by block.

    Parameters
    ----------
    seed, stream : int
        Same numbers, same noise. Every consumer has its own stream.
    columns : int
        Of what it returns.
    block : int
        Samples in a block.
    """

    def __init__(self, seed: int, stream: int, columns: int, block: int = BLOCK) -> None:
        if seed < 0:
            raise InputError("seed", f"is {seed}", "seeds are whole numbers from 0")
        self._key, self.columns, self.block_size = (seed, stream), columns, block
        self._recent: dict[int, FloatArray] = {}

    def __call__(self, first: int, count: int) -> FloatArray:
        """Return samples ``first .. first + count``, shape (count, columns)."""
        if first < 0 or count < 0:
            raise InputError("noise", f"asked for {count} samples from {first}", "from 0 on")
        out = np.empty((count, self.columns))
        done = 0
        while done < count:
            number, skip = divmod(first + done, self.block_size)
            part = self.block(number)[skip : skip + count - done]
            out[done : done + len(part)] = part
            done += len(part)
        return out

    def block(self, number: int) -> FloatArray:
        """Return one block, shape (block_size, columns), not to be written to."""
        if number not in self._recent:
            made = self._make(number)
            while len(self._recent) > 3:
                del self._recent[next(iter(self._recent))]
            self._recent[number] = made
        return self._recent[number]

    def normals(self, number: int, columns: int) -> FloatArray:
        """Draw a block of unit normal values, shape (block_size, columns)."""
        rng = np.random.default_rng([*self._key, number])
        return rng.standard_normal((self.block_size, columns))

    def start_normals(self, columns: int) -> FloatArray:
        """Draw unit normal values for the state at the start, shape (columns,)."""
        # NumPy fills short keys up with zeros: only the fourth word tells this from block 0.
        return np.random.default_rng([*self._key, 0, 1]).standard_normal(columns)

    @abstractmethod
    def _make(self, number: int) -> FloatArray:
        """Make one block."""


class WhiteNoise(StreamedNoise):
    """Independent unit normal values."""

    def _make(self, number: int) -> FloatArray:
        return self.normals(number, self.columns)


class RecursiveNoise(StreamedNoise):
    """Noise with a state that runs from block to block.

    Parameters
    ----------
    state : ndarray
        At sample 0.
    """

    def __init__(
        self, seed: int, stream: int, columns: int, state: FloatArray, block: int = BLOCK
    ) -> None:
        super().__init__(seed, stream, columns, block)
        self._states = [state]

    def _make(self, number: int) -> FloatArray:
        for k in range(len(self._states) - 1, number):
            self._states.append(self._run(k)[1])
        made, state = self._run(number)
        if len(self._states) == number + 1:
            self._states.append(state)
        return made

    def _run(self, number: int) -> tuple[FloatArray, FloatArray]:
        """Run through one block: what it gives, and the state after it."""
        state = self._states[number].copy()
        out = np.empty((self.block_size, self.columns))
        self._advance(number, state, out)
        return out, state

    @abstractmethod
    def _advance(self, number: int, state: FloatArray, out: FloatArray) -> None:
        """Fill one block and bring the state to its end."""


class GaussMarkovNoise(RecursiveNoise):
    """First-order Gauss-Markov processes, one a column; stationary.

    Parameters
    ----------
    seed, stream : int
    sigma, correlation_time : array_like, shape (n,) or ()
        Standard deviation, and correlation time [s].
    step : float
        Between samples [s].
    """

    def __init__(
        self, seed: int, stream: int, sigma: ArrayLike, correlation_time: ArrayLike, step: float
    ) -> None:
        pair = np.broadcast_arrays(np.atleast_1d(sigma), np.atleast_1d(correlation_time))
        self.sigma, time = (np.array(item, np.float64) for item in pair)
        if not (np.all(self.sigma >= 0.0) and np.all(time > 0.0) and 0.0 < step < np.inf):
            raise InputError(
                "Gauss-Markov process", "needs sigma >= 0, correlation time > 0 and step > 0"
            )
        super().__init__(seed, stream, self.sigma.size, self.sigma)
        self._states = [self.sigma * self.start_normals(self.columns)]
        self._decay = np.exp(-step / time)
        self._drive = self.sigma * np.sqrt(-np.expm1(-2.0 * step / time))

    def _advance(self, number: int, state: FloatArray, out: FloatArray) -> None:
        normals = self.normals(number, self.columns)
        first_order(state, self._decay, self._drive, normals, out)


class RandomWalkNoise(RecursiveNoise):
    """Random walks from zero, one a column.

    Parameters
    ----------
    seed, stream : int
    density : array_like, shape (n,) or ()
        Standard deviation after 1 s [unit / sqrt(s)].
    step : float
        Between samples [s].
    """

    def __init__(self, seed: int, stream: int, density: ArrayLike, step: float) -> None:
        self._drive = np.atleast_1d(np.asarray(density, np.float64)) * np.sqrt(step)
        super().__init__(seed, stream, self._drive.size, np.zeros(self._drive.size))

    def _advance(self, number: int, state: FloatArray, out: FloatArray) -> None:
        normals = self.normals(number, self.columns)
        first_order(state, np.ones(self.columns), self._drive, normals, out)


class FlickerNoise(StreamedNoise):
    """Flicker noise of one-sided density ``level / f`` [unit^2/Hz], one column.

    Parameters
    ----------
    seed, stream : int
    level : float
        Density at 1 Hz.
    step : float
        Between samples [s]; the density holds up to 0.2 of the sampling rate within 3 %, up to
        0.3 within 8 % (what lies above half the rate is folded back).
    longest : float, optional
        Correlation time [s] of the slowest part: the density is flat below ``1 / (2 pi longest)``.
    """

    def __init__(
        self, seed: int, stream: int, level: float, step: float, longest: float = 1e5
    ) -> None:
        super().__init__(seed, stream, 1)
        sigma, times = flicker_bank(level, step / 2.0, longest)
        self._parts = GaussMarkovNoise(seed, stream, sigma, times, step)

    def _make(self, number: int) -> FloatArray:
        return self._parts.block(number).sum(axis=1, keepdims=True)


def flicker_bank(level: float, shortest: float, longest: float) -> tuple[FloatArray, FloatArray]:
    """Return Gauss-Markov processes whose sum is flicker noise.

    A process has the one-sided density ``4 sigma^2 T / (1 + (2 pi f T)^2)``; the sum over
    correlation times in the ratio r is ``sigma^2 / (f ln r)`` between the ends of the series.

    Returns
    -------
    sigma, correlation_time : ndarray, shape (n,)
        Standard deviations (all the same), and times [s] from ``shortest`` to ``longest``.
    """
    count = max(1, round(np.log(longest / shortest) / np.log(FLICKER_RATIO))) + 1
    times = shortest * FLICKER_RATIO ** np.arange(count)
    return np.full(count, np.sqrt(level * np.log(FLICKER_RATIO))), times


def gauss_markov_allan_deviation(
    sigma: float, correlation_time: float, tau: FloatArray
) -> FloatArray:
    """Return the Allan deviation of a Gauss-Markov process at averaging times [s].

    IEEE Std 952-1997, equation C.21, with ``sigma = q_c sqrt(T / 2)``. Its peak is 0.617 sigma at
    1.89 T.
    """
    ratio = correlation_time / np.asarray(tau, np.float64)
    decay = np.exp(-1.0 / ratio)
    bracket = 1.0 - 0.5 * ratio * (3.0 - 4.0 * decay + decay * decay)
    # Far below T the bracket cancels; there the process is a random walk.
    series = 1.0 / (3.0 * ratio**2) - 1.0 / (4.0 * ratio**3)
    bracket = np.where(ratio > 1e3, series, bracket)
    return np.asarray(sigma * np.sqrt(2.0 * ratio * bracket))


@njit(cache=True, nogil=True)
def first_order(
    state: FloatArray,
    decay: FloatArray,
    drive: FloatArray,
    normals: FloatArray,
    out: FloatArray,
) -> None:
    """Write the states of first-order recursions, shape (m, n); ``state`` ends after the last."""
    for k in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[k, j] = state[j]
            state[j] = decay[j] * state[j] + drive[j] * normals[k, j]
