"""Soak test from observables: hours of them and of the IMU through the filters, in one process.

The bench gives observations and IMU samples; single points, precise positions, motion state,
fusion, aiding and events are those of the station. Samples, epochs and satellites are lost by
chance, and the ground shakes now and then. Memory and handles are those of this process.
"""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from time import monotonic
from typing import Any, Final

import numpy as np

from deepseis_bringup.faults.cases import masked
from deepseis_bringup.graph import GraphConfig, precise_parameters
from deepseis_bringup.offline import pick
from deepseis_bringup.offline_inertial import InertialChain
from deepseis_bringup.soak.plan import LAST_S, Disturbance, plan
from deepseis_bringup.soak.resources import Resources
from deepseis_core.constants import GPS_GM
from deepseis_core.ephemeris import FIT_S, pack, states_from_pseudoranges
from deepseis_core.geodesy import ecef_from_enu
from deepseis_core.gps_time import GpsTime
from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import (
    DisplacementSource,
    Ephemeris,
    ImuSample,
    Lli,
    Observations,
    PreciseStatus,
    Pvt,
    PvtStatus,
)
from deepseis_pvt.ephemeris_book import EphemerisBook
from deepseis_pvt.phase_values import PhaseConfig
from deepseis_pvt.precise import PreciseConfig
from deepseis_pvt.precise_rtk import BaseConfig
from deepseis_pvt.precise_set import precise_positions
from deepseis_pvt.rtk import RtkConfig
from deepseis_pvt.spp import SppConfig, SppSolver
from deepseis_pvt.still_reference import ReferenceConfig
from deepseis_sim.bench import Bench
from deepseis_sim.bench_streams import ImuStream, ObservationStream
from deepseis_sim.scenario import Scenario, load_scenario

SPAN_S: Final = 0.02
RENEWAL_S: Final = 3600.0
"""A satellite's ephemeris is that of the last whole hour [s]."""
QUAKE_S: Final = 15.0
QUAKE_EVERY_S: Final = 300.0
SHORTEST_HOLE: Final = 1.6
"""In steps of a stream: longer ones are holes."""


@dataclass
class Holes:
    """When a stream had nothing good; memory grows with the holes alone.

    Examples
    --------
    >>> holes = Holes(0.02)
    >>> for t in (0.0, 0.02, 0.04, 1.0, 1.02): holes.add(t)
    >>> holes.between(0.5, 2.0), holes.between(0.0, 0.5)
    ([], [(0.06, 1.0)])
    """

    step: float
    last: float = math.nan
    found: list[tuple[float, float]] = field(default_factory=list)

    def add(self, time: float) -> None:
        """Take the time of something good [s]."""
        if time - self.last > SHORTEST_HOLE * self.step:
            self.found.append((round(self.last + self.step, 6), time))
        self.last = time

    def between(self, begin: float, end: float) -> list[tuple[float, float]]:
        """Return the holes that begin in an interval."""
        return [hole for hole in self.found if begin <= hole[0] < end]


def renewed(ephemeris: Ephemeris, toe: float) -> Ephemeris:
    """Return the same orbit and clock referred to another time of the same week [s].

    As a new broadcast would have it: what is linear in time goes into the constants.
    """
    late = toe - ephemeris.toe
    motion = math.sqrt(GPS_GM / ephemeris.sqrt_a**6) + ephemeris.delta_n
    clock = toe - ephemeris.toc
    return replace(
        ephemeris,
        toe=toe,
        toc=toe,
        m0=ephemeris.m0 + motion * late,
        omega0=ephemeris.omega0 + ephemeris.omega_dot * late,
        i0=ephemeris.i0 + ephemeris.i_dot * late,
        af0=ephemeris.af0 + (ephemeris.af1 + ephemeris.af2 * clock) * clock,
        af1=ephemeris.af1 + 2.0 * ephemeris.af2 * clock,
    )


def day_scenario(duration: float, rate_hz: float, seed: int, outages: str = "") -> Scenario:
    """Return hours of rest with earthquakes of 0.5 g, observations in place of the signal."""
    starts = np.arange(120.0, duration - QUAKE_S, QUAKE_EVERY_S)
    motion = ", ".join(
        f"{{kind: circle, radius: 0.03, frequency_hz: 2.0, start: {start:.1f}, "
        f"duration: {QUAKE_S}, ramp: 1.0}}"
        for start in starts
    )
    settings = [
        f"duration={duration}", f"motion=[{motion}]", "base=false", f"seed={seed}",
        "signal=false", f"observations.rate_hz={rate_hz}", "sky.satellites=32", "truth_rate_hz=10",
    ]  # fmt: skip
    return load_scenario(
        "sine-2hz", short=True, settings=[*settings, *([outages] if outages else [])]
    )


