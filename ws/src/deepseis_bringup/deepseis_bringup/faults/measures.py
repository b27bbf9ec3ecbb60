"""What a fault cost: what was lost, how long until all was back, which phases were wrong."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import median_filter

from deepseis_bringup.accept.loop_measures import CarrierTruth
from deepseis_bringup.faults.record import LOCK, RunRecord, Said, Timeline
from deepseis_core.types import FloatArray, IntArray, Lli

SETTLED_EPOCHS: Final = 25
"""Over so many epochs, half a second, a change of cycles is told from noise and dynamics."""
CYCLES_PER_MS: Final = 1575420
"""A whole millisecond of the receiver's clock moves time, code and phase together."""
BEFORE_S: Final = 2.0
"""What was there so long before a fault is to be there after it [s]."""
LOCKED_STEP_S: Final = 0.02
"""Integrations of a locked satellite; in pull-in they are shorter [s]."""
NORMAL_GAP_S: Final = 0.05
"""Of integrations of a locked satellite: two of 20 ms, and room [s]."""
NEAR_CYCLES: Final = 0.12
"""Less than half of half a cycle: two that lie apart by a slip are not near."""
TOLERANCE_S: Final = 2e-3
"""Of times of validity [s]."""
HELD_S: Final = 1.0
"""What is back stays back so long [s]: until then it is not counted as back."""


Timelines = Mapping[str, Timeline]


@dataclass(frozen=True)
class WrongCycles:
    """A satellite's phase against the truth.

    Attributes
    ----------
    satellite : str
    changes : int
        Changes of cycles, halves too, that no loss-of-lock mark announces: must be 0.
    epochs : int
        Epochs without a mark whose phase is off by more than a quarter of a cycle.
    marks : int
        Loss-of-lock marks after the first.
    greatest : float
        Greatest deviation within an arc [cycles].
    times : tuple of float
        When changes and epochs off were; of the latter the first of each second [s].
    """

    satellite: str
    changes: int
    epochs: int
    marks: int
    greatest: float
    times: tuple[float, ...] = ()


def wrong_cycles(
    record: RunRecord, truth: CarrierTruth, begin: float, end: float
) -> list[WrongCycles]:
    """Compare the phases of every satellite with the truth between two moments [s].

    An arc lasts from one mark to the next; whatever lies between, holes too, belongs to it.
    Epochs that say themselves that they may be half a cycle off are left out. Constants of the
    others are whole cycles apart: a loop's phase is right where its discriminator shows nothing,
    and that is told by the longest arc. A short one, in a loop under stress, has no place of its
    own where most of it lies.
    """
    found = []
    for name, (t, phase, lli) in record.observed().items():
        if name not in truth.satellites:
            continue
        spline = CubicSpline(truth.t, truth.phase_cycles[:, truth.satellites.index(name)])
        inside = (t >= begin) & (t < min(end, truth.t[-1])) & np.isfinite(phase)
        t, phase, marks = t[inside], phase[inside], lli[inside].astype(np.int64)
        constant = phase + spline(t)
        constant -= CYCLES_PER_MS * np.round((constant - constant[:1]) / CYCLES_PER_MS)
        starts = (marks & int(Lli.SLIP)) != 0
        starts[:1] = True
        arcs = np.split(np.arange(t.size), np.flatnonzero(starts)[1:])
        known = (marks & int(Lli.HALF_CYCLE)) == 0
        arcs = [arc for rows in arcs if (arc := rows[known[rows]]).size]
        changes = epochs = 0
        greatest, times = 0.0, list[float]()
        for arc, off in zip(arcs, deviations(constant, arcs), strict=True):
            greatest = max(greatest, float(np.abs(off).max()))
            far = np.abs(off) > 0.25
            epochs += int(far.sum())
            settled = median_filter(off, min(SETTLED_EPOCHS, off.size), mode="nearest")
            (changed,) = np.nonzero(np.diff(np.round(2.0 * settled)))
            changes += changed.size
            _, firsts = np.unique(np.floor(t[arc][far]), return_index=True)
            times += [*t[arc[1:]][changed].tolist(), *t[arc][far][firsts].tolist()]
        marked = int(starts[1:].sum())
        found.append(WrongCycles(name, changes, epochs, marked, greatest, tuple(sorted(times))))
    return found


def deviations(constant: FloatArray, arcs: Sequence[IntArray]) -> list[FloatArray]:
    """Return by what the epochs of each arc are off [cycles].

    Parameters
    ----------
    constant : ndarray, shape (n,)
        Phase less truth [cycles].
    arcs : sequence of ndarray
        Epochs of each; empty ones have no deviations.

    Examples
    --------
    >>> moved = np.array([7.0, 7.0, 7.01, 9.2, 8.9])
    >>> first, second = deviations(moved, [np.arange(3), np.arange(3, 5)])
    >>> print(np.round(first, 2), np.round(second, 2))
    [0.   0.   0.01] [ 0.2 -0.1]
    """
    filled = [arc for arc in arcs if arc.size]
    if not filled:
        return []
    base = constant_of(constant[max(filled, key=len)])
    off = [constant[arc] - base for arc in filled]
    return [values - np.round(np.median(values)) for values in off]


