"""What the noise of a carrier loop's discriminator makes of the Doppler that it gives."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from deepseis_core.constants import L1_WAVELENGTH
from deepseis_core.types import FloatArray, Observations, TrackingFlag

FALLBACK_BANDWIDTH_HZ: Final = 50.0
"""Of a loop whose aiding is away [Hz]; the usual one."""
NCO_NOISE: Final = 2.73
"""NCO frequency's sigma over bandwidth and the discriminator's sigma [rad]: order 3, 50 Hz, 2 ms.

From the loop's state covariance (`deepseis_tracking.loop_filter.transition`); 1 ms gives 2.88,
30 Hz at 2 ms 2.85."""


def without_aiding(observations: Observations) -> NDArray[np.bool_]:
    """Return whose loops lack the aiding that they ought to have, shape (n,)."""
    return np.asarray((observations.flags & TrackingFlag.AID_MISSED) != 0)


def lone_rate_sd(observations: Observations) -> FloatArray:
    """Return what wide loops add to the noise of range rates, shape (n,) [m/s].

    Their NCO's frequency follows the discriminator: 2.4 Hz at 43 dB-Hz, where an aided loop of
    8 Hz has 0.1 Hz. 0 for satellites that are not flagged ``AID_MISSED``.
    """
    error_cycles = np.nan_to_num(observations.carrier_error_sd_cycles.astype(np.float64))
    wide_hz = NCO_NOISE * FALLBACK_BANDWIDTH_HZ * error_cycles
    return np.asarray(np.where(without_aiding(observations), L1_WAVELENGTH * wide_hz, 0.0))
