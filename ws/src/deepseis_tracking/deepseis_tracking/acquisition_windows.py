"""Warm start: who is above the horizon, and within which Doppler."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from deepseis_core.config import setting
from deepseis_core.ephemeris import pack, select_ephemerides
from deepseis_core.gps_time import GpsTime
from deepseis_core.propagation import line_of_sight
from deepseis_core.rinex_nav import read_rinex_nav
from deepseis_core.types import Ephemeris

MOTION_HZ = 20.0
"""Margin for what the antenna may do: 3.8 m/s."""


def visible_windows(
    position_ecef: ArrayLike,
    time: GpsTime,
    ephemerides: Iterable[Ephemeris],
    clock_uncertainty_hz: float,
    *,
    clock_offset_hz: float = 0.0,
    time_uncertainty_s: float = 60.0,
    elevation_mask: float = 0.0,
) -> dict[str, tuple[float, float]]:
    """Return the Doppler window of every satellite in view.

    Parameters
    ----------
    position_ecef : array_like, shape (3,)
        Antenna [m]; 100 km of error move a Doppler by less than 100 Hz.
    time : GpsTime
        Of the first sample.
    ephemerides : iterable of Ephemeris
        The nearest in time of each satellite is used.
    clock_uncertainty_hz : float
        Half width of what the oscillator adds at L1 [Hz].
    clock_offset_hz : float, optional
        What it is known to add [Hz].
    time_uncertainty_s : float, optional
        Of ``time`` [s]; widens each window by the Doppler's rate.
    elevation_mask : float, optional
        Lowest elevation [rad].

    Returns
    -------
    dict of str to (float, float)
        Lowest and highest Doppler [Hz], for ``Acquirer.search``.
    """
    chosen = select_ephemerides(ephemerides, time.week, time.tow_ns)
    if not chosen:
        return {}
    view = line_of_sight(pack(list(chosen.values())), time.week, time.tow_ns, position_ecef)
    centre = view.doppler_hz + clock_offset_hz
    reach = clock_uncertainty_hz + np.abs(view.doppler_rate) * time_uncertainty_s + MOTION_HZ
    return {
        name: (float(centre[i] - reach[i]), float(centre[i] + reach[i]))
        for i, name in enumerate(chosen)
        if view.elevation[i] >= elevation_mask
    }


@dataclass(frozen=True)
class WarmStart:
    """What a station knows of the sky before it hears it."""

    nav_file: str = setting("", "RINEX navigation file; empty: cold start [path]")
    position_ecef: list[float] = setting([], "antenna, ECEF; empty: cold start [m]")
    clock_offset_hz: float = setting(0.0, "what the oscillator is known to add at L1 [Hz]")
    clock_uncertainty_hz: float = setting(600.0, "half width of what else it adds [Hz]", low=0.0)
    time_uncertainty_s: float = setting(60.0, "of the coarse start time [s]", low=0.0)
    elevation_mask_deg: float = setting(0.0, "lowest satellite [deg]", low=-5.0, high=90.0)


class Forecast:
    """Doppler windows at any coarse time, from a `WarmStart`.

    Raises
    ------
    InputError
        The navigation file cannot be used.
    """

    def __init__(self, warm: WarmStart) -> None:
        self.warm = warm
        self.known = bool(warm.nav_file) and len(warm.position_ecef) == 3
        self._ephemerides = read_rinex_nav(warm.nav_file).ephemerides if self.known else []

    def windows(self, utc_ns: int) -> dict[str, tuple[float, float]] | None:
        """Return the windows of the satellites in view; None: nothing is known, search all."""
        if not self.known:
            return None
        warm = self.warm
        found = visible_windows(
            warm.position_ecef,
            GpsTime.from_utc_ns(utc_ns),
            self._ephemerides,
            warm.clock_uncertainty_hz,
            clock_offset_hz=warm.clock_offset_hz,
            time_uncertainty_s=warm.time_uncertainty_s,
            elevation_mask=math.radians(warm.elevation_mask_deg),
        )
        return found or None
