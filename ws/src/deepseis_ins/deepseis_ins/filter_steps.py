"""Steps of `delayed_filter`: what is kept of them; GNSS brought to the filter's time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from deepseis_core.geodesy import ecef_from_geodetic, rotation_ned_ecef
from deepseis_core.rotation import quat_rotate
from deepseis_core.types import FloatArray
from deepseis_ins.error_state import POS
from deepseis_ins.gnss_offset import GnssOffsets
from deepseis_ins.imu_history import ImuHistory
from deepseis_ins.loose import Innovation, LooseFilter
from deepseis_ins.loose import Snapshot as FilterSnapshot
from deepseis_ins.oscillator_terms import OscillatorState
from deepseis_ins.strapdown import NavState, propagate


@dataclass(frozen=True)
class Rest:
    """What is held while the station stands still.

    Attributes
    ----------
    antenna_ecef : ndarray, shape (3,)
        Where the antenna is [m].
    C_nb : ndarray, shape (3, 3)
        How the IMU stands.
    begun : int
        Its first sample.
    learnt : tuple
        What was known of slow errors, once a second, with the sample.
    """

    antenna_ecef: FloatArray
    C_nb: FloatArray
    begun: int
    learnt: tuple[tuple[int, GnssOffsets], ...] = ()

    def with_learnt(self, sample_index: int, offsets: GnssOffsets, step: int, reach: int) -> Rest:
        """Return the same with what is known at a sample, if the last is ``step`` old.

        What is older than ``reach`` is dropped but for one; all are numbers of samples.
        """
        if self.learnt and sample_index - self.learnt[-1][0] < step:
            return self
        first = sum(at < sample_index - reach for at, _ in self.learnt[1:])
        return replace(self, learnt=(*self.learnt[first:], (sample_index, offsets)))

    def known_before(self, sample_index: int) -> GnssOffsets | None:
        """Return what was known at or before a sample; None: nothing kept goes back so far."""
        return next((item for at, item in reversed(self.learnt) if at <= sample_index), None)


REGULAR, RTK, PRECISE, POSITION, RANGES = range(5)
"""Kinds of steps, in their order at the same sample."""


@dataclass(frozen=True)
class Step:
    """State after the step at a sample."""

    sample_index: int
    kind: int
    row: int
    filter: FilterSnapshot
    rest: Rest | None
    offsets: GnssOffsets
    place_n: FloatArray | None
    oscillator: OscillatorState | None
    more: Any = None
    """What a mode keeps beside that."""


@dataclass(frozen=True)
class GnssUpdate:
    """What became of one epoch of GNSS that was used."""

    sample_index: int
    innovations: tuple[Innovation | None, Innovation | None]


def antenna_ecef(nav: NavState, lever_arm_b: FloatArray) -> FloatArray:
    """Return where the antenna is [m]; the lever arm is forward-right-down."""
    lever_n = quat_rotate(nav.quat_nb, lever_arm_b)
    C_ne = rotation_ned_ecef(nav.latitude, nav.longitude)
    return ecef_from_geodetic([nav.latitude, nav.longitude, nav.height]) + lever_n @ C_ne


def position_covariance_ecef(filter: LooseFilter) -> FloatArray:
    """Return the covariance of the filter's position, ECEF, shape (3, 3) [m^2]."""
    nav = filter.nav
    C_ne = rotation_ned_ecef(nav.latitude, nav.longitude)
    return C_ne.T @ filter.P[POS, POS] @ C_ne


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