@dataclass
class DayRun:
    """What the soak test found."""

    hours: float
    disturbances: list[Disturbance]
    holes: dict[str, Holes]
    resources: Resources
    wall_s: float
    events: int
    epochs: int


class Day:
    """The station's filters on the bench's observations.

    Parameters
    ----------
    hours : float
    rate_hz : float
        Of the observations.
    seed : int
    every_s : float
        Between disturbances in the mean [s].
    """

    def __init__(self, hours: float, rate_hz: float, seed: int, every_s: float) -> None:
        duration = 3600.0 * hours
        kinds = ("imu-gap", "no-signal", "outage")
        self.planned = plan(duration, seed, every_s=every_s, kinds=kinds, satellites=8)
        self._dark = [p for p in self.planned if p.kind == "no-signal"]
        self._gaps = [p for p in self.planned if p.kind == "imu-gap"]
        clear = day_scenario(duration, rate_hz, seed)
        outages = [(int(p.victim), p.begin, p.end) for p in self.planned if p.kind == "outage"]
        setting = masked(clear, outages) if outages else ""
        self.bench = Bench(day_scenario(duration, rate_hz, seed, setting))
        self.rate_hz, self.sample_rate_hz = rate_hz, self.bench.sample_rate_hz
        self.start = self.bench.start
        self.orbits = {
            item.ephemeris.satellite: item.ephemeris for item in self.bench.model.satellites
        }
        self.packed: dict[str, Ephemeris] = {}
        self.solver, self.book = SppSolver(), EphemerisBook(FIT_S)
        station = self.bench.station()
        place = ecef_from_enu(station.antenna_lever_arm, station.monument_ecef)
        known = precise_parameters(GraphConfig({}, self.sample_rate_hz, aiding="fusion"))
        self.precise = precise_positions(
            place.tolist(), self.book, self.sample_rate_hz, pick(PreciseConfig, known),
            pick(PhaseConfig, known), ReferenceConfig(), SppConfig(), RtkConfig(), BaseConfig(),
        )  # fmt: skip
        self.inertial = self._inertial()
        self.holes = {
            "aiding": Holes(SPAN_S), "position": Holes(1.0 / rate_hz),
            "phase displacement": Holes(1.0 / rate_hz), "fused displacement": Holes(SPAN_S),
        }  # fmt: skip
        self.events, self.epochs, self._hour, self._is_dark = 0, 0, -1, False

    def _inertial(self) -> InertialChain:
        station, imu = self.bench.station(), self.bench.scenario.imu
        assert imu is not None
        utc_ns = self.start.to_utc_ns()
        common = {"start_utc_ns": utc_ns, "imu_rate_hz": imu.rate_hz, "imu_grade": imu.grade}
        geometry = {
            "monument_ecef": list(station.monument_ecef),
            "antenna_lever_arm": list(station.antenna_lever_arm),
            "imu_to_antenna": list(station.imu_to_antenna),
            "imu_orientation_xyzw": list(station.imu_orientation_xyzw),
        }
        given: dict[str, dict[str, Any]] = {
            "motion_state": common,
            "fusion": {**common, **geometry},
            "seismic_event": {"start_utc_ns": utc_ns},
        }
        clock = SampleClock(utc_ns, self.sample_rate_hz)
        return InertialChain("bench", clock, given, pick, self._imu())

    def _imu(self) -> Iterator[ImuSample]:
        """Yield IMU samples but for those of the gaps."""
        (stream,) = (item for item in self.bench.streams if isinstance(item, ImuStream))
        for begin, end in self.bench.spans():
            for item in stream.between(begin, end):
                if not _within(self._gaps, item.value.sample_index / self.sample_rate_hz):
                    yield item.value

    def _observations(self) -> Iterator[Observations]:
        (stream,) = (
            item for item in self.bench.streams
            if isinstance(item, ObservationStream) and item.topic == "gnss/observations"
        )  # fmt: skip
        for begin, end in self.bench.spans():
            for item in stream.between(begin, end):
                yield item.value

    def run(self, resources: Resources, show: Callable[[float], object]) -> None:
        """Work through all of it."""
        block = round(SPAN_S * self.sample_rate_hz)
        epochs = self._observations()
        epoch = next(epochs, None)
        name = "all filters and the bench"
        for number, begin in enumerate(range(0, self.bench.sample_count - block, block)):
            through = begin + block - 1
            self._renew(begin)
            self._advance(through)
            while epoch is not None and epoch.sample_index <= through:
                self._solve(epoch)
                epoch = next(epochs, None)
            self.inertial.pvt_valid(through)
            if number % 500 == 0:
                now = begin / self.sample_rate_hz
                resources.sample(now, {name: os.getpid()})
                show(now)

    def _renew(self, sample: int) -> None:
        """Broadcast the ephemerides of a new hour."""
        hour = int(sample / self.sample_rate_hz / RENEWAL_S)
        if hour == self._hour:
            return
        self._hour = hour
        toe = self.start.tow_ns * 1e-9 + hour * RENEWAL_S
        at = GpsTime(self.start.week, round(toe * 1e9))
        self.book.forget(sample, at.diff_ns(GpsTime(0, 0)))
        for name, orbit in self.orbits.items():
            self.packed[name] = replace(renewed(orbit, toe), effective_sample_index=sample)
            self.book.add(self.packed[name])
            self.inertial.push_ephemeris(self.packed[name])

    def _advance(self, through: int) -> None:
        for topic, value, _ in self.inertial.advance(through):
            if topic == "motion/state":
                self.precise.push_motion(value)
            elif topic == "aiding/doppler" and value.valid:
                self.holes["aiding"].add(value.valid_from / self.sample_rate_hz)
            elif topic == "seismo/event":
                self.events += bool(value.ended)
            elif topic == "seismo/displacement" and value.source == DisplacementSource.FUSED:
                self.holes["fused displacement"].add(self._seconds(int(value.tow_ns[0])))
        self.precise.motion_valid(self.inertial.motion.valid_through)

    def _seconds(self, tow_ns: int) -> float:
        return (tow_ns - self.start.tow_ns) * 1e-9

    def _solve(self, epoch: Observations) -> None:
        """Solve an epoch as the pvt node does."""
        now = epoch.sample_index / self.sample_rate_hz
        self.epochs += 1
        if _within(self._dark, now):
            epoch, self._is_dark = without_satellites(epoch), True
        elif self._is_dark:  # loops that lost their signal say so
            epoch, self._is_dark = replace(epoch, lli=epoch.lli | np.uint8(Lli.SLIP)), False
        pvt = self._position(epoch)
        if pvt.status != PvtStatus.NONE:
            self.holes["position"].add(now)
        self.inertial.push_pvt(pvt)
        for topic, value in self.precise.solve(epoch):
            self.inertial.push_position(topic, value)
            if value.status >= PreciseStatus.PHASE or value.datum > 0:
                self.holes["phase displacement"].add(now)

    def _position(self, epoch: Observations) -> Pvt:
        none = np.full(3, np.nan)
        nothing = Pvt(
            epoch.sample_index, epoch.week, epoch.tow_ns, epoch.valid_through,
            int(PvtStatus.NONE), none, none, math.nan, math.nan, np.full((3, 3), np.nan),
            np.full((3, 3), np.nan),
        )  # fmt: skip
        if len(epoch.satellites) < 4:
            return nothing
        packed = pack([self.packed[name] for name in epoch.satellites])
        states = states_from_pseudoranges(packed, epoch.week, epoch.tow_ns, epoch.pseudorange)
        found = self.solver.solve(
            states, epoch.pseudorange, epoch.carrier_doppler_hz,
            epoch.cn0_dbhz.astype(np.float64), tow=epoch.tow_ns * 1e-9,
        )  # fmt: skip
        if found is None:
            return nothing
        return replace(
            nothing,
            status=int(PvtStatus.SINGLE),
            position_ecef=found.position_ecef,
            velocity_ecef=found.velocity_ecef,
            clock_bias=found.clock_bias,
            clock_drift=found.clock_drift,
            position_covariance_ecef=found.covariance[:3, :3],
            velocity_covariance_ecef=found.velocity_covariance[:3, :3],
        )


