"""Lines of a gravimetric survey that are driven again and again, and how they agree.

A *pass* is what lies between two rests. Passes over the same road, either way, are passes of one
line: its first pass is the reference, whose points other passes are brought to. What a pass does
beyond the road's ends (a turn) falls on the reference's ends and is left out.

Internal coincidence [1]_ (tables 2 and 3): at stations along the line, the deviation of every
pass from the mean of all; its RMS for each pass, and over all of them. With n passes of equal and
independent noise it is ``sqrt((n - 1) / n)`` of that noise.

References
----------
.. [1] Wei G. et al., "Strapdown vehicle autonomous gravimetry method based on two-dimensional
   laser Doppler velocimeter", Infrared and Laser Engineering 52(6), 2023.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from deepseis_core.config import setting
from deepseis_core.types import FloatArray


@dataclass(frozen=True)
class LineConfig:
    """What makes a pass, and when passes are of one line."""

    rest: float = setting(10.0, "shortest rest between passes [s]", low=1.0, high=3600.0)
    shortest: float = setting(300.0, "length of a pass, at least [m]", low=10.0, high=1e6)
    tolerance: float = setting(60.0, "between passes of one line [m]", low=1.0, high=1e4)
    spacing: float = setting(50.0, "of stations [m]", low=1.0, high=1e4)
    margin: float = setting(100.0, "left out at either end of the line [m]", low=0.0, high=1e4)


@dataclass(frozen=True)
class Way:
    """A drive, m moments.

    Attributes
    ----------
    time : ndarray, shape (m,)
        [s]
    position : ndarray, shape (m, 3)
        East, north, up about one origin for all drives [m].
    still : ndarray of bool, shape (m,)
    gravity : ndarray, shape (m,)
        Disturbance [m/s^2].
    force : ndarray, shape (m, 2)
        Specific force forward and right through the same low-pass [m/s^2].
    """

    time: FloatArray
    position: FloatArray
    still: NDArray[np.bool_]
    gravity: FloatArray
    force: FloatArray


@dataclass(frozen=True)
class Pass:
    """One pass at the stations of its line, n of them; not a number where it does not reach.

    ``direction`` is 1 along the reference, -1 against it; ``drive`` counts the drives; ``force``,
    (2, n), is forward and right.
    """

    drive: int
    begin: float
    end: float
    direction: int
    gravity: FloatArray
    height: FloatArray
    force: FloatArray


@dataclass(frozen=True)
class Coincidence:
    """How passes agree: k of them at n stations.

    Attributes
    ----------
    deviation : ndarray, shape (k, n)
        From the mean over all passes.
    rms, least, greatest : ndarray, shape (k,)
        Of each pass.
    total : float
        RMS over all.
    """

    deviation: FloatArray
    rms: FloatArray
    least: FloatArray
    greatest: FloatArray
    total: float


@dataclass(frozen=True)
class Line:
    """A line: its stations [m] along the reference, (n,), their places, (n, 3), and passes."""

    station: FloatArray
    position: FloatArray
    passes: tuple[Pass, ...]

    @property
    def gravity(self) -> FloatArray:
        """Of all passes, shape (k, n)."""
        return np.array([item.gravity for item in self.passes])


def coincidence(values: FloatArray) -> Coincidence:
    """Compare k passes at the n stations that all of them reach, shape (k, n).

    Examples
    --------
    >>> round(coincidence(np.array([[1.0, 3.0], [3.0, 3.0]])).total, 4)
    0.7071
    """
    common = values[:, np.isfinite(values).all(axis=0)]
    deviation = common - common.mean(axis=0)
    squares = deviation**2
    with np.errstate(invalid="ignore"):
        return Coincidence(
            deviation,
            np.sqrt(squares.mean(axis=1)) if common.size else np.full(len(values), np.nan),
            deviation.min(axis=1, initial=0.0),
            deviation.max(axis=1, initial=0.0),
            float(np.sqrt(squares.mean())) if common.size else float("nan"),
        )


def spans_between_rests(way: Way, config: LineConfig) -> list[slice]:
    """Return the rows of every pass."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], way.still, [False]]).astype(int)))
    rests = [
        (a, b) for a, b in edges.reshape(-1, 2) if way.time[b - 1] - way.time[a] >= config.rest
    ]
    bounds = [0, *(int(x) for rest in rests for x in rest), way.time.size]
    found = [slice(a, b) for a, b in zip(bounds[::2], bounds[1::2], strict=True) if b - a > 1]
    return [part for part in found if _length(way.position[part]) >= config.shortest]


def survey_lines(ways: Sequence[Way], config: LineConfig) -> list[Line]:
    """Find passes and lines in drives, in order of their first passes."""
    references: list[_Reference] = []
    members: list[list[Pass]] = []
    for number, way in enumerate(ways):
        for part in spans_between_rests(way, config):
            for reference, passes in zip(references, members, strict=True):
                found = reference.take(way, part, number)
                if found is not None:
                    passes.append(found)
                    break
            else:
                reference = _Reference(way.position[part], config)
                found = reference.take(way, part, number)
                if found is not None:
                    references.append(reference)
                    members.append([found])
    return [
        Line(reference.station, reference.place, tuple(passes))
        for reference, passes in zip(references, members, strict=True)
    ]


class _Reference:
    """The way of a line's first pass."""

    def __init__(self, position: FloatArray, config: LineConfig) -> None:
        self.config = config
        along = _along(position)
        along, rows = np.unique(along, return_index=True)
        fine = np.arange(0.0, along[-1], min(5.0, config.spacing))
        path = np.stack([np.interp(fine, along, position[rows, k]) for k in range(3)], axis=1)
        self.fine, self.tree = fine, KDTree(path[:, :2])
        self.station = np.arange(config.margin, along[-1] - config.margin + 1e-6, config.spacing)
        self.place = np.stack(
            [np.interp(self.station, fine, path[:, k]) for k in range(3)], axis=1
        )

    def take(self, way: Way, part: slice, number: int) -> Pass | None:
        """Bring a pass to the stations; None if it is on another road."""
        away, row = self.tree.query(way.position[part, :2])
        near = away <= self.config.tolerance
        along = self.fine[row]
        if (
            self.station.size < 2
            or np.mean(near) < 0.8
            or np.ptp(along[near]) < 0.8 * self.fine[-1]
        ):
            return None
        inside = near & (along > 0.0) & (along < self.fine[-1])
        time, along = way.time[part][inside], along[inside]
        direction = 1 if np.polyfit(time, along, 1)[0] > 0.0 else -1
        order = np.argsort(along, kind="stable")

        def at(values: FloatArray) -> FloatArray:
            places, rows = np.unique(along[order], return_index=True)
            mean = np.add.reduceat(values[inside][order], rows) / np.diff([*rows, along.size])
            return np.interp(self.station, places, mean, left=np.nan, right=np.nan)

        return Pass(
            number, float(time[0]), float(time[-1]), direction,
            at(way.gravity[part]), at(way.position[part, 2]),
            np.array([at(way.force[part, k]) for k in range(2)]),
        )  # fmt: skip


def _along(position: FloatArray) -> FloatArray:
    """Return the distance travelled in plan [m]."""
    steps = np.hypot(*np.diff(position[:, :2], axis=0).T)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _length(position: FloatArray) -> float:
    return float(_along(position)[-1])
