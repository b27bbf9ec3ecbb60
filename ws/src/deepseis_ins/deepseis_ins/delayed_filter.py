"""The filter behind the present: it works through what is measured, and can go back.

It stands D behind the present, where everything measured is known, and does its work in steps at
regular samples and at the epochs of GNSS, in order:

- at rest: zero velocity, zero turn and zero displacement since the rest began. GNSS is not used
  but compared with what is known: its slow errors are learnt (`gnss_offset`);
- moving, or not known to be at rest: GNSS without its slow errors, positions against a base where
  there are any, else precise ones of the station alone, else those of PVT (`gnss_updates`).

Its positions are relative to the place where it rested last, to which the slow errors are
compared; how uncertain that place is, is kept beside the filter and added for those who ask.

A snapshot is kept of every step. What turns out to have been wrong, because the motion began
earlier than noticed or because something came late, is undone: back to the snapshot before it and
all steps again, as if it had been known at once.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from deepseis_core.geodesy import rotation_ned_ecef
from deepseis_core.hidden_motion import LEAST_HIDDEN, doubtful, hidden_motion
from deepseis_core.types import FloatArray, Pvt
from deepseis_ins import measurements
from deepseis_ins.error_state import POS
from deepseis_ins.filter_steps import (
    POSITION,
    PRECISE,
    REGULAR,
    RTK,
    GnssUpdate,
    Rest,
    Step,
    antenna_ecef,
)
from deepseis_ins.fusion_config import FusionConfig
from deepseis_ins.fusion_smoother import Carried, FusionSmoother
from deepseis_ins.gnss_epochs import Epoch, PreciseEpoch, has_position
from deepseis_ins.gnss_offset import GnssOffsets
from deepseis_ins.gnss_updates import GnssUpdates
from deepseis_ins.imu_history import NOTHING, ImuHistory
from deepseis_ins.loose import LooseFilter
from deepseis_ins.motion_timeline import MotionTimeline
from deepseis_ins.oscillator_terms import OscillatorTerms
from deepseis_ins.strapdown import NavState, Trajectory

SAME_MOMENT_S: Final = 1e-9
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

    holds_angle = True
    """Whether zero turn is a constraint at rest."""
    holds_place = True
    """Whether zero displacement is one, and the place of a rest that of the filter's positions."""

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
        self.offsets = GnssOffsets.at_start(config)
        self.place_n: FloatArray | None = None
        self._survey_n = config.monument_sd**2 * np.eye(3)
        self.gnss = GnssUpdates(config, filter, history, lever_arm_b, sample_rate_hz)
        self._counts = dict.fromkeys(("constraints", "undone", "too_old", "doubted"), 0)
        self._interval = sample_rate_hz / config.filter_rate_hz
        self._undoable = round(config.undo_s * sample_rate_hz)
        self._pvts: list[Pvt] = []
        self._precise: list[PreciseEpoch] = []
        self._rtk: list[PreciseEpoch] = []
        self.smoother: FusionSmoother | None = None
        if config.smoothing_lag_s > 0.0:
            self.smoother = FusionSmoother(config.smoothing_lag_s, history.dt)
        self._carried: list[Trajectory] = []
        start = history.sample_index(row)
        self._steps = [self._snapshot(start, POSITION)]

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

    @property
    def counts(self) -> dict[str, int]:
        """Counts since the start, for diagnostics."""
        return self._counts | self.gnss.counts

    def covariances(self) -> tuple[FloatArray, FloatArray]:
        """Return those of the 15 errors, the survey's included, and of the displacement, NED."""
        P = self.filter.P
        P[POS, POS] += self.beside()
        moved = P[POS, POS].copy()
        P[POS, POS] += self._survey_n
        return P, moved

    def beside(self) -> FloatArray:
        """Return what adds to the filter's covariance of displacements, NED, (3, 3) [m^2].

        These are from where the station was surveyed to stand, whose own error counts not.
        """
        place = np.zeros((3, 3)) if self.place_n is None else self.place_n
        if not self.offsets.kind:
            return place.copy()
        seconds = self.history.sample_index(self.row) / self.sample_rate_hz
        C_ne = rotation_ned_ecef(self.nav.latitude, self.nav.longitude)
        return place + C_ne @ self.offsets.crept(seconds) @ C_ne.T

    def antenna_ecef(self) -> FloatArray:
        """Return where the antenna is [m]."""
        return antenna_ecef(self.nav, self.lever_arm_b)

    # Work

    def push(self, pvt: Pvt) -> None:
        """Take a position of PVT that counts from now on."""
        if has_position(pvt):
            self._push(self._pvts, pvt, POSITION)

    def push_precise(self, epoch: PreciseEpoch) -> None:
        """Take a precise position that counts from now on."""
        self._push(self._precise, epoch, PRECISE)

    def push_rtk(self, epoch: PreciseEpoch) -> None:
        """Take a position against a base that counts from now on."""
        self._push(self._rtk, epoch, RTK)

    def _push(self, epochs: list[Any], epoch: Any, kind: int) -> None:
        first = self._steps[0]
        if (epoch.sample_index, kind) <= (first.sample_index, first.kind):
            self._counts["too_old"] += 1
            return
        insort(epochs, epoch, key=_sample_index)
        if (epoch.sample_index, kind) <= self.done:
            self.rewind(epoch.sample_index)

    def rewind(self, sample_index: int) -> None:
        """Undo all steps at or after a sample; `work` does them again."""
        if self._steps[-1].sample_index < sample_index:
            return
        self._counts["undone"] += 1
        if self._steps[0].sample_index >= sample_index and len(self._steps) > 1:
            self._counts["too_old"] += 1
        while len(self._steps) > 1 and self._steps[-1].sample_index >= sample_index:
            del self._steps[-1]
        step = self._steps[-1]
        if self.smoother is not None:
            self.smoother.rewind(self._moment(step.sample_index, step.kind) + SAME_MOMENT_S)
        self.filter.restore(step.filter)
        self.row, self.rest = step.row, step.rest
        self.offsets, self.place_n = step.offsets, step.place_n
        self._put_back(step.more)
        if self.oscillator is not None and step.oscillator is not None:
            self.oscillator.state = step.oscillator

    def work(self, horizon: int) -> list[GnssUpdate]:
        """Do all steps up to a sample; return what was done with GNSS."""
        updates = []
        while (due := self._next(horizon)) is not None:
            sample, kind, epoch = due
            first = self.row + 1
            self._carry(self.history.number_at(sample))
            still = self._settle(sample)
            self._beside_gnss(still=still)
            if self.oscillator is not None and kind in (PRECISE, POSITION):
                self.oscillator.take(epoch, self.history, still=still)
            if epoch is not None:
                update = self._measured(epoch, still=still)
                updates += [] if update is None else [update]
            elif still:
                self._constrain()
            self._hand_over(first, sample, kind)
            self._steps.append(self._snapshot(sample, kind))
        self._forget(horizon)
        return updates

    def _next(self, horizon: int) -> tuple[int, int, Any] | None:
        """Return sample and kind of the next step, and its epoch of GNSS."""
        done = self.done
        number = int(done[0] / self._interval)
        while (regular := round(number * self._interval)) <= done[0]:
            number += 1
        key, found = (regular, REGULAR), None
        for kind, epochs in self._waiting():
            first = done[0] + (kind <= done[1])
            at = bisect_left(epochs, first, key=_sample_index)
            if at < len(epochs) and (epochs[at].sample_index, kind) < key:
                key, found = (epochs[at].sample_index, kind), epochs[at]
        return (*key, found) if key[0] <= horizon else None

    def _waiting(self) -> Sequence[tuple[int, list[Any]]]:
        """Return kinds of epochs, and those that have been pushed."""
        return (RTK, self._rtk), (PRECISE, self._precise), (POSITION, self._pvts)

    def _beside_gnss(self, *, still: bool) -> None:
        """Work in what a mode has beside GNSS and constraints; here nothing."""

    def _kept(self) -> Any:
        """Return what a mode has to keep of a step; here nothing."""

    def _put_back(self, kept: Any) -> None:
        """Be again what was kept."""

    def _carry(self, row: int) -> None:
        """Propagate to the end of a row."""
        if row <= self.row:
            return
        history = self.history
        begin, end = self.row + 1, row + 1
        angle, velocity = history.increments(begin, end)
        self._carried = [self.filter.propagate(angle, velocity, history.dt)]
        unknown = history.unknown(begin, end)
        if unknown is not NOTHING:
            self.filter.widen(
                position_sd=unknown.position**0.5,
                velocity_sd=unknown.velocity**0.5,
                attitude_sd=unknown.attitude**0.5,
                moved=unknown.moved,
            )
        self.row = row

    def _hand_over(self, first: int, sample_index: int, kind: int) -> None:
        """Give the smoother what came since the step before: rows from ``first``."""
        if self.smoother is None:
            return
        rows = np.arange(first, self.row + 1)
        index = np.array([self.history.sample_index(int(row)) for row in rows], np.int64)
        track = Carried(index, np.zeros((0, 3)), np.zeros((0, 3)))
        if len(rows):
            (got,) = self._carried
            track = Carried(index, got.geodetic, got.vel_n)
        moment = self._moment(sample_index, kind)
        self.smoother.push(moment, self.filter.take_steps(), track, self.beside())

    def _moment(self, sample_index: int, kind: int) -> float:
        """Return a step's time, later for later kinds of the same sample [s]."""
        return sample_index / self.sample_rate_hz + 10.0 * SAME_MOMENT_S * kind

    def _settle(self, sample_index: int) -> bool:
        """Begin or end a rest where it begins or ends; return whether the station is at rest."""
        still = self._is_still(sample_index)
        if still and self.rest is None:
            if self.place_n is None:
                self.place_n = np.zeros((3, 3))
            else:
                own = self.filter.P[POS, POS] if self.holds_place else 0.0
                self.place_n = self.beside() + own
            self.offsets = self.offsets.followed_none()
            self.rest = Rest(self.antenna_ecef(), self._refer(), sample_index)
        elif not still and self.rest is not None:
            self._leave(self.rest, sample_index)
        return still

    def _leave(self, rest: Rest, sample_index: int) -> None:
        """End a rest; if that was noticed late, its last seconds may have been of the motion."""
        rate = self.sample_rate_hz
        # From its beginning, which may be longer ago than steps can be undone.
        late = self.timeline.lateness(sample_index) / rate
        far, fast = hidden_motion(self.filter.grade.accelerometers.walk, late)
        self.rest = None
        if far < LEAST_HIDDEN:
            return
        back = doubtful(self.config.doubt_s, (sample_index - rest.begun) / rate)
        self.offsets = self.offsets.doubted(rest.known_before(sample_index - round(back * rate)))
        self.filter.widen(position_sd=far, velocity_sd=fast)
        self._counts["doubted"] += 1

    def _is_still(self, sample_index: int) -> bool:
        return self.timeline.is_still(sample_index)

    def _refer(self) -> FloatArray:
        """Return the attitude that a rest begins with; zero turn refers to it."""
        return self.filter.refer_attitude()

    def _constrain(self) -> None:
        assert self.rest is not None
        config, rest, nav = self.config, self.rest, self.filter.nav
        update = self.gnss.update
        update(measurements.zero_velocity(nav, config.still_velocity_sd))
        if self.holds_angle:
            angle_sd = np.radians(config.still_angle_sd_deg)
            update(measurements.zero_angle(self.filter.nav, rest.C_nb, angle_sd))
        if self.holds_place:
            at, place = rest.antenna_ecef, config.still_position_sd**2 * np.eye(3)
            update(measurements.gnss_position(self.filter.nav, at, place, self.lever_arm_b))
        self._counts["constraints"] += 1

    def _measured(self, epoch: Epoch, *, still: bool) -> GnssUpdate | None:
        """Learn from an epoch of GNSS at rest, or use it."""
        gnss, offsets = self.gnss, self.offsets
        alone = self._precise if isinstance(epoch, PreciseEpoch) else self._pvts
        against_base = isinstance(epoch, PreciseEpoch) and epoch.against_base
        dt = self._interval_before(self._rtk if against_base else alone, epoch)
        if still:
            assert self.rest is not None
            place = self.rest.antenna_ecef
            if isinstance(epoch, PreciseEpoch):
                self.offsets = gnss.learn_precise(offsets, epoch, place, dt)
            else:
                self.offsets = gnss.learn(offsets, epoch, place, dt)
            self._remember(epoch.sample_index)
            return None
        if isinstance(epoch, PreciseEpoch):
            if not against_base and self._takes_to_rest(epoch):
                return None
            if not against_base and gnss.follows_rtk(offsets, epoch.sample_index):
                self.offsets = gnss.compare(offsets, epoch, self.row, dt)
                return None
            used = gnss.use_precise(offsets, epoch, self.row, dt)
        else:
            used = gnss.use(offsets, epoch, self.row, dt)
        self.offsets = used.offsets
        return used.update

    def _takes_to_rest(self, epoch: PreciseEpoch) -> bool:
        """Return whether a position is from before motion was noticed: biases took it along."""
        return epoch.sample_index <= self.timeline.noticed(epoch.sample_index)

    def _remember(self, sample_index: int) -> None:
        """Keep what is known of slow errors, once a second of a rest."""
        assert self.rest is not None
        second, reach = self.sample_rate_hz, self.config.doubt_s * self.sample_rate_hz
        self.rest = self.rest.with_learnt(sample_index, self.offsets, round(second), round(reach))

    def _interval_before(self, epochs: Sequence[Any], epoch: Any) -> float:
        """Return the time since the epoch of its kind before one [s]."""
        before = bisect_left(epochs, epoch.sample_index, key=_sample_index)
        if not before:
            return FIRST_INTERVAL_S
        return (epoch.sample_index - epochs[before - 1].sample_index) / self.sample_rate_hz

    def _snapshot(self, sample_index: int, kind: int) -> Step:
        return Step(
            sample_index,
            kind,
            self.row,
            self.filter.snapshot(),
            self.rest,
            self.offsets,
            self.place_n,
            self.oscillator.state if self.oscillator is not None else None,
            self._kept(),
        )

    def _forget(self, horizon: int) -> None:
        """Drop what is too old to be undone."""
        oldest = horizon - self._undoable
        while len(self._steps) > 1 and self._steps[1].sample_index < oldest:
            del self._steps[0]
        first = self._steps[0].sample_index
        for _, epochs in self._waiting():
            old = bisect_left(epochs, first, key=_sample_index) - 1
            if old > 0:
                del epochs[:old]


def _sample_index(item: Any) -> int:
    return int(item.sample_index)
