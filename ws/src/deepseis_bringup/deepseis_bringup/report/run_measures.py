"""Figures of merit of a run: per satellite, position, time to first fix, what was lost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final

import numpy as np
import yaml
from numpy.typing import ArrayLike, NDArray

from deepseis_bringup.report.run_columns import Columns
from deepseis_bringup.report.run_data import RunData
from deepseis_bringup.report.run_truth import (
    PhaseErrors,
    Truth,
    is_locked,
    is_settled,
    phase_errors,
)
from deepseis_core.constants import CA_RATE_CPS, SPEED_OF_LIGHT
from deepseis_core.ephemeris import pack
from deepseis_core.geodesy import geodetic_from_ecef, rotation_enu_ecef
from deepseis_core.propagation import line_of_sight
from deepseis_core.types import FloatArray, PvtStatus, TrackingFlag, TrackingMode
from deepseis_tracking.channel import TrackingConfig

CHIP: Final = SPEED_OF_LIGHT / CA_RATE_CPS  # [m]


@dataclass(frozen=True)
class Positions:
    """Position solutions in east, north, up [m] from ``origin_ecef``; sigmas alike."""

    t: FloatArray
    enu: FloatArray
    covariance: FloatArray
    velocity: FloatArray
    velocity_sd: FloatArray
    origin_ecef: FloatArray
    against_truth: bool

    @property
    def sd(self) -> FloatArray:
        """One sigma of each axis as the solver states it [m]."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2)))


@dataclass(frozen=True)
class SkyTrack:
    """Elevation and azimuth [deg] of one satellite over time [s]."""

    t: FloatArray
    elevation: FloatArray
    azimuth: FloatArray


