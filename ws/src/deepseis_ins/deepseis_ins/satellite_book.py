"""Which satellites are aided, with which ephemerides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deepseis_core.ephemeris import FIT_S, age, pack, select_ephemerides
from deepseis_core.gps_time import GpsTime
from deepseis_core.propagation import line_of_sight
from deepseis_core.types import Ephemeris, FloatArray

RENEWAL_S = 60.0
"""The choice is made anew at multiples of this, and when an ephemeris takes effect [s]."""
_FORGOTTEN_S = 2.0 * FIT_S
"""Ephemerides so old are forgotten; those of the future, out of a day's file, are not [s]."""


@dataclass(frozen=True)
class Chosen:
    """Satellites in view.

    Attributes
    ----------
    names : tuple of str, length n
    packed : ndarray, shape (n, 22)
        Ephemerides (`deepseis_core.ephemeris.pack`).
    unit : ndarray, shape (n, 3)
        From satellite to receiver, ECEF, at the time of the choice.
    """

    names: tuple[str, ...]
    packed: FloatArray
    unit: FloatArray


NOBODY = Chosen((), np.zeros((0, 22)), np.zeros((0, 3)))


class SatelliteBook:
    """Keeps ephemerides, and a choice until a better one is due.

    Parameters
    ----------
    elevation_mask_deg : float
        Lowest satellite chosen [deg].
    sample_rate_hz : float
    """

    def __init__(self, elevation_mask_deg: float, sample_rate_hz: float) -> None:
        self._mask = np.deg2rad(elevation_mask_deg)
        self._renewal = round(RENEWAL_S * sample_rate_hz)
        self._waiting: list[Ephemeris] = []
        self._effective: dict[str, list[Ephemeris]] = {}
        self._chosen, self._chosen_for = NOBODY, -1

    def push(self, ephemeris: Ephemeris) -> None:
        """Take an ephemeris, in any order; it counts from its effective sample on."""
        self._waiting.append(ephemeris)

    def choose(
        self,
        sample_index: int,
        start: GpsTime,
        antenna_ecef: FloatArray,
        told: int | None = None,
    ) -> Chosen:
        """Return the choice that holds at a sample; samples must not go back.

        Parameters
        ----------
        sample_index : int
        start : GpsTime
            GPS time of the sample.
        antenna_ecef : ndarray, shape (3,)
            Roughly [m].
        told : int, optional
            Ephemerides that take effect later do not count yet: not all of them are there.
        """
        new = self._take(sample_index if told is None else told)
        number = sample_index // self._renewal
        if new or number != self._chosen_for:
            self._chosen_for = number
            self._chosen = self._choice(start, antenna_ecef)
        return self._chosen

    def _take(self, sample_index: int) -> bool:
        due = [item for item in self._waiting if item.effective_sample_index <= sample_index]
        if not due:
            return False
        self._waiting = [
            item for item in self._waiting if item.effective_sample_index > sample_index
        ]
        for item in due:
            kept = self._effective.setdefault(item.satellite, [])
            if item not in kept:
                kept.append(item)
            kept.sort(key=_order)
        return True

    def _choice(self, time: GpsTime, antenna_ecef: FloatArray) -> Chosen:
        for name, kept in self._effective.items():
            self._effective[name] = [
                item for item in kept if age(item, time.week, time.tow_ns) <= _FORGOTTEN_S
            ]
        known = [item for name in sorted(self._effective) for item in self._effective[name]]
        chosen = select_ephemerides(known, time.week, time.tow_ns)
        if not chosen:
            return NOBODY
        packed = pack(list(chosen.values()))
        view = line_of_sight(packed, time.week, time.tow_ns, antenna_ecef)
        high = view.elevation >= self._mask
        names = tuple(name for name, up in zip(chosen, high, strict=True) if up)
        return Chosen(names, packed[high], view.unit[high])


def _order(item: Ephemeris) -> tuple[int, int, float, float, int]:
    """Sort key that does not know when something arrived."""
    return item.effective_sample_index, item.week, item.toe, item.transmit_tow, item.iode
