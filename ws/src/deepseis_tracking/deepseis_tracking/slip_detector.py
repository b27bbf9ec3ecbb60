"""Whether a locked loop may have slipped in an integration (compiled)."""

from __future__ import annotations

import math
from typing import Any

from numba import njit

MEAN_S = 0.02
"""Errors are averaged over so long: shorter integrations are noisier than the limits [s]."""
SHORT_MEAN_S = 0.004
"""The same for the wide loop of `fallback`, which passes half a cycle in some 20 ms [s]."""
FAR_CYCLES = 0.18
"""Beyond that error it may be that of the next half cycle: the discriminator ends at 0.25."""
FADED = 0.05
"""Of the mean power: an integration with less has seen no signal, its error is noise."""
SEEN = 60.0
"""Mean power from which on noise alone does not make that of a signal that is there [-]."""
QUIET = 0.25
"""Of the mean power: a short integration with less may have seen no signal."""
QUIET_S = 0.02
"""So much more of such than of others within a short time, and the signal has vanished [s]."""
JUMP_CYCLES = 0.15
"""Nor can it come in one step: 2 g at 2 Hz moves the error of 15 Hz by 0.035 in 20 ms. A slipping
loop passes half a cycle in some steps."""
JUMP_SIGMAS = 7.0
"""Least jump in sigmas of one error, 5 of the difference: by noise once in ten hours [-]."""


@njit(cache=True, nogil=True)
def error_sigma(cn0_dbhz: float, seconds: float) -> float:
    """Noise of the discriminator's mean [cycles] (arctangent, thesis 3.2)."""
    power = 2.0 * seconds * 10.0 ** (cn0_dbhz / 10.0)
    return math.sqrt((1.0 + 1.0 / power) / power) / (2.0 * math.pi)


@njit(cache=True, nogil=True)
def is_quiet(state: Any, power: float, period: float) -> bool:
    """Whether a wide loop had better coast than follow the error of an integration.

    On noise alone it walks half a cycle in 20 ms, before a mean of its power can tell; coasting
    it keeps 2 g at 2 Hz to 0.01 cycles for 30 ms. Counts for how long it has been so.

    Parameters
    ----------
    state : record of STATE
    power : float
        I^2 + Q^2 - 2, in variances of noise.
    period : float
        Of the integration [s].
    """
    if state.fallback == 0:
        state.quiet_s = 0.0
        return False
    quiet = power < QUIET * state.lock_den
    state.quiet_s = max(0.0, state.quiet_s + (period if quiet else -period))
    return quiet


@njit(cache=True, nogil=True)
def may_have_slipped(state: Any, error: float, power: float, period: float, quiet: bool) -> bool:
    """Take the next carrier error [cycles], of an integration's power less noise.

    Parameters
    ----------
    state : record of STATE
    error : float
        Of the discriminator [cycles].
    power : float
        I^2 + Q^2 - 2, in variances of noise.
    period : float
        Of the integration [s].
    quiet : bool
        The loop has not followed it (`is_quiet`).
    """
    if quiet:
        return state.quiet_s >= QUIET_S
    over = SHORT_MEAN_S if state.fallback == 1 else MEAN_S
    before = state.mean_error
    state.mean_error += min(1.0, period / over) * (error - before)
    sigma = error_sigma(state.cn0, over)
    far = abs(state.mean_error) > max(FAR_CYCLES, min(0.2, 5.5 * sigma))
    jumped = abs(state.mean_error - before) > max(JUMP_CYCLES, JUMP_SIGMAS * sigma)
    faded = power < FADED * state.lock_den and state.lock_den > SEEN
    return far or jumped or (faded and state.fallback == 0)