@dataclass
class Measures:
    """Everything computed from a run once, for summary, tables and figures."""

    run: RunData
    truth: Truth | None = None
    extra: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def loops(self) -> dict[str, Any]:
        """Loop settings: of the run's parameters, else the defaults."""
        settings = {k: v for k, v in vars(TrackingConfig()).items()}
        for path in sorted((self.run.folder / "parameters").glob("*.yaml")):
            if path.stem.startswith(("tracker", "trackers")):
                settings |= _parameters(path.read_text(encoding="utf-8"))
        return settings

    @cached_property
    def positions(self) -> Positions | None:
        """Positions, against the truth or else their own mean."""
        pvt = self.run.pvt
        good = pvt["status"] > PvtStatus.NONE if pvt.count else np.zeros(0, bool)
        if not good.any():
            return None
        ecef = pvt["position_ecef"][good]
        samples = pvt["sample_index"][good]
        known = self.truth is not None and self.truth.position_t.size > 0
        if known and self.truth is not None:
            true = self.truth.position_at(samples / self.run.sample_rate_hz)
        else:
            true = np.broadcast_to(ecef.mean(axis=0), ecef.shape)
        origin = np.asarray(true.mean(axis=0))
        latitude, longitude, _ = geodetic_from_ecef(origin)
        turn = np.asarray(rotation_enu_ecef(latitude, longitude))
        covariance = turn @ pvt["position_covariance_ecef"][good].reshape(-1, 3, 3) @ turn.T
        of_velocity = turn @ pvt["velocity_covariance_ecef"][good].reshape(-1, 3, 3) @ turn.T
        return Positions(
            self.run.seconds(samples),
            (ecef - true) @ turn.T,
            covariance,
            pvt["velocity_ecef"][good] @ turn.T,
            np.sqrt(np.diagonal(of_velocity, axis1=1, axis2=2)),
            origin,
            known,
        )

    @cached_property
    def sky(self) -> dict[str, SkyTrack]:
        """Where each satellite stood: from its ephemeris, else from the solutions, the truth."""
        tracks = _sky_of_solutions(self.run)
        tracks |= _sky_of_ephemerides(self.run, self.positions)
        if self.truth is not None and self.truth.elevation.ndim == 1:
            angles = zip(self.truth.elevation, self.truth.azimuth, strict=True)
            for satellite, (elevation, azimuth) in zip(
                self.truth.satellites, angles, strict=False
            ):
                if satellite not in tracks and satellite in self.run.tracking:
                    at = np.zeros(1)
                    angle = (np.degrees([elevation]), np.degrees([azimuth]))
                    tracks[satellite] = SkyTrack(at, *angle)
        return {s: tracks[s] for s in self.run.satellites if s in tracks}

    @cached_property
    def satellites(self) -> dict[str, dict[str, float]]:
        """Figures of every satellite that gave an integration."""
        return {s: self._satellite(s, self.run.tracking[s]) for s in self.run.satellites}

    @cached_property
    def phase_errors(self) -> PhaseErrors | None:
        """True phase errors where there is a truth."""
        if self.truth is None:
            return None
        limits = {s: v["phase_error_limit_deg"] for s, v in self.satellites.items()}
        return phase_errors(self.run, self.truth, limits)

    @cached_property
    def first_fix_s(self) -> float:
        """Time from the first sample to the first position [s]; NaN: none."""
        return float(self.positions.t[0]) if self.positions is not None else float("nan")

    @cached_property
    def gaps(self) -> tuple[int, int | None]:
        """Gaps in the samples, and the samples missing; None: unknown without recorded IF."""
        blocks = self.run.if_blocks
        if len(blocks):
            missing = blocks[1:, 0] - blocks[:-1].sum(axis=1)
            return int((missing != 0).sum()), int(missing.clip(0).sum())
        flagged = [
            ((c["flags"].astype(np.int64) & TrackingFlag.GAP) > 0).sum()
            for c in self.run.tracking.values()
        ]
        count = int(max(flagged, default=0))
        return count, None if count else 0

    def _satellite(self, satellite: str, columns: Columns) -> dict[str, float]:
        locked, rate = is_locked(columns), self.run.sample_rate_hz
        settled = is_settled(columns, rate)
        flags = columns["flags"].astype(np.int64)
        seconds = columns["sample_count"] / rate
        after = np.cumsum(settled) > 0
        slips = (flags & TrackingFlag.SLIP > 0) & after
        turned = flags & TrackingFlag.HALF_CYCLE > 0
        known = np.cumsum(flags & TrackingFlag.POLARITY_KNOWN > 0) > 0
        values = {
            "cn0_mean_dbhz": _mean_dbhz(columns["cn0_dbhz"][settled]),
            "first_lock_s": _first(self.run.seconds(columns["sample_index"]), locked),
            "phase_lock_s": float(seconds[flags & TrackingFlag.PHASE_LOCK > 0].sum()),
            "locked_s": float(seconds[locked].sum()),
            "slips": float(_rises(slips)),
            "half_cycles": float((turned[1:] & known[:-1]).sum()),
            "carrier_error_rms_deg": 360.0 * _rms(columns["carrier_error_cycles"][settled]),
            "code_error_rms_m": CHIP * _rms(columns["code_error_chips"][settled]),
            "integration_s": float(np.median(seconds[settled])) if settled.any() else np.nan,
            "aided_share": _mean(columns.per_row("mode")[settled] == TrackingMode.TRACK_AIDED),
        }
        return values | self._limits(values) | self._from_others(satellite)

    def _limits(self, values: Mapping[str, float]) -> dict[str, float]:
        """Thermal limits at the measured C/N0 (thesis 3.2)."""
        aided = values["aided_share"] > 0.5
        bandwidth = self.loops["aided_bandwidth_hz" if aided else "pll_bandwidth_hz"]
        loop, single = thermal(values["cn0_mean_dbhz"], bandwidth, values["integration_s"])
        return {
            "phase_error_limit_deg": float(loop),
            "carrier_error_expected_deg": float(np.hypot(loop, single)),
        }

    def _from_others(self, satellite: str) -> dict[str, float]:
        run = self.run
        found = [e for e in run.ephemerides if e.satellite == satellite]
        decoded = [e.effective_sample_index for e in found if e.effective_sample_index >= 0]
        used = run.pvt["satellites"] == satellite if run.pvt.count else np.zeros(0, bool)
        residual = run.pvt["pseudorange_residual"][used] if used.any() else np.zeros(0)
        sky = self.sky.get(satellite)
        return {
            "ephemeris_s": float(run.seconds(min(decoded))) if decoded else np.nan,
            "used_share": float(used.sum()) / max(run.pvt.count, 1),
            "residual_rms_m": _rms(residual),
            "elevation_deg": float(sky.elevation[-1]) if sky else np.nan,
            "azimuth_deg": float(sky.azimuth[-1]) if sky else np.nan,
        }


