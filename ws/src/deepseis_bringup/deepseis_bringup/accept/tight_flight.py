"""A drive through the tightly coupled filter, with ranges raw or smoothed, of some or all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from deepseis_bringup.accept.tight_drive import Drive, Flags, Imu
from deepseis_core.constants import L1_WAVELENGTH, NS_PER_S
from deepseis_core.errors import InputError
from deepseis_core.geodesy import geodetic_from_ecef, rotation_ned_ecef
from deepseis_core.hatch import HatchConfig, Smoothed, smooth
from deepseis_core.rotation import matrix_from_quat
from deepseis_core.selection import ALL, HIGHEST, select
from deepseis_core.types import FloatArray
from deepseis_ins.alignment import gyrocompassed, still_mean
from deepseis_ins.loose import LooseConfig
from deepseis_ins.measurements import gnss_position
from deepseis_ins.strapdown import NavState
from deepseis_ins.tight import Ranges, TightFilter
from deepseis_pvt.spp import SppConfig, SppSolution, SppSolver

MASK_DEG: Final = 10.0


@dataclass(frozen=True)
class Way:
    """How ranges are used."""

    smoothed: bool
    rule: str

    @property
    def name(self) -> str:
        """For tables."""
        ranges = "Hatch" if self.smoothed else "raw"
        return f"{ranges}, {'all satellites' if self.rule == ALL else 'four selected'}"


WAYS: Final = tuple(Way(smoothed, rule) for rule in (HIGHEST, ALL) for smoothed in (False, True))
RAW_FOUR, HATCH_FOUR, RAW_ALL, HATCH_ALL = WAYS


@dataclass(frozen=True)
class Flight:
    """What a way made of a drive, at its epochs; NaN before the filter starts.

    Attributes
    ----------
    position : ndarray, shape (m, 3)
        Of the antenna, ECEF [m].
    sd : ndarray, shape (m, 3)
        What the filter says of it, east, north, up [m].
    error : ndarray, shape (m, 3)
        East, north, up [m]; NaN where the truth is not known.
    used : ndarray of int, shape (m,)
        Ranges accepted.
    squares : ndarray, shape (m,)
        Normalised square of the innovations accepted, and ``rows``, how many they are.
    """

    way: Way
    position: FloatArray
    sd: FloatArray
    error: FloatArray
    used: FloatArray
    squares: FloatArray
    rows: FloatArray


def smoothed_ranges(drive: Drive, config: HatchConfig | None = None) -> Smoothed:
    """Return the drive's ranges smoothed."""
    o = drive.observed
    return smooth(o.pseudorange, o.phase, o.lost, config, pseudorange_sd=o.pseudorange_sd)


def fly(
    drive: Drive,
    way: Way,
    *,
    hatch: HatchConfig | None = None,
    hidden: Flags | None = None,
) -> Flight:
    """Run the filter over a drive.

    Parameters
    ----------
    drive : Drive
    way : Way
    hatch : HatchConfig, optional
    hidden : ndarray of bool, shape (m, n), optional
        Satellites taken away.
    """
    drive = drive if hidden is None else drive.hiding(hidden)
    o = drive.observed
    states, (unit, elevation) = o.states(), drive.geometry()
    chosen = select(unit, elevation, way.rule, mask_deg=MASK_DEG).chosen
    ranges, range_sd = o.pseudorange, o.pseudorange_sd
    if way.smoothed:
        smoothed = smoothed_ranges(drive, hatch)
        ranges = smoothed.pseudorange
        range_sd = range_sd * np.sqrt(
            np.maximum(1.0 / np.maximum(smoothed.count, 1), drive.smoothed_share)
        )
    tight, first = _started(drive, states)
    imu = cut(drive.imu, o.time)
    m = len(o.time)
    out = Flight(way, *[np.full((m, 3), np.nan) for _ in range(3)],
                 *[np.full(m, np.nan) for _ in range(3)])  # fmt: skip
    row = int(np.searchsorted(imu.time, drive.still[1] + 1e-9))
    for k in range(first, m):
        end = int(np.searchsorted(imu.time, o.time[k] + 1e-6))
        if end > row:
            part = slice(row, end)
            tight.propagate(imu.delta_theta[part], imu.delta_vel[part], imu.dt[part])
        row = end
        taken = np.flatnonzero(chosen[k])
        got = tight.update_ranges(
            Ranges(
                states[k, taken],
                ranges[k, taken],
                o.range_rate[k, taken],
                range_sd[k, taken],
                o.range_rate_sd[k, taken],
                o.tow_ns[k] / NS_PER_S,
                o.klobuchar,
            )
        )
        _note(out, k, tight, got.accepted[: taken.size].sum())
        out.squares[k] = got.normalised_squared[got.accepted].sum()
        out.rows[k] = got.accepted.sum()
    out.error[:] = drive.errors_n(out.position)
    return out


