"""Runs of the fusion on the bench without samples and without ROS: IMU, positions, truth."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from scipy.signal import cont2discrete, lfilter

from deepseis_core.constants import L1_WAVELENGTH, SPEED_OF_LIGHT
from deepseis_core.ephemeris import pack, states_from_pseudoranges
from deepseis_core.geodesy import ecef_from_enu, geodetic_from_ecef, rotation_enu_ecef
from deepseis_core.imu_grades import ImuGrade, grade_named
from deepseis_core.miss_log import MissScript
from deepseis_core.propagation import line_of_sight
from deepseis_core.types import (
    Ephemeris,
    FloatArray,
    ImuSample,
    IntArray,
    LdvVelocity,
    MotionKind,
    MotionState,
    Observations,
    PrecisePosition,
    PreciseStatus,
    Pvt,
    PvtStatus,
)
from deepseis_ins.fusion_config import FusionConfig
from deepseis_ins.fusion_engine import FusionEngine
from deepseis_ins.fusion_output import FusionOutput
from deepseis_ins.ldv_engine import LdvFusionEngine
from deepseis_ins.ldv_fusion import LdvFusionConfig
from deepseis_ins.motion_engine import MotionEngine, MotionEngineConfig
from deepseis_ins.motion_state import MotionConfig
from deepseis_ins.range_config import RangeConfig
from deepseis_ins.tight import TightConfig
from deepseis_ins.tight_engine import TightFusionEngine
from deepseis_pvt.spp import SppSolver
from deepseis_sim.bench import Bench
from deepseis_sim.bench_streams import ImuStream, LdvStream, ObservationStream
from deepseis_sim.scenario import load_scenario

EVERYTHING = 2**60
OCXO = TightConfig(clock_bias_noise=1e-3, clock_drift_noise=0.03)
"""The bench's oscillator."""


@dataclass(frozen=True)
class Inputs:
    """What the fusion gets of a run."""

    imu: Sequence[ImuSample]
    pvt: Sequence[Pvt]
    motion: Sequence[MotionState]
    precise: Sequence[PrecisePosition] = ()
    observations: Sequence[Observations] = ()
    ldv: Sequence[LdvVelocity] = ()


