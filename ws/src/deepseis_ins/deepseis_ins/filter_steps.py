"""Steps of `delayed_filter`: what is kept of them; GNSS brought to the filter's time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deepseis_core.geodesy import rotation_ned_ecef
from deepseis_core.types import FloatArray, Pvt, PvtStatus
from deepseis_ins.gnss_offset import SlowError
from deepseis_ins.imu_history import ImuHistory
from deepseis_ins.loose import Innovation, LooseFilter
from deepseis_ins.loose import Snapshot as FilterSnapshot
from deepseis_ins.oscillator_terms import OscillatorState
from deepseis_ins.strapdown import propagate


@dataclass(frozen=True)
class Rest:
    """What is held while the station stands still.

    Attributes
    ----------
    antenna_ecef : ndarray, shape (3,)
        Where the antenna is [m].
    C_nb : ndarray, shape (3, 3)
        How the IMU stands.
    covariance_n : ndarray, shape (3, 3)
        Of the place, north, east, down [m^2].
    """

    antenna_ecef: FloatArray
    C_nb: FloatArray
    covariance_n: FloatArray


@dataclass(frozen=True)
class Step:
    """State after the step at a sample; ``kind`` 0 is a regular one, 1 an epoch of GNSS."""

    sample_index: int
    kind: int
    row: int
    filter: FilterSnapshot
    rest: Rest | None
    position: SlowError
    velocity: SlowError
    oscillator: OscillatorState | None


@dataclass(frozen=True)
class GnssUpdate:
    """What became of one epoch of GNSS that was used."""

    sample_index: int
    innovations: tuple[Innovation | None, Innovation | None]


def has_position(pvt: Pvt) -> bool:
    """Return whether there is a position with a covariance."""
    return pvt.status != PvtStatus.NONE and _is_measured(
        pvt.position_ecef, pvt.position_covariance_ecef
    )


def has_velocity(pvt: Pvt) -> bool:
    """Return whether there is a velocity with a covariance."""
    return _is_measured(pvt.velocity_ecef, pvt.velocity_covariance_ecef)


def _is_measured(value: FloatArray, covariance: FloatArray) -> bool:
    if not (np.isfinite(value).all() and np.isfinite(covariance).all()):
        return False
    return bool(np.linalg.eigvalsh(covariance)[0] > 0.0)


def change_after(
    filter: LooseFilter, history: ImuHistory, row: int, sample_index: int, sample_rate_hz: float
) -> tuple[FloatArray, FloatArray]:
    """Return by what position and velocity change from a row's end to a sample, ECEF [m, m/s].

    The sample lies less than an interval after the end of ``row``, where the filter stands. The
    velocity between is a straight line: 1 mm/s off at 2 g and 2 Hz, 200 Hz.
    """
    nav = filter.nav
    late = (sample_index - history.sample_index(row)) / sample_rate_hz
    if late <= 0.0 or row + 1 >= history.end:
        return np.zeros(3), np.zeros(3)
    angle, velocity = history.increments(row + 1, row + 2)
    after, _ = propagate(
        nav,
        angle - filter.gyro_bias * history.dt,
        velocity - filter.accel_bias * history.dt,
        history.dt,
    )
    gained = (after.vel_n - nav.vel_n) * (late / history.dt)
    C_ne = rotation_ned_ecef(nav.latitude, nav.longitude)
    return (late * (nav.vel_n + 0.5 * gained)) @ C_ne, gained @ C_ne
