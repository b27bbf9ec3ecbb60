"""The data bits of one satellite, as many as asked for, from any bit on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from deepseis_core.lnav import encode_frame_bits
from deepseis_core.types import Ephemeris

BITS_PER_SUBFRAME = 300
SUBFRAME_S = 6


class NavData:
    """LNAV bits that carry an ephemeris, numbered from the beginning of a GPS week.

    Bit k is transmitted from 0.02 k s of that week on, by the satellite's clock.

    Parameters
    ----------
    ephemeris : Ephemeris
        On its broadcast grid (`deepseis_core.lnav.quantise`), or the receiver decodes another.
    week : int
        GPS week that the bits are numbered from.
    """

    def __init__(self, ephemeris: Ephemeris, week: int) -> None:
        self.ephemeris, self.week = ephemeris, week
        self._recent: dict[int, NDArray[np.uint8]] = {}

    def bits(self, first: int, count: int) -> NDArray[np.uint8]:
        """Return bits ``first .. first + count``: 1 inverts the signal."""
        begin, end = first // BITS_PER_SUBFRAME, -(-(first + count) // BITS_PER_SUBFRAME)
        self._recent = {
            number: self._recent[number] if number in self._recent else self._encode(number)
            for number in range(begin, end)
        }
        offset = first - begin * BITS_PER_SUBFRAME
        return np.concatenate(list(self._recent.values()))[offset : offset + count]

    def _encode(self, number: int) -> NDArray[np.uint8]:
        return encode_frame_bits(self.ephemeris, number * SUBFRAME_S, 1, week=self.week)