def thermal(
    cn0_dbhz: ArrayLike, bandwidth_hz: float, integration_s: float
) -> tuple[FloatArray, FloatArray]:
    """Thermal phase noise [deg]: of the loop, and of a single integration's discriminator.

    Examples
    --------
    >>> loop, single = thermal(np.array([45.0]), 15.0, 0.02)
    >>> loop.round(2), single.round(2)
    (array([1.25]), array([1.61]))
    """
    cn0 = 10 ** (np.asarray(cn0_dbhz) / 10)
    squaring = 1 + 1 / (2 * integration_s * cn0)
    loop = np.sqrt(bandwidth_hz / cn0 * squaring)
    return np.degrees(loop), np.degrees(np.sqrt(squaring / (2 * cn0 * integration_s)))


def _parameters(text: str) -> dict[str, Any]:
    """Values in a ROS parameter file, whatever the node is called."""
    document = yaml.safe_load(text) or {}
    nodes = [node for node in document.values() if isinstance(node, dict)]
    return {k: v for node in nodes for k, v in node.get("ros__parameters", {}).items()}


def _sky_of_solutions(run: RunData) -> dict[str, SkyTrack]:
    pvt, tracks = run.pvt, {}
    if not pvt.count:
        return {}
    t = run.seconds(pvt.per_row("sample_index"))
    for satellite in np.unique(pvt["satellites"]):
        at = pvt["satellites"] == satellite
        angles = (np.degrees(pvt[key][at].astype(float)) for key in ("elevation", "azimuth"))
        tracks[str(satellite)] = SkyTrack(t[at], *angles)
    return tracks


def _sky_of_ephemerides(run: RunData, positions: Positions | None) -> dict[str, SkyTrack]:
    """Directions over the whole time of tracking, from the newest ephemeris of each satellite."""
    newest = {e.satellite: e for e in run.ephemerides if e.satellite in run.tracking}
    if positions is None or not newest:
        return {}
    before = float(run.seconds(run.pvt["sample_index"][0]))
    start = int(run.pvt["tow_ns"][0]) - round(before * 1e9)
    t = np.linspace(0.0, run.duration, 25)
    tow_ns = start + (t * 1e9).astype(np.int64)
    week = int(run.pvt["week"][0])
    sight = line_of_sight(pack(list(newest.values())), week, tow_ns, positions.origin_ecef)
    tracks = {}
    for k, satellite in enumerate(newest):
        seen = run.seconds(run.tracking[satellite]["sample_index"])
        during = (t >= seen[0] - 1.0) & (t <= seen[-1] + 1.0) if seen.size else np.zeros(25, bool)
        if during.any():
            angles = np.degrees(sight.elevation[during, k]), np.degrees(sight.azimuth[during, k])
            tracks[satellite] = SkyTrack(t[during], *angles)
    return tracks


def _rms(values: NDArray[Any]) -> float:
    return float(np.sqrt(np.mean(np.square(values, dtype=np.float64)))) if values.size else np.nan


def _mean(values: NDArray[Any]) -> float:
    return float(np.mean(values)) if values.size else float("nan")


def _mean_dbhz(values: NDArray[Any]) -> float:
    """Mean of the powers, in dB-Hz."""
    if not values.size:
        return float("nan")
    return float(10 * np.log10(np.mean(10 ** (values.astype(np.float64) / 10))))


def _first(times: FloatArray, when: NDArray[np.bool_]) -> float:
    return float(times[np.argmax(when)]) if when.any() else float("nan")


def _rises(mask: NDArray[np.bool_]) -> int:
    """Stretches of true values."""
    return int((mask & ~np.concatenate(([False], mask[:-1]))).sum()) if mask.size else 0
