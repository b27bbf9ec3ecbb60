"""Precise positions from observations, in order of validity: what the pvt node publishes.

The solutions themselves are in `phase_displacement`; here they get their observations, orbits
and the state of motion, and become values that cross packages.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from deepseis_core.config import setting
from deepseis_core.constants import L1_WAVELENGTH, NS_PER_S, NS_PER_WEEK
from deepseis_core.ephemeris import PACKED_COLUMNS, states_from_pseudoranges
from deepseis_core.hidden_motion import hidden_motion
from deepseis_core.loop_noise import without_aiding
from deepseis_core.miss_log import EVER
from deepseis_core.types import (
    FloatArray,
    IntArray,
    Lli,
    MotionKind,
    MotionState,
    Observations,
    PrecisePosition,
    PreciseStatus,
    TrackingFlag,
)
from deepseis_pvt import phase_kernels as kernels
from deepseis_pvt.ephemeris_book import EphemerisBook
from deepseis_pvt.phase_displacement import CLOCK, PhaseDisplacement
from deepseis_pvt.phase_values import PhaseConfig, PhaseEpoch, PhaseSolution
from deepseis_pvt.spp import SppConfig
from deepseis_pvt.still_reference import ReferenceConfig, StillReference

PHASE: Final = "phase"
"""``method`` of one station without a base."""
NO_IONOSPHERE: Final = np.zeros(8)


@dataclass(frozen=True)
class PreciseConfig:
    """Whom precise positions wait for, and who tells of the antenna's rest."""

    wait_motion: bool = setting(
        False, "an IMU does: wait for motion/state at every epoch, and calibrate at rest"
    )
    add_discriminator: bool = setting(
        False,
        "add what the loops' discriminators say of each phase: more noise, white, and no lag;"
        " phases of aided loops alone follow their aiding",
    )
    imu_walk: float = setting(
        0.002, "velocity random walk of that IMU: what it notices late [m/s/sqrt(s)]",
        low=0.0, high=1.0,
    )  # fmt: skip
    wait_base: bool = setting(False, "wait for base/observations at every epoch")
    still_until_s: float = setting(
        0.0,
        "otherwise: still for that long after the first epoch, then never; 0: as phases tell [s]",
        low=0.0,
    )


