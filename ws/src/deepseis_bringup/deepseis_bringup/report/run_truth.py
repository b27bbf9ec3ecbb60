"""What a simulator knows of a run, and the tracking loops' phase error against it."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from deepseis_bringup.report.run_columns import Columns
from deepseis_bringup.report.run_data import RunData
from deepseis_core.errors import InputError
from deepseis_core.geodesy import geodetic_from_ecef, rotation_enu_ecef
from deepseis_core.rotation import quat_rotate
from deepseis_core.types import FloatArray, TrackingFlag

SETTLING: Final = 1.0  # [s] after lock: the loops' transients are no noise
LONGEST: Final = 20_000  # epochs at which phases are compared


@dataclass(frozen=True)
class Truth:
    """Truth of a recording; times [s] since sample 0, arrays (m,) and (m, satellites).

    ``position_ecef`` (m, 3) is the antenna's, ``imu_ecef`` the IMU's, which is another where the
    mount tilts; it is empty where the simulator did not say where the IMU sits.
    """

    satellites: tuple[str, ...]
    t: FloatArray
    carrier_phase_cycles: FloatArray
    position_t: FloatArray
    position_ecef: FloatArray
    elevation: FloatArray
    azimuth: FloatArray
    imu_ecef: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))

    @classmethod
    def read(cls, path: str | Path) -> Truth:
        """Read a ``truth.npz``; what it does not hold stays empty.

        Raises
        ------
        InputError
            Where it is no such file.
        """
        try:
            with np.load(path, allow_pickle=False) as file:
                values = {name: file[name] for name in file.files}
        except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
            raise InputError(path, f"is not a readable truth.npz: {error}") from None
        if "t_s" not in values:
            raise InputError(path, "holds no t_s", "name the truth.npz of the simulation")
        satellites = tuple(f"G{int(prn):02d}" for prn in values.get("prn", ()))
        empty = np.zeros((0, 0))
        times, position = _antenna(values)
        degrees = {name: np.radians(values[key]) for name, key in _DEGREES if key in values}
        return cls(
            satellites,
            values["t_s"],
            values.get("carrier_phase_cycles", empty),
            times,
            position,
            values.get("elevation", degrees.get("elevation", np.zeros(0))),
            values.get("azimuth", degrees.get("azimuth", np.zeros(0))),
            _imu(values, position),
        )

    def position_at(self, t: NDArray[Any], *, of_imu: bool = False) -> FloatArray:
        """Antenna's or IMU's position [m] at times [s] since sample 0, shape (len(t), 3)."""
        position = self.imu_ecef if of_imu and len(self.imu_ecef) else self.position_ecef
        axes = [np.interp(t, self.position_t, position[:, k]) for k in range(3)]
        return np.stack(axes, axis=-1)


_DEGREES: Final = (("elevation", "el_deg"), ("azimuth", "az_deg"))


def _antenna(values: Mapping[str, NDArray[Any]]) -> tuple[FloatArray, FloatArray]:
    for name in ("antenna_ecef", "antenna_ecef_m"):
        if name in values:
            position = np.atleast_2d(values[name])
            if len(position) == 1:
                return np.zeros(1), position
            clocks = [values[key] for key in ("motion_t_s", "t_s") if key in values]
            times = next((c for c in clocks if c.size == len(position)), None)
            if times is None:
                raise InputError(name, "has no times: as many t_s or motion_t_s as rows")
            return times, position
    return np.zeros(0), np.zeros((0, 3))


def _imu(values: Mapping[str, NDArray[Any]], antenna: FloatArray) -> FloatArray:
    """Return where the IMU is (m, 3) [m]: lever arm and attitude lead back from the antenna."""
    turns, lever = values.get("orientation_xyzw"), values.get("imu_to_antenna")
    if turns is None or lever is None or turns.shape != (len(antenna), 4) or not len(antenna):
        return np.zeros((0, 3))
    latitude, longitude, _ = geodetic_from_ecef(antenna[0])
    C_enu_e = np.asarray(rotation_enu_ecef(latitude, longitude))
    return np.asarray(
        antenna - quat_rotate(turns, np.broadcast_to(lever, antenna.shape)) @ C_enu_e
    )


def is_locked(columns: Columns) -> NDArray[np.bool_]:
    """Tell the integrations of one satellite that track its phase, bit edges known."""
    needed = int(TrackingFlag.PHASE_LOCK | TrackingFlag.BIT_SYNC)
    return np.asarray((columns["flags"].astype(np.int64) & needed) == needed)


def is_settled(columns: Columns, sample_rate_hz: float) -> NDArray[np.bool_]:
    """Tell the integrations that have tracked the phase for `SETTLING` without a break."""
    locked, start = is_locked(columns), columns["sample_index"]
    begins = locked & ~np.concatenate(([False], locked[:-1]))
    origin = np.maximum.accumulate(np.where(begins, start, np.int64(-(2**62))))
    return np.asarray(locked & (start - origin > SETTLING * sample_rate_hz))


def nco_phase(
    columns: Columns, samples: FloatArray, sample_rate_hz: float, *, settled: bool = True
) -> FloatArray:
    """Carrier NCO phase [cycles] at sample instants; NaN outside integrations.

    ``settled``: NaN outside settled integrations too.
    """
    start, count = columns["sample_index"], columns["sample_count"]
    out = np.full(len(samples), np.nan)
    if not start.size:
        return out
    at = np.searchsorted(start, samples, side="right") - 1
    inside = (at >= 0) & (samples < (start + count)[at])
    if settled:
        inside &= is_settled(columns, sample_rate_hz)[at]
    k = at[inside]
    tau = (samples[inside] - start[k]) / sample_rate_hz
    out[inside] = (
        columns["carrier_phase_cycles"][k]
        + columns["carrier_doppler_hz"][k] * tau
        + columns["carrier_doppler_rate"][k] * tau**2 / 2
        + columns["carrier_doppler_accel"][k] * tau**3 / 3
    )
    return out


@dataclass(frozen=True)
class PhaseErrors:
    """True phase error of the loops, the part common to all satellites removed.

    ``t`` [s] since the first sample, shape (m,); ``error_cycles`` (m, satellites), NaN while not
    locked; ``own_share``: what is left of a satellite's own error variance when the common part
    is taken away, 0..1.
    """

    satellites: tuple[str, ...]
    t: FloatArray
    error_cycles: FloatArray
    own_share: FloatArray

    def rms_cycles(self) -> FloatArray:
        """RMS [cycles] of each satellite, freed of the share that the common part took."""
        seen = np.isfinite(self.error_cycles)
        square = np.where(seen, self.error_cycles, 0.0) ** 2
        mean = square.sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
        return np.asarray(np.sqrt(mean / self.own_share))


def phase_errors(run: RunData, truth: Truth, limits: Mapping[str, float]) -> PhaseErrors | None:
    """Compare the NCO of every satellite with the truth at the truth's own epochs.

    Parameters
    ----------
    run, truth : RunData, Truth
        The run and what is known of it.
    limits : mapping
        Expected error of each satellite, any unit: the common part is the mean weighted by its
        inverse square.

    Returns
    -------
    PhaseErrors or None
        None where fewer than two satellites can be compared.
    """
    known = [s for s in run.satellites if s in truth.satellites and limits.get(s, 0) > 0]
    if not truth.carrier_phase_cycles.size or len(known) < 2:
        return None
    step = max(1, -(-truth.t.size // LONGEST))
    samples = truth.t[::step] * run.sample_rate_hz
    columns = [truth.satellites.index(s) for s in known]
    error = -truth.carrier_phase_cycles[::step, columns]
    arcs = np.zeros(error.shape, np.int64)
    for k, satellite in enumerate(known):
        track = run.tracking[satellite]
        error[:, k] += nco_phase(track, samples, run.sample_rate_hz)
        arcs[:, k] = _arc_numbers(track, samples)
    weights = np.array([limits[s] for s in known], np.float64) ** -2.0
    inside = np.isfinite(error).any(axis=1)
    if not inside.any():
        return None
    error = remove_common(error[inside], arcs[inside], weights)
    share = 1.0 - weights / weights.sum()
    return PhaseErrors(tuple(known), run.seconds(samples[inside]), error, share)


def _arc_numbers(track: Columns, samples: FloatArray) -> NDArray[np.int64]:
    """Count the breaks of the phase before every instant."""
    breaks = int(TrackingFlag.SLIP | TrackingFlag.GAP | TrackingFlag.HALF_CYCLE)
    count = np.cumsum((track["flags"].astype(np.int64) & breaks) > 0)
    at = np.searchsorted(track["sample_index"], samples, side="right") - 1
    return np.asarray(count[np.maximum(at, 0)])


def remove_common(error: FloatArray, arcs: NDArray[np.int64], weights: FloatArray) -> FloatArray:
    """Take away each arc's constant and the weighted mean over satellites of every epoch.

    The common part is first found from differences between epochs, which need no constants,
    then from what is left.
    """
    same_arc = np.diff(arcs, axis=0) == 0
    change = np.where(same_arc, np.diff(error, axis=0), np.nan)
    common = np.concatenate(([0.0], np.cumsum(_weighted_mean(change, weights))))
    left = _without_means(error - common[:, None], arcs)
    left = left - _weighted_mean(left, weights)[:, None]
    return _without_means(left, arcs)


def _weighted_mean(values: FloatArray, weights: FloatArray) -> FloatArray:
    seen = np.isfinite(values)
    total = (seen * weights).sum(axis=1)
    mean = (np.where(seen, values, 0.0) * weights).sum(axis=1) / np.where(total > 0, total, 1.0)
    return np.asarray(mean)


def _without_means(values: FloatArray, arcs: NDArray[np.int64]) -> FloatArray:
    out = values.copy()
    for k in range(values.shape[1]):
        for arc in np.unique(arcs[:, k]):
            mask = (arcs[:, k] == arc) & np.isfinite(values[:, k])
            if mask.any():
                out[mask, k] -= out[mask, k].mean()
    return out
