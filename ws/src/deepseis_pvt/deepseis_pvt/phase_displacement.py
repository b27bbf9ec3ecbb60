"""Displacement of one antenna from carrier phases, without a base, epoch by epoch.

Before the event the antenna is known to be still where it was surveyed, and each satellite's phase
residual there calibrates a bias (ambiguity, atmosphere, orbit, satellite clock) and its slow
rate. In the event every epoch is solved for displacement and receiver clock by itself. Biases and
rates are the states of a filter (`phase_kernels`); they drift on by random walks, so the
covariance grows with the time since the calibration, and what satellites disagree on beyond four
unknowns goes on calibrating them. Stillness adds that the displacement is known: then all but the
clock does.

The scheme is variometric ("temporal point positioning"): G. Colosimo, M. Crespi and A. Mazzoni,
"Real-time GPS seismology with a stand-alone receiver", J. Geophys. Res. 116, B11302, 2011, with
differences to a filtered past in place of the last epoch, so that nothing is integrated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from deepseis_core.config import check
from deepseis_core.hidden_motion import LEAST_HIDDEN
from deepseis_core.types import FloatArray, IntArray
from deepseis_pvt import phase_kernels as kernels
from deepseis_pvt.creep_level import CreepLevel
from deepseis_pvt.loop_lag import LoopLag
from deepseis_pvt.phase_fit import Fit
from deepseis_pvt.phase_search import SlipSearch
from deepseis_pvt.phase_values import PhaseConfig, PhaseEpoch, PhaseSolution
from deepseis_pvt.rest_memory import STEP_S, RestMemory, hold
from deepseis_pvt.still_reference import StillReference

SLOTS: Final = 32
"""Satellites that the filter has room for: a slot for each GPS PRN."""
CLOCK: Final = 3
"""Index of the clock in the free part; before it east, north, up."""
FEWEST_BELIEVED: Final = 5
"""Satellites whose arcs must reach back for what was learnt since to be forgotten."""
FEWEST_AFLOAT: Final = 5
"""Satellites whose phases go on together from a place that is not known."""
LONGEST_GAP: Final = 60.0
"""A satellite that has been away for longer begins anew [s]."""


@dataclass(frozen=True)
class Biases:
    """State and covariance of the biases' filter, the arc of each slot, and how they creep.

    ``epoch`` is the one they are known after, ``noise`` the variance of its phases [m^2].
    """

    state: FloatArray
    P: FloatArray
    arc: IntArray
    creep: tuple[FloatArray, float, float]
    epoch: PhaseEpoch
    noise: FloatArray


class PhaseDisplacement:
    """Calibrates while the antenna is still, and solves every epoch.

    Parameters
    ----------
    config : PhaseConfig, optional
        Settings.
    reference : StillReference, optional
        Where the antenna is when it is still.

    Attributes
    ----------
    noise_level : float
        Variance of the phases as residuals show it, over that of the model [-], at least 1.
    creep : CreepLevel
        How biases creep against what the settings allow.
    calibrated : float
        Stillness so far [s].
    stress : ndarray, shape (3, 3)
        Covariance of what the loops make displacements lag behind [m^2].
    at_rest : bool
        At the last epoch the antenna was where ``reference`` says.
    doubts : bool
        At the last epoch a rest ended whose last part is not believed.
    datum : int
        0: displacements are from the surveyed place. Otherwise all phases were lost in motion, so
        often until now, and displacements are from where the antenna was when they went on.
    """

    def __init__(
        self, config: PhaseConfig | None = None, reference: StillReference | None = None
    ) -> None:
        self.config = c = config or PhaseConfig()
        check(c)
        self.state: FloatArray = np.zeros(2 * SLOTS)
        self.P: FloatArray = np.zeros((2 * SLOTS, 2 * SLOTS))
        self.reference = reference or StillReference()
        self.noise_level, self.calibrated, self.at_rest, self.doubts = 1.0, 0.0, False, False
        self.creep = CreepLevel(c.bias_walk**2, c.bias_rate_sd**2, c.bias_rate_memory_s, SLOTS)
        self.memory = RestMemory[Biases](c.doubt_s)
        self._arc: IntArray = np.zeros(SLOTS, np.int64)
        self._growth: FloatArray = np.zeros(SLOTS)
        self._seen: FloatArray = np.full(SLOTS, -np.inf)
        self._broken: NDArray[np.bool_] = np.zeros(SLOTS, np.bool_)
        self._time: float | None = None
        self._lag = LoopLag()
        self.stress: FloatArray = np.zeros((3, 3))
        self._limits = [float(chdtri(n, c.phase_false_alarm)) for n in range(1, SLOTS + 1)]
        self._together = SlipSearch[Fit](lambda found: found.chi_square)
        self.datum = 0
        self.counts = {"slips_found": 0, "arcs": 0, "contradictions": 0, "doubted": 0, "afloat": 0}

    @property
    def members(self) -> IntArray:
        """Slots in use."""
        return np.flatnonzero(self._seen > -np.inf)

    def shift(self, slot: int, change: float) -> None:
        """Take account of a changed model: a satellite's residuals have moved by so much [m]."""
        self.state[slot] += change
        for kept in self.memory.values():
            kept.state[slot] += change
            kept.epoch.residual[kept.epoch.slot == slot] += change
        self.creep.breaks(np.array([slot]))

    def solve(
        self, epoch: PhaseEpoch, still: bool, hidden: float | None = None
    ) -> PhaseSolution | None:
        """Work an epoch through; None if it has no solution.

        Parameters
        ----------
        epoch : PhaseEpoch
        still : bool
            The antenna does not move, as far as others than the phases know.
        hidden : float, optional
            How far it may have moved before a motion was noticed [m]; as the settings say.
        """
        dt = self._drift(epoch)
        model = self.config.variance(epoch.cn0_dbhz, epoch.elevation, epoch.alone)
        noise = self.noise_level * model
        gap = epoch.time - self._seen[epoch.slot]
        self._broken[epoch.slot] |= epoch.slipped | (epoch.lock_time < gap - 0.5 * epoch.interval)
        self.doubts = bool(self.memory) and (self.reference.moved or not still)
        if self.doubts:
            sd = self.config.hidden_motion_sd if hidden is None else hidden
            self.doubts = sd >= LEAST_HIDDEN and self._doubt(epoch, sd)
            self.memory.clear()
        known = np.isfinite(self._seen[epoch.slot]) & ~self._broken[epoch.slot]
        innovation = epoch.residual - self.state[epoch.slot]
        free, refused = self._free(epoch, innovation, noise, known)
        solution = None
        if free is not None:
            solution = self._solution(epoch, free, refused, noise)
        self.at_rest = self._is_at_reference(epoch.time, still, None if self.datum else solution)
        good = known & ~refused
        if self.at_rest and self.datum:
            good, self.datum = self._all_anew(epoch), 0
        elif free is None and not self.at_rest and self._can_go_on(epoch):
            self.counts["afloat"] += 1
            good, self.datum = self._all_anew(epoch), self.counts["afloat"]
            free = Fit.at_beginning(epoch, CLOCK + 1)
        self._calibrate(epoch, innovation, noise, good, free, self.at_rest)
        self._watch_creep(epoch, model, ~good)
        self.calibrated += dt if self.at_rest and self.members.size >= CLOCK + 1 else 0.0
        if self.at_rest and self.memory.due(epoch.time):
            state, P, arc = self.state.copy(), self.P.copy(), self._arc.copy()
            kept = Biases(state, P, arc, self.creep.known, epoch, noise)
            self.memory.keep(epoch.time, kept)
        return solution

    def _doubt(self, epoch: PhaseEpoch, sd: float) -> bool:
        """Go back to what was known before the part of a rest that is not believed.

        Of that part is believed that the antenna had moved no farther than ``sd`` [m] when its
        last second was kept. False where too few arcs go back so far.
        """
        recalled = self.memory.recall(epoch.time)
        if recalled is None:
            return False
        known, last = recalled
        same = (known.arc == self._arc) & (last.arc == self._arc)
        rest = last.epoch
        goes_on = same[rest.slot]
        if goes_on.sum() < FEWEST_BELIEVED:
            return False
        self.counts["doubted"] += 1
        self.state, self.P, self.creep.known = known.state, known.P, known.creep
        for begun in np.flatnonzero(~same).tolist():
            self._forget(begun)
        self._creep_for(rest.time - known.epoch.time)
        slot, design = rest.slot[goes_on], rest.design[goes_on]
        y = rest.residual[goes_on] - design[:, :CLOCK] @ self.reference.position
        hold(self.state, self.P, slot, y - self.state[slot], design, last.noise[goes_on], sd)
        self._creep_for(epoch.time - rest.time)
        return True

    def _is_at_reference(self, time: float, still: bool, solution: PhaseSolution | None) -> bool:
        nothing = np.zeros((3, 3))
        if solution is None:
            return self.reference.decide(time, still, None, nothing, nothing)
        biases = solution.common[:3, :3] - self.reference.covariance
        parts = solution.covariance[:3, :3], biases
        return self.reference.decide(time, still, solution.displacement, *parts)

    def _drift(self, epoch: PhaseEpoch) -> float:
        """Carry the state to the epoch; forget satellites long gone."""
        dt = 0.0 if self._time is None else epoch.time - self._time
        self._time = epoch.time
        growth = 1.0 / np.sin(epoch.elevation) ** 2
        self._growth[epoch.slot] = growth
        if dt > 0.0:
            self._creep(dt)
        for slot in self.members[epoch.time - self._seen[self.members] > LONGEST_GAP]:
            self._forget(int(slot))
        return dt

    def _creep(self, dt: float) -> None:
        """Let biases creep on for a moment [s]."""
        c = self.config
        kernels.propagate(
            self.state, self.P, self.members, self.creep.walk_level * c.bias_walk**2,
            self.creep.rate_level * c.bias_rate_sd**2 * self._growth, c.bias_rate_memory_s, dt,
        )  # fmt: skip

    def _creep_for(self, seconds: float) -> None:
        steps = math.ceil(seconds / STEP_S)
        for _ in range(steps):
            self._creep(seconds / steps)

    def _watch_creep(self, epoch: PhaseEpoch, noise: FloatArray, anew: NDArray[np.bool_]) -> None:
        """Let phases at rest tell how biases creep.

        Their noise is the model's: a level that residuals raise may be creep itself.
        """
        if anew.any():
            self.creep.breaks(epoch.slot[anew])
        if not self.at_rest:
            self.creep.moved()
            return
        place = epoch.design[:, :CLOCK] @ self.reference.position
        shared = self._shared(epoch)
        growth = self._growth[epoch.slot]
        self.creep.push(epoch.time, epoch.slot, epoch.residual - place, noise, growth, shared)

    def _shared(self, epoch: PhaseEpoch) -> float:
        """Return how many epochs share the noise of a loop slower than they come."""
        return max(1.0, 0.5 / (epoch.interval * self.config.loop_bandwidth_hz))

    def _fit(
        self, epoch: PhaseEpoch, y: FloatArray, noise: FloatArray, good: NDArray[np.bool_],
        design: FloatArray,
    ) -> Fit | None:  # fmt: skip
        rows = np.flatnonzero(good)
        m, p = len(rows), design.shape[1]
        found = Fit(
            rows, np.empty(p), np.empty((p, p)), np.empty((p, m)), np.empty(m), np.empty(m), -1.0
        )
        if m < p:
            return None
        found.chi_square = kernels.fit(
            self.P, epoch.slot[rows], y[rows], design[rows], noise[rows],
            found.x, found.C, found.G, found.residual, found.normalised,
        )  # fmt: skip
        return found if found.chi_square >= 0.0 else None

    def _free(
        self, epoch: PhaseEpoch, y: FloatArray, noise: FloatArray, known: NDArray[np.bool_]
    ) -> tuple[Fit | None, NDArray[np.bool_]]:
        """Solve for displacement and clock, without the satellites that the others contradict."""
        refused = np.zeros(len(known), np.bool_)
        found = self._fit(epoch, y, noise, known, epoch.design)
        for _ in range(self.config.max_slips):
            if found is None or self._passes(found) or found.freedom < 2:
                break
            worst = found.rows[int(np.argmax(np.abs(found.normalised)))]
            refused[worst] = True
            found = self._fit(epoch, y, noise, known & ~refused, epoch.design)
        if refused.sum() > 1 or (found is not None and not self._passes(found)):
            together = self._together.search(
                epoch.time, known, self.config.max_slips,
                lambda good: self._agreeing(self._fit(epoch, y, noise, good, epoch.design)),
            )  # fmt: skip
            found, refused = together or (found, refused)
        if found is None or found.freedom == 0:
            return found, refused
        if not self._passes(found):
            self.counts["contradictions"] += 1
        self._learn_noise(found, epoch.interval)
        self.counts["slips_found"] += int(refused.sum())
        return found, refused

    def _agreeing(self, found: Fit | None) -> Fit | None:
        return found if found is not None and found.freedom > 1 and self._passes(found) else None

    def _passes(self, found: Fit) -> bool:
        return found.freedom == 0 or found.chi_square <= self._limits[found.freedom - 1]

    def _learn_noise(self, found: Fit, interval: float) -> None:
        """Follow the level of noise that the residuals show: motion is not in them."""
        shown = min(found.chi_square / found.freedom, 9.0) * self.noise_level
        weight = min(1.0, interval / self.config.noise_memory_s)
        self.noise_level = max(1.0, self.noise_level + weight * (shown - self.noise_level))

    def _solution(
        self, epoch: PhaseEpoch, found: Fit, refused: NDArray[np.bool_], noise: FloatArray
    ) -> PhaseSolution:
        covariance = found.C.copy()
        if not self._passes(found):
            covariance *= found.chi_square / found.freedom
        variance = (found.G**2) @ noise[found.rows]
        common = covariance - (found.G * noise[found.rows]) @ found.G.T
        self.stress = np.zeros((3, 3))
        if epoch.lag is not None:
            error, sd = (values[found.rows] for values in epoch.lag)
            self.stress = self._lag.push(error, sd, found.G[:CLOCK], epoch.interval)
        common[:3, :3] += self.reference.covariance
        covariance[:3, :3] += self.reference.covariance + self.stress
        residual = np.full(len(refused), np.nan)
        residual[found.rows] = found.residual
        walk = self.creep.walk_level * self.config.bias_walk**2
        drift = walk * float((found.G[CLOCK] ** 2).sum())
        return PhaseSolution(
            displacement=found.x[:3].copy(),
            clock=float(found.x[CLOCK]),
            covariance=covariance,
            common=common,
            clock_noise=float(np.sqrt(2.0 * variance[CLOCK] + drift)),
            residual=residual,
            used=np.isfinite(residual),
            refused=refused,
            calibrated=self.calibrated >= self.config.calibration_s,
            datum=self.datum,
            by_loops=self._by_loops(epoch, found, common, variance),
        )

    def _by_loops(
        self, epoch: PhaseEpoch, found: Fit, common: FloatArray, variance: FloatArray
    ) -> tuple[FloatArray, FloatArray] | None:
        """Return the displacement by the loops' own phases, and its sigmas [m].

        Biases are the same; noise is that of the loops' bandwidth.
        """
        if epoch.held is None:
            return None
        c = self.config
        moved = found.x[:CLOCK] + found.G[:CLOCK] @ epoch.held[found.rows]
        noise = variance[:CLOCK] * min(1.0, c.own_bandwidth_hz / c.loop_bandwidth_hz)
        return moved, np.sqrt(np.diag(common)[:CLOCK] + noise)

    def _calibrate(
        self, epoch: PhaseEpoch, y: FloatArray, noise: FloatArray, good: NDArray[np.bool_],
        free: Fit | None, still: bool,
    ) -> None:  # fmt: skip
        """Let biases learn, and give satellites that begin an arc theirs."""
        found, design = free, epoch.design
        offset = np.zeros(len(y))
        if still:
            design = np.ascontiguousarray(epoch.design[:, CLOCK:])
            offset = epoch.design[:, :CLOCK] @ self.reference.position
            found = self._fit(epoch, y - offset, noise, good, design)
            if found is None:
                found, self.calibrated = Fit.at_beginning(epoch, 1), 0.0
        if found is None:
            return
        starts = ~good & epoch.settled(self.config.datum_lock_s) if self.datum else ~good
        rows, fresh = found.rows, np.flatnonzero(starts)
        slow = noise * self._shared(epoch)
        started = self._start(epoch, found, fresh, design, offset, slow)
        if len(rows) > len(found.x):
            kernels.absorb(
                self.state, self.P, self.members, epoch.slot[rows], (y - offset)[rows],
                design[rows], slow[rows],
            )  # fmt: skip
        self._enter(epoch, fresh, *started)
        self._seen[epoch.slot[good | starts]] = epoch.time

    def _can_go_on(self, epoch: PhaseEpoch) -> bool:
        """Tell whether phases are there again after all were lost in motion.

        Displacements then go on from wherever the antenna is: who knows that, as an INS does for
        some seconds, has millimetres again.
        """
        return (
            self.reference.moved
            and int(epoch.settled(self.config.datum_lock_s).sum()) >= FEWEST_AFLOAT
        )

    def _all_anew(self, epoch: PhaseEpoch) -> NDArray[np.bool_]:
        """Let no bias hold any more; return which satellites of the epoch are known: none."""
        for slot in self.members.tolist():
            self._forget(slot)
        return np.zeros(len(epoch.slot), np.bool_)

    def _start(
        self, epoch: PhaseEpoch, found: Fit, fresh: IntArray, design: FloatArray,
        offset: FloatArray, noise: FloatArray,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
        """Work out biases that begin at this epoch, and their covariances."""
        bias = epoch.residual[fresh] - offset[fresh] - design[fresh] @ found.x
        rows, block = np.zeros((len(fresh), 2 * SLOTS)), np.zeros((len(fresh), len(fresh)))
        if len(fresh):
            kernels.introduce(
                self.P, self.members, epoch.slot[found.rows], found.C, found.G,
                epoch.slot[fresh], np.ascontiguousarray(design[fresh]), noise[fresh], rows, block,
            )  # fmt: skip
        return bias, rows, block

    def _enter(
        self, epoch: PhaseEpoch, fresh: IntArray, bias: FloatArray, rows: FloatArray,
        block: FloatArray,
    ) -> None:  # fmt: skip
        """Put new biases into the filter; the rate of a satellite that had one goes on."""
        slots = epoch.slot[fresh]
        for k, slot in enumerate(slots.tolist()):
            if self._seen[slot] == -np.inf:
                rate = SLOTS + slot
                self.state[rate] = 0.0
                self.P[rate, :] = self.P[:, rate] = 0.0
                self.P[rate, rate] = (self.config.bias_rate_sd**2) * self._growth[slot]
            self.state[slot] = bias[k]
            row = rows[k].copy()
            row[slots] = 0.0
            self.P[slot, :] = self.P[:, slot] = row
        self.P[np.ix_(slots, slots)] = block
        self._broken[slots] = False
        self._arc[slots] += 1
        self.counts["arcs"] += len(slots)

    def _forget(self, slot: int) -> None:
        for index in (slot, SLOTS + slot):
            self.P[index, :] = self.P[:, index] = 0.0
            self.state[index] = 0.0
        self._arc[slot] += 1
        self._seen[slot] = -np.inf