class PhasePositions:
    """Displacement of a surveyed antenna from its phases, at every observation epoch.

    Parameters
    ----------
    antenna_ecef : ndarray, shape (3,)
        Surveyed, ECEF [m].
    book : EphemerisBook
        Orbits and ionosphere; shared with the engine of positions.
    config, phase, reference, spp : optional
        Settings; of the last the models of the atmosphere.
    sample_rate_hz : float, optional
        Nominal IF rate [Hz].
    """

    def __init__(
        self,
        antenna_ecef: FloatArray,
        book: EphemerisBook,
        config: PreciseConfig | None = None,
        phase: PhaseConfig | None = None,
        reference: ReferenceConfig | None = None,
        spp: SppConfig | None = None,
        sample_rate_hz: float = 4e6,
    ) -> None:
        self.sample_rate_hz = sample_rate_hz
        self.antenna: FloatArray = np.array(antenna_ecef, np.float64)
        self.config, self.book = config or PreciseConfig(), book
        self.models, self.witnessed = spp or SppConfig(), self.config.wait_motion
        self.filter = PhaseDisplacement(phase, StillReference(reference, witnessed=self.witnessed))
        self._states: deque[MotionState] = deque()
        self._motion_valid = -1
        self._kind = int(MotionKind.UNKNOWN)
        self._hidden: float | None = None
        self._orbits: dict[str, FloatArray] = {}
        self._used: dict[int, FloatArray] = {}
        self._klobuchar: FloatArray | None = None
        self._start_ns: int | None = None

    def late(self, sample_index: int) -> dict[str, int]:
        """Tell what an epoch lacks (it is not decided whether it is still), and how far it is."""
        waits = self.witnessed and self._motion_valid < sample_index
        return {"motion": self._motion_valid} if waits else {}

    @property
    def rest(self) -> FloatArray | None:
        """Where the antenna rested at the last epoch, east, north, up [m]; None: it moves."""
        return self.filter.reference.position if self.filter.at_rest else None

    @property
    def statistics(self) -> dict[str, int]:
        """Counts since the start, for diagnostics."""
        return {**self.filter.counts, **self.filter.reference.counts}

    def push_motion(self, state: MotionState) -> None:
        """Take a decision on motion, in order; nothing is kept where none is waited for."""
        if self.witnessed:
            self._states.append(state)

    def motion_valid(self, through: int) -> None:
        """All decisions through this sample have been pushed."""
        self._motion_valid = max(self._motion_valid, through)

    def solve(self, observations: Observations, known: int = EVER) -> PrecisePosition:
        """Return the precise position of an epoch; epochs come in order.

        Decisions on motion beyond the sample ``known`` do not count: not all of them are there.
        """
        o = with_discriminator(observations) if self.config.add_discriminator else observations
        gps_ns = o.week * NS_PER_WEEK + o.tow_ns
        if self._start_ns is None:
            self._start_ns = gps_ns
        time = (gps_ns - self._start_ns) / NS_PER_S
        still = self._still(min(o.sample_index, known), time)
        epoch, names = self._epoch(o, gps_ns, time)
        solution = self.filter.solve(epoch, still, self._hidden)
        return nothing(o, PHASE) if solution is None else position_of(o, names, solution)

    def _still(self, sample_index: int, time: float) -> bool:
        """Tell whether the antenna is still at an epoch, as far as others than phases know."""
        if not self.witnessed:
            return self.config.still_until_s == 0.0 or time <= self.config.still_until_s
        # From the decision on: what it says of the past must not depend on when it arrives.
        while self._states and self._states[0].valid_through <= sample_index:
            decision = self._states.popleft()
            if self._kind != decision.state:
                self._hidden = self._hidden_at(decision)
            self._kind = decision.state
        return self._kind == MotionKind.STATIC

    def _hidden_at(self, decision: MotionState) -> float:
        """Return how far the ground may have moved before a motion that the IMU found [m]."""
        late = (decision.valid_through - decision.sample_index) / self.sample_rate_hz
        return hidden_motion(self.config.imu_walk, max(0.0, late))[0]

    def _choose(
        self, o: Observations, gps_ns: int
    ) -> tuple[list[int], IntArray, list[FloatArray]]:
        """Return rows, slots and orbits of all satellites with phase and orbit.

        Once a second it is looked for better orbits.
        """
        rows, orbits = [], []
        phase = np.isfinite(o.carrier_phase_cycles + o.pseudorange + o.cn0_dbhz).tolist()
        if gps_ns % NS_PER_S == 0:
            self._orbits.clear()
        for row, name in enumerate(o.satellites):
            if name[0] != "G" or not phase[row]:
                continue
            orbit = self._orbits.get(name)
            if orbit is None:
                item = self.book.find(name, o.sample_index, gps_ns)
                if item is None:
                    continue
                orbit = self._orbits[name] = item[1]
            rows.append(row)
            orbits.append(orbit)
        slots = np.array([int(o.satellites[row][1:]) - 1 for row in rows], np.int64)
        return rows, slots, orbits

    def _residuals(
        self, o: Observations, rows: list[int], packed: FloatArray, klobuchar: FloatArray | None
    ) -> FloatArray:
        table = np.empty((len(rows), 5))
        kernels.phase_residuals(
            self.antenna, states_from_pseudoranges(packed, o.week, o.tow_ns, o.pseudorange[rows]),
            o.carrier_phase_cycles[rows] * L1_WAVELENGTH,
            NO_IONOSPHERE if klobuchar is None else klobuchar, o.tow_ns / NS_PER_S,
            self.models.troposphere, self.models.ionosphere and klobuchar is not None, table,
        )  # fmt: skip
        return table

    def _keep_biases(
        self, o: Observations, rows: list[int], slots: IntArray, orbits: list[FloatArray]
    ) -> None:
        """Carry biases over to a new orbit or ionosphere: nothing moves as models change."""
        klobuchar = self.book.klobuchar(o.sample_index)
        new_air = klobuchar is not self._klobuchar
        changed = [
            k
            for k, slot in enumerate(slots.tolist())
            if slot in self._used and (new_air or self._used[slot] is not orbits[k])
        ]
        if changed:
            where = [rows[k] for k in changed]
            old = np.array([self._used[slot] for slot in slots[changed].tolist()])
            before = self._residuals(o, where, old, self._klobuchar)
            after = self._residuals(o, where, np.array([orbits[k] for k in changed]), klobuchar)
            steps = after[:, kernels.RESIDUAL] - before[:, kernels.RESIDUAL]
            for slot, step in zip(slots[changed].tolist(), steps.tolist(), strict=True):
                self.filter.shift(slot, step)
        self._klobuchar = klobuchar
        self._used.update(zip(slots.tolist(), orbits, strict=True))

    def _epoch(self, o: Observations, gps_ns: int, time: float) -> tuple[PhaseEpoch, list[str]]:
        rows, slot, orbits = self._choose(o, gps_ns)
        self._keep_biases(o, rows, slot, orbits)
        packed = np.array(orbits).reshape(len(rows), PACKED_COLUMNS)
        table = self._residuals(o, rows, packed, self._klobuchar)
        high = table[:, kernels.ELEVATION] >= np.radians(self.filter.config.phase_mask_deg)
        rows = [row for row, fit in zip(rows, high, strict=True) if fit]
        slot, table = slot[high], table[high]
        design = np.ones((len(rows), 4))
        design[:, :CLOCK] = table[:, kernels.EAST :]
        alone = without_aiding(o)[rows]
        epoch = PhaseEpoch(
            time=time,
            interval=o.interval,
            slot=slot,
            residual=np.ascontiguousarray(table[:, kernels.RESIDUAL]),
            design=design,
            elevation=table[:, kernels.ELEVATION],
            cn0_dbhz=o.cn0_dbhz[rows].astype(np.float64),
            slipped=(o.lli[rows] & Lli.SLIP) != 0,
            lock_time=o.lock_time[rows].astype(np.float64),
            lag=self._lag(o, rows, alone),
            code_less_phase=o.pseudorange[rows] - o.carrier_phase_cycles[rows] * L1_WAVELENGTH,
            alone=alone,
            early=(o.flags[rows] & TrackingFlag.BIT_SYNC) == 0,
            held=self._held(o, rows, alone),
        )
        return epoch, [o.satellites[row] for row in rows]

    def _lag(
        self, o: Observations, rows: list[int], alone: NDArray[np.bool_]
    ) -> tuple[FloatArray, FloatArray] | None:
        """Return lags that are still in the phases: of all loops, or of those without aiding."""
        error, sd = lag_of(o, rows)
        if not self.config.add_discriminator:
            return error, sd
        return (np.where(alone, error, 0.0), np.where(alone, sd, 0.0)) if alone.any() else None

    def _held(
        self, o: Observations, rows: list[int], alone: NDArray[np.bool_]
    ) -> FloatArray | None:
        """Return what the loops' own phases are ahead of those that are used [m]."""
        return np.where(alone, 0.0, -lag_of(o, rows)[0]) if self.config.add_discriminator else None


