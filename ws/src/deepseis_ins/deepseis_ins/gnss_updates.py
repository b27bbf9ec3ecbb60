"""How the delayed filter uses epochs of GNSS: learns their slow errors, or follows them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from deepseis_core.types import FloatArray, Pvt
from deepseis_ins import measurements
from deepseis_ins.filter_steps import (
    GnssUpdate,
    antenna_ecef,
    change_after,
    position_covariance_ecef,
)
from deepseis_ins.fusion_config import FusionConfig
from deepseis_ins.gnss_epochs import PreciseEpoch, has_velocity
from deepseis_ins.gnss_offset import GnssOffsets, precise_error
from deepseis_ins.imu_history import ImuHistory
from deepseis_ins.loose import Innovation, LooseFilter
from deepseis_ins.measurements import Measurement


@dataclass(frozen=True)
class Used:
    """What came of an epoch.

    Attributes
    ----------
    update : GnssUpdate or None
        None: it was not needed.
    offsets : GnssOffsets
        What is known of slow errors now.
    """

    update: GnssUpdate | None
    offsets: GnssOffsets


class GnssUpdates:
    """Works epochs of GNSS into a filter that stands within an interval before them.

    Parameters
    ----------
    config : FusionConfig
    filter : LooseFilter
    history : ImuHistory
    lever_arm_b : ndarray, shape (3,)
        From IMU to antenna, forward-right-down [m].
    sample_rate_hz : float

    Attributes
    ----------
    counts : dict of str to int
    """

    def __init__(
        self,
        config: FusionConfig,
        filter: LooseFilter,
        history: ImuHistory,
        lever_arm_b: FloatArray,
        sample_rate_hz: float,
    ) -> None:
        self.config, self.filter, self.history = config, filter, history
        self.lever_arm_b, self.sample_rate_hz = lever_arm_b, sample_rate_hz
        self.hold = round(config.precise_hold_s * sample_rate_hz)
        self.counts = dict.fromkeys(
            ("updates", "precise", "precise_jumps", "rejected", "recovered"), 0
        )

    def update(self, measurement: Measurement) -> Innovation:
        """Work a measurement in, and count."""
        innovation = self.filter.update(measurement)
        self.counts["rejected"] += not innovation.accepted
        self.counts["recovered"] += innovation.recovered
        return innovation

    # At rest

    def learn(
        self, offsets: GnssOffsets, pvt: Pvt, place_ecef: FloatArray, dt: float
    ) -> GnssOffsets:
        """Return what is known after a position of an antenna whose place is known."""
        seconds = pvt.sample_index / self.sample_rate_hz
        position = offsets.position.learn(
            seconds, pvt.position_ecef, place_ecef, pvt.position_covariance_ecef, dt
        )
        velocity = offsets.velocity
        if has_velocity(pvt):
            velocity = velocity.learn(
                seconds, pvt.velocity_ecef, np.zeros(3), pvt.velocity_covariance_ecef, dt
            )
        return replace(offsets, position=position, velocity=velocity)

    def learn_precise(
        self, offsets: GnssOffsets, epoch: PreciseEpoch, place_ecef: FloatArray, dt: float
    ) -> GnssOffsets:
        """Do the same with a precise position."""
        known = offsets.precise.get(epoch.kind) or precise_error(self.config)
        seconds = epoch.sample_index / self.sample_rate_hz
        learnt = known.learn(seconds, epoch.position_ecef, place_ecef, epoch.noise_ecef, dt)
        return offsets.with_precise(epoch.kind, learnt)

    # Moving

    def use(self, offsets: GnssOffsets, pvt: Pvt, row: int, dt: float) -> Used:
        """Use a position of PVT, unless there are precise ones."""
        if offsets.kind and pvt.sample_index - offsets.used_at <= self.hold:
            return Used(None, offsets)
        seconds = pvt.sample_index / self.sample_rate_hz
        moved, gained = self._change_after(row, pvt.sample_index)
        fix = offsets.position.correct(
            seconds, pvt.position_ecef - moved, pvt.position_covariance_ecef, dt
        )
        filter, lever = self.filter, self.lever_arm_b
        position = self.update(
            measurements.gnss_position(filter.nav, fix.value, fix.covariance, lever)
        )
        velocity = None
        if has_velocity(pvt):
            fix = offsets.velocity.correct(
                seconds, pvt.velocity_ecef - gained, pvt.velocity_covariance_ecef, dt
            )
            measurement = measurements.gnss_velocity(
                filter.nav, filter.omega_ib_b, fix.value, fix.covariance, lever
            )
            velocity = self.update(measurement)
        self.counts["updates"] += 1
        return Used(GnssUpdate(pvt.sample_index, (position, velocity)), offsets)

    def use_precise(self, offsets: GnssOffsets, epoch: PreciseEpoch, row: int, dt: float) -> Used:
        """Use a precise position; what jumps is refused, and after a while compared anew.

        A jump must not move the filter: a slip that passed unseen is no displacement.
        """
        known = offsets.precise.get(epoch.kind)
        if known is None:  # a kind that was never compared with a known place
            off = epoch.position_ecef - self._antenna_at(row, epoch.sample_index)
            offsets = self._refer(offsets, epoch, off)
            return Used(None, offsets)
        moved, _ = self._change_after(row, epoch.sample_index)
        fix = known.take_off(epoch.position_ecef - moved, epoch.noise_ecef, dt)
        nav, lever = self.filter.nav, self.lever_arm_b
        measurement = measurements.gnss_position(nav, fix.value, fix.covariance, lever)
        measurement = replace(measurement, name="precise", recovers=False)
        innovation = self.update(measurement)
        self.counts["precise"] += 1
        update = GnssUpdate(epoch.sample_index, (innovation, None))
        if innovation.accepted:
            used = replace(
                offsets,
                kind=epoch.kind,
                used_at=epoch.sample_index,
                rejected=0,
                off=np.zeros(3),
                stated=epoch.common_ecef,
            )
            return Used(update, used)
        return Used(update, self._refused(offsets, epoch, row))

    def _refused(self, offsets: GnssOffsets, epoch: PreciseEpoch, row: int) -> GnssOffsets:
        expected = self._antenna_at(row, epoch.sample_index)
        off = epoch.position_ecef - expected - offsets.precise[epoch.kind].mean
        rejected, total = offsets.rejected + 1, offsets.off + off
        if rejected < self.config.precise_rejections:
            return replace(offsets, rejected=rejected, off=total)
        self.counts["precise_jumps"] += 1
        return self._refer(offsets, epoch, total / rejected)

    def _refer(self, offsets: GnssOffsets, epoch: PreciseEpoch, off: FloatArray) -> GnssOffsets:
        """Take what a kind is off by from the filter's own position, and its uncertainty."""
        known = offsets.precise.get(epoch.kind) or precise_error(self.config)
        seconds = epoch.sample_index / self.sample_rate_hz
        place = position_covariance_ecef(self.filter) + offsets.crept(seconds)
        place = place + epoch.noise_ecef
        return offsets.with_precise(
            epoch.kind, known.refer(seconds, off, place), rejected=0, off=np.zeros(3)
        )

    def _antenna_at(self, row: int, sample_index: int) -> FloatArray:
        moved, _ = self._change_after(row, sample_index)
        return antenna_ecef(self.filter.nav, self.lever_arm_b) + moved

    def _change_after(self, row: int, sample_index: int) -> tuple[FloatArray, FloatArray]:
        return change_after(self.filter, self.history, row, sample_index, self.sample_rate_hz)
