"""The filter behind the present: it works through what is measured, and can go back.

It stands D behind the present, where everything measured is known, and does its work in steps at
regular samples and at the epochs of GNSS, in order:

- at rest: zero velocity, zero turn and zero displacement since the rest began. GNSS is not used
  but compared with what is known: its slow errors are learnt (`gnss_offset`);
- moving, or not known to be at rest: GNSS without its slow errors.

A snapshot is kept of every step. What turns out to have been wrong, because the motion began
earlier than noticed or because something came late, is undone: back to the snapshot before it and
all steps again, as if it had been known at once.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from dataclasses import replace
from typing import Final

import numpy as np

from deepseis_core.geodesy import ecef_from_geodetic, rotation_ned_ecef
from deepseis_core.rotation import quat_rotate
from deepseis_core.types import FloatArray, Pvt
from deepseis_ins import measurements
from deepseis_ins.error_state import POS
from deepseis_ins.filter_steps import (
    GnssUpdate,
    Rest,
    Step,
    change_after,
    has_position,
    has_velocity,
)
from deepseis_ins.fusion_config import FusionConfig
from deepseis_ins.gnss_offset import position_error, velocity_error
from deepseis_ins.imu_history import ImuHistory
from deepseis_ins.loose import Innovation, LooseFilter
from deepseis_ins.motion_timeline import MotionTimeline
from deepseis_ins.oscillator_terms import OscillatorTerms
from deepseis_ins.strapdown import NavState

FIRST_INTERVAL_S: Final = 0.1
"""Before the first epoch of GNSS, as if there were one before [s]."""


class DelayedFilter:
    """Works through steps, forward and again.

    Parameters
    ----------
    config : FusionConfig
    filter : LooseFilter
        At the end of row ``row``.
    row : int
    history : ImuHistory
    timeline : MotionTimeline
    lever_arm_b : ndarray, shape (3,)
        From IMU to antenna, forward-right-down [m].
    sample_rate_hz : float
    oscillator : OscillatorTerms, optional
        What it is to estimate of the receiver's oscillator.

    Attributes
    ----------
    row : int
        Row of increments at whose end the filter stands.
    """

    def __init__(
        self,
        config: FusionConfig,
        filter: LooseFilter,
        row: int,
        history: ImuHistory,
        timeline: MotionTimeline,
        lever_arm_b: FloatArray,
        sample_rate_hz: float,
        oscillator: OscillatorTerms | None = None,
    ) -> None:
        self.config, self.filter, self.row = config, filter, row
        self.oscillator = oscillator
        self.history, self.timeline = history, timeline
        self.lever_arm_b, self.sample_rate_hz = lever_arm_b, sample_rate_hz
        self.rest: Rest | None = None
        self.position, self.velocity = position_error(config), velocity_error(config)
        self.counts = dict.fromkeys(
            ("updates", "rejected", "recovered", "constraints", "undone", "too_old"), 0
        )
        self._interval = sample_rate_hz / config.filter_rate_hz
        self._kept = round(config.undo_s * sample_rate_hz)
        self._pvts: list[Pvt] = []
        start = history.sample_index(row)
        self._steps = [self._snapshot(start, 1)]

    # What others need

    @property
    def nav(self) -> NavState:
        """Where the filter stands."""
        return self.filter.nav

    @property
    def done(self) -> tuple[int, int]:
        """Sample and kind of the last step."""
        return self._steps[-1].sample_index, self._steps[-1].kind

    @property
    def oldest_row(self) -> int:
        """Row to which it can still go back."""
        return self._steps[0].row

    def covariance(self) -> FloatArray:
        """Return the covariance of the 15 errors, that of a place held at rest included."""
        P = self.filter.P
        if self.rest is not None:
            P[POS, POS] += self.rest.covariance_n
        return P

    def antenna_ecef(self) -> FloatArray:
        """Return where the antenna is [m]."""
        nav = self.filter.nav
        lever_n = quat_rotate(nav.quat_nb, self.lever_arm_b)
        C_ne = rotation_ned_ecef(nav.latitude, nav.longitude)
        return ecef_from_geodetic([nav.latitude, nav.longitude, nav.height]) + lever_n @ C_ne

    # Work

    def push(self, pvt: Pvt) -> None:
        """Take an epoch of GNSS that counts from now on."""
        if not has_position(pvt):
            return
        first = self._steps[0]
        if (pvt.sample_index, 1) <= (first.sample_index, first.kind):
            self.counts["too_old"] += 1
            return
        insort(self._pvts, pvt, key=lambda item: item.sample_index)
        if (pvt.sample_index, 1) <= self.done:
            self.rewind(pvt.sample_index)

    def rewind(self, sample_index: int) -> None:
        """Undo all steps at or after a sample; `work` does them again."""
        if self._steps[-1].sample_index < sample_index:
            return
        self.counts["undone"] += 1
        if self._steps[0].sample_index >= sample_index and len(self._steps) > 1:
            self.counts["too_old"] += 1
        while len(self._steps) > 1 and self._steps[-1].sample_index >= sample_index:
            del self._steps[-1]
        step = self._steps[-1]
        self.filter.restore(step.filter)
        self.row, self.rest = step.row, step.rest
        self.position, self.velocity = step.position, step.velocity
        if self.oscillator is not None and step.oscillator is not None:
            self.oscillator.state = step.oscillator

    def work(self, horizon: int) -> list[GnssUpdate]:
        """Do all steps up to a sample; return what was done with GNSS."""
        updates = []
        while (due := self._next(horizon)) is not None:
            sample, pvt = due
            self._carry(self.history.number_at(sample))
            still = self._settle(sample)
            if pvt is not None and self.oscillator is not None:
                self.oscillator.take(pvt, self.history, self.sample_rate_hz, still=still)
            if pvt is None:
                if still:
                    self._constrain()
            elif still:
                self._learn(pvt)
            else:
                updates.append(self._use(pvt))
            self._steps.append(self._snapshot(sample, int(pvt is not None)))
        self._forget(horizon)
        return updates

    def _next(self, horizon: int) -> tuple[int, Pvt | None] | None:
        """Return sample of the next step, and its epoch of GNSS."""
        done = self.done
        number = int(done[0] / self._interval)
        while (regular := round(number * self._interval)) <= done[0]:
            number += 1
        key, pvt = (regular, 0), None
        for item in self._pvts:
            if (item.sample_index, 1) > done:
                if (item.sample_index, 1) < key:
                    key, pvt = (item.sample_index, 1), item
                break
        return (key[0], pvt) if key[0] <= horizon else None

    def _carry(self, row: int) -> None:
        """Propagate to the end of a row."""
        if row <= self.row:
            return
        history = self.history
        begin, end = self.row + 1, row + 1
        angle, velocity = history.increments(begin, end)
        self.filter.propagate(angle, velocity, history.dt)
        walk2, turn2 = history.unknown(begin, end)
        if walk2 or turn2:
            self.filter.widen(velocity_sd=walk2**0.5, attitude_sd=turn2**0.5)
        self.row = row

    def _settle(self, sample_index: int) -> bool:
        """Begin or end a rest where it begins or ends; return whether the station is at rest."""
        still = self.timeline.is_still(sample_index)
        if still and self.rest is None:
            covariance = self.filter.P[POS, POS].copy()
            self.rest = Rest(self.antenna_ecef(), self.filter.refer_attitude(), covariance)
        elif not still and self.rest is not None:
            nav = self.filter.nav
            C_ne = rotation_ned_ecef(nav.latitude, nav.longitude)
            place = C_ne.T @ self.rest.covariance_n @ C_ne
            # What was learnt at a place is as uncertain as the place.
            learnt = self.position.covariance + place
            self.position = replace(self.position, covariance=learnt)
            self.filter.widen(position_sd=self.rest.covariance_n)
            self.rest = None
        return still

    def _constrain(self) -> None:
        assert self.rest is not None
        config, rest, nav = self.config, self.rest, self.filter.nav
        place = config.still_position_sd**2 * np.eye(3)
        angle_sd = np.radians(config.still_angle_sd_deg)
        self._update(measurements.zero_velocity(nav, config.still_velocity_sd))
        self._update(measurements.zero_angle(self.filter.nav, rest.C_nb, angle_sd))
        self._update(
            measurements.gnss_position(self.filter.nav, rest.antenna_ecef, place, self.lever_arm_b)
        )
        self.counts["constraints"] += 1

    def _learn(self, pvt: Pvt) -> None:
        assert self.rest is not None
        seconds, dt = self._epoch(pvt)
        self.position = self.position.learn(
            seconds, pvt.position_ecef, self.rest.antenna_ecef, pvt.position_covariance_ecef, dt
        )
        if has_velocity(pvt):
            self.velocity = self.velocity.learn(
                seconds, pvt.velocity_ecef, np.zeros(3), pvt.velocity_covariance_ecef, dt
            )

    def _use(self, pvt: Pvt) -> GnssUpdate:
        seconds, dt = self._epoch(pvt)
        moved, gained = change_after(
            self.filter, self.history, self.row, pvt.sample_index, self.sample_rate_hz
        )
        fix = self.position.correct(
            seconds, pvt.position_ecef - moved, pvt.position_covariance_ecef, dt
        )
        measurement = measurements.gnss_position(
            self.filter.nav, fix.value, fix.covariance, self.lever_arm_b
        )
        position, velocity = self._update(measurement), None
        if has_velocity(pvt):
            fix = self.velocity.correct(
                seconds, pvt.velocity_ecef - gained, pvt.velocity_covariance_ecef, dt
            )
            measurement = measurements.gnss_velocity(
                self.filter.nav,
                self.filter.omega_ib_b,
                fix.value,
                fix.covariance,
                self.lever_arm_b,
            )
            velocity = self._update(measurement)
        self.counts["updates"] += 1
        return GnssUpdate(pvt.sample_index, (position, velocity))

    def _update(self, measurement: measurements.Measurement) -> Innovation:
        innovation = self.filter.update(measurement)
        self.counts["rejected"] += not innovation.accepted
        self.counts["recovered"] += innovation.recovered
        return innovation

    def _epoch(self, pvt: Pvt) -> tuple[float, float]:
        """Return an epoch's time and the time since the one before [s]."""
        before = bisect_left(self._pvts, pvt.sample_index, key=lambda item: item.sample_index)
        seconds, interval = pvt.sample_index / self.sample_rate_hz, FIRST_INTERVAL_S
        if before:
            interval = seconds - self._pvts[before - 1].sample_index / self.sample_rate_hz
        return seconds, interval

    def _snapshot(self, sample_index: int, kind: int) -> Step:
        return Step(
            sample_index,
            kind,
            self.row,
            self.filter.snapshot(),
            self.rest,
            self.position,
            self.velocity,
            self.oscillator.state if self.oscillator is not None else None,
        )

    def _forget(self, horizon: int) -> None:
        """Drop what is too old to be undone."""
        oldest = horizon - self._kept
        while len(self._steps) > 1 and self._steps[1].sample_index < oldest:
            del self._steps[0]
        first = self._steps[0].sample_index
        while len(self._pvts) > 1 and self._pvts[1].sample_index < first:
            del self._pvts[0]
