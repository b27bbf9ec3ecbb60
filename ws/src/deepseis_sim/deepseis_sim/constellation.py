"""Which satellites a station sees, and how strongly."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from deepseis_core.ephemeris import pack, select_ephemerides
from deepseis_core.gps_time import GpsTime
from deepseis_core.propagation import line_of_sight
from deepseis_core.types import Ephemeris, FloatArray

ZENITH_CN0_DBHZ = 45.0
LOW_CN0_DBHZ = 41.0
LOW_ELEVATION = float(np.deg2rad(10.0))


@dataclass(frozen=True)
class VisibleSatellite:
    """One satellite above the mask, its direction at the start [rad], its C/N0 [dB-Hz]."""

    ephemeris: Ephemeris
    elevation: float
    azimuth: float
    cn0_dbhz: float

    @property
    def satellite(self) -> str:
        """Name, e.g. "G05"."""
        return self.ephemeris.satellite

    @property
    def prn(self) -> int:
        """Number of its C/A code."""
        return int(self.ephemeris.satellite[1:])


def cn0_at_elevation(
    elevation: ArrayLike,
    *,
    zenith_dbhz: float = ZENITH_CN0_DBHZ,
    low_dbhz: float = LOW_CN0_DBHZ,
) -> FloatArray:
    """Return the C/N0 of an unobstructed satellite [dB-Hz].

    A line in the sine of elevation through one value at the zenith and another at 10 degrees,
    which continues below.

    Parameters
    ----------
    elevation : array_like
        [rad]
    zenith_dbhz, low_dbhz : float, optional
        C/N0 at the zenith and at 10 degrees.

    Examples
    --------
    >>> cn0_at_elevation(np.deg2rad([90.0, 10.0])).round(6).tolist()
    [45.0, 41.0]
    """
    low = np.sin(LOW_ELEVATION)
    share = (np.sin(elevation) - low) / (1.0 - low)
    return low_dbhz + (zenith_dbhz - low_dbhz) * share


def visible_satellites(
    ephemerides: Iterable[Ephemeris],
    time: GpsTime,
    position_ecef: ArrayLike,
    *,
    elevation_mask: float = LOW_ELEVATION,
    cn0_dbhz: Mapping[str, float] | None = None,
) -> tuple[VisibleSatellite, ...]:
    """Choose the healthy satellites above an elevation.

    Parameters
    ----------
    ephemerides : iterable of Ephemeris
        Of each satellite the one nearest in time is taken.
    time : GpsTime
    position_ecef : array_like, shape (3,)
        Antenna [m].
    elevation_mask : float, optional
        [rad]
    cn0_dbhz : mapping of str to float, optional
        C/N0 of satellites by name [dB-Hz]; others as `cn0_at_elevation`.

    Returns
    -------
    tuple of VisibleSatellite
        In the order of names.
    """
    chosen = list(select_ephemerides(ephemerides, time.week, time.tow_ns).values())
    if not chosen:
        return ()
    los = line_of_sight(pack(chosen), time.week, time.tow_ns, position_ecef)
    given = cn0_dbhz or {}
    return tuple(
        VisibleSatellite(
            ephemeris,
            float(elevation),
            float(azimuth),
            float(given.get(ephemeris.satellite, cn0_at_elevation(elevation))),
        )
        for ephemeris, elevation, azimuth in zip(chosen, los.elevation, los.azimuth, strict=True)
        if elevation > elevation_mask
    )
