"""How the delayed filter uses epochs of GNSS: learns their slow errors, or follows them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

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
from deepseis_ins.gnss_epochs import RTK, PreciseEpoch, has_velocity
from deepseis_ins.gnss_offset import (
    GnssOffsets,
    Refused,
    SlowError,
    precise_error,
    put,
)
from deepseis_ins.imu_history import ImuHistory
from deepseis_ins.loose import Innovation, LooseFilter
from deepseis_ins.measurements import Measurement

HOME_GATE: Final = 16.0
"""Of the normalised square of what a kind of positions is off by when it is back."""


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
            ("updates", "precise", "rtk", "rtk_back", "precise_jumps", "rejected", "recovered"), 0
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
        known = offsets.precise.get(epoch.kind) or precise_error(self.config, epoch.kind)
        seconds = epoch.sample_index / self.sample_rate_hz
        learnt = known.learn(seconds, epoch.position_ecef, place_ecef, epoch.noise_ecef, dt)
        return offsets.with_precise(epoch.kind, learnt)

    # Moving

    def use(self, offsets: GnssOffsets, pvt: Pvt, row: int, dt: float) -> Used:
        """Use a position of PVT, unless there are precise ones."""
        if offsets.kind and pvt.sample_index - offsets.used_at <= self.hold:
            return Used(None, offsets)
        moved, gained = self._change_after(row, pvt.sample_index)
        position = self.update(self._position(offsets, pvt, moved, dt))
        velocity = None
        if has_velocity(pvt):
            velocity = self.update(self._velocity(offsets, pvt, gained, dt))
        self.counts["updates"] += 1
        return Used(GnssUpdate(pvt.sample_index, (position, velocity)), offsets)

    def _position(
        self, offsets: GnssOffsets, pvt: Pvt, moved: FloatArray, dt: float
    ) -> Measurement:
        """Return a position without its slow error, where the filter stands."""
        seconds, value = pvt.sample_index / self.sample_rate_hz, pvt.position_ecef - moved
        fix = offsets.position.correct(seconds, value, pvt.position_covariance_ecef, dt)
        return measurements.gnss_position(
            self.filter.nav, fix.value, fix.covariance, self.lever_arm_b
        )

    def _velocity(
        self, offsets: GnssOffsets, pvt: Pvt, gained: FloatArray, dt: float
    ) -> Measurement:
        """Return a velocity without its slow error, when the filter stands."""
        seconds, value = pvt.sample_index / self.sample_rate_hz, pvt.velocity_ecef - gained
        fix = offsets.velocity.correct(seconds, value, pvt.velocity_covariance_ecef, dt)
        filter, lever = self.filter, self.lever_arm_b
        return measurements.gnss_velocity(
            filter.nav, filter.omega_ib_b, fix.value, fix.covariance, lever
        )

    def follows_rtk(self, offsets: GnssOffsets, sample_index: int) -> bool:
        """Whether positions against a base have been used up to a moment ago."""
        since = sample_index - offsets.used_at
        return offsets.kind.startswith(RTK) and since <= self.hold

    def compare(
        self, offsets: GnssOffsets, epoch: PreciseEpoch, row: int, dt: float
    ) -> GnssOffsets:
        """Return what is known after a position of a kind that is not followed now.

        So the filter can go over to it without a jump: a constant difference between the two, and
        what one creeps against the other, is no displacement.
        """
        seconds = epoch.sample_index / self.sample_rate_hz
        known = offsets.precise.get(epoch.kind) or precise_error(self.config, epoch.kind)
        here = self._antenna_at(row, epoch.sample_index)
        learnt = known.learn(seconds, epoch.position_ecef, here, epoch.noise_ecef, dt)
        place = position_covariance_ecef(self.filter) + offsets.crept(seconds)
        inherited = put(offsets.inherited, epoch.kind, place - epoch.common_ecef)
        return offsets.with_precise(epoch.kind, learnt, inherited=inherited)

    def use_precise(self, offsets: GnssOffsets, epoch: PreciseEpoch, row: int, dt: float) -> Used:
        """Use a precise position; what jumps is refused, and after a while compared anew.

        A jump must not move the filter: a slip that passed unseen is no displacement. A base that
        is back does not move it either: its positions are compared with the filter's first, and
        what these have crept meanwhile is worked off over ``rtk_return_s``.
        """
        known = offsets.precise.get(epoch.kind)
        is_back = epoch.against_base and offsets.kind not in ("", epoch.kind)
        if is_back:
            return Used(None, self._refused(offsets, epoch, row))
        if known is None:  # a kind that was never compared with a known place
            if epoch.afloat and not self._knows_its_place(offsets, epoch.sample_index):
                return Used(None, offsets)  # it would keep what PVT can still put right
            off = epoch.position_ecef - self._antenna_at(row, epoch.sample_index)
            return Used(None, self._refer(offsets, epoch, off))
        if epoch.kind in offsets.home:
            offsets = self._homewards(offsets, epoch.kind, epoch.sample_index)
            known = offsets.precise[epoch.kind]
        moved, _ = self._change_after(row, epoch.sample_index)
        fix = known.take_off(epoch.position_ecef - moved, epoch.noise_ecef, dt)
        nav, lever = self.filter.nav, self.lever_arm_b
        measurement = measurements.gnss_position(nav, fix.value, fix.covariance, lever)
        measurement = replace(measurement, name="precise", recovers=False)
        innovation = self.update(measurement)
        self.counts["precise"] += 1
        self.counts["rtk"] += epoch.against_base
        update = GnssUpdate(epoch.sample_index, (innovation, None))
        if innovation.accepted:
            used = replace(
                offsets,
                kind=epoch.kind,
                used_at=epoch.sample_index,
                refused=put(offsets.refused, epoch.kind, None),
                stated=epoch.common_ecef,
            )
            return Used(update, used)
        return Used(update, self._refused(offsets, epoch, row))

    def _knows_its_place(self, offsets: GnssOffsets, sample_index: int) -> bool:
        """Tell whether the filter's position is good enough to refer others' to it."""
        seconds = sample_index / self.sample_rate_hz
        place = position_covariance_ecef(self.filter) + offsets.crept(seconds)
        return bool(np.linalg.eigvalsh(place)[-1] < self.config.afloat_sd**2)

    def _refused(self, offsets: GnssOffsets, epoch: PreciseEpoch, row: int) -> GnssOffsets:
        """Count a position that is not used; after some, refer its kind to the filter's."""
        known = offsets.precise.get(epoch.kind)
        mean = known.mean if known is not None else np.zeros(3)
        off = epoch.position_ecef - self._antenna_at(row, epoch.sample_index) - mean
        before = offsets.refused.get(epoch.kind, Refused())
        now = Refused(before.count + 1, before.off + off)
        if now.count < self.config.precise_rejections:
            return replace(offsets, refused=put(offsets.refused, epoch.kind, now))
        is_back = offsets.kind not in ("", epoch.kind)
        self.counts["rtk_back" if is_back else "precise_jumps"] += 1
        referred = self._refer(offsets, epoch, now.off / now.count)
        if not is_back:
            return referred
        home = self._home(known, referred.precise[epoch.kind], epoch)
        return replace(
            referred,
            kind=epoch.kind,
            used_at=epoch.sample_index,
            home=put(referred.home, epoch.kind, home),
        )

    def _home(
        self, known: SlowError | None, referred: SlowError, epoch: PreciseEpoch
    ) -> SlowError | None:
        """Return what was known of a kind, if it agrees with what it is referred to now.

        If it does not, its integers are others than before.
        """
        if known is None:
            return None
        seconds = epoch.sample_index / self.sample_rate_hz
        covariance = known.covariance_at(seconds) + referred.covariance_at(seconds)
        away = referred.mean - known.mean
        return known if away @ np.linalg.solve(covariance, away) < HOME_GATE else None

    def _homewards(self, offsets: GnssOffsets, kind: str, sample_index: int) -> GnssOffsets:
        """Work off what a kind was referred by while it was not there."""
        home, here = offsets.home[kind], offsets.precise[kind]
        seconds = sample_index / self.sample_rate_hz
        elapsed = (sample_index - offsets.used_at) / self.sample_rate_hz
        share = -float(np.expm1(-elapsed / self.config.rtk_return_s))
        known = home.covariance_at(seconds)
        mean = here.mean + share * (home.mean - here.mean)
        covariance = here.covariance + share * (known - here.covariance)
        return offsets.with_precise(kind, replace(here, mean=mean, covariance=covariance))

    def _refer(self, offsets: GnssOffsets, epoch: PreciseEpoch, off: FloatArray) -> GnssOffsets:
        """Take what a kind is off by from the filter's own position, and its uncertainty."""
        known = offsets.precise.get(epoch.kind) or precise_error(self.config, epoch.kind)
        seconds = epoch.sample_index / self.sample_rate_hz
        place = position_covariance_ecef(self.filter) + offsets.crept(seconds)
        place = place + epoch.noise_ecef
        return offsets.with_precise(
            epoch.kind,
            known.refer(seconds, off, place),
            refused=put(offsets.refused, epoch.kind, None),
            inherited=put(offsets.inherited, epoch.kind, None),
            home=put(offsets.home, epoch.kind, None),
        )

    def _antenna_at(self, row: int, sample_index: int) -> FloatArray:
        moved, _ = self._change_after(row, sample_index)
        return antenna_ecef(self.filter.nav, self.lever_arm_b) + moved

    def _change_after(self, row: int, sample_index: int) -> tuple[FloatArray, FloatArray]:
        return change_after(self.filter, self.history, row, sample_index, self.sample_rate_hz)
