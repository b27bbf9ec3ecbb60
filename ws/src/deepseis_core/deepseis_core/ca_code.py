"""Coarse/acquisition codes of GPS satellites 1 to 32."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from deepseis_core.constants import CA_LENGTH

# Delay of the G2 sequence [chips] of PRN 1 to 32 (IS-GPS-200, table 3-Ia).
_G2_DELAY = (
    *(5, 6, 7, 8, 17, 18, 139, 140, 141, 251, 252, 254, 255, 256, 257, 258),
    *(469, 470, 471, 472, 473, 474, 509, 512, 513, 514, 515, 516, 859, 860, 861, 862),
)
_G1_TAPS = (3, 10)
_G2_TAPS = (2, 3, 6, 8, 9, 10)


def _shift_register(taps: tuple[int, ...]) -> NDArray[np.int8]:
    """Return one period of a ten-stage register that starts with all ones, as logic levels."""
    register = [1] * 10
    output = np.empty(CA_LENGTH, np.int8)
    for i in range(CA_LENGTH):
        output[i] = register[9]
        register = [sum(register[tap - 1] for tap in taps) % 2, *register[:9]]
    return output


@lru_cache(maxsize=1)
def ca_codes() -> NDArray[np.int8]:
    """Return the codes of PRN 1 to 32 as rows 0 to 31; see `ca_code`.

    Returns
    -------
    ndarray of int8, shape (32, 1023), read-only
    """
    g1, g2 = _shift_register(_G1_TAPS), _shift_register(_G2_TAPS)
    codes = np.array([1 - 2 * (g1 ^ np.roll(g2, delay)) for delay in _G2_DELAY], np.int8)
    codes.setflags(write=False)
    return codes


def ca_code(prn: int) -> NDArray[np.int8]:
    """Return one period of a satellite's C/A code.

    Logic 0 is +1 and logic 1 is -1, so that the product of signals is their exclusive or.

    Parameters
    ----------
    prn : int
        Satellite, 1 to 32.

    Returns
    -------
    ndarray of int8, shape (1023,), read-only

    References
    ----------
    IS-GPS-200, 3.3.2.3 and table 3-Ia.

    Examples
    --------
    >>> ca_code(1)[:10]
    array([-1, -1,  1,  1, -1,  1,  1,  1,  1,  1], dtype=int8)
    """
    if not 1 <= prn <= len(_G2_DELAY):
        raise ValueError(f"PRN {prn} is not one of 1 to {len(_G2_DELAY)}")
    return ca_codes()[prn - 1]
