"""Fusion of IMU and GNSS, span by span: the inertial solution and the aiding of the loops.

Time is the sample index; nothing depends on when something arrives. A measurement of time t acts
at the start of the first span at or after t + D, so that the aiding of a span depends on

- IMU data up to its end, the sample that ends exactly there included;
- decisions on motion, and ephemerides, through its first sample;
- positions up to D before its first sample.

The filter stands where measurements have been worked in (`delayed_filter`); the present is
reached from there by mechanisation alone, anew for every span (`fusion_present`). In real time
what is late is not waited for: late IMU data are extrapolated, and everything that comes late is
worked in as soon as it is there, as if it had been there in time: from then on the fusion is
again exactly where it would have been.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from deepseis_core.errors import InputError
from deepseis_core.imu_grades import ImuGrade
from deepseis_core.miss_log import MissScript
from deepseis_core.types import (
    Aiding,
    Displacement,
    PrecisePosition,
    PreciseStatus,
    Pvt,
    PvtStatus,
    Station,
)
from deepseis_ins.aiding import DopplerPredictor, KnotGrid
from deepseis_ins.alignment import still_mean
from deepseis_ins.antenna_motion import KnotInterpolator
from deepseis_ins.delayed_filter import DelayedFilter
from deepseis_ins.filter_steps import GnssUpdate
from deepseis_ins.fusion_config import FusionConfig
from deepseis_ins.fusion_inputs import FusionInputs
from deepseis_ins.fusion_output import FusionOutput, FusionStatus, SolutionWriter, no_aiding
from deepseis_ins.fusion_present import Present
from deepseis_ins.fusion_start import Site, start_filter, start_moving
from deepseis_ins.fusion_time import Timebase
from deepseis_ins.gnss_epochs import PreciseEpoch, has_velocity
from deepseis_ins.ground_motion import GroundMotion, PreciseMotion
from deepseis_ins.imu_history import RowFlag
from deepseis_ins.loose import LooseConfig, LooseFilter
from deepseis_ins.oscillator_terms import OscillatorTerms
from deepseis_ins.satellite_book import Chosen

SOURCE = "fusion"
LATE_S = 1.0
"""After a gap: loops that could not do without aiding for so long have slipped [s]."""
LOST_S = 30.0
"""IMU data missing for so long: the station starts anew."""


class FusionEngine(FusionInputs):
    """Gives solution and aiding of successive 20 ms spans.

    Parameters
    ----------
    config : FusionConfig
    grade : ImuGrade
    sample_rate_hz : float
        Of the IF samples [Hz].
    station : Station
        Monument, lever arms, orientation.
    imu_rate_hz : float
        [Hz]
    loose : LooseConfig, optional
        Settings of the filter.
    script : MissScript, optional
        What the run that is replayed did not wait for.

    Attributes
    ----------
    next_sample : int
        First sample of the next span.
    trouble : str
        Why the last attempt to start failed; empty if it did not.

    Raises
    ------
    InputError
        Settings, grade or station make no sense.
    """

    def __init__(
        self,
        config: FusionConfig,
        grade: ImuGrade,
        sample_rate_hz: float,
        station: Station,
        imu_rate_hz: float,
        *,
        loose: LooseConfig | None = None,
        script: MissScript | None = None,
    ) -> None:
        if not grade.has_gyros:
            raise InputError("fusion", "needs gyroscopes, this grade of IMU has none")
        if 0.0 < config.smoothing_lag_s <= config.undo_s:
            reason = f"is {config.smoothing_lag_s:g} s, and {config.undo_s:g} s can be undone"
            hint = "more than undo_s, which may be shorter, or 0"
            raise InputError("smoothing_lag_s", reason, hint)
        super().__init__(config, grade, sample_rate_hz, imu_rate_hz, script)
        self.config, self.grade = config, grade
        self.loose, self.site = loose or LooseConfig(), Site.of(station)
        self.interpolator = KnotInterpolator(sample_rate_hz)
        self.writer = SolutionWriter(self.site.monument_ecef, self.site.C_enu_e, self.interpolator)
        self.ground = GroundMotion(grade, self.history.dt, self.interpolator)
        self._gnss_motion: list[Displacement] = []
        self._precise_motion = PreciseMotion()
        self.oscillator: OscillatorTerms | None = None
        if config.oscillator_on_body:
            self.oscillator = OscillatorTerms(config, sample_rate_hz)
        self.delayed: DelayedFilter | None = None
        self.timebase = Timebase(SOURCE, sample_rate_hz)
        self._reported = -1
        self._recovering, self._lost_at = False, -1
        self._joined = False
        self._latest: Pvt | None = None
        self.trouble = ""
        self._counts = dict.fromkeys(
            ("spans", "invalid", "late_imu", "late_motion", "late_pvt", "extrapolated",
             "starts", "corrected_surveys", "restarts"), 0,
        )  # fmt: skip
        self._worked: dict[str, int] = {}

    # Out

    @property
    def valid_through(self) -> int:
        """Last sample that has been given."""
        return self.next_sample - 1

    @property
    def statistics(self) -> dict[str, int]:
        """Counts since the start, for diagnostics."""
        clock = {"clock_jumps": self.timebase.jumps}
        parts: list[Mapping[str, int]] = [
            self._counts, clock, self.history.counts, self._worked,
        ]  # fmt: skip
        if self.delayed is not None:
            parts.append(self.delayed.counts)
        keys = [key for part in parts for key in part]
        return {key: sum(part.get(key, 0) for part in parts) for key in dict.fromkeys(keys)}

    def advance(self, force: bool = False) -> FusionOutput | None:
        """Return what holds for the next span, or None if it is not due.

        Parameters
        ----------
        force : bool, optional
            Do not wait for what is late (a deadline in real time). Samples that the source has
            not announced are waited for all the same.
        """
        lacking = self.lacking()
        if "samples" in lacking or (lacking and not force):
            return None
        begin, end = self.next_sample, self.next_sample + self.block
        self.miss()
        for what in self.missed:
            self._counts[f"late_{what}"] += 1
        self._take(begin, end)
        self.history.fill(end)
        updates = self._work(begin - self.delay)
        output = self._produce(begin, end, updates)
        self._counts["spans"] += 1
        self._counts["invalid"] += not output.aiding.valid
        self._forget()
        self.next_sample = end
        return output

    def join(self, sample: int) -> None:
        """Begin at a sample of a running graph, whose station may be moving.

        With a surveyed attitude the filter starts at once, from the survey and the velocity of
        GNSS; without one the station has to stand still first, as at every start.
        """
        self.begin_at(sample)
        self._joined = self.site.C_nb is not None

    # Inputs in order

    def _take(self, begin: int, end: int) -> None:
        """Let everything count that does so by now; undo what turns out to have been wrong."""
        changed_row = self.history.take(self.known("imu", end))
        changed = self.take_motion(begin)
        if self.delayed is not None:
            if changed_row is not None and changed_row <= self.delayed.row:
                self.delayed.rewind(self.history.sample_index(changed_row))
            if changed is not None:
                self.delayed.rewind(changed)
        horizon = self.known("pvt", begin - self.delay)
        for pvt in self.due_pvts(horizon):
            self._take_pvt(pvt)
        for position in self.due_precise(horizon):
            self._take_precise(position)
        for position in self.due_rtk(horizon):
            self._take_rtk(position)

    def _take_pvt(self, pvt: Pvt) -> None:
        if pvt.status == PvtStatus.NONE:
            return
        self.timebase.take(pvt)
        self._latest = pvt
        if self.delayed is not None:
            self.delayed.push(pvt)

    def _take_precise(self, position: PrecisePosition) -> None:
        through = self.next_sample + self.block - 1
        self._gnss_motion += self._precise_motion.take(position, through)
        epoch = PreciseEpoch.of(position, self.site.antenna_ecef, self.site.C_enu_e)
        if epoch is None:
            return
        if self.config.precise and self.delayed is not None:
            self.delayed.push_precise(epoch)

    def _take_rtk(self, position: PrecisePosition) -> None:
        """Take a position against a base, if its integers are known and the base is not old."""
        fixed = position.status == PreciseStatus.FIX
        if not (fixed and position.base_age <= self.config.rtk_base_age_s):
            return
        epoch = PreciseEpoch.of(position, self.site.antenna_ecef, self.site.C_enu_e)
        if epoch is not None and self.config.rtk and self.delayed is not None:
            self.delayed.push_rtk(epoch)

    def _work(self, horizon: int) -> list[GnssUpdate]:
        """Bring the filter to D before the span; start it if the station has stood still."""
        if self._imu_lost():
            self._restart()
        elif self.delayed is None and self._joined:
            self._start_joined()
        elif self.delayed is None:
            self._start(horizon)
        if self.delayed is None:
            return []
        # What is done again has been reported already.
        updates = [u for u in self.delayed.work(horizon) if u.sample_index > self._reported]
        self._reported = max(self._reported, *(u.sample_index for u in updates), -1)
        return updates

    def _start(self, horizon: int) -> None:
        history, count = self.history, round(self.config.alignment_s / self.history.dt)
        row = history.number_at(horizon)
        rows = row + 1 - count, row + 1
        if not (self.timeline.is_still(horizon) and history.is_whole(*rows)):
            return
        still = still_mean(*history.increments(*rows), history.dt)
        try:
            filter, corrected = start_filter(
                self.config, self.loose, self.grade, self.site, still, self._make_filter
            )
        except InputError as error:
            self.trouble = str(error)
            return
        self._counts["corrected_surveys"] += corrected
        self._begin(filter, row)

    def _start_joined(self) -> None:
        """Start from the latest epoch of GNSS."""
        history, pvt = self.history, self._latest
        row = history.number_at(pvt.sample_index) if pvt is not None else -1
        if pvt is None or not has_velocity(pvt) or not history.is_whole(row, row + 1):
            return
        rate_b = history.increments(row, row + 1)[0][0] / history.dt
        filter = start_moving(
            self.config, self.loose, self.grade, self.site, pvt, rate_b, self._make_filter
        )
        self._begin(filter, row)

    def _begin(self, filter: LooseFilter, row: int) -> None:
        self.trouble = ""
        self._counts["starts"] += 1
        self.ground.origin_enu = self.writer.enu(filter.nav)
        self.delayed = self._make_delayed(filter, row)

    def _make_filter(self, *arguments: Any, **keywords: Any) -> LooseFilter:
        """Make the filter of this mode from a loose one's arguments."""
        return LooseFilter(*arguments, **keywords)

    def _make_delayed(self, filter: LooseFilter, row: int) -> DelayedFilter:
        """Put a filter behind the present."""
        return DelayedFilter(
            self.config, filter, row, self.history, self.timeline, self.site.lever_arm_b,
            self.sample_rate_hz, self.oscillator,
        )  # fmt: skip

    def _imu_lost(self) -> bool:
        count = round(LOST_S / self.history.dt)
        rows = self.history.end - count, self.history.end
        return self.history.count(*rows, RowFlag.MISSING) >= count

    def _restart(self) -> None:
        """Forget where everything is: after so long without IMU data nobody knows."""
        counts = self.delayed.counts if self.delayed is not None else {}
        for key, value in counts.items():
            self._worked[key] = self._worked.get(key, 0) + value
        self.delayed = None
        self.history.restart()
        self._recovering = False
        self._counts["restarts"] += 1

    def _forget(self) -> None:
        kept = self.config.undo_s + self.config.alignment_s + 1.0
        begin = self.next_sample - self.delay - round(kept * self.sample_rate_hz)
        self.timeline.forget(begin)
        oldest = self.history.number_at(begin)
        if self.delayed is not None:
            oldest = min(oldest, self.delayed.oldest_row - 1)
        self.history.forget(oldest)

    # Outputs

    def _produce(self, begin: int, end: int, updates: list[GnssUpdate]) -> FusionOutput:
        grid = KnotGrid.of_span(begin, end - begin, self.sample_rate_hz)
        late, delayed, predictor = " ".join(self.missed), self.delayed, self.timebase.predictor
        motion, self._gnss_motion = tuple(self._gnss_motion), []
        if delayed is None or predictor is None:
            status = FusionStatus.ALIGNING if delayed is None else FusionStatus.NO_TIME
            solution = self.writer.empty(end - 1)
            nothing = no_aiding(SOURCE, grid)
            return FusionOutput(solution, nothing, status, late, motion=motion)
        present = Present.of(delayed, self.history.number_at(end), self.site.monument_ecef)
        told = self.known("pvt", begin - self.delay) + self.delay
        chosen = self.book.choose(begin, predictor.gps_time(begin), self.site.monument_ecef, told)
        first, last = (self.history.number_at(sample) + 1 for sample in (begin, end))
        lost = self.history.count(first, last, RowFlag.MISSING) > 0
        at_the_end = RowFlag.MISSING | RowFlag.HELD
        extrapolated = self.history.count(first, last, at_the_end) if "imu" in self.missed else 0
        self._counts["extrapolated"] += extrapolated
        status = self._status(present, chosen, lost=lost)
        solution = self.writer.write((begin, end), self.timebase, present, updates)
        if status is FusionStatus.RUNNING:
            aiding = self._aiding(grid, present, chosen, predictor)
        else:
            aiding = no_aiding(SOURCE, grid)
        fused = self.ground.fused(solution, present)
        motion += () if fused is None else (fused,)
        if delayed.smoother is not None:
            motion += self.ground.late(
                delayed.smoother.take(), self.timebase, self.writer, end - 1
            )
        return FusionOutput(solution, aiding, status, late, extrapolated, motion)

    def _status(self, present: Present, chosen: Chosen, *, lost: bool) -> FusionStatus:
        """Return what the fusion does; ``lost``: more of the IMU is missing than is bridged."""
        self._recovering |= lost
        if lost:
            self._lost_at = self.next_sample
            return FusionStatus.IMU_LOST
        sd = present.velocity_sd()
        late = self.next_sample - self._lost_at > LATE_S * self.sample_rate_hz
        enough = self.config.regained_late_sd if late else self.config.regained_sd
        if self._recovering and sd > enough:
            return FusionStatus.RECOVERING
        self._recovering = False
        if sd > self.config.greatest_sd:
            return FusionStatus.UNCERTAIN
        return FusionStatus.RUNNING if chosen.names else FusionStatus.NO_SATELLITES

    def _aiding(
        self, grid: KnotGrid, present: Present, chosen: Chosen, predictor: DopplerPredictor
    ) -> Aiding:
        antenna = self.interpolator.antenna(present.nodes, grid.samples)
        aiding = predictor.predict(
            grid,
            antenna,
            chosen.names,
            chosen.packed,
            doppler_sd_hz=present.doppler_sd_hz(chosen.unit),
        )
        if self.oscillator is None:
            return aiding
        samples, points = present.nodes.sample_index, self.interpolator.lever_points
        weights = self.interpolator.weights(samples, grid.samples, points)
        doppler, rate = self.oscillator.doppler(weights, present.gained_b)
        return replace(
            aiding,
            carrier_doppler_hz=aiding.carrier_doppler_hz + doppler,
            carrier_doppler_rate=aiding.carrier_doppler_rate + rate,
        )
