"""From integrations to observations and positions, in order of the sample index.

The engine looks for a first fix at regular samples, ties the sample counter to GPS time by a whole
number of nanoseconds, and then works through the epochs of the GPS-time grid, each as soon as the
watermarks of all satellites allow. Nothing depends on the order in which messages arrive.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from deepseis_core.config import setting
from deepseis_core.constants import NS_PER_S, SPEED_OF_LIGHT
from deepseis_core.ephemeris import states_from_pseudoranges
from deepseis_core.gps_time import GpsTime
from deepseis_core.loop_noise import lone_rate_sd
from deepseis_core.miss_log import EVER, MissScript
from deepseis_core.types import (
    Ephemeris,
    FloatArray,
    Observations,
    Pvt,
    PvtStatus,
    TrackingEpochs,
    TrackingFlag,
)
from deepseis_pvt.assisted_start import Assistance, predict_transmit_ms
from deepseis_pvt.ephemeris_book import EphemerisBook
from deepseis_pvt.first_fix import FirstFix
from deepseis_pvt.held_back import HeldBack
from deepseis_pvt.observables import (
    NS_PER_MS,
    GridClock,
    ObservablesBuilder,
    ObservablesConfig,
)
from deepseis_pvt.pvt_values import no_position, pvt_of
from deepseis_pvt.spp import SppConfig, SppSolver
from deepseis_pvt.track_store import TrackStore

COUNTED = (
    *("attempts", "epochs", "empty_epochs", "forced", "predicted_transmit_times"),
    *("positions", "no_position", "rejected", "inconsistent", "clock_jumps"),
)


@dataclass(frozen=True)
class PvtConfig:
    """Settings of the engine."""

    pvt_rate_hz: int = setting(10, "rate of positions, a divisor of rate_hz [Hz]", low=1, high=50)
    first_fix_step: float = setting(
        0.1, "time between attempts at the first fix [s]", low=0.001, high=10.0
    )
    max_first_gdop: float = setting(30.0, "GDOP of an acceptable first fix [-]", low=1.0)
    max_ephemeris_age: float = setting(
        7200.0, "greatest distance from toe [s]", low=60.0, high=604800.0
    )
    use_unhealthy: bool = setting(False, "use satellites that say they are unhealthy")
    predict_transmit_time: bool = setting(
        True, "after the first fix, range satellites whose own time is not decoded yet"
    )


class PvtEngine:
    """Works through tracking epochs; gives observations and positions.

    Parameters
    ----------
    config : PvtConfig
        Settings of the engine.
    sample_rate_hz : float
        Nominal IF rate [Hz].
    satellites : iterable of str
        All satellites of the graph; work waits for each of them.
    observables, spp : optional
        Settings of the parts.
    assistance : Assistance, optional
        Known position and coarse time, for a start before a subframe is decoded.
    script : MissScript, optional
        What the run that is replayed did not wait for.

    Attributes
    ----------
    clock : GridClock or None
        Receiver time of samples; None before the first fix.
    worked_through : int
        Last sample that epochs, or attempts at the first fix, have been worked through to.
    missed : dict of str to int
        What the last epoch was not kept waiting for (satellites, or what ``witnesses`` names), and
        through which sample it was there.
    witnesses : callable
        Tells what others than the trackers lack for an epoch at a sample, and how far it is there.
    """

    def __init__(
        self,
        config: PvtConfig,
        sample_rate_hz: float,
        satellites: Iterable[str],
        *,
        observables: ObservablesConfig | None = None,
        spp: SppConfig | None = None,
        assistance: Assistance | None = None,
        script: MissScript | None = None,
    ) -> None:
        self.config, self.sample_rate_hz = config, sample_rate_hz
        self.store = TrackStore(satellites)
        self.builder = ObservablesBuilder(
            observables or ObservablesConfig(), sample_rate_hz, self.store
        )
        if self.builder.config.rate_hz % config.pvt_rate_hz:
            raise ValueError(f"pvt_rate_hz = {config.pvt_rate_hz} is no divisor of rate_hz")
        self.book = EphemerisBook(config.max_ephemeris_age, config.use_unhealthy)
        self.solver = SppSolver(spp)
        self._first_fix = FirstFix(
            self.builder, self.book, self.solver, config.max_first_gdop, assistance
        )
        self.clock: GridClock | None = None
        self.worked_through = -1
        self.missed: dict[str, int] = {}
        self.witnesses: Callable[[int], dict[str, int]] = lambda _sample: {}
        self.script = script or MissScript()
        self._held = HeldBack(self.script, self.store)
        self._attempt = 0
        self._next_ns = 0
        self._state: FloatArray | None = None
        self._counts = dict.fromkeys(COUNTED, 0)

    @property
    def statistics(self) -> dict[str, int]:
        """Counts since the start, for diagnostics."""
        return {**self._counts, **self.builder.counts, **self.store.counts}

    @property
    def valid_through(self) -> int:
        """Last sample before the next epoch or attempt at the first fix: nothing more to come."""
        if self.clock is not None:
            return self.clock.sample_at(self._next_ns)[0] - 1
        return round(self._attempt * self.config.first_fix_step * self.sample_rate_hz) - 1

    def newest_sample(self) -> int:
        """Return the last sample of any satellite's integrations; promises do not count."""
        return max(int(self.store.end.max(initial=0)), self._held.end) - 1

    @staticmethod
    def utc_ns(observations: Observations) -> int:
        """Return the UTC of an epoch in Unix nanoseconds."""
        return GpsTime(observations.week, observations.tow_ns).to_utc_ns()

    def join(self, sample: int) -> None:
        """Begin with the first attempt after a sample of a running graph."""
        self._attempt = -(-sample // round(self.config.first_fix_step * self.sample_rate_hz))

    def push_epochs(self, epochs: TrackingEpochs) -> None:
        """Take the integrations of one satellite and IF block."""
        if self.script:
            self._held.push_epochs(epochs)
        else:
            self.store.push(epochs, self.worked_through)

    def push_ephemeris(self, ephemeris: Ephemeris) -> None:
        """Take an ephemeris a channel has decoded, or a preloaded one (effective from -1)."""
        if self.script and ephemeris.effective_sample_index >= 0:
            self._held.push_ephemeris(ephemeris)
        else:
            self._take_ephemeris(ephemeris)

    def _take_ephemeris(self, ephemeris: Ephemeris) -> None:
        if self.book.add(ephemeris) and ephemeris.effective_sample_index >= 0:
            self.store.received_ephemeris(ephemeris.satellite)

    def assist(self, assistance: Assistance | None) -> None:
        """Take what is known before the first fix, once coarse time is."""
        self._first_fix.assistance = assistance

    def push_klobuchar(self, alpha: Iterable[float], beta: Iterable[float]) -> None:
        """Take ionosphere parameters known from the start."""
        self.book.add_klobuchar(alpha, beta)

    def advance(self, force_through: int | None = None) -> list[tuple[Observations, Pvt | None]]:
        """Work through all epochs that the inputs allow.

        Parameters
        ----------
        force_through : int, optional
            Sample through which to work whatever is missing (a deadline in real time).

        Returns
        -------
        list of (Observations, Pvt or None)
            In order; a ``Pvt`` at its own rate, with status NONE where there is no position.
        """
        return [epoch for epoch in self.steps(force_through) if epoch is not None]

    def steps(
        self, force_through: int | None = None
    ) -> Iterator[tuple[Observations, Pvt | None] | None]:
        """Work as `advance` does, one step at a time; None is an attempt at the first fix."""
        while self.clock is None and self._try_first_fix(force_through):
            yield None
        while self.clock is not None:
            epoch = self._next_epoch(self.clock, force_through)
            if epoch is None:
                break
            yield epoch

    def late(self, sample_index: int) -> dict[str, int]:
        """Return what an epoch at a sample lacks, and through which sample that is there."""
        found = {} if self.builder.reached(sample_index) else self.builder.late(sample_index)
        return found | self.witnesses(sample_index)

    def _may_work(self, sample_index: int, force_through: int | None) -> bool:
        if self.script:
            self._held.hand_on(sample_index, self.worked_through, self._take_ephemeris)
        late = self.late(sample_index)
        scripted = self.script.at(sample_index)
        known = sample_index <= self.store.ephemerides_through()
        waits = [what for what, there in late.items() if there < scripted.get(what, EVER)]
        forced = force_through is not None and sample_index <= force_through
        if (waits or not known) and not forced:
            return False
        self.missed = late | scripted
        self._counts["forced"] += bool(self.missed) or not known
        self.store.give_up_ephemerides(sample_index)
        return True

    def _try_first_fix(self, force_through: int | None) -> bool:
        """Make the next attempt if the inputs allow; tell whether to go on with more."""
        sample = round(self._attempt * self.config.first_fix_step * self.sample_rate_hz)
        if not self._may_work(sample, force_through):
            return False
        self._attempt += 1
        self._counts["attempts"] += 1
        self.worked_through = sample
        self.builder.locate(sample)
        found = self._first_fix.attempt(sample)
        if found is not None:
            self._start_grid(sample, *found)
        return True

    def _start_grid(self, sample: int, gps_ns: int, position_ecef: FloatArray) -> None:
        """Fix the offset between samples and GPS time; find the first grid epoch."""
        clock = GridClock(self.sample_rate_hz, 0)
        clock.offset_ns = gps_ns - clock.gps_ns_at(sample)
        interval = self.builder.interval_ns
        self._next_ns = (gps_ns // interval + 1) * interval
        self._state = np.append(position_ecef, 0.0)
        self.clock = clock

    def _next_epoch(
        self, clock: GridClock, force_through: int | None
    ) -> tuple[Observations, Pvt | None] | None:
        gps_ns = self._next_ns
        sample, fraction = clock.sample_at(gps_ns)
        if not self._may_work(sample, force_through):
            return None
        self.builder.locate(sample, fraction)
        if self.config.predict_transmit_time and self._state is not None:
            self._predict_transmit_times(sample, gps_ns)
        self._next_ns = gps_ns + self.builder.interval_ns
        valid_through = clock.sample_at(self._next_ns)[0] - 1
        observations = self.builder.build(sample, fraction, gps_ns, valid_through)
        self.worked_through = sample
        self._counts["epochs"] += 1
        self._counts["empty_epochs"] += not observations.satellites
        pvt_interval = NS_PER_S // self.config.pvt_rate_hz
        if gps_ns % pvt_interval:
            return observations, None
        pvt = self._solve_epoch(observations, gps_ns)
        if self._correct_clock(clock, pvt, sample):
            valid_through = clock.sample_at(self._next_ns)[0] - 1
            observations = dataclasses.replace(observations, valid_through=valid_through)
        next_ns = (self._next_ns + pvt_interval - 1) // pvt_interval * pvt_interval
        pvt = dataclasses.replace(pvt, valid_through=clock.sample_at(next_ns)[0] - 1)
        if gps_ns % (60 * NS_PER_S) == 0:
            self.book.forget(sample, gps_ns)
        return observations, pvt

    def _predict_transmit_times(self, sample: int, gps_ns: int) -> None:
        builder = self.builder
        for i in np.flatnonzero((builder.row >= 0) & (builder.transmit_ms < 0)).tolist():
            item = self.book.find(self.store.satellites[i], sample, gps_ns)
            if item is None or self._state is None:
                continue
            whole = predict_transmit_ms(self._state, item[1], gps_ns, float(builder.code_ms[i]))
            if whole is not None:
                builder.transmit_ms[i] = whole
                self._counts["predicted_transmit_times"] += 1

    def _solve_epoch(self, observations: Observations, gps_ns: int) -> Pvt:
        o = observations
        items = [self.book.find(name, o.sample_index, gps_ns) for name in o.satellites]
        chosen = [k for k, item in enumerate(items) if item is not None]
        solution = None
        if len(chosen) >= 4:
            packed = np.stack([item[1] for item in items if item is not None])
            pseudorange = o.pseudorange[chosen]
            locked = (o.flags[chosen] & TrackingFlag.PHASE_LOCK) != 0
            solution = self.solver.solve(
                states_from_pseudoranges(packed, o.week, o.tow_ns, pseudorange),
                pseudorange,
                np.where(locked, o.carrier_doppler_hz[chosen], np.nan),
                o.cn0_dbhz[chosen].astype(np.float64),
                tow=o.tow_ns / NS_PER_S,
                accuracy=np.array([item[0].accuracy for item in items if item is not None]),
                klobuchar=self.book.klobuchar(o.sample_index),
                start=self._state,
                extra_rate_sd=lone_rate_sd(o)[chosen],
            )
        if solution is None:
            self._counts["no_position"] += 1
            return no_position(o)
        self._counts["positions"] += 1
        self._counts["rejected"] += int(solution.rejected.sum())
        self._counts["inconsistent"] += not solution.consistent
        self._state = np.append(solution.position_ecef, solution.clock_bias)
        return pvt_of(o, [o.satellites[k] for k in chosen], solution)

    def _correct_clock(self, clock: GridClock, pvt: Pvt, sample: int) -> bool:
        """Move receiver time by whole milliseconds once it is more than half of one off."""
        if pvt.status == PvtStatus.NONE:
            return False
        bias_ms = pvt.clock_bias / SPEED_OF_LIGHT * 1000.0
        whole = round(bias_ms)
        if abs(bias_ms) <= 0.5 or whole == 0:
            return False
        clock.offset_ns -= whole * NS_PER_MS
        self.builder.steered_ms -= whole
        self._counts["clock_jumps"] += 1
        assert self._state is not None
        self._state[3] -= whole * (SPEED_OF_LIGHT / 1000.0)
        while clock.sample_at(self._next_ns)[0] <= sample:
            self._next_ns += self.builder.interval_ns
        return True
