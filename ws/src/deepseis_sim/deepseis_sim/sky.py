"""The sky of a whole run: which satellites rise, and how strongly each is received when.

A satellite's C/N0 follows its elevation; it has none below the mask or behind an obstruction.
Obstructions are sectors of the sky seen from the antenna (azimuth clockwise from north), there
for a while or for good.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from deepseis_core.config import setting
from deepseis_core.ephemeris import FIT_S, pack, select_ephemerides
from deepseis_core.errors import InputError
from deepseis_core.gps_time import GpsTime
from deepseis_core.lnav import quantise
from deepseis_core.propagation import line_of_sight
from deepseis_core.rinex_nav import read_rinex_nav
from deepseis_core.types import Ephemeris, FloatArray
from deepseis_sim.constellation import (
    LOW_CN0_DBHZ,
    ZENITH_CN0_DBHZ,
    VisibleSatellite,
    cn0_at_elevation,
)
from deepseis_sim.nominal_constellation import nominal_constellation
from deepseis_sim.slow_table import SlowTable

BLOCKED_DB: Final = 60.0
RISE_STEP: Final = 30.0
"""A run's satellites are looked for at moments this far apart [s]."""

DIRECTION_STEP: Final = 10.0
"""Directions are evaluated this far apart, with cubics between: off by less than 1e-6 rad [s]."""

_MOMENTS: Final = 500


@dataclass(frozen=True)
class Obstruction:
    """Something between antenna and satellites.

    It lies in a sector of azimuth and below an elevation; ``keep`` spares the highest satellites
    of the moment wherever it lies. Its loss grows and fades over ``ramp_s`` within its time.
    """

    azimuth_from_deg: float = setting(0.0, "first azimuth [deg]", low=-360.0, high=360.0)
    azimuth_to_deg: float = setting(
        360.0, "last azimuth, clockwise from the first [deg]", low=-360.0, high=720.0
    )
    elevation_to_deg: float = setting(90.0, "upper edge [deg]", low=-90.0, high=90.0)
    loss_db: float = setting(60.0, "loss; 60 and more: nothing left [dB]", low=0.0, high=200.0)
    from_s: float = setting(0.0, "beginning [s]", low=0.0)
    to_s: float = setting(0.0, "end; 0: of the run [s]", low=0.0)
    ramp_s: float = setting(0.0, "time it takes to come and to go [s]", low=0.0)
    keep: int = setting(0, "satellites that it spares, the highest first", low=0)

    def share(self, time: FloatArray) -> FloatArray:
        """Return how much of it is there at times [s], 0 to 1."""
        end = self.to_s if self.to_s > 0.0 else np.inf
        inside = (time >= self.from_s) & (time < end)
        if not self.ramp_s:
            return inside.astype(np.float64)
        edge = np.minimum(time - self.from_s, end - time)
        return np.where(inside, np.clip(edge / self.ramp_s, 0.0, 1.0), 0.0)

    def covers(self, elevation: FloatArray, azimuth: FloatArray) -> NDArray[np.bool_]:
        """Tell which directions [rad] it lies in."""
        width = self.azimuth_to_deg - self.azimuth_from_deg
        turned = (np.rad2deg(azimuth) - self.azimuth_from_deg) % 360.0
        inside = (turned <= width % 360.0) | (abs(width) >= 360.0)
        return inside & (elevation <= np.deg2rad(self.elevation_to_deg))


@dataclass(frozen=True)
class SkyConfig:
    """Settings of satellites and of what stands before them."""

    nav_file: str = setting("", "RINEX navigation file; empty: the built-in constellation")
    satellites: int = setting(12, "most satellites, the highest of the run first", low=1, high=32)
    elevation_mask_deg: float = setting(10.0, "lowest satellite [deg]", low=-5.0, high=90.0)
    zenith_cn0_dbhz: float = setting(
        ZENITH_CN0_DBHZ, "C/N0 at the zenith [dB-Hz]", low=0.0, high=80.0
    )
    low_cn0_dbhz: float = setting(LOW_CN0_DBHZ, "C/N0 at 10 degrees [dB-Hz]", low=0.0, high=80.0)
    cn0_offset_db: float = setting(0.0, "added to every C/N0 [dB]", low=-60.0, high=60.0)
    ionosphere: bool = setting(True, "Klobuchar ionosphere in the signal")
    troposphere: bool = setting(True, "Saastamoinen troposphere in the signal")
    obstructions: tuple[Obstruction, ...] = ()


def broadcast_ephemerides(nav_file: str | Path, start: GpsTime, seed: int = 1) -> list[Ephemeris]:
    """Return ephemerides as a receiver decodes them.

    Parameters
    ----------
    nav_file : path
        RINEX navigation file; empty: the built-in constellation.
    start : GpsTime
    seed : int, optional
        Of the built-in constellation.
    """
    if not str(nav_file):
        return nominal_constellation(start, seed=seed)
    return [quantise(item) for item in read_rinex_nav(nav_file).ephemerides]


