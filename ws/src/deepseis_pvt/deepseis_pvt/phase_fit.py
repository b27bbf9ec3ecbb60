"""What a fit of some satellites' phases gives, and what stands for it where all begins."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from deepseis_core.types import FloatArray, IntArray
from deepseis_pvt.phase_values import PhaseEpoch


@dataclass
class Fit:
    """What `phase_kernels.fit` found for some satellites of an epoch."""

    rows: IntArray
    x: FloatArray
    C: FloatArray
    G: FloatArray
    residual: FloatArray
    normalised: FloatArray
    chi_square: float

    @property
    def freedom(self) -> int:
        """Degrees of freedom."""
        return len(self.rows) - len(self.x)

    @classmethod
    def at_beginning(cls, epoch: PhaseEpoch, unknowns: int) -> Self:
        """Begin: the clock is what the codes say; only its changes mean anything.

        Of four unknowns the others are zero: displacements are from where the antenna is now.
        """
        none = np.zeros(0)
        x = np.zeros(unknowns)
        x[-1] = np.median(epoch.residual + epoch.code_less_phase) if len(epoch.slot) else 0.0
        C, G = np.zeros((unknowns, unknowns)), np.zeros((unknowns, 0))
        return cls(none.astype(np.int64), x, C, G, none, none, 0.0)