def _note(out: Flight, k: int, tight: TightFilter, used: int) -> None:
    """Write down where the antenna is."""
    nav = tight.nav
    m = gnss_position(nav, np.zeros(3), np.eye(3), tight.lever_arm_b)
    C_ne = rotation_ned_ecef(nav.latitude, nav.longitude)
    out.position[k] = C_ne.T @ m.z
    P = m.H @ tight.P @ m.H.T
    out.sd[k] = np.sqrt(np.diag(P))[[1, 0, 2]]
    out.used[k] = used


def _started(drive: Drive, states: FloatArray) -> tuple[TightFilter, int]:
    """Return a filter aligned at rest, and the first epoch after it."""
    o, (begin, end) = drive.observed, drive.still
    first = int(np.searchsorted(o.time, end + 1e-6))
    fix = next(
        (s for k in range(first - 1, len(o.time)) if (s := single_point(drive, states, k))), None
    )
    if fix is None:
        raise InputError(drive.name, "no position could be found to start from")
    place = geodetic_from_ecef(fix.position_ecef)
    part = slice(*np.searchsorted(drive.imu.time, [begin + 1e-6, end + 1e-6]))
    mean = still_mean(drive.imu.delta_theta[part], drive.imu.delta_vel[part], drive.imu.dt[part])
    found = gyrocompassed(mean, place[0], place[2], drive.grade)
    C_ne = rotation_ned_ecef(place[0], place[1])
    lever_n = matrix_from_quat(found.quat_nb) @ drive.lever_arm_b
    place = geodetic_from_ecef(fix.position_ecef - C_ne.T @ lever_n)
    sd = np.sqrt(np.diag(C_ne @ fix.covariance[:3, :3] @ C_ne.T))
    latitude, longitude, height = place.tolist()
    tight = TightFilter(
        LooseConfig(), drive.grade,
        NavState(latitude, longitude, height, np.zeros(3), found.quat_nb), tight=drive.clock,
        lever_arm_b=drive.lever_arm_b, attitude_sd=found.covariance,
        position_sd=sd, velocity_sd=[0.02] * 3,
    )  # fmt: skip
    return tight, first


def single_point(drive: Drive, states: FloatArray, k: int) -> SppSolution | None:
    """Return our single-point solution of an epoch."""
    o = drive.observed
    seen = np.flatnonzero(np.isfinite(o.pseudorange[k]))
    if seen.size < 4:
        return None
    return SppSolver(SppConfig(elevation_mask_deg=MASK_DEG)).solve(
        states[k, seen], o.pseudorange[k, seen], -o.range_rate[k, seen] / L1_WAVELENGTH,
        o.cn0_dbhz[k, seen], tow=o.tow_ns[k] / NS_PER_S, klobuchar=o.klobuchar,
    )  # fmt: skip


def cut(imu: Imu, times: FloatArray) -> Imu:
    """Cut intervals at the times that lie within them, at constant rates."""
    begin = imu.time - imu.dt
    inside = times[(times > begin[0]) & (times < imu.time[-1])]
    row = np.searchsorted(imu.time, inside)
    free = (inside - begin[row] > 1e-6) & (imu.time[row] - inside > 1e-6)
    edges = np.union1d(imu.time, inside[free])
    row = np.searchsorted(imu.time, edges - 1e-9)
    dt = np.diff(edges, prepend=begin[0])
    share = (dt / imu.dt[row])[:, None]
    return Imu(edges, dt, share * imu.delta_theta[row], share * imu.delta_vel[row])


def rms(values: FloatArray) -> FloatArray:
    """Return the RMS of what is known, by columns."""
    return np.sqrt(np.nanmean(values**2, axis=0))


def without(drive: Drive, span: tuple[float, float], keep: int, elevation: FloatArray) -> Flags:
    """Return a mask that leaves the highest so many satellites in a span."""
    o = drive.observed
    hidden = np.zeros(o.pseudorange.shape, np.bool_)
    for k in np.flatnonzero((o.time >= span[0]) & (o.time < span[1])):
        seen = np.flatnonzero(np.isfinite(o.pseudorange[k]))
        order: Sequence[int] = seen[np.argsort(-elevation[k, seen])].tolist()
        hidden[k, order[keep:]] = True
    return hidden