class FusionBench:
    """A scenario's IMU data and positions; motion is decided by the detector.

    Parameters
    ----------
    name : str
        Scenario; its short form.
    grade : str
        Of the IMU.
    settings : str
        As for `load_scenario`.
    """

    def __init__(self, name: str, grade: str = "span-fsas", *settings: str) -> None:
        changes = [
            f"imu.grade={grade}", "signal=false", "observations.rate_hz=10", *settings,
        ]  # fmt: skip
        self.bench = Bench(load_scenario(name, short=True, settings=changes))
        self.grade: ImuGrade = grade_named(grade)
        self.sample_rate_hz = self.bench.sample_rate_hz
        imu = self.bench.scenario.imu
        assert imu is not None
        self.imu_rate_hz = imu.rate_hz
        self.ephemerides = [item.ephemeris for item in self.bench.model.satellites]
        samples, positions, observations, ldv = self._made()
        decisions = self._decisions(samples)
        self.inputs = Inputs(samples, positions, decisions, (), observations, ldv)

    def _made(
        self,
    ) -> tuple[list[ImuSample], list[Pvt], list[Observations], list[LdvVelocity]]:
        samples: list[ImuSample] = []
        positions: list[Pvt] = []
        observations: list[Observations] = []
        ldv: list[LdvVelocity] = []
        by_name = {item.satellite: item for item in self.ephemerides}
        solver = SppSolver()
        for begin, end in self.bench.spans():
            for stream in self.bench.streams:
                if isinstance(stream, ImuStream):
                    samples += [item.value for item in stream.between(begin, end)]
                elif isinstance(stream, LdvStream):
                    ldv += [item.value for item in stream.between(begin, end)]
                elif isinstance(stream, ObservationStream) and stream.topic.startswith("gnss"):
                    values = [item.value for item in stream.between(begin, end)]
                    observations += values
                    found = (position_of(solver, item, by_name) for item in values)
                    positions += [item for item in found if item is not None]
        return samples, positions, observations, ldv

    def _decisions(self, samples: Iterable[ImuSample]) -> list[MotionState]:
        engine = MotionEngine(
            MotionEngineConfig(), MotionConfig(), self.grade, self.imu_rate_hz,
            self.sample_rate_hz,
        )  # fmt: skip
        for sample in samples:
            engine.push(sample)
        return [state for _, said in engine.advance(self.bench.sample_count) for state in said]

    def engine(
        self,
        config: FusionConfig | None = None,
        *,
        ranges: RangeConfig | None = None,
        ldv_config: LdvFusionConfig | None = None,
        script: MissScript | None = None,
        **inputs: Any,
    ) -> FusionEngine:
        """Return an engine that has been given everything; ``inputs`` replace the run's own."""
        engine = self.empty_engine(config, ranges, ldv_config, script)
        given = {**vars(self.inputs), **inputs}
        for sample in given["imu"]:
            engine.push_imu(sample)
        for pvt in given["pvt"]:
            engine.push_pvt(pvt)
        for position in given["precise"]:
            engine.push_precise(position)
        for position in given.get("rtk", ()):
            engine.push_rtk(position)
        if isinstance(engine, TightFusionEngine):
            for epoch in given["observations"]:
                engine.push_observations(epoch)
        if isinstance(engine, LdvFusionEngine):
            for velocity in given["ldv"]:
                engine.push_ldv(velocity)
        for state in given["motion"]:
            engine.push_motion(state)
        for valid in watermarks(engine):
            valid(EVERYTHING)
        return engine

    def empty_engine(
        self,
        config: FusionConfig | None = None,
        ranges: RangeConfig | None = None,
        ldv: LdvFusionConfig | None = None,
        script: MissScript | None = None,
    ) -> FusionEngine:
        """Return an engine that knows the orbits only."""
        config = config or FusionConfig()
        given = config, self.grade, self.sample_rate_hz, self.bench.station(), self.imu_rate_hz
        engine: FusionEngine
        if config.coupling == "tight":
            engine = TightFusionEngine(*given, tight=OCXO, ranges=ranges, script=script)
        elif config.coupling == "ldv":
            engine = LdvFusionEngine(*given, ldv=ldv, script=script)
        else:
            engine = FusionEngine(*given, script=script)
        for ephemeris in self.ephemerides:
            engine.push_ephemeris(ephemeris)
        return engine

    def run(self, engine: FusionEngine, until: float | None = None) -> Outputs:
        """Work through the run, or to a time [s]."""
        end = self.bench.sample_count if until is None else until * self.sample_rate_hz
        spans = []
        while engine.next_sample + engine.block <= end:
            output = engine.advance()
            assert output is not None, engine.waiting_for()
            spans.append(output)
        return Outputs(self, spans)

    def antenna(self, samples: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return the antenna's true states, shape (m, 9), and true times [s] of samples."""
        time = samples / self.sample_rate_hz
        time = time - self.bench.clock(time)
        states = self.bench.site.states(self.bench.motion, time, self.bench.scenario.lever_arm)
        return np.hstack([states.position, states.velocity, states.acceleration]), time


def precise_positions(
    run: FusionBench,
    *,
    seed: int = 1,
    sd: Sequence[float] = (1e-3, 1e-3, 2.5e-3),
    walk: float = 2e-4,
    rate_hz: float = 50.0,
    begin: float = 4.0,
) -> list[PrecisePosition]:
    """Make precise positions of the antenna: truth, white noise, and an error that creeps.

    Parameters
    ----------
    run : FusionBench
    seed : int
    sd : sequence of float
        White noise, east, north, up [m]; about that of 11 satellites and loops of 8 Hz.
    walk : float
        Random walk of the creeping error [m/sqrt(s)].
    rate_hz : float
    begin : float
        First of them [s].
    """
    random, step = np.random.default_rng(seed), round(run.sample_rate_hz / rate_hz)
    samples = np.arange(round(begin * rate_hz) * step, run.bench.sample_count, step)
    antenna, time = run.antenna(samples)
    station = run.bench.station()
    latitude, longitude, _ = geodetic_from_ecef(station.monument_ecef)
    C_enu_e = rotation_enu_ecef(latitude, longitude)
    surveyed = ecef_from_enu(station.antenna_lever_arm, station.monument_ecef)
    shape = (len(samples), 3)
    creep = np.cumsum(random.normal(0.0, walk / np.sqrt(rate_hz), shape), axis=0)
    moved = (antenna[:, :3] - surveyed) @ C_enu_e.T
    moved += random.normal(0.0, sd, shape) + creep
    clock = SPEED_OF_LIGHT * run.bench.clock(samples / run.sample_rate_hz)
    clock += random.normal(0.0, 1e-3, len(samples))
    start = run.bench.start
    covariance = np.diag(np.square(sd)).ravel()
    return [
        PrecisePosition(
            int(sample), start.week, start.tow_ns + round(t * 1e9), int(sample), "phase",
            PreciseStatus.PHASE, displacement, covariance, float(bias), 1.5e-3,
        )
        for sample, t, displacement, bias in zip(samples, time, moved, clock, strict=True)
    ]  # fmt: skip


@dataclass
class Outputs:
    """Spans of a run, and what they say of the motion."""

    run: FusionBench
    spans: list[FusionOutput] = field(repr=False)

    def time_of(self, output: FusionOutput) -> float:
        """Return when a span begins [s]."""
        return output.aiding.valid_from / self.run.sample_rate_hz

    def between(self, begin: float, end: float) -> Outputs:
        """Return the spans that begin in an interval [s]."""
        return Outputs(self.run, [s for s in self.spans if begin <= self.time_of(s) < end])

    @cached_property
    def velocity_errors(self) -> list[FloatArray | None]:
        """Errors of the predicted range rates at the knots, (n, m) [m/s]; None: no aiding."""
        return [self._errors(item) if item.aiding.valid else None for item in self.spans]

    def error(self) -> FloatArray:
        """Return all of them in a row [m/s]."""
        found = [item[:, :-1].ravel() for item in self.velocity_errors if item is not None]
        return np.concatenate(found)

    def jumps(self) -> FloatArray:
        """Return by how much they jump from span to span, all in a row [m/s]."""
        pairs = zip(self.velocity_errors, self.velocity_errors[1:], strict=False)
        found = [
            b[:, 0] - a[:, -1]
            for a, b in pairs
            if a is not None and b is not None and len(a) == len(b)
        ]
        return np.concatenate(found)

    def phase_error(self, bandwidth_hz: float) -> FloatArray:
        """Return what an aided loop of order 2 makes of the errors, shape (n, m) [deg].

        Critically damped, ``wn = 8 Bn / 5`` (thesis 3.3.3): from the velocity's error to phase
        ``(2 pi / lam) s / (s + wn)^2``. The same satellites must be aided throughout.
        """
        found = [item[:, :-1] for item in self.velocity_errors if item is not None]
        wn = 1.6 * bandwidth_hz
        loop = cont2discrete(([1.0, 0.0], [1.0, 2.0 * wn, wn**2]), 1e-3, "bilinear")
        error = np.concatenate(found, axis=1) * (360.0 / L1_WAVELENGTH)
        return np.asarray(lfilter(np.ravel(loop[0]), np.ravel(loop[1]), error, axis=1))

    def sd(self) -> FloatArray:
        """Return what the aiding says of its sigma, all in a row [m/s]."""
        return L1_WAVELENGTH * np.concatenate([s.aiding.doppler_sd_hz for s in self.spans])

    def _errors(self, output: FusionOutput) -> FloatArray:
        aiding, start = output.aiding, self.run.bench.start
        step = np.arange(aiding.knot_count)
        antenna, time = self.run.antenna(
            aiding.knot_sample_index + aiding.knot_step_samples * step
        )
        by_name = {item.satellite: item for item in self.run.ephemerides}
        packed = pack([by_name[name] for name in aiding.satellites])
        tow_ns = start.tow_ns + np.round(time * 1e9).astype(np.int64)
        true_hz = line_of_sight(packed, start.week, tow_ns, antenna).doppler_hz.T
        return (aiding.carrier_doppler_hz - true_hz) * -L1_WAVELENGTH


def position_of(
    solver: SppSolver, epoch: Observations, ephemerides: dict[str, Ephemeris]
) -> Pvt | None:
    """Solve an epoch as the pvt node does; None: it has no solution."""
    packed = pack([ephemerides[name] for name in epoch.satellites])
    states = states_from_pseudoranges(packed, epoch.week, epoch.tow_ns, epoch.pseudorange)
    found = solver.solve(
        states, epoch.pseudorange, epoch.carrier_doppler_hz, epoch.cn0_dbhz.astype(np.float64),
        tow=epoch.tow_ns * 1e-9,
    )  # fmt: skip
    if found is None:
        return None
    return Pvt(
        epoch.sample_index, epoch.week, epoch.tow_ns, epoch.valid_through, PvtStatus.SINGLE,
        found.position_ecef, found.velocity_ecef, found.clock_bias, found.clock_drift,
        found.covariance[:3, :3], found.velocity_covariance[:3, :3],
    )  # fmt: skip


def watermarks(engine: FusionEngine) -> list[Any]:
    """Return what tells an engine how far its inputs are complete."""
    found = [engine.source_valid, engine.imu_valid, engine.motion_valid, engine.pvt_valid]
    return [*found, engine.ldv_valid] if isinstance(engine, LdvFusionEngine) else found


def motion(kind: MotionKind, since: int, decided: int) -> MotionState:
    """Make a decision."""
    nothing = np.zeros(6, np.float32)
    return MotionState(since, decided, int(kind), "fast", nothing, nothing)


def as_bytes(output: FusionOutput) -> bytes:
    """Return all numbers of a span."""
    parts = [str((output.status, output.late, output.extrapolated)).encode()]
    for value in (output.solution, output.aiding, *output.motion):
        for item in vars(value).values():
            parts.append(item.tobytes() if isinstance(item, np.ndarray) else str(item).encode())
    return b"|".join(parts)
