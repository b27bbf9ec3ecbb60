"""Acceptance of displacements: the benchmark of deeply coupled seismogeodesy, and our goals.

Each scene is simulated once and worked through with a plain loop and with an aided one. Three
streams are held against the truth: displacement by the plain loop's phases, by the aided loop's
phases (both without a base, epoch by epoch) and the fused one. Their error is split as the
published benchmark has it: a lag, found by shifting the truth, and what is left at that lag.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from deepseis_bringup.accept import Acceptance, Goal, Row
from deepseis_bringup.accept_displacement_figures import displacement_figures
from deepseis_bringup.accept_position import true_position
from deepseis_bringup.accept_scene import Loop, Scene, aided
from deepseis_bringup.offline import Output
from deepseis_bringup.report_plot import Figure
from deepseis_core.types import (
    Displacement,
    DisplacementSource,
    FloatArray,
    IntArray,
    PrecisePosition,
    PreciseStatus,
)

Say = Callable[[str], None]

LONGEST_LAG: Final = 0.2
"""Searched on both sides [s]."""
PLAIN, AIDED, FUSED = "plain PLL 15 Hz", "IMU-aided PLL 8 Hz", "fused, six degrees of freedom"
BENCHMARK: Final = {PLAIN: (6.0, 56.5), AIDED: (1.9, 8.0), FUSED: (0.9, 3.5)}
"""GRL 2020, a shaken Wenchuan record of 0.5 to 2 g: amplitude error [mm], lag [ms]."""
HORIZONTAL, VERTICAL = 3.0, 8.0
"""Goal of displacement in real time without a base, RMS [mm]."""
TABLE: Final = "GRL 2020 benchmark"
SCENES: Final[dict[str, tuple[str, ...]]] = {
    "sine-2hz": (),
    "quake": (),
    "shake-table": (),
}


@dataclass(frozen=True)
class Stream:
    """Displacements of a run: times [s], (m,), and east, north, up, (m, 3) [m]."""

    t: FloatArray
    moved: FloatArray

    def between(self, begin: float, end: float) -> Stream:
        """Return the part in an interval [s]."""
        inside = (self.t >= begin) & (self.t < end)
        return Stream(self.t[inside], self.moved[inside])


@dataclass(frozen=True)
class Figures:
    """How a stream agrees with the truth.

    Attributes
    ----------
    rms, greatest : ndarray, shape (3,)
        Of the errors, east, north, up, those at rest before taken off [m].
    lag : float
        Of the stream behind the truth [s].
    left : float
        RMS of the horizontal error at that lag, its mean taken off [m].
    """

    rms: FloatArray
    greatest: FloatArray
    lag: float
    left: float


def compare(
    stream: Stream,
    truth: Callable[[FloatArray], FloatArray],
    still: tuple[float, float],
    moving: tuple[float, float],
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
        return Figures(unknown, unknown, float("nan"), float("nan"))
    start = (rest.moved - truth(rest.t)).mean(axis=0) if len(rest.t) else np.zeros(3)
    error = part.moved - truth(part.t) - start

    def left(lag: float) -> float:
        apart = (part.moved - truth(part.t - lag))[:, :2]
        return float(np.sqrt(((apart - apart.mean(axis=0)) ** 2).sum(axis=1).mean()))

    # The best lag among 1 ms steps first: a long shaking has other valleys a period away.
    steps = np.arange(-LONGEST_LAG, LONGEST_LAG + 5e-4, 2e-3)
    near = float(steps[int(np.argmin([left(float(lag)) for lag in steps]))])
    found = minimize_scalar(left, bounds=(near - 2e-3, near + 2e-3), method="bounded",
                            options={"xatol": 1e-6})  # fmt: skip
    return Figures(
        np.sqrt((error**2).mean(axis=0)),
        np.abs(error).max(axis=0),
        float(found.x),
        left(float(found.x)),
    )


class Listener:
    """Collects the displacements of a run."""

    def __init__(self, start_tow_ns: int) -> None:
        self.start_tow_ns = start_tow_ns
        self._precise: list[PrecisePosition] = []
        self._fused: list[Displacement] = []

    def __call__(self, output: Output) -> None:
        """Take what a run gives."""
        if output.topic == "gnss/precise" and output.value.status >= PreciseStatus.PHASE:
            self._precise.append(output.value)
        fused = output.topic == "seismo/displacement"
        if fused and output.value.source == DisplacementSource.FUSED:
            self._fused.append(output.value)

    def phases(self) -> Stream:
        """Return displacements by phases."""
        times = np.array([item.tow_ns for item in self._precise], np.int64)
        moved = [item.displacement_enu for item in self._precise]
        return Stream(self._seconds(times), np.reshape(moved, (-1, 3)))

    def fused(self) -> Stream:
        """Return the fused ones."""
        parts = self._fused
        if not parts:
            return Stream(np.zeros(0), np.zeros((0, 3)))
        times = np.concatenate([item.tow_ns for item in parts])
        return Stream(self._seconds(times), np.concatenate([item.displacement for item in parts]))

    def _seconds(self, tow_ns: IntArray) -> FloatArray:
        return np.asarray((tow_ns - self.start_tow_ns) * 1e-9)


def accept_displacement(folder: Path, *, short: bool, say: Say = lambda _text: None) -> Acceptance:
    """Measure displacements of one station without a base.

    Parameters
    ----------
    folder : Path
        Gets ``displacement.csv`` and ``displacement.html``.
    short : bool
        Short forms of the scenarios.
    say : callable, optional
        Told what is done.
    """
    form = "short forms" if short else "full forms"
    acceptance = Acceptance("displacement", f"Displacement of one station, {form}")
    acceptance.remarks.append(
        "The benchmark's Wenchuan record is not at hand: our scenes stand in for it."
    )
    pictures: list[Figure] = []
    with tempfile.TemporaryDirectory(dir=folder, prefix=".input.") as place:
        for name, settings in SCENES.items():
            say(f"{name}: simulating")
            scene = Scene(name, Path(place), short=short, settings=settings)
            if scene.stands_in:
                acceptance.remarks.append(f"{name}: an artificial motion stands in.")
            rows, figures = measure_scene(scene, say)
            acceptance.add(*rows)
            pictures += figures
    acceptance.figures.append((TABLE, pictures))
    acceptance.write(folder)
    return acceptance


def measure_scene(scene: Scene, say: Say) -> tuple[list[Row], list[Figure]]:
    """Return lines and pictures of one scene."""
    t, moved = true_position(scene)
    truth = CubicSpline(t, moved)
    rows: list[Row] = []
    streams: dict[str, Stream] = {}
    for loop in (plain(), aided(8.0)):
        say(f"{scene.name}: {loop.name}")
        listener = Listener(scene.scenario.start.time.tow_ns)
        scene.run(loop, listener)
        streams[AIDED if loop.aiding else PLAIN] = listener.phases()
        if loop.aiding:
            streams[FUSED] = listener.fused()
    for name, stream in streams.items():
        figures = compare(stream, truth, scene.still, scene.moving)
        rows += _rows(scene.name, name, figures)
    return rows, displacement_figures(scene.name, streams, truth, scene.still, scene.moving)


def plain() -> Loop:
    """Return a conventional loop as a receiver has it: found again when it is lost."""
    settings = {"pll_order": 2, "pll_bandwidth_hz": 15.0}
    return replace(aided(15.0), name=PLAIN, aiding="", tracker=settings)


def _rows(scene: str, stream: str, figures: Figures) -> Sequence[Row]:
    table, live = TABLE, "real time, no base"
    amplitude, lag = BENCHMARK[stream]
    ours = 1e3 * figures.left, 1e3 * abs(figures.lag)
    rms, greatest = 1e3 * figures.rms, 1e3 * figures.greatest
    horizontal = float(np.hypot(rms[0], rms[1]))
    goals = (Goal.at_most(HORIZONTAL), Goal.at_most(VERTICAL))
    bound = goals if stream != PLAIN else (None, None)
    of_all = f"{scene}, {stream}"
    return [
        Row(table, of_all, "amplitude error, horizontal", "mm", ours[0], amplitude,
            Goal.at_most(amplitude)),
        Row(table, of_all, "lag", "ms", ours[1], lag, Goal.at_most(lag)),
        Row(live, of_all, "horizontal error RMS", "mm", horizontal, None, bound[0]),
        Row(live, of_all, "vertical error RMS", "mm", float(rms[2]), None,
            bound[1]),
        Row(live, of_all, "greatest error, any axis", "mm",
            float(greatest.max())),
    ]  # fmt: skip