def without_satellites(epoch: Observations) -> Observations:
    """Return an epoch in which nothing was observed."""
    arrays = {
        name: value[:0]
        for name, value in vars(epoch).items()
        if isinstance(value, np.ndarray) and len(value) == len(epoch.satellites)
    }
    return replace(epoch, satellites=(), **arrays)  # type: ignore[arg-type]


def _within(planned: Sequence[Disturbance], time: float) -> bool:
    """Tell whether a time lies in one of some disturbances; those that are past are dropped."""
    while planned and planned[0].end <= time and isinstance(planned, list):
        planned.pop(0)
    return bool(planned) and planned[0].begin <= time


def soak_observables(
    hours: float,
    *,
    rate_hz: float = 10.0,
    seed: int = 1,
    every_s: float = 60.0,
    show: Callable[[float], object] = lambda _done: None,
) -> DayRun:
    """Run the soak test; ``show`` is told the seconds done. Ctrl-C ends it with what there is."""
    resources, started = Resources(), monotonic()
    day = Day(hours, rate_hz, seed, every_s)
    with contextlib.suppress(KeyboardInterrupt):
        day.run(resources, show)
    wall, done = monotonic() - started, day.epochs / rate_hz
    # What came last may have hit something that was not seen to the end.
    planned = [item for item in day.planned if item.end + LAST_S <= done]
    hours = min(hours, done / 3600.0)
    return DayRun(hours, planned, day.holes, resources, wall, day.events, day.epochs)
