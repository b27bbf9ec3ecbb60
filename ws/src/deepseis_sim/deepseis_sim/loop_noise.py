"""What noise does in tracking loops, without signal: errors of replicas and of discriminators.

Each loop is the discrete first-order one at its integration time T, driven by the thermal noise n
of its discriminator (u: replica minus signal, e: what the discriminator shows)::

    e[k] = n[k] - u[k],    u[k+1] = u[k] + g e[k],    g = 4 Bn T / (1 + 2 Bn T)

so that u has exactly the variance ``2 Bn T s_n^2``, the textbooks' ``s_t^2``, and e has
``s_n^2 + s_t^2`` (design, section 4), and the density of u at zero frequency is that of any loop
that follows a constant. What the loop's order changes is the shape between, about Bn. Motion
leaves no error: the loops stand for ideally aided ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepseis_core.types import FloatArray, IntArray

INTEGRATION: Final = 0.02
"""T, one data bit [s]."""
STEPS_PER_S: Final = 50

# Columns of normal variates, and of the kernel's output.
CARRIER, CODE, SLOW, RATE = 0, 1, 2, 3
_COLUMNS = 4


def carrier_sd_cycles(cn0_dbhz: FloatArray) -> FloatArray:
    """Return the sigma of the two-quadrant arctangent of one integration [cycles].

    ``sqrt(1/(2 CN0 T) (1 + 1/(2 T CN0))) / (2 pi)``: design, section 4.
    """
    energy = 10.0 ** (cn0_dbhz / 10.0) * INTEGRATION
    out: FloatArray = np.sqrt((1.0 + 0.5 / energy) / (2.0 * energy)) / (2.0 * np.pi)
    return out


def code_sd_chips(cn0_dbhz: FloatArray, spacing_chips: float) -> FloatArray:
    """Return the sigma of the early-minus-late power discriminator of one integration [chips].

    E. D. Kaplan and C. J. Hegarty, "Understanding GPS: Principles and Applications", 2nd ed.,
    eq. 5.20 in open loop (Bn -> 1/(2 T)).
    """
    energy = 10.0 ** (cn0_dbhz / 10.0) * INTEGRATION
    squaring = 1.0 + 2.0 / ((2.0 - spacing_chips) * energy)
    out: FloatArray = np.sqrt(spacing_chips / (4.0 * energy) * squaring)
    return out


def gain(bandwidth_hz: float) -> float:
    """Return the gain of the first-order loop with a noise bandwidth [-]."""
    return 4.0 * bandwidth_hz * INTEGRATION / (1.0 + 2.0 * bandwidth_hz * INTEGRATION)


@dataclass(frozen=True)
class LoopErrors:
    """Errors at k integrations of n channels, shape (k, n), in units of the given sigmas.

    ``carrier`` and ``code`` are replica minus signal as an integration begins; ``*_shown`` what
    its discriminator shows. ``slow`` is a Gauss-Markov process and ``rate`` white noise, both
    of unit variance. ``intact`` counts the integrations since the signal was last too weak,
    ``losses`` how often it has been.
    """

    carrier: FloatArray
    carrier_shown: FloatArray
    code: FloatArray
    code_shown: FloatArray
    slow: FloatArray
    rate: FloatArray
    intact: IntArray
    losses: IntArray


@njit(cache=True, nogil=True)
def _run(
    normals: FloatArray, sd: FloatArray, weak: NDArray[np.bool_], gains: FloatArray, keep: float,
    state: FloatArray, counts: IntArray, out: FloatArray, counted: IntArray,
) -> None:  # fmt: skip
    """Advance all channels (kernel); ``sd`` and ``out`` are (k, n, 2) and (k, n, 6)."""
    fresh = np.sqrt(1.0 - keep * keep)
    for k in range(normals.shape[0]):
        for i in range(normals.shape[1]):
            for loop in range(2):
                shown = sd[k, i, loop] * normals[k, i, loop] - state[i, loop]
                out[k, i, 2 * loop] = state[i, loop]
                out[k, i, 2 * loop + 1] = shown
                state[i, loop] += gains[loop] * shown
            state[i, 2] = keep * state[i, 2] + fresh * normals[k, i, 2]
            out[k, i, 4] = state[i, 2]
            out[k, i, 5] = normals[k, i, 3]
            if weak[k, i]:
                counts[i, 1] += counts[i, 0] > 0
                counts[i, 0] = 0
            else:
                counts[i, 0] += 1
            counted[k, i, 0], counted[k, i, 1] = counts[i, 0], counts[i, 1]


class LoopNoise:
    """Noise of n channels, one second of integrations after the other.

    Parameters
    ----------
    n : int
        Channels.
    bandwidth_hz : tuple of two float
        Noise bandwidths of carrier and code loop [Hz].
    tau : float
        Correlation time of ``LoopErrors.slow`` [s].
    seed : sequence of int
        Of the random numbers; every second has its own.
    intact : int
        The signals have been good for so many integrations as the first one begins.
    """

    def __init__(
        self,
        n: int,
        bandwidth_hz: tuple[float, float],
        tau: float,
        seed: tuple[int, ...],
        intact: int,
    ) -> None:
        self._seed, self._second = seed, 0
        self._gains = np.array([gain(b) for b in bandwidth_hz])
        self._keep = float(np.exp(-INTEGRATION / tau))
        self._start = np.random.default_rng([*seed, 0]).standard_normal((n, _COLUMNS))
        self._state: FloatArray | None = None
        self._counts = np.zeros((n, 2), np.int64)
        self._counts[:, 0] = intact

    def advance(
        self, carrier_sd: FloatArray, code_sd: FloatArray, weak: NDArray[np.bool_]
    ) -> LoopErrors:
        """Return the next second; arguments have shape (50, n).

        Parameters
        ----------
        carrier_sd, code_sd : ndarray
            Sigmas of the discriminators; the errors come in the same units.
        weak : ndarray of bool
            Where there is too little signal to track.
        """
        self._second += 1
        shape = carrier_sd.shape
        sd = np.stack([carrier_sd, code_sd], axis=-1)
        if self._state is None:  # at rest: the loops have been running for long
            rest = np.sqrt(self._gains / (2.0 - self._gains))
            scale = np.column_stack([rest * sd[0], np.ones(shape[1])])
            self._state = scale * self._start[:, :3]
        out, counted = np.empty((*shape, 6)), np.empty((*shape, 2), np.int64)
        rng = np.random.default_rng([*self._seed, self._second])
        drawn = rng.standard_normal((*shape, _COLUMNS))
        _run(drawn, sd, weak, self._gains, self._keep, self._state, self._counts, out, counted)
        return LoopErrors(
            carrier=out[..., 0],
            carrier_shown=out[..., 1],
            code=out[..., 2],
            code_shown=out[..., 3],
            slow=out[..., 4],
            rate=out[..., 5],
            intact=counted[..., 0],
            losses=counted[..., 1],
        )
