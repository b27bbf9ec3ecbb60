"""A drive as the acceptance of tight coupling takes it: IMU, observations, truth; simulated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from deepseis_core import rotation
from deepseis_core.constants import L1_WAVELENGTH, NS_PER_S
from deepseis_core.ephemeris import (
    STATE_COLUMNS,
    pack,
    select_ephemerides,
    states_from_pseudoranges,
)
from deepseis_core.errors import InputError
from deepseis_core.geodesy import geodetic_from_ecef, rotation_enu_ecef
from deepseis_core.imu_errors import ImuErrors
from deepseis_core.imu_grades import ImuGrade, grade_named
from deepseis_core.propagation import line_of_sight
from deepseis_core.types import Ephemeris, FloatArray, Lli
from deepseis_ins.tight import TightConfig
from deepseis_sim.bench import Bench
from deepseis_sim.imu import ImuSynthesizer
from deepseis_sim.loop_noise import INTEGRATION, code_sd_chips
from deepseis_sim.observation_model import CHIP, ObservationModel
from deepseis_sim.scenario import load_scenario

Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class Imu:
    """Increments forward-right-down, ends of their intervals on the drive's time [s]."""

    time: FloatArray
    dt: FloatArray
    delta_theta: FloatArray
    delta_vel: FloatArray


@dataclass(frozen=True)
class Observed:
    """m epochs of n satellites; NaN where there is none.

    Attributes
    ----------
    time : ndarray, shape (m,)
        Of the drive [s].
    week : int
    tow_ns : ndarray of int64, shape (m,)
        Receiver time.
    names : tuple of str, length n
    ephemerides : tuple of Ephemeris, length n
    pseudorange, phase, range_rate : ndarray, shape (m, n)
        [m, m, m/s], all growing with range.
    lost : ndarray of bool, shape (m, n)
        The phase lost its continuity since the epoch before.
    cn0_dbhz, pseudorange_sd, range_rate_sd : ndarray, shape (m, n)
        White noise [m, m/s].
    klobuchar : ndarray, shape (8,), or None
    """

    time: FloatArray
    week: int
    tow_ns: NDArray[np.int64]
    names: tuple[str, ...]
    ephemerides: tuple[Ephemeris, ...]
    pseudorange: FloatArray
    phase: FloatArray
    range_rate: FloatArray
    lost: Flags
    cn0_dbhz: FloatArray
    pseudorange_sd: FloatArray
    range_rate_sd: FloatArray
    klobuchar: FloatArray | None = None

    def states(self) -> FloatArray:
        """Return the satellites at departure, shape (m, n, 12); NaN where there is no range."""
        packed = pack(self.ephemerides)
        out = np.full((*self.pseudorange.shape, STATE_COLUMNS), np.nan)
        for k, ranges in enumerate(self.pseudorange):
            seen = np.flatnonzero(np.isfinite(ranges))
            out[k, seen] = states_from_pseudoranges(
                packed[seen], self.week, int(self.tow_ns[k]), ranges[seen]
            )
        return out


@dataclass(frozen=True)
class Truth:
    """Where the antenna was at the epochs, ECEF, shapes (m, 3) [m, m/s]; NaN: not known."""

    position: FloatArray
    velocity: FloatArray


@dataclass(frozen=True)
class Drive:
    """All that a run needs.

    ``still`` is the time at rest at the start [s]; ``blocked`` spans of time in which satellites
    are missing [s]; ``somewhere`` a place near it, if the truth does not tell [m].

    ``smoothed_share`` is what a smoothed range keeps at least of the raw one's variance in the
    filter's eyes, for a window of 100. White noise is small after it, 1/199 of the variance, but
    slow; a filter that takes all noise for white would be right with 1/199 if it forgot faster
    than the window, and with the whole if it averaged much longer. Found on drives with other
    seeds than those shown, receiver of H table 2: with 0.2 position errors are 1.05 times what the
    filter says, with 0.05 1.8 times, with 1 0.7 times. What is slow anyway it does not lessen.
    """

    name: str
    imu: Imu
    grade: ImuGrade
    observed: Observed
    truth: Truth
    lever_arm_b: FloatArray
    clock: TightConfig
    still: tuple[float, float]
    blocked: Sequence[tuple[float, float]] = ()
    somewhere: FloatArray | None = None
    smoothed_share: float = 0.2

    def place(self) -> FloatArray:
        """Return where it is, roughly, ECEF [m]: from the truth, or from the first fix."""
        return (
            self.somewhere
            if self.somewhere is not None
            else np.nanmean(self.truth.position, axis=0)
        )

    def geometry(self) -> tuple[FloatArray, FloatArray]:
        """Return unit vectors (m, n, 3) and elevations (m, n) [rad], roughly."""
        o = self.observed
        place = self.place()
        sight = line_of_sight(pack(o.ephemerides), o.week, o.tow_ns, place)
        unit = sight.unit.copy()
        unit[~np.isfinite(o.pseudorange)] = np.nan
        return unit, sight.elevation

    def hiding(self, hidden: Flags) -> Drive:
        """Return the same without some satellites, (m, n); receivers see them come and go."""
        o = self.observed
        code, phase, rate = (
            np.where(hidden, np.nan, values) for values in (o.pseudorange, o.phase, o.range_rate)
        )
        return replace(self, observed=replace(o, pseudorange=code, phase=phase, range_rate=rate))

    def until(self, end: float) -> Drive:
        """Return its beginning [s]."""
        o, m = self.observed, int(np.searchsorted(self.observed.time, end))
        observed = replace(
            o,
            time=o.time[:m],
            tow_ns=o.tow_ns[:m],
            pseudorange=o.pseudorange[:m],
            phase=o.phase[:m],
            range_rate=o.range_rate[:m],
            lost=o.lost[:m],
            cn0_dbhz=o.cn0_dbhz[:m],
            pseudorange_sd=o.pseudorange_sd[:m],
            range_rate_sd=o.range_rate_sd[:m],
        )
        truth = Truth(self.truth.position[:m], self.truth.velocity[:m])
        return replace(self, observed=observed, truth=truth)

    def errors_n(self, position: FloatArray) -> FloatArray:
        """Return errors of positions (m, 3) along east, north, up [m]."""
        return self.differences_n(position, self.truth.position)

    def differences_n(self, position: FloatArray, other: FloatArray) -> FloatArray:
        """Return positions (m, 3) less others, east, north, up [m]."""
        place = geodetic_from_ecef(self.place())
        return (position - other) @ rotation_enu_ecef(place[0], place[1]).T