class Sky:
    """Satellites of a run and their C/N0 at any moment.

    Parameters
    ----------
    config : SkyConfig
    ephemerides : iterable of Ephemeris
        Of each satellite the one nearest to the middle of the run is taken, if it is healthy.
    start : GpsTime
        Second zero.
    antenna : callable
        ECEF [m], shape (m, 3), at seconds since the start, shape (m,).
    duration : float
        Length of the run [s].

    Attributes
    ----------
    satellites : tuple of VisibleSatellite
        All that are above the mask at some moment of the run, in the order of names. Directions
        are those at the start, ``cn0_dbhz`` is that of the clear sky then.

    Raises
    ------
    InputError
        Where an obstruction's times make no sense, or no satellite rises.
    """

    def __init__(
        self,
        config: SkyConfig,
        ephemerides: Iterable[Ephemeris],
        start: GpsTime,
        antenna: Callable[[FloatArray], FloatArray],
        duration: float,
    ) -> None:
        for number, item in enumerate(config.obstructions, 1):
            if item.to_s and item.to_s <= item.from_s:
                raise InputError(f"obstruction {number}", "ends before it begins")
        self.config, self.start, self.antenna = config, start, antenna
        middle = start.add_ns(round(duration / 2.0 * 1e9))
        chosen = list(
            select_ephemerides(
                ephemerides, middle.week, middle.tow_ns, max_age_s=FIT_S + duration / 2.0
            ).values()
        )
        if not chosen:
            raise InputError("sky", "there is no ephemeris for its time", "check start and file")
        self._packed = pack(chosen)
        self._directions = SlowTable(self._unit, DIRECTION_STEP)
        kept = self._rising(duration)
        if not kept:
            raise InputError("sky", "no satellite is visible", "check position, time and mask")
        chosen = [chosen[k] for k in kept]
        self._packed = pack(chosen)
        self._directions = SlowTable(self._unit, DIRECTION_STEP)
        elevation, azimuth = (part[0] for part in self.directions(np.zeros(1)))
        cn0_dbhz = self._clear(elevation)
        self.satellites = tuple(
            VisibleSatellite(item, float(el), float(az), float(cn0))
            for item, el, az, cn0 in zip(chosen, elevation, azimuth, cn0_dbhz, strict=True)
        )

    def directions(self, time: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return elevation and azimuth (0 to 2 pi) [rad] at seconds (m,), shape (m, n)."""
        east, north, up = np.moveaxis(self._directions(time), 1, 0)
        return np.arctan2(up, np.hypot(east, north)), np.arctan2(east, north) % (2.0 * np.pi)

    def cn0_dbhz(self, time: FloatArray) -> FloatArray:
        """Return the C/N0 [dB-Hz] at seconds (m,), shape (m, n); minus infinity: no signal."""
        elevation, azimuth = self.directions(time)
        cn0 = self._clear(elevation)
        cn0[elevation < self._mask] = -np.inf
        for item in self.config.obstructions:
            share = item.share(time)
            if not share.any():
                continue
            hidden = item.covers(elevation, azimuth)
            if item.keep:
                hidden &= _rank(elevation) >= item.keep
            loss = np.where(hidden, share[:, None] * item.loss_db, 0.0)
            cn0 = np.where(loss >= BLOCKED_DB, -np.inf, cn0 - loss)
        return cn0

    @property
    def _mask(self) -> float:
        return float(np.deg2rad(self.config.elevation_mask_deg))

    def _clear(self, elevation: FloatArray) -> FloatArray:
        c = self.config
        clear = cn0_at_elevation(elevation, zenith_dbhz=c.zenith_cn0_dbhz, low_dbhz=c.low_cn0_dbhz)
        return clear + c.cn0_offset_db

    def _unit(self, number: int) -> FloatArray:
        """Return directions as vectors east, north, up, shape (3, n), at a point of the grid."""
        time = np.array([number * DIRECTION_STEP])
        when = self.start.add_ns(round(time[0] * 1e9))
        los = line_of_sight(self._packed, when.week, when.tow_ns, self.antenna(time)[0, :3])
        east, north = np.sin(los.azimuth), np.cos(los.azimuth)
        flat = np.cos(los.elevation)
        return np.stack([flat * east, flat * north, np.sin(los.elevation)])

    def _rising(self, duration: float) -> list[int]:
        """Choose the satellites that rise above the mask, in the order given."""
        moments = np.append(np.arange(0.0, duration, RISE_STEP), duration)
        highest = np.full(len(self._packed), -np.inf)
        for first in range(0, moments.size, _MOMENTS):
            elevation, _ = self.directions(moments[first : first + _MOMENTS])
            highest = np.maximum(highest, elevation.max(axis=0))
        ranked = np.argsort(-highest, kind="stable")[: self.config.satellites]
        return sorted(int(k) for k in ranked if highest[k] > self._mask)


def _rank(elevation: FloatArray) -> NDArray[np.int64]:
    """Return each satellite's place among those of its moment, 0 the highest."""
    return np.argsort(np.argsort(-elevation, axis=1, kind="stable"), axis=1)
