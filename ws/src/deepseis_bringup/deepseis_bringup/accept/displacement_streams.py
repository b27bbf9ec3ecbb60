"""Streams of displacement that come out of a run, and how they agree with the truth."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from deepseis_bringup.accept.position import true_position
from deepseis_bringup.accept.scene import Loop, Outcome, Scene
from deepseis_bringup.offline import BESIDE, Output
from deepseis_core.types import (
    Displacement,
    DisplacementSource,
    FloatArray,
    IntArray,
    PrecisePosition,
    PreciseStatus,
)

LONGEST_LAG: Final = 0.2
"""Searched on both sides [s]."""
PHASES, RTK, FUSED = "phases alone", "RTK", "fused"
"""Streams of a run; the fusion that aids its loops follows the station's own phases."""
BASED: Final = "fused with the base"
"""The same by a fusion that follows RTK and runs along."""
Truth = Callable[[FloatArray], FloatArray]
"""Displacement at times, (m, 3) [m]."""


@dataclass(frozen=True)
class Stream:
    """Displacements of a run: times [s], (m,), and east, north, up, (m, 3) [m].

    ``sd`` is what the stream says of its sigma, (m, 3) [m].
    """

    t: FloatArray
    moved: FloatArray
    sd: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))

    def between(self, begin: float, end: float) -> Stream:
        """Return the part in an interval [s]."""
        inside = (self.t >= begin) & (self.t < end)
        return Stream(self.t[inside], self.moved[inside], self.sd[inside[: len(self.sd)]])


NOTHING: Final = Stream(np.zeros(0), np.zeros((0, 3)))


@dataclass(frozen=True)
class Figures:
    """How a stream agrees with the truth.

    Attributes
    ----------
    rms, greatest : ndarray, shape (3,)
        Of the errors, east, north, up, those at rest before taken off [m].
    still : ndarray, shape (3,)
        RMS of the errors at rest, their mean taken off [m].
    greatest_horizontal : float
        [m]
    lag : float
        Of the stream behind the truth [s].
    left : float
        RMS of the horizontal error at that lag, its mean taken off [m].
    """

    rms: FloatArray
    greatest: FloatArray
    still: FloatArray
    greatest_horizontal: float
    lag: float
    left: float

    @property
    def horizontal(self) -> float:
        """RMS of the horizontal error [m]."""
        return float(np.hypot(self.rms[0], self.rms[1]))


def compare(
    stream: Stream, truth: Truth, still: tuple[float, float], moving: tuple[float, float]
) -> Figures:
    """Hold a stream against the truth while it moves; not a number where nothing came out.

    Parameters
    ----------
    stream : Stream
    truth : callable
        Displacement at times, (m, 3) [m].
    still, moving : tuple of float
        [s]
    """
    rest, part = stream.between(*still), stream.between(*moving)
    if not len(part.t):
        unknown = np.full(3, np.nan)
        return Figures(unknown, unknown, unknown, *[float("nan")] * 3)
    before = rest.moved - truth(rest.t)
    start = before.mean(axis=0) if len(rest.t) else np.zeros(3)
    error = part.moved - truth(part.t) - start
    lag = _lag(part, truth)
    return Figures(
        np.sqrt((error**2).mean(axis=0)),
        np.abs(error).max(axis=0),
        before.std(axis=0) if len(rest.t) else np.full(3, np.nan),
        float(np.hypot(error[:, 0], error[:, 1]).max()),
        lag,
        _left(part, truth, lag),
    )


def _left(part: Stream, truth: Truth, lag: float) -> float:
    apart = (part.moved - truth(part.t - lag))[:, :2]
    return float(np.sqrt(((apart - apart.mean(axis=0)) ** 2).sum(axis=1).mean()))


def _lag(part: Stream, truth: Truth) -> float:
    """Return the lag that leaves least."""
    # The best among 2 ms steps first: a long shaking has other valleys a period away.
    steps = np.arange(-LONGEST_LAG, LONGEST_LAG + 5e-4, 2e-3)
    near = float(steps[int(np.argmin([_left(part, truth, float(lag)) for lag in steps]))])
    found = minimize_scalar(
        lambda lag: _left(part, truth, lag),
        bounds=(near - 2e-3, near + 2e-3),
        method="bounded",
        options={"xatol": 1e-6},
    )
    return float(found.x)


