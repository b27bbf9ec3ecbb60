"""Smoothed states of the loosely coupled filter.

A `LooseFilter` made with ``smoothing=True`` writes its steps down; `smooth` or `FixedLagSmoother`
(`deepseis_ins.smoother`) finds the error left in each; here it is taken off the state that the
filter had there. What is considered is part of the errors, so the covariances hold (see there).
"""

from __future__ import annotations

import numpy as np

from deepseis_core.types import FloatArray
from deepseis_ins import loose_kernels as kernels
from deepseis_ins.error_state import POS, STATES, VEL
from deepseis_ins.nav_array import pack, unpack
from deepseis_ins.smoother import between
from deepseis_ins.strapdown import NavState


def smoothed_nav(nav: NavState, error: FloatArray) -> NavState:
    """Take an error off a state.

    Parameters
    ----------
    nav : NavState
        Of the filter after the measurements of a step.
    error : ndarray, shape (15,) or more
        `Smoothed.error` or `LateStep.error`; with the state before the measurements,
        ``error_before``.
    """
    x = pack(nav)
    first = np.ascontiguousarray(error[:STATES], np.float64)
    kernels.feed_back_kernel(x, np.zeros(6), first)
    return unpack(x)


def errors_between(start: FloatArray, end: FloatArray, share: FloatArray, dt: float) -> FloatArray:
    """Return errors of the 15 states at IMU rate; arguments of `deepseis_ins.smoother.between`."""
    return between(start[:STATES], end[:STATES], POS, VEL, share, dt)