def constant_of(values: FloatArray) -> float:
    """Return where most of an arc's values lie [cycles], to less than their noise.

    Examples
    --------
    >>> constant_of(np.array([7.0, 7.01, 7.5, 7.5, 7.51]))
    7.5
    """
    near = np.abs(values[:, None] - _some(values)[None]) < NEAR_CYCLES
    centre = _some(values)[int(np.argmax(near.sum(axis=0)))]
    return float(np.median(values[np.abs(values - centre) < NEAR_CYCLES]))


def _some(values: FloatArray) -> FloatArray:
    return values[:: max(1, values.size // 64)]


@dataclass(frozen=True)
class Loss:
    """What a fault from ``begin`` to ``end`` [s] took from the output, and until when.

    Attributes
    ----------
    missing : dict
        Seconds without aiding, position, displacement by phases, fused displacement.
    satellites : int
        That lost phase lock.
    back : dict
        Seconds after the end of the fault until each is back to stay; infinite: it is not.
    """

    missing: dict[str, float]
    satellites: int
    back: dict[str, float]

    @property
    def recovery(self) -> float:
        """Seconds until all is back."""
        return max(self.back.values())

    @property
    def slowest(self) -> str:
        """Name what came back last."""
        return max(self.back, key=lambda name: self.back[name])

    def text(self) -> str:
        """Say what was lost."""
        parts = [
            f"{name} {seconds:.2f} s" for name, seconds in self.missing.items() if seconds > 0.03
        ]
        parts += [f"{self.satellites} satellites' lock"] if self.satellites else []
        return ", ".join(parts) or "nothing"


def loss_of(timelines: Timelines, begin: float, end: float, until: float) -> Loss:
    """Tell what a fault took, from its beginning to ``until`` [s].

    Parameters
    ----------
    timelines : mapping
        From `RunRecord.timelines`.
    begin, end : float
        Of the fault [s].
    until : float
        Looked at so far [s].
    """
    parts = {name: _cut(line, begin - BEFORE_S, until) for name, line in timelines.items()}
    back, lost = {}, 0
    for name, (t, good) in parts.items():
        before = good[t < begin]
        if name.startswith(LOCK):
            if not before.size or not before.all():
                continue
            since = t >= begin
            hole = np.diff(np.concatenate(([begin], t[since], [until]))).max() > NORMAL_GAP_S
            lost += bool(hole or not good[since].all())
        step = LOCKED_STEP_S if name.startswith(LOCK) else _step(timelines[name])
        back[name] = _back(t[good], step, end, until)
    missing = {
        name: _missing(part[0][part[1]], _step(timelines[name]), begin, until)
        for name, part in parts.items()
        if not name.startswith(LOCK)
    }
    return Loss(missing, lost, back)


def _cut(line: Timeline, begin: float, until: float) -> Timeline:
    t, good = line
    low, high = np.searchsorted(t, (begin, until))
    return t[low:high], good[low:high]


def _step(line: Timeline) -> float:
    return float(np.median(np.diff(line[0][:2000]))) if line[0].size > 1 else 0.0


def _missing(good: FloatArray, step: float, begin: float, until: float) -> float:
    """Return for how long [s] there was nothing good between two moments."""
    inside = good[(good >= begin) & (good < until)]
    holes = np.diff(np.concatenate(([begin], inside, [until])))
    return float(np.where(holes > 1.5 * step + TOLERANCE_S, holes - step, 0.0).sum())


def _back(good: FloatArray, step: float, end: float, until: float) -> float:
    """Return how long after ``end`` [s] a stream is good again and stays so for a while."""
    after = good[good >= end - 1.5 * step]
    if not after.size or until - after[-1] > 2.5 * step + NORMAL_GAP_S:
        return float("inf")  # it ends without it
    # The last hole that begins within reach of the fault; later ones are other events.
    first = after[0]
    for hole in np.flatnonzero(np.diff(after) > 1.5 * step + TOLERANCE_S):
        if after[hole] - max(first, end) < HELD_S:
            first = after[hole + 1]
    gap = float(first) - end
    return gap if gap > 1.5 * step + TOLERANCE_S else 0.0


@dataclass(frozen=True)
class Deviation:
    """Greatest error of a displacement [m] and of the error in its own sigmas."""

    greatest: float
    in_sigmas: float


def deviation(
    t: FloatArray,
    moved: FloatArray,
    sd: FloatArray | None,
    truth: Callable[[FloatArray], FloatArray],
    still: tuple[float, float],
    span: tuple[float, float],
) -> Deviation:
    """Hold displacements (m, 3) against the truth within a span [s]; its error at rest is off."""
    rest, inside = (t >= still[0]) & (t < still[1]), (t >= span[0]) & (t < span[1])
    if not inside.any():
        return Deviation(float("nan"), float("nan"))
    start = (moved[rest] - truth(t[rest])).mean(axis=0) if rest.any() else np.zeros(3)
    error = moved[inside] - truth(t[inside]) - start
    ratio = float("nan") if sd is None else float(np.abs(error / sd[inside]).max())
    return Deviation(float(np.linalg.norm(error, axis=1).max()), ratio)


def complaints(said: Sequence[Said], begin: float, until: float) -> list[Said]:
    """Return the first warning or error of every node in a span of time."""
    first: dict[str, Said] = {}
    for item in said:
        quiet = {s.text for s in said if s.node == item.node and s.level and s.time < begin - 1.0}
        if item.level and begin <= item.time < until and item.text not in quiet:
            first.setdefault(item.node, item)
    return list(first.values())
