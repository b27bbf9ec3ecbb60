"""Ground motion of a run: its streams by name, events, and the truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deepseis_bringup.report.run_columns import Columns
from deepseis_bringup.report.run_data import RunData
from deepseis_bringup.report.run_truth import Truth
from deepseis_core.geodesy import geodetic_from_ecef, rotation_enu_ecef
from deepseis_core.types import DisplacementSource, FloatArray, PreciseStatus

FUSED, SMOOTHED = "fused, real time", "fused, smoothed behind a lag"
OF_IMU = (FUSED, SMOOTHED)
"""Streams that tell how the IMU moved; the others tell of the antenna."""
AIDED, GNSS, RTK = "by aided loops", "GNSS only, no base", "GNSS only, against a base"


@dataclass(frozen=True)
class Moved:
    """A stream: times [s] (m,), displacement, velocity, acceleration (m, 3), SI; NaN unknown.

    ``sd`` is what it says of the sigma of its displacement, (m, 3) [m].
    """

    t: FloatArray
    displacement: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    sd: FloatArray


@dataclass(frozen=True)
class Event:
    """An event as its reports tell it: times [s] and peaks so far (m,), SI."""

    name: str
    onset: float
    ended: bool
    t: FloatArray
    peaks: FloatArray
    magnitude: float
    magnitude_sd: float


def streams(run: RunData) -> dict[str, Moved]:
    """Return the streams that a run has, the fused ones first."""
    found: dict[str, Moved] = {}
    motion = run.motion.get("seismo/displacement")
    if motion is not None:
        kinds = (
            (FUSED, DisplacementSource.FUSED, False),
            (SMOOTHED, DisplacementSource.FUSED, True),
            (AIDED, DisplacementSource.AIDED, False),
            (GNSS, DisplacementSource.GNSS, False),
        )
        t = _epochs(run, motion)
        for name, source, smoothed in kinds:
            of_it = (motion["source"] == int(source)) & (motion["smoothed"] == smoothed)
            chosen = of_it[motion["row"]]
            if chosen.any():
                found[name] = _batched(motion, t, chosen)
    for name, topic in ((GNSS, "gnss/precise"), (RTK, "gnss/rtk")):
        positions = run.motion.get(topic)
        if positions is not None and name not in found:
            stream = _positions(run, positions, topic)
            if stream.t.size:
                found[name] = stream
    return found


def _batched(motion: Columns, t: FloatArray, chosen: NDArray[np.bool_]) -> Moved:
    def rows(name: str) -> FloatArray:
        return motion[name].reshape(-1, 3)[chosen].astype(np.float64)

    order = np.argsort(t[chosen], kind="stable")
    names = ("displacement", "velocity", "acceleration", "displacement_sd")
    return Moved(t[chosen][order], *(rows(name)[order] for name in names))


def _positions(run: RunData, positions: Columns, topic: str) -> Moved:
    least = PreciseStatus.FIX if topic.endswith("rtk") else PreciseStatus.PHASE
    good = positions["status"] >= int(least)
    moved = positions["displacement_enu"][good]
    variance = positions["covariance_enu"][good].reshape(-1, 3, 3)
    sd = np.sqrt(np.diagonal(variance, axis1=1, axis2=2))
    nothing = np.full(moved.shape, np.nan)
    t = run.seconds(positions["sample_index"][good])
    return Moved(t, moved, nothing, nothing, sd)


def _epochs(run: RunData, motion: Columns) -> FloatArray:
    """Return times of the epochs since the first sample [s]."""
    tow, row = motion["tow_ns"], motion["row"]
    first = np.searchsorted(row, np.arange(len(motion["stamp_ns"])))
    first = np.minimum(first, len(tow) - 1)
    since = motion["stamp_ns"][row] - run.start_utc_ns + tow - tow[first][row]
    return np.asarray(1e-9 * since - clock_offset(run))


def clock_offset(run: RunData) -> float:
    """Return by what receiver time is ahead of the count of samples [s]."""
    o = run.observations
    if not o.count:
        return 0.0
    counted = run.seconds(o["sample_index"]) + o["sample_fraction"] / run.sample_rate_hz
    return float(np.median(1e-9 * (o["stamp_ns"] - run.start_utc_ns) - counted))


def events(run: RunData) -> list[Event]:
    """Return the events of a run."""
    reports = run.motion.get("seismo/event")
    if reports is None:
        return []
    found = []
    for name in dict.fromkeys(reports["event_id"].tolist()):
        of_it = np.flatnonzero(reports["event_id"] == name)
        last, onset = of_it[-1], reports["onset"][of_it[0]]
        peaks = [reports[f"peak_{k}"][of_it] for k in ("displacement", "velocity", "acceleration")]
        utc_ns = int(onset.sec) * 10**9 + int(onset.nanosec)
        stamps = 1e-9 * (reports["stamp_ns"][of_it] - run.start_utc_ns)
        found.append(
            Event(
                str(name), 1e-9 * (utc_ns - run.start_utc_ns), bool(reports["ended"][last]),
                stamps, np.stack(peaks, axis=1),
                float(reports["magnitude"][last]), float(reports["magnitude_sd"][last]),
            )
        )  # fmt: skip
    return found


def truth_at(truth: Truth | None, t: FloatArray, *, of_imu: bool = False) -> FloatArray | None:
    """Return true displacement of antenna or IMU, ENU, (m, 3) [m]; None: not known."""
    if truth is None or truth.position_t.size < 2:
        return None
    first = truth.position_at(truth.position_t[:1], of_imu=of_imu)[0]
    latitude, longitude, _ = geodetic_from_ecef(first)
    turn = np.asarray(rotation_enu_ecef(latitude, longitude))
    return np.asarray((truth.position_at(t, of_imu=of_imu) - first) @ turn.T)


def errors(moved: Mapping[str, Moved], truth: Truth | None) -> dict[str, FloatArray]:
    """Return every stream's displacement less the truth of its point, (m, 3) [m]; or nothing."""
    found = {}
    for name, stream in moved.items():
        true = truth_at(truth, stream.t, of_imu=name in OF_IMU)
        if true is not None:
            found[name] = stream.displacement - true
    return found
