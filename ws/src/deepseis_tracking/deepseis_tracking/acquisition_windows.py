"""Warm start: who is above the horizon, and within which Doppler."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike

from deepseis_core.ephemeris import pack, select_ephemerides
from deepseis_core.gps_time import GpsTime
from deepseis_core.propagation import line_of_sight
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