class Listener:
    """Collects the displacements of a run."""

    def __init__(self, start_tow_ns: int) -> None:
        self.start_tow_ns = start_tow_ns
        self._positions: dict[str, list[PrecisePosition]] = {"gnss/precise": [], "gnss/rtk": []}
        self._fused: dict[str, list[Displacement]] = {FUSED: [], BASED: []}
        self.rtk_epochs = 0

    def __call__(self, output: Output) -> None:
        """Take what a run gives."""
        value = output.value
        if output.topic in self._positions:
            self.rtk_epochs += output.topic == "gnss/rtk"
            least = PreciseStatus.FIX if output.topic == "gnss/rtk" else PreciseStatus.PHASE
            if value.status >= least:
                self._positions[output.topic].append(value)
        moved = output.topic.endswith("seismo/displacement")
        if moved and value.source == DisplacementSource.FUSED and not value.smoothed:
            based = output.topic.startswith(BESIDE)
            self._fused[BASED if based else FUSED].append(value)

    def streams(self) -> dict[str, Stream]:
        """Return what came out, by its name."""
        return {
            PHASES: self._of_positions("gnss/precise"),
            RTK: self._of_positions("gnss/rtk"),
            FUSED: self._of_fused(FUSED),
            BASED: self._of_fused(BASED),
        }

    def _of_positions(self, topic: str) -> Stream:
        values = self._positions[topic]
        times = np.array([item.tow_ns for item in values], np.int64)
        moved = np.reshape([item.displacement_enu for item in values], (-1, 3))
        variance = [np.diag(np.reshape(item.covariance_enu, (3, 3))) for item in values]
        return Stream(self._seconds(times), moved, np.sqrt(np.reshape(variance, (-1, 3))))

    def _of_fused(self, name: str) -> Stream:
        parts = self._fused[name]
        if not parts:
            return NOTHING
        times = np.concatenate([item.tow_ns for item in parts])
        moved, sd = (
            np.concatenate([np.reshape(getattr(item, name), (-1, 3)) for item in parts])
            for name in ("displacement", "displacement_sd")
        )
        return Stream(self._seconds(times), moved, sd.astype(np.float64))

    def _seconds(self, tow_ns: IntArray) -> FloatArray:
        return np.asarray((tow_ns - self.start_tow_ns) * 1e-9)


@dataclass(frozen=True)
class Run:
    """What one loop made of a scene."""

    loop: Loop
    outcome: Outcome
    streams: Mapping[str, Stream]
    rtk_epochs: int


@dataclass(frozen=True)
class Shaken:
    """A scene with its truth and the runs on it."""

    scene: Scene
    truth: Truth
    runs: Sequence[Run] = ()

    def figures(self, run: Run, stream: str) -> Figures:
        """Hold a stream of a run against the truth."""
        return compare(run.streams[stream], self.truth, self.scene.still, self.scene.moving)

    def of(self, loop: str) -> Run:
        """Return the run of a loop by its name."""
        return next(run for run in self.runs if run.loop.name == loop)


def shake(scene: Scene, loops: Sequence[Loop], say: Callable[[str], None]) -> Shaken:
    """Work through a scene with every loop, aided by a fusion without the base.

    Another one, that follows RTK, runs along where there is a base.
    """
    runs = []
    for loop in loops:
        say(f"{scene.name}: {loop.name}")
        listener = Listener(scene.scenario.start.time.tow_ns)
        alone = replace(loop, fusion={**loop.fusion, "rtk": False}) if loop.aiding else loop
        outcome = scene.run(alone, listener, loop if loop.aiding and scene.base else None)
        runs.append(Run(loop, outcome, listener.streams(), listener.rtk_epochs))
    return Shaken(scene, truth_of(scene), runs)


def truth_of(scene: Scene) -> Truth:
    """Return the antenna's true displacement as a function of GPS time since the start.

    The truth file's times are the receiver's, whose clock was set wrong; streams have GPS times.
    """
    t, moved = true_position(scene)
    with np.load(scene.truth_file) as truth:
        ahead = np.interp(t, truth["t_s"], truth["clock_bias"])
    return CubicSpline(t - ahead, moved)
