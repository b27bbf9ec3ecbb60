"""A made-up station under a made-up sky, for engines to rehearse on before they say "ready".

A kernel compiles, or is loaded from the cache, at its first call. In real time the first calls
would come with the first samples, and miss their deadlines: so engines work through a moment of
this before. Nothing that comes out of a rehearsal is kept.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np

from deepseis_core.constants import L1_HZ, L1_WAVELENGTH, SPEED_OF_LIGHT
from deepseis_core.ephemeris import pack
from deepseis_core.geodesy import ecef_from_geodetic
from deepseis_core.propagation import line_of_sight
from deepseis_core.types import (
    Ephemeris,
    FloatArray,
    Observations,
    TrackingEpochs,
    TrackingFlag,
    TrackingMode,
)

WEEK: Final = 2200
TOW_MS: Final = 7_200_000
"""GPS time of sample 0 [weeks, ms of week]."""
SATELLITES: Final = 8
MONUMENT_ECEF: Final = ecef_from_geodetic([0.66, 2.46, 50.0])
BLOCK_S: Final = 0.02

_LOCKED = TrackingFlag.CODE_LOCK | TrackingFlag.PHASE_LOCK | TrackingFlag.BIT_SYNC


@cache
def ephemerides() -> tuple[Ephemeris, ...]:
    """Return the satellites highest above the station, of 30 on circular orbits."""
    sky = [_orbit(prn) for prn in range(1, 31)]
    view = line_of_sight(pack(sky), WEEK, TOW_MS * 1_000_000, MONUMENT_ECEF)
    chosen = sorted(np.argsort(-view.elevation)[:SATELLITES].tolist())
    return tuple(sky[k] for k in chosen)


def _orbit(prn: int) -> Ephemeris:
    plane, slot = divmod(prn - 1, 5)
    toe = TOW_MS / 1000.0
    return Ephemeris(
        satellite=f"G{prn:02d}", week=WEEK, toe=toe, toc=toe, af0=1e-5 * (slot - 2), af1=0.0,
        af2=0.0, tgd=0.0, sqrt_a=5153.65, eccentricity=0.005, i0=0.96,
        omega0=plane * np.pi / 3.0 - 2.0, omega=0.4 * slot, m0=1.257 * slot + 0.3 * plane - 2.0,
        delta_n=4.5e-9, omega_dot=-8e-9, i_dot=0.0, cuc=0.0, cus=0.0, crc=0.0, crs=0.0, cic=0.0,
        cis=0.0,
    )  # fmt: skip


@dataclass(frozen=True)
class Receiver:
    """Channels that track the sky without an error.

    Attributes
    ----------
    sample_rate_hz : float
        [Hz]
    transmit_time : bool
        Whether the channels have decoded when the signal was sent.
    """

    sample_rate_hz: float
    transmit_time: bool = True

    @property
    def block(self) -> int:
        """Samples of a block."""
        return round(BLOCK_S * self.sample_rate_hz)

    def tow_ns(self, sample: int) -> int:
        """Return GPS time of week of a sample [ns]."""
        return TOW_MS * 1_000_000 + round(sample / self.sample_rate_hz * 1e9)

    def epochs(self, number: int) -> list[TrackingEpochs]:
        """Return one integration of every satellite, in a block."""
        first = number * self.block
        travel, doppler_hz = self._seen(first)
        return [
            self._message(item.satellite, first, float(travel[k]), float(doppler_hz[k]))
            for k, item in enumerate(ephemerides())
        ]

    def observations(self, number: int) -> Observations:
        """Return the epoch at the begin of a block."""
        first = number * self.block
        travel, doppler_hz = self._seen(first)
        n = len(travel)
        small, byte = np.zeros(n, np.float32), np.zeros(n, np.uint8)
        return Observations(
            first, 0.0, WEEK, self.tow_ns(first), first + self.block - 1, BLOCK_S,
            tuple(item.satellite for item in ephemerides()), SPEED_OF_LIGHT * travel,
            SPEED_OF_LIGHT / L1_WAVELENGTH * travel, doppler_hz, small + np.float32(45.0), byte,
            small + np.float32(60.0), small, small + np.float32(0.002), small,
            small + np.float32(0.01), np.full(n, int(_LOCKED), np.uint16),
        )  # fmt: skip

    def _seen(self, sample: int) -> tuple[FloatArray, FloatArray]:
        """Return signals' travel times [s] and Doppler [Hz] at a sample, shape (8,)."""
        view = line_of_sight(pack(ephemerides()), WEEK, self.tow_ns(sample), MONUMENT_ECEF)
        return view.range / SPEED_OF_LIGHT - view.satellite_clock, view.doppler_hz

    def _message(
        self, satellite: str, first: int, travel: float, doppler_hz: float
    ) -> TrackingEpochs:
        sent_ms = self.tow_ns(first) / 1e6 - 1e3 * travel
        whole = int(sent_ms)
        flags = _LOCKED | TrackingFlag.POLARITY_KNOWN if self.transmit_time else _LOCKED
        single = np.zeros(1, np.float32)

        def one(value: float) -> FloatArray:
            return np.array([value], np.float64)

        return TrackingEpochs(
            satellite=satellite,
            block_sample_index=first,
            valid_through=first + self.block - 1,
            ephemeris_count=0,
            mode=TrackingMode.TRACK,
            sample_index=np.array([first]),
            sample_count=np.array([self.block], np.int32),
            transmit_ms=np.array([whole if self.transmit_time else -1]),
            code_phase_chips=one(1023.0 * (sent_ms - whole)),
            code_rate_cps=one(1.023e6 * (1.0 + doppler_hz / L1_HZ)),
            carrier_phase_cycles=one(-L1_HZ * travel),
            carrier_doppler_hz=one(doppler_hz),
            carrier_doppler_rate=one(0.0),
            carrier_doppler_accel=one(0.0),
            early_i=single, early_q=single, prompt_i=single, prompt_q=single, late_i=single,
            late_q=single, carrier_error_cycles=single, code_error_chips=single,
            cn0_dbhz=np.full(1, 45.0, np.float32),
            phase_lock_indicator=np.ones(1, np.float32),
            aid_doppler_hz=single, aid_age_s=single,
            flags=np.array([int(flags)], np.uint16),
        )  # fmt: skip
