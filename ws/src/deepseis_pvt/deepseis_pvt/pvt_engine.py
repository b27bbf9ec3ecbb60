"""From integrations to observations and positions, in order of the sample index.

The engine looks for a first fix at regular samples, ties the sample counter to GPS time by a whole
number of nanoseconds, and then works through the epochs of the GPS-time grid, each as soon as the
watermarks of all satellites allow. Nothing depends on the order in which messages arrive.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from deepseis_core.config import setting
from deepseis_core.constants import NS_PER_S, NS_PER_WEEK, SPEED_OF_LIGHT
from deepseis_core.ephemeris import states_from_pseudoranges
from deepseis_core.gps_time import GpsTime
from deepseis_core.types import (
    Ephemeris,
    FloatArray,
    Observations,
    Pvt,
    PvtStatus,
    TrackingEpochs,
    TrackingFlag,
)
from deepseis_pvt.assisted_start import Assistance, predict_transmit_ms, resolve_start
from deepseis_pvt.ephemeris_book import EphemerisBook, week_of
from deepseis_pvt.observables import (
    NS_PER_MS,
    GridClock,
    ObservablesBuilder,
    ObservablesConfig,
)
from deepseis_pvt.spp import SppConfig, SppSolution, SppSolver
from deepseis_pvt.track_store import TrackStore

FIRST_TRAVEL_MS = 68
"""Travel time assumed of the nearest satellite before the receiver's clock is known [ms]."""

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

    Attributes
    ----------
    clock : GridClock or None
        Receiver time of samples; None before the first fix.
    worked_through : int
        Last sample that epochs, or attempts at the first fix, have been worked through to.
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
    ) -> None:
        self.config, self.sample_rate_hz, self.assistance = config, sample_rate_hz, assistance
        self.store = TrackStore(satellites)
        self.builder = ObservablesBuilder(
            observables or ObservablesConfig(), sample_rate_hz, self.store
        )
        if self.builder.config.rate_hz % config.pvt_rate_hz:
            raise ValueError(f"pvt_rate_hz = {config.pvt_rate_hz} is no divisor of rate_hz")
        self.book = EphemerisBook(config.max_ephemeris_age, config.use_unhealthy)
        self.solver = SppSolver(spp)
        self.clock: GridClock | None = None
        self.worked_through = -1
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
        """Last sample before the next epoch, or attempt at the first fix: nothing more up to it."""
        if self.clock is not None:
            return self.clock.sample_at(self._next_ns)[0] - 1
        return round(self._attempt * self.config.first_fix_step * self.sample_rate_hz) - 1

    def newest_sample(self) -> int:
        """Return the last sample that any satellite has published through."""
        return int(self.store.published.max(initial=-1))

    @staticmethod
    def utc_ns(observations: Observations) -> int:
        """Return the UTC of an epoch in Unix nanoseconds."""
        return GpsTime(observations.week, observations.tow_ns).to_utc_ns()

    def push_epochs(self, epochs: TrackingEpochs) -> None:
        """Take the integrations of one satellite and IF block."""
        self.store.push(epochs, self.worked_through)

    def push_ephemeris(self, ephemeris: Ephemeris) -> None:
        """Take an ephemeris a channel has decoded, or a preloaded one (effective from -1)."""
        if self.book.add(ephemeris) and ephemeris.effective_sample_index >= 0:
            self.store.received_ephemeris(ephemeris.satellite)

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
        done = []
        while self.clock is None and self._try_first_fix(force_through):
            pass
        while self.clock is not None:
            epoch = self._next_epoch(self.clock, force_through)
            if epoch is None:
                break
            done.append(epoch)
        return done

    def _may_work(self, sample_index: int, force_through: int | None) -> bool:
        known = sample_index <= self.store.ephemerides_through()
        if known and self.builder.reached(sample_index):
            return True
        if force_through is not None and sample_index <= force_through:
            self._counts["forced"] += 1
            return True
        return False

    # ---- first fix

    def _try_first_fix(self, force_through: int | None) -> bool:
        """Make the next attempt if the inputs allow; tell whether to go on with more."""
        sample = round(self._attempt * self.config.first_fix_step * self.sample_rate_hz)
        if not self._may_work(sample, force_through):
            return False
        self._attempt += 1
        self.worked_through = sample
        self._counts["attempts"] += 1
        self.builder.locate(sample)
        transmit = self._transmit_times(sample)
        if len(transmit) >= 4:
            solution, receive_ms = self._solve_first(sample, transmit)
            if solution is not None:
                self._start_grid(sample, receive_ms, solution)
        return True

    def _transmit_times(self, sample: int) -> dict[int, tuple[int, FloatArray]]:
        """Return whole transmit milliseconds since the GPS epoch, and ephemerides, by number."""
        builder, found = self.builder, {}
        for i in np.flatnonzero(builder.row >= 0).tolist():
            tow_ms = int(builder.transmit_ms[i])
            if tow_ms < 0:
                continue
            name = self.store.satellites[i]
            item = self.book.find(name, sample, tow_ms * NS_PER_MS, week_known=False)
            if item is not None:
                found[i] = (
                    week_of(item[0], tow_ms) * (NS_PER_WEEK // NS_PER_MS) + tow_ms,
                    item[1],
                )
        if len(found) < 4 and self.assistance is not None:
            coarse = GridClock(self.sample_rate_hz, self.assistance.gps_ns_at_sample_0)
            return resolve_start(
                self.assistance,
                self.builder,
                self.store.satellites,
                self.book,
                sample,
                coarse.gps_ns_at(sample),
            )
        return found

    def _solve_first(
        self, sample: int, transmit: dict[int, tuple[int, FloatArray]]
    ) -> tuple[SppSolution | None, int]:
        numbers = list(transmit)
        whole = np.array([transmit[i][0] for i in numbers])
        receive_ms = int(whole.max()) + FIRST_TRAVEL_MS
        travel_ms = (receive_ms - whole) - self.builder.code_ms[numbers]
        near = travel_ms < 150.0
        numbers = [i for i, ok in zip(numbers, near, strict=True) if ok]
        if len(numbers) < 4:
            return None, receive_ms
        pseudorange = travel_ms[near] * (SPEED_OF_LIGHT / 1000.0)
        packed = np.stack([transmit[i][1] for i in numbers])
        week, tow_ns = divmod(receive_ms * NS_PER_MS, NS_PER_WEEK)
        doppler, cn0 = self.builder.doppler_and_cn0(numbers)
        solution = self.solver.solve(
            states_from_pseudoranges(packed, week, tow_ns, pseudorange),
            pseudorange,
            doppler,
            cn0,
            tow=tow_ns / NS_PER_S,
            klobuchar=self.book.klobuchar(sample),
        )
        if solution is None or not self._credible(solution):
            return None, receive_ms
        return solution, receive_ms

    def _credible(self, solution: SppSolution) -> bool:
        """Tell whether a first fix is consistent, determined, and nearer than the satellites."""
        radius = float(np.linalg.norm(solution.position_ecef))
        return (
            solution.consistent
            and solution.dops[0] <= self.config.max_first_gdop
            and 6.3e6 < radius < 2.0e7
        )

    def _start_grid(self, sample: int, receive_ms: int, solution: SppSolution) -> None:
        """Fix the offset between samples and GPS time; find the first grid epoch."""
        bias_ns = round(solution.clock_bias / SPEED_OF_LIGHT * NS_PER_S)
        clock = GridClock(self.sample_rate_hz, 0)
        clock.offset_ns = receive_ms * NS_PER_MS - bias_ns - clock.gps_ns_at(sample)
        interval = self.builder.interval_ns
        self._next_ns = (clock.gps_ns_at(sample) // interval + 1) * interval
        self._state = np.append(solution.position_ecef, 0.0)
        self.clock = clock

    # ---- grid epochs

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


def no_position(observations: Observations) -> Pvt:
    """Return the statement that an epoch has no position."""
    return Pvt(
        sample_index=observations.sample_index,
        week=observations.week,
        tow_ns=observations.tow_ns,
        valid_through=observations.valid_through,
        status=PvtStatus.NONE,
        position_ecef=np.full(3, np.nan),
        velocity_ecef=np.full(3, np.nan),
        clock_bias=float("nan"),
        clock_drift=float("nan"),
        position_covariance_ecef=np.full((3, 3), np.nan),
        velocity_covariance_ecef=np.full((3, 3), np.nan),
    )


def pvt_of(observations: Observations, satellites: list[str], solution: SppSolution) -> Pvt:
    """Return a solution as the value that crosses packages."""
    used = np.flatnonzero(solution.used)
    dops = solution.dops.tolist()
    return Pvt(
        sample_index=observations.sample_index,
        week=observations.week,
        tow_ns=observations.tow_ns,
        valid_through=observations.valid_through,
        status=PvtStatus.SINGLE,
        position_ecef=solution.position_ecef,
        velocity_ecef=solution.velocity_ecef,
        clock_bias=solution.clock_bias,
        clock_drift=solution.clock_drift,
        position_covariance_ecef=solution.covariance[:3, :3].copy(),
        velocity_covariance_ecef=solution.velocity_covariance[:3, :3].copy(),
        satellites=tuple(satellites[k] for k in used),
        pseudorange_residual=solution.pseudorange_residual[used].astype(np.float32),
        range_rate_residual=solution.range_rate_residual[used].astype(np.float32),
        elevation=solution.elevation[used].astype(np.float32),
        azimuth=solution.azimuth[used].astype(np.float32),
        gdop=dops[0],
        pdop=dops[1],
        hdop=dops[2],
        vdop=dops[3],
        rejected=tuple(satellites[k] for k in np.flatnonzero(solution.rejected)),
    )
