"""C/A codes of every system on L1: GPS is searched for, QZSS and SBAS interfere with it."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from deepseis_core import ca_code

GPS = tuple(f"G{prn:02d}" for prn in range(1, 33))

# Delay of the G2 sequence [chips] (IS-GPS-200, table 6-I): SBAS, QZSS L1S, QZSS L1 C/A.
_SBAS_DELAY = (
    *(145, 175, 52, 21, 237, 235, 886, 657, 634, 762, 355, 1012, 176, 603, 130, 359, 595),
    *(68, 386, 797, 456, 499, 883, 307, 127, 211, 121, 118, 163, 628, 853, 484, 289, 811),
    *(202, 1021, 463, 568, 904),
)
_L1S_DELAY = (144, 476, 193, 109, 445, 291, 87, 399, 292, 901)
_QZSS_DELAY = (339, 208, 711, 189, 263, 537, 663, 942, 173, 900)
_DELAYS = {
    f"PRN{first + i}": delay
    for first, delays in ((120, _SBAS_DELAY), (183, _L1S_DELAY), (193, _QZSS_DELAY))
    for i, delay in enumerate(delays)
}

OTHERS = tuple(_DELAYS)
"""Names of the codes that are no GPS satellite's: "PRN120" to "PRN202"."""


@lru_cache(maxsize=1)
def _registers() -> tuple[NDArray[np.int8], NDArray[np.int8]]:
    return (
        ca_code._shift_register(ca_code._G1_TAPS),
        ca_code._shift_register(ca_code._G2_TAPS),
    )


def code(satellite: str) -> NDArray[np.int8]:
    """Return one period of a satellite's code, +1 and -1.

    Examples
    --------
    The first ten chips of PRN 193 are 0727 in octal (IS-GPS-200, table 6-I):

    >>> code("PRN193")[:10]
    array([ 1, -1, -1, -1,  1, -1,  1, -1, -1, -1], dtype=int8)
    """
    if satellite in _DELAYS:
        g1, g2 = _registers()
        return (1 - 2 * (g1 ^ np.roll(g2, _DELAYS[satellite]))).astype(np.int8)
    if satellite not in GPS:
        raise ValueError(f"{satellite!r} is not a satellite with a known C/A code")
    return ca_code.ca_code(int(satellite[1:]))
