"""A raw recording of an antenna that stands still: the demo's input."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deepseis_core.config import check, setting
from deepseis_core.errors import InputError
from deepseis_core.geodesy import ecef_from_geodetic
from deepseis_core.gps_time import GpsTime
from deepseis_core.if_format import IfFormat
from deepseis_core.lnav import quantise
from deepseis_core.rinex_nav import read_rinex_nav
from deepseis_core.types import Ephemeris, FloatArray
from deepseis_sim.constellation import visible_satellites
from deepseis_sim.nominal_constellation import nominal_constellation
from deepseis_sim.recording import FrontEnd, Progress, SimulatedRecording, write_recording
from deepseis_sim.signal_model import SignalModel, linear_clock, still


@dataclass(frozen=True)
class StillConfig:
    """Settings of a still antenna's recording.

    The default starts 2 s before a subframe 1 and lasts 40 s, so that a receiver can decode
    subframes 1, 2 and 3, and, in this frame, the ionosphere in page 18 of subframe 4.
    """

    duration: float = setting(40.0, "length [s]", low=0.1, high=1e5)
    if_format: str = setting("iq2", "packing of the samples (deepseis_core.if_format)")
    sample_rate_hz: float = setting(4.0e6, "sample rate [Hz]", low=1e6, high=1e8)
    intermediate_frequency_hz: float = setting(0.0, "intermediate frequency [Hz]")
    week: int = setting(2399, "GPS week of the start", low=0, high=10000)
    tow: int = setting(346258, "GPS second of week of the start [s]", low=0, high=604799)
    latitude_deg: float = setting(35.681298, "latitude [deg]", low=-90.0, high=90.0)
    longitude_deg: float = setting(139.766247, "longitude [deg]", low=-180.0, high=360.0)
    height: float = setting(10.0, "height above the ellipsoid [m]", low=-500.0, high=1e5)
    nav_file: str = setting("", "RINEX navigation file; empty: the built-in constellation")
    elevation_mask_deg: float = setting(10.0, "lowest satellite [deg]", low=-5.0, high=90.0)
    clock_bias: float = setting(3.2e-4, "receiver clock ahead at the start [s]")
    clock_drift: float = setting(8e-8, "receiver clock drift [s/s]", low=-1e-4, high=1e-4)
    ionosphere: bool = setting(True, "Klobuchar ionosphere in the signal")
    troposphere: bool = setting(True, "Saastamoinen troposphere in the signal")
    seed: int = setting(1, "of noise, initial phases and the built-in constellation", low=0)

    @property
    def start(self) -> GpsTime:
        """Time of sample 0 by the receiver's clock."""
        return GpsTime(self.week, self.tow * 10**9)

    @property
    def position_ecef(self) -> FloatArray:
        """Antenna [m]."""
        angles = np.deg2rad([self.latitude_deg, self.longitude_deg])
        return ecef_from_geodetic(np.array([angles[0], angles[1], self.height]))


def still_model(
    config: StillConfig, *, cn0_dbhz: Mapping[str, float] | None = None
) -> SignalModel:
    """Return the signals that a still antenna receives; see `simulate_still`."""
    satellites = visible_satellites(
        _ephemerides(config),
        config.start,
        config.position_ecef,
        elevation_mask=float(np.deg2rad(config.elevation_mask_deg)),
        cn0_dbhz=cn0_dbhz,
    )
    return SignalModel(
        satellites,
        config.start,
        still(config.position_ecef),
        clock=linear_clock(config.clock_bias, config.clock_drift),
        ionosphere=config.ionosphere,
        troposphere=config.troposphere,
        seed=config.seed,
    )


def simulate_still(
    config: StillConfig,
    folder: str | Path,
    *,
    cn0_dbhz: Mapping[str, float] | None = None,
    progress: Progress | None = None,
) -> SimulatedRecording:
    """Simulate the recording of a still antenna.

    Parameters
    ----------
    config : StillConfig
    folder : path
        Gets the files that `deepseis_sim.recording` lists.
    cn0_dbhz : mapping of str to float, optional
        C/N0 by satellite name [dB-Hz]; others as `deepseis_sim.constellation.cn0_at_elevation`.
    progress : callable, optional
        Called with the seconds of signal made so far.

    Raises
    ------
    InputError
        Where a setting or a file makes no sense.
    """
    try:
        check(config)
    except ValueError as error:
        raise InputError("settings", str(error)) from None
    front_end = FrontEnd(
        IfFormat.from_text(config.if_format),
        config.sample_rate_hz,
        config.intermediate_frequency_hz,
    )
    model = still_model(config, cn0_dbhz=cn0_dbhz)
    return write_recording(
        model, front_end, config.duration, folder, seed=config.seed, progress=progress
    )


def _ephemerides(config: StillConfig) -> list[Ephemeris]:
    """Return ephemerides as a receiver decodes them."""
    if not config.nav_file:
        return nominal_constellation(config.start, seed=config.seed)
    return [quantise(item) for item in read_rinex_nav(config.nav_file).ephemerides]
