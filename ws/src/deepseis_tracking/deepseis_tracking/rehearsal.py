"""The search's and the decoder's kernels compiled, or loaded, before the first sample.

Kernels of the channels: `engine.TrackingEngine.compile`.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from deepseis_core.ca_code import ca_code
from deepseis_core.constants import CA_LENGTH, CA_RATE_CPS
from deepseis_core.lnav_decoder import LnavDecoder
from deepseis_core.lnav_words import PREAMBLE
from deepseis_tracking.acquisition import Acquirer, AcquisitionConfig

SAMPLE_RATE_HZ: Final = 4e6
"""Kernels are the same for all rates, and the front end's is not known yet [Hz]."""


def rehearse_search(config: AcquisitionConfig) -> bool:
    """Search for a strong satellite in a made-up signal; tells whether it was found."""
    acquirer = Acquirer(SAMPLE_RATE_HZ, config)
    place = np.arange(acquirer.samples_needed) * (CA_RATE_CPS / SAMPLE_RATE_HZ)
    code = ca_code(1)[place.astype(np.int64) % CA_LENGTH]
    noise = np.random.default_rng(1).normal(0.0, 20.0, (2, len(code)))
    i, q = (4.0 * code + noise).astype(np.int8)
    return acquirer.search(i, q, 0, ["G01"], {"G01": (-300.0, 300.0)})[0].detected


def rehearse_decoding(reference_week: int) -> None:
    """Look for a subframe in bits that have preambles only."""
    bits = np.zeros(600)
    for k in range(8):
        bits[k::300] = 1.0 - 2.0 * (PREAMBLE >> (7 - k) & 1)
    LnavDecoder("G01", reference_week).push(bits, 0)