def lag_of(o: Observations, rows: list[int]) -> tuple[FloatArray, FloatArray]:
    """Return what discriminators say that phases lag behind [m], and their open-loop sigma [m]."""
    error = np.nan_to_num(o.carrier_error_cycles[rows].astype(np.float64))
    sd = np.nan_to_num(o.carrier_error_sd_cycles[rows].astype(np.float64))
    return -L1_WAVELENGTH * error, L1_WAVELENGTH * sd


def phase_positions(
    position_ecef: Sequence[float],
    book: EphemerisBook,
    config: PreciseConfig,
    phase: PhaseConfig,
    reference: ReferenceConfig,
    spp: SppConfig,
    sample_rate_hz: float,
) -> PhasePositions | None:
    """Return what solves for displacements; None where the antenna has not been surveyed."""
    if len(position_ecef) != 3:
        return None
    return PhasePositions(
        np.array(position_ecef), book, config, phase, reference, spp, sample_rate_hz
    )


def with_discriminator(observations: Observations) -> Observations:
    """Return observations whose phases are those of the signal, as each integration shows it.

    The NCO's phase is the signal's behind the loop's filter, and in an aided loop the aiding's at
    all that is faster. With the discriminator's output it is the signal's alone, with the white
    noise of an integration. The observation's sign is against the NCO's. A loop that runs without
    its aiding is left as it is: its phase is its own, and the noise of its short integrations is
    five times that of its filter.
    """
    o = observations
    error = np.nan_to_num(o.carrier_error_cycles.astype(np.float64))
    error[without_aiding(o)] = 0.0
    return replace(o, carrier_phase_cycles=o.carrier_phase_cycles - error)


def nothing(observations: Observations, method: str) -> PrecisePosition:
    """Return the statement that an epoch has no precise position."""
    o = observations
    return PrecisePosition(
        sample_index=o.sample_index,
        week=o.week,
        tow_ns=o.tow_ns,
        valid_through=o.valid_through,
        method=method,
        status=PreciseStatus.NONE,
        displacement_enu=np.full(3, np.nan),
        covariance_enu=np.full((3, 3), np.nan),
        clock_bias=float("nan"),
        clock_bias_sd=float("nan"),
    )


def position_of(
    observations: Observations, names: list[str], solution: PhaseSolution
) -> PrecisePosition:
    """Return a solution as the value that crosses packages."""
    o, used = observations, solution.used
    placed = solution.calibrated and solution.datum == 0
    status = PreciseStatus.PHASE if placed else PreciseStatus.CALIBRATING
    own, own_sd = solution.by_loops or (np.full(3, np.nan), np.full(3, np.nan))
    return PrecisePosition(
        sample_index=o.sample_index,
        week=o.week,
        tow_ns=o.tow_ns,
        valid_through=o.valid_through,
        method=PHASE,
        status=status,
        displacement_enu=solution.displacement,
        covariance_enu=np.ascontiguousarray(solution.covariance[:CLOCK, :CLOCK]),
        clock_bias=solution.clock,
        clock_bias_sd=solution.clock_noise,
        common_covariance_enu=np.ascontiguousarray(solution.common[:CLOCK, :CLOCK]),
        satellites=tuple(name for name, use in zip(names, used, strict=True) if use),
        phase_residual=solution.residual[used].astype(np.float32),
        rejected=tuple(name for name, use in zip(names, used, strict=True) if not use),
        datum=solution.datum,
        loops_displacement_enu=own,
        loops_sd_enu=own_sd,
    )
