"""The filter behind the present of a vehicle with a velocimeter.

At every step the velocimeter's measurements since the step before are averaged and compared with
what the mechanisation went through. Scale, pitch and yaw of the installation are estimated in the
place of a reference attitude; zero turn is no constraint here. With GNSS all of them become known;
without it the velocimeter holds the velocity.

A vehicle at constant speed on a smooth road looks still to an IMU: it is not where the velocimeter
measures that it moves.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right, insort
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from deepseis_core.rotation import euler_from_matrix, flu_from_frd, matrix_from_quat
from deepseis_core.types import FloatArray, LdvVelocity, Pvt
from deepseis_ins.delayed_filter import DelayedFilter
from deepseis_ins.filter_steps import GnssUpdate
from deepseis_ins.gnss_epochs import Epoch, PreciseEpoch
from deepseis_ins.gnss_offset import GnssOffsets
from deepseis_ins.gnss_updates import GnssUpdates
from deepseis_ins.ldv import (
    LdvInstallation,
    LdvRecord,
    LdvWindow,
    ldv_velocity,
    lever_sensitivity,
)
from deepseis_ins.ldv_filter import (
    LEVER,
    POSITION_OFF,
    VELOCITY_OFF,
    LdvFilter,
    of_gnss,
    sensitive,
)
from deepseis_ins.ldv_fusion import LdvFusionConfig, three
from deepseis_ins.ldv_kernels import window_kernel
from deepseis_ins.measurements import Measurement, gnss_position, gnss_velocity
from deepseis_ins.strapdown import NavState

SEEN_S: Final = 0.5
"""What the velocimeter measured so long before a step tells whether it is a rest [s]."""


@dataclass(frozen=True)
class _Usable:
    """One usable measurement."""

    sample_index: int
    velocity: FloatArray
    variance: FloatArray


class SlowGnssUpdates(GnssUpdates):
    """Works epochs of GNSS into a filter that has the slow errors of PVT as states."""

    def _position(
        self, offsets: GnssOffsets, pvt: Pvt, moved: FloatArray, dt: float
    ) -> Measurement:
        value, nav = pvt.position_ecef - moved, self.filter.nav
        fix = offsets.position.take_off(value, pvt.position_covariance_ecef, dt)
        position = gnss_position(nav, fix.value, fix.covariance, self.lever_arm_b)
        return of_gnss(position, POSITION_OFF)

    def _velocity(
        self, offsets: GnssOffsets, pvt: Pvt, gained: FloatArray, dt: float
    ) -> Measurement:
        value, nav = pvt.velocity_ecef - gained, self.filter.nav
        fix = offsets.velocity.take_off(value, pvt.velocity_covariance_ecef, dt)
        rate_b, lever = self.filter.omega_ib_b, self.lever_arm_b
        velocity = gnss_velocity(nav, rate_b, fix.value, fix.covariance, lever)
        return of_gnss(velocity, VELOCITY_OFF)


class LdvDelayedFilter(DelayedFilter):
    """Works through steps, with what the velocimeter measured between them.

    Parameters
    ----------
    given
        As `DelayedFilter`'s; the filter is a `LdvFilter`.
    ldv : LdvFusionConfig
    """

    filter: LdvFilter
    holds_angle = False
    holds_place = False

    def __init__(self, *given: Any, ldv: LdvFusionConfig) -> None:
        self.ldv_config, self.installation = ldv, ldv.installation()
        self.no_slip_arm_b = flu_from_frd(three("ldv_no_slip_arm", ldv.ldv_no_slip_arm))
        self._measurements: list[_Usable] = []
        self._ldv_counts = dict.fromkeys(("ldv", "ldv_unusable", "ldv_windows"), 0)
        self._before: tuple[int, NavState] | None = None
        filter = given[1]
        filter.refer_constants(self.installation.sd)
        super().__init__(*given)
        self.gnss = SlowGnssUpdates(
            self.config, filter, self.history, self.lever_arm_b, self.sample_rate_hz
        )

    @property
    def counts(self) -> dict[str, int]:
        """Counts since the start, for diagnostics."""
        return super().counts | self._ldv_counts

    def report(self) -> dict[str, object]:
        """Return the installation as settings have it (axes forward, left, up)."""
        installation = self.installation
        roll, pitch, yaw = np.degrees(euler_from_matrix(installation.C_bd))
        sd = self.filter.constants_sd()
        return {
            "ldv_scale": f"{installation.scale:.7f}",
            "ldv_scale_sd": f"{sd[0]:.7f}",
            "ldv_orientation_deg": f"{roll:.5f} {-pitch:.5f} {-yaw:.5f}",
            "ldv_angle_sd_deg": " ".join(f"{v:.5f}" for v in np.degrees(sd[1:])),
            "ldv_lever_arm": " ".join(f"{v:.4f}" for v in flu_from_frd(installation.lever_arm_b)),
            "ldv_lever_sd": " ".join(f"{v:.4f}" for v in self.filter.lever_sd),
        }

    def push_ldv(self, value: LdvVelocity) -> None:
        """Take a measurement that counts from now on."""
        sd = np.asarray(value.beam_velocity_sd, np.float64)
        whole = np.isfinite(np.hstack([value.beam_velocity, sd])).all() and (sd > 0.0).all()
        if not (whole and value.quality >= self.ldv_config.ldv_quality):
            self._ldv_counts["ldv_unusable"] += 1
            return
        if value.sample_index <= self._steps[0].sample_index:
            self._counts["too_old"] += 1
            return
        record = LdvRecord.from_beams(
            np.zeros(1),
            value.beam_velocity[None],
            sd[None],
            value.beam_elevation,
            np.array([value.quality]),
        )
        self._ldv_counts["ldv"] += 1
        usable = _Usable(value.sample_index, record.velocity[0], record.variance[0])
        insort(self._measurements, usable, key=_sample_index)
        if value.sample_index <= self.done[0]:
            self.rewind(value.sample_index)

    # Work

    def _kept(self) -> LdvInstallation:
        return self.installation

    def _put_back(self, kept: Any) -> None:
        self.installation = kept

    def _carry(self, row: int) -> None:
        self._before = (self.row + 1, self.filter.nav) if row > self.row else None
        super()._carry(row)

    def _is_still(self, sample_index: int) -> bool:
        if not super()._is_still(sample_index):
            return False
        since = sample_index - round(SEEN_S * self.sample_rate_hz)
        seen = self._between(since, sample_index)
        return not any(abs(m.velocity[0]) > self.ldv_config.ldv_least_speed for m in seen)

    def _refer(self) -> FloatArray:
        return matrix_from_quat(self.nav.quat_nb)

    def _measured(self, epoch: Epoch, *, still: bool) -> GnssUpdate | None:
        """Use a position of PVT at rest as well: its slow errors are learnt by the filter."""
        if isinstance(epoch, PreciseEpoch):
            return super()._measured(epoch, still=still)
        dt = self._interval_before(self._pvts, epoch)
        used = self.gnss.use(self.offsets, epoch, self.row, dt)
        return None if still else used.update

    def _between(self, begin: int, end: int) -> list[_Usable]:
        """Return measurements after a sample, up to another."""
        first = bisect_right(self._measurements, begin, key=_sample_index)
        last = bisect_right(self._measurements, end, key=_sample_index)
        return self._measurements[first:last]

    def _beside_gnss(self, *, still: bool) -> None:
        """Compare the velocity over the step with the velocimeter's."""
        if still or self._before is None:
            return
        (first, before), history = self._before, self.history
        begin = history.sample_index(first - 1)
        seen = self._between(begin, history.sample_index(self.row))
        if not seen:
            return
        window, turn_b = self._window(first, before, begin, seen)
        nav, length = self.nav, (self.row + 1 - first) * history.dt
        C_nb = matrix_from_quat(nav.quat_nb)
        measurement = ldv_velocity(
            window, C_nb, self.filter.omega_ib_b, nav.latitude, self.installation,
            self.ldv_config.use(length),
        )  # fmt: skip
        swing = lever_sensitivity(C_nb, turn_b, nav.latitude)
        self.gnss.update(sensitive(measurement, LEVER, swing))
        self._ldv_counts["ldv_windows"] += 1
        error, _ = self.filter.take_constants()
        known = self.installation.corrected(error)
        arm = known.lever_arm_b - self.filter.take_lever()
        self.installation = replace(known, lever_arm_b=arm)

    def _window(
        self, first: int, before: NavState, begin: int, seen: list[_Usable]
    ) -> tuple[LdvWindow, FloatArray]:
        """Return means over a step, and the mean angular rate."""
        history, (passed,) = self.history, self._carried
        angle, _ = history.increments(first, self.row + 1)
        omega = angle / history.dt - self.filter.gyro_bias
        ends = history.indices(first - 1, self.row + 1) - begin
        velocity = np.zeros((len(seen), 3))
        velocity[:, [0, 2]] = [m.velocity for m in seen]
        own, predicted, measured = np.empty((3, 3))
        window_kernel(
            ends / self.sample_rate_hz,
            np.vstack([before.vel_n, passed.vel_n]),
            np.vstack([before.quat_nb, passed.quat_nb]),
            np.vstack([omega[:1], omega]),
            before.latitude,
            np.array([m.sample_index - begin for m in seen]) / self.sample_rate_hz,
            self.installation.velocity_b(velocity),
            np.stack([self.installation.lever_arm_b, self.no_slip_arm_b]),
            own,
            predicted,
            measured,
        )
        variance = np.mean([m.variance for m in seen], axis=0) / len(seen)
        return LdvWindow(len(seen), predicted, measured, variance), omega.mean(axis=0)

    def _forget(self, horizon: int) -> None:
        super()._forget(horizon)
        kept = self._steps[0].sample_index - round(SEEN_S * self.sample_rate_hz)
        old = bisect_left(self._measurements, kept, key=_sample_index)
        del self._measurements[:old]


def _sample_index(item: _Usable) -> int:
    return item.sample_index