OCXO: Final = TightConfig(clock_bias_noise=1e-3, clock_drift_noise=0.03)
"""The scenarios' oscillator: c^2 2 pi^2 h-2 is (0.021 m/s)^2 a second, and some flicker."""
LOOP_RATE_SD: Final = 0.03
"""Doppler of an 8 Hz loop at 41 to 45 dB-Hz [m/s]."""


def simulated(name: str, *, short: bool, settings: Sequence[str] = ()) -> Drive:
    """Make a scenario's drive in memory: what a bag of it holds."""
    scenario = load_scenario(name, short=short, settings=list(settings))
    bench = Bench(scenario)
    if scenario.imu is None:
        raise InputError(f"scenario {name}", "has no IMU")
    rate, grade = scenario.imu.rate_hz, grade_named(scenario.imu.grade)
    made = ImuSynthesizer(bench.motion, bench.site, rate, clock=bench.clock).increments(
        0, round(scenario.duration * rate)
    )
    measured = ImuErrors(grade, rate, scenario.seed).apply(0, made.delta_theta, made.delta_vel)
    imu = Imu(
        made.time_end,
        np.full(made.time_end.size, made.dt),
        rotation.flu_from_frd(measured.delta_theta),
        rotation.flu_from_frd(measured.delta_vel),
    )
    observed = _observed(bench)
    true = observed.time - bench.clock(observed.time)
    antenna = bench.site.states(bench.motion, true, scenario.lever_arm)
    begin, _ = bench.motion.span
    hidden = [(o.from_s, o.to_s) for o in scenario.sky.obstructions]
    return Drive(
        name, imu, grade, observed, Truth(antenna.position, antenna.velocity),
        rotation.flu_from_frd(np.asarray(scenario.lever_arm, np.float64)), OCXO,
        (0.0, begin - 0.5), hidden,
    )  # fmt: skip


def _observed(bench: Bench) -> Observed:
    """Collect a bench's observations of the whole run."""
    scenario = bench.scenario
    config = scenario.observations
    model = ObservationModel(bench.model, config, cn0=bench.sky.cn0_dbhz, seed=scenario.seed)
    epochs = list(model.epochs(0, model.count(scenario.duration)))
    names = model.satellites
    shape = len(epochs), len(names)
    fields = {key: np.full(shape, np.nan) for key in ("code", "phase", "rate", "cn0")}
    lost = np.zeros(shape, np.bool_)
    for k, epoch in enumerate(epochs):
        seen = [names.index(name) for name in epoch.satellites]
        fields["code"][k, seen] = epoch.pseudorange
        fields["phase"][k, seen] = L1_WAVELENGTH * epoch.carrier_phase_cycles
        fields["rate"][k, seen] = -L1_WAVELENGTH * epoch.carrier_doppler_hz
        fields["cn0"][k, seen] = epoch.cn0_dbhz
        lost[k, seen] = (epoch.lli & Lli.SLIP) != 0
    tow_ns = np.array([epoch.tow_ns for epoch in epochs])
    start = bench.start.total_ns
    week = epochs[0].week
    chosen = select_ephemerides(
        [item.ephemeris for item in bench.model.satellites], week, int(tow_ns[len(tow_ns) // 2])
    )
    known = chosen[names[0]]
    klobuchar = None
    if scenario.sky.ionosphere and known.iono_alpha:
        klobuchar = np.array([*known.iono_alpha, *known.iono_beta])
    code_sd, rate_sd = _noise(bench, fields["cn0"])
    return Observed(
        (week * 604800 * NS_PER_S + tow_ns - start) / NS_PER_S, week, tow_ns, names,
        tuple(chosen[name] for name in names), fields["code"], fields["phase"], fields["rate"],
        lost, fields["cn0"], code_sd, rate_sd, klobuchar,
    )  # fmt: skip


def _noise(bench: Bench, cn0: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what white noise of ranges and range rates the settings make."""
    config = bench.scenario.observations
    code = config.pseudorange_sd + np.zeros_like(cn0)
    if config.pseudorange_sd == 0.0:
        loop = np.sqrt(2.0 * config.dll_bandwidth_hz * INTEGRATION)
        code = CHIP * config.code_noise_scale * loop * code_sd_chips(cn0, config.spacing_chips)
    rate = np.full_like(cn0, config.range_rate_sd or LOOP_RATE_SD)
    return np.hypot(code, config.multipath_sd), rate
