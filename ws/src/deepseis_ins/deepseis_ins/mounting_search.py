"""Rough time offset and heading of an IMU: correlation of its velocities with those of GNSS.

Horizontal velocities are complex numbers, north + i east. The magnitude of their correlation
does not depend on the heading, and where it is largest its argument is the heading. Both sides
are differentiated or integrated in the frequency domain and kept to one band, below which the
IMU drifts and above which positions are noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal.windows import tukey

from deepseis_core.errors import InputError
from deepseis_core.geodesy import normal_gravity
from deepseis_core.rotation import quat_rotate
from deepseis_core.types import FloatArray
from deepseis_ins.mounting_data import AntennaSeries, ImuSeries

LOW_HZ = 0.2
HIGH_HZ = 10.0
GRID_HZ = 50.0
LEAST_S = 4.0
TAPER = 0.1
LEAST_SHARE = 0.02
"""Of the energy of all axes, below which an axis does not move."""


@dataclass(frozen=True)
class Rough:
    """Offset [s], turn about down [rad], and the correlation there, of the worst axis [-]."""

    offset: float
    turn: float
    agreement: float


def velocity_spectrum_source(imu: ImuSeries, quat_nb: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return times and specific forces, north, east, down, in the middle of the intervals."""
    force = quat_rotate(quat_nb[:-1], imu.delta_vel_b / imu.dt[:, None])
    return imu.time - 0.5 * imu.dt, force


def search(
    forces: tuple[FloatArray, FloatArray],
    antenna: AntennaSeries,
    largest: float,
    *,
    heading_known: bool,
) -> Rough:
    """Find the offset at which both velocities agree best.

    Parameters
    ----------
    forces : (ndarray, ndarray)
        As `velocity_spectrum_source` gives them.
    antenna : AntennaSeries
    largest : float
        Offset, on both sides [s].
    heading_known : bool
        The turn is 0.

    Raises
    ------
    InputError
        There is not enough of both at the same time, or nothing moves.
    """
    time, force = forces
    begin, end = max(time[0], antenna.time[0]), min(time[-1], antenna.time[-1])
    if end - begin < LEAST_S:
        reason = f"IMU and GNSS have {max(0.0, end - begin):.1f} s in common"
        raise InputError("mounting", reason, f"at least {LEAST_S:g} s; is start_utc right?")
    grid = np.arange(begin, end, 1.0 / GRID_HZ)
    window = tukey(len(grid), TAPER)[:, None]
    size = 2 * len(grid)
    frequency = np.fft.fftfreq(size, 1.0 / GRID_HZ)
    high = min(HIGH_HZ, 0.4 * antenna.rate_hz)
    band = (np.abs(frequency) >= LOW_HZ) & (np.abs(frequency) <= high)
    omega = 2j * np.pi * np.where(band, frequency, 1.0)
    gravity = np.array([0.0, 0.0, normal_gravity(antenna.latitude, antenna.height)])
    smooth = _averaged(time, force + gravity, grid)
    imu_v = _spectra(smooth * window, size) / omega[:, None] * band[:, None]
    seen = CubicSpline(antenna.time, antenna.value)(grid)
    gnss_v = _spectra((seen - seen.mean(axis=0)) * window, size) * band[:, None]
    gnss_v = gnss_v if antenna.is_velocity else gnss_v * omega[:, None]
    return _peak(imu_v, gnss_v, size, largest, heading_known)


def _averaged(time: FloatArray, value: FloatArray, grid: FloatArray) -> FloatArray:
    """Average over the steps of the grid, so that nothing above its band folds into it."""
    step = np.diff(time, prepend=2 * time[0] - time[1])[:, None]
    total = np.vstack([np.zeros(3), np.cumsum(value * step, axis=0)])
    ends = np.concatenate([[time[0] - 0.5 * step[0, 0]], time + 0.5 * step[:, 0]])
    half = 0.5 / GRID_HZ
    columns = [
        np.interp(grid + half, ends, total[:, k]) - np.interp(grid - half, ends, total[:, k])
        for k in range(3)
    ]
    out = np.stack(columns, axis=1) * GRID_HZ
    return np.asarray(out - out.mean(axis=0))


def _spectra(value: FloatArray, size: int) -> NDArray[np.complex128]:
    """Return spectra of north, east and down, shape (size, 3)."""
    return np.asarray(np.fft.fft(value, size, axis=0))


def _peak(
    imu_v: NDArray[np.complex128],
    gnss_v: NDArray[np.complex128],
    size: int,
    largest: float,
    heading_known: bool,
) -> Rough:
    axes = np.fft.ifft(gnss_v * np.conj(imu_v), axis=0).real
    # (n + i e) conj(n' + i e'): its real part is that of both axes
    across = gnss_v[:, 1] * np.conj(imu_v[:, 0]) - gnss_v[:, 0] * np.conj(imu_v[:, 1])
    level = axes[:, 0] + axes[:, 1] + 1j * np.fft.ifft(across).real
    score = (level.real if heading_known else np.abs(level)) + axes[:, 2]
    lag = np.fft.fftfreq(size, 1.0 / size)
    score = np.where(np.abs(lag) <= largest * GRID_HZ, score, -np.inf)
    best = int(np.argmax(score))
    around = score[[best - 1, best, (best + 1) % size]]
    part = 0.0
    if np.isfinite(around).all():
        curvature = around[0] - 2.0 * around[1] + around[2]
        part = 0.5 * float(around[0] - around[2]) / float(curvature) if curvature < 0.0 else 0.0
    turn = 0.0 if heading_known else float(np.angle(level[best]))
    powers = [np.sum(np.abs(v) ** 2, axis=0) / size for v in (imu_v, gnss_v)]
    if min(float(p.sum()) for p in powers) <= 0.0:
        raise InputError("mounting", "nothing moves")
    found = axes[best] if heading_known else np.array([np.abs(level[best]), axes[best, 2]])
    agreement = _worst(found, powers[0], powers[1], heading_known)
    return Rough((float(lag[best]) + part) / GRID_HZ, turn, agreement)


def _worst(found: FloatArray, imu: FloatArray, gnss: FloatArray, heading_known: bool) -> float:
    """Return the least correlation of the axes that move; both level ones are one, if unknown.

    A wrong sign shows on its own axis, however much the others agree.
    """
    if not heading_known:
        imu, gnss = (np.array([p[0] + p[1], p[2]]) for p in (imu, gnss))
    moves = np.minimum(imu / imu.sum(), gnss / gnss.sum()) > LEAST_SHARE
    each = found / np.sqrt(np.maximum(imu * gnss, 1e-300))
    return float(np.min(each[moves])) if moves.any() else 0.0
