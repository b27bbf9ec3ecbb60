"""Sampled C/A replicas, ready made: generating code is choosing a row.

A replica that starts between two samples differs from its neighbour only where a chip edge
passes a sample. The bank therefore holds one period of the code at ``phase_steps`` sub-sample
phases; whole samples are an offset into the row. The quantised phase is *known*, so nothing is
lost: the channel refers the code discriminator to the phase that was really used.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepseis_core.ca_code import ca_code
from deepseis_core.constants import CA_LENGTH, CA_RATE_CPS

MARGIN = 64
"""Samples before and after one code period that every row holds."""


@njit(cache=True, nogil=True)
def _fill(chips: NDArray[np.int8], chips_per_sample: float, rows: NDArray[np.int8]) -> None:
    steps, width = rows.shape
    length = chips.shape[0]
    for row in range(steps):
        for k in range(width):
            position = (k - MARGIN + row / steps) * chips_per_sample
            rows[row, k] = chips[math.floor(position) % length]


class ReplicaBank:
    """Replicas of one satellite's code at one sampling rate.

    Parameters
    ----------
    satellite : str
        RINEX name, ``G01`` to ``G32``.
    sample_rate_hz : float
        Sampling rate [Hz].

    Attributes
    ----------
    rows : ndarray of int8, shape (phase_steps, samples of a period + 2 * MARGIN)
        Row ``r``, column ``MARGIN + k`` is the code at ``(k + r / phase_steps)`` samples.
    chips_per_sample : float
        At the nominal code rate.
    """

    def __init__(self, satellite: str, sample_rate_hz: float) -> None:
        self.chips_per_sample = CA_RATE_CPS / sample_rate_hz
        period = math.ceil(CA_LENGTH / self.chips_per_sample)
        phase_steps = 32 if sample_rate_hz < 8e6 else 8
        self.rows = np.empty((phase_steps, period + 2 * MARGIN), np.int8)
        _fill(ca_code(int(satellite[1:])), self.chips_per_sample, self.rows)

    def tap_offset(self, spacing_chips: float) -> int:
        """Half the early-to-late spacing in phase steps, at least one."""
        steps = self.rows.shape[0]
        return max(1, round(spacing_chips / 2 / self.chips_per_sample * steps))

    def real_spacing_chips(self, spacing_chips: float) -> float:
        """Early-to-late spacing that the quantised taps have [chips]."""
        offset = self.tap_offset(spacing_chips)
        return 2 * offset * self.chips_per_sample / self.rows.shape[0]
