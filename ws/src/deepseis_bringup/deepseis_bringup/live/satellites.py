"""Satellites as the live page shows them: what the loops say, and where the satellite stands."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from deepseis_core.types import (
    Lli,
    Observations,
    Pvt,
    TrackingEpochs,
    TrackingFlag,
    TrackingMode,
)

MODES: Final[Mapping[int, str]] = {
    TrackingMode.IDLE: "searching",
    TrackingMode.PULL_IN: "pull-in",
    TrackingMode.BIT_SYNC: "bit sync",
    TrackingMode.TRACK: "own loop",
    TrackingMode.TRACK_AIDED: "aided",
}


def number(value: float, digits: int) -> float | None:
    """Return a value as JSON can hold it; None: not known."""
    return round(float(value), digits) if math.isfinite(value) else None


@dataclass
class _Seen:
    """What is known of one satellite.

    ``heard`` is by the model's clock [s]; ``is_half``: its last phase may be off by half a cycle,
    None: it had none yet.
    """

    epochs: TrackingEpochs | None = None
    azimuth: float = math.nan
    elevation: float = math.nan
    residual: float = math.nan
    used: bool = False
    rejected: bool = False
    slips: int = 0
    is_half: bool | None = None
    lock_time: float = math.nan
    heard: float = -math.inf


class SatelliteTable:
    """Collects what topics say of each satellite."""

    def __init__(self) -> None:
        self._seen: dict[str, _Seen] = {}

    def _of(self, satellite: str) -> _Seen:
        return self._seen.setdefault(satellite, _Seen())

    def take_tracking(self, epochs: TrackingEpochs, now: float) -> None:
        """Take the integrations of a block."""
        seen = self._of(epochs.satellite)
        seen.heard = now
        if len(epochs.sample_index) or epochs.mode == TrackingMode.IDLE:
            seen.epochs = epochs

    def take_pvt(self, pvt: Pvt) -> None:
        """Take the place in the sky, the residuals, and who was left out."""
        for seen in self._seen.values():
            seen.used = seen.rejected = False
            seen.residual = math.nan
        for k, satellite in enumerate(pvt.satellites):
            seen = self._of(satellite)
            seen.used = True
            seen.azimuth, seen.elevation = float(pvt.azimuth[k]), float(pvt.elevation[k])
            seen.residual = float(pvt.pseudorange_residual[k])
        for satellite in pvt.rejected:
            self._of(satellite).rejected = True

    def take_observations(self, epoch: Observations) -> None:
        """Count slips; take the time since the last one.

        A phase is marked, too, where it begins and where its polarity becomes known: that is none.
        """
        for k, satellite in enumerate(epoch.satellites):
            seen, lli = self._of(satellite), int(epoch.lli[k])
            is_half = bool(lli & Lli.HALF_CYCLE)
            goes_on = seen.is_half is not None and (is_half or not seen.is_half)
            seen.slips += bool(lli & Lli.SLIP) and goes_on
            seen.is_half = is_half
            seen.lock_time = float(epoch.lock_time[k])

    def rows(self, now: float) -> list[dict[str, Any]]:
        """Return a row for each satellite that is tracked or was placed in the sky."""
        return [
            _row(name, seen, now)
            for name, seen in sorted(self._seen.items())
            if _mode(seen) != TrackingMode.IDLE or seen.used
        ]


def _mode(seen: _Seen) -> int:
    return seen.epochs.mode if seen.epochs is not None else int(TrackingMode.IDLE)


def _row(name: str, seen: _Seen, now: float) -> dict[str, Any]:
    mode = _mode(seen)
    row: dict[str, Any] = {
        "name": name,
        "mode": MODES.get(mode, "unknown"),
        "aided": mode == TrackingMode.TRACK_AIDED,
        "azimuth_deg": number(math.degrees(seen.azimuth), 1),
        "elevation_deg": number(math.degrees(seen.elevation), 1),
        "residual_m": number(seen.residual, 2),
        "used": seen.used,
        "rejected": seen.rejected,
        "slips": seen.slips,
        "lock_time_s": number(seen.lock_time, 1),
        "silent_s": number(now - seen.heard, 1),
    }
    if seen.epochs is not None and len(seen.epochs.flags):
        row |= _of_loops(seen.epochs)
    return row


def _of_loops(epochs: TrackingEpochs) -> dict[str, Any]:
    """Return what the newest integration says."""
    flags = int(epochs.flags[-1])
    any_flag = int(np.bitwise_or.reduce(epochs.flags))
    has_aid = math.isfinite(float(epochs.aid_doppler_hz[-1]))
    return {
        "cn0_dbhz": number(epochs.cn0_dbhz[-1], 1),
        "phase_lock_indicator": number(epochs.phase_lock_indicator[-1], 3),
        "code_lock": bool(flags & TrackingFlag.CODE_LOCK),
        "phase_lock": bool(flags & TrackingFlag.PHASE_LOCK),
        "aid_age_ms": number(1e3 * epochs.aid_age_s[-1], 1) if has_aid else None,
        "aid_missed": bool(any_flag & TrackingFlag.AID_MISSED),
        "aid_diverged": bool(any_flag & TrackingFlag.AID_DIVERGED),
        "doppler_hz": number(epochs.carrier_doppler_hz[-1], 1),
    }
