"""Fused displacement when precise positions creep as those of real satellites do."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fusion_bench import FusionBench, precise_positions
from real_rest import Watched, watch

from deepseis_core.types import DisplacementSource, FloatArray, PrecisePosition

RATE = 4_000_000
BEGIN, END = 14.0, 40.0
"""Shaking [s]."""
NOISE = np.array([1e-3, 1e-3, 2e-3])


@pytest.fixture(scope="module")
def run() -> FusionBench:
    """A shake table, 3 cm at 2 Hz, with the IMU of the thesis on it."""
    motion = (
        "[{kind: sine, amplitude: 0.03, frequency_hz: 2.0, azimuth_deg: 90.0, start: 14.0,"
        " duration: 26.0, ramp: 1.0}]"
    )
    return FusionBench("shake-table", "stim300", "duration=40.5", f"motion={motion}")


@pytest.fixture(scope="module")
def watched(shared_data: Path) -> Watched:
    """What phases of real satellites do over a still antenna."""
    return watch(shared_data)


def creeping(
    run: FusionBench, creep: FloatArray, common: FloatArray, *, apart: bool
) -> list[PrecisePosition]:
    """Return positions with noise that creep from the onset on, and say how far.

    Parameters
    ----------
    run : FusionBench
    creep : ndarray, shape (n, 3)
        At seconds from the onset on, east, north, up [m].
    common : ndarray, shape (n, 3, 3)
        Its stated covariance [m^2].
    apart : bool
        The creeping part of the covariance is named.
    """
    seconds, found = np.arange(len(creep), dtype=np.float64), []
    for item in precise_positions(run, sd=NOISE, walk=0.0):
        since = item.sample_index / RATE - BEGIN
        off = np.array([np.interp(since, seconds, axis) for axis in creep.T])
        part = common[int(np.clip(round(since), 0, len(common) - 1))] * (since > 0.0)
        found.append(
            replace(
                item,
                displacement_enu=item.displacement_enu + off * (since > 0.0),
                covariance_enu=item.covariance_enu + part.ravel(),
                common_covariance_enu=part.ravel() * apart,
            )
        )
    return found


def fused(run: FusionBench, precise: list[PrecisePosition]) -> tuple[FloatArray, ...]:
    """Return times, errors and stated sigmas of fused displacements while it shakes."""
    outputs = run.run(run.engine(precise=precise))
    parts = [m for span in outputs.spans for m in span.motion]
    parts = [m for m in parts if m.source == DisplacementSource.FUSED]
    t = np.concatenate([(m.tow_ns - run.bench.start.tow_ns) * 1e-9 for m in parts])
    moved = run.bench.motion.at(t).position - run.bench.motion.at(np.zeros(1)).position
    error = np.concatenate([m.displacement for m in parts]) - moved
    sd = np.concatenate([m.displacement_sd for m in parts])
    shaking = (t > BEGIN + 2.0) & (t < END - 1.0)
    return t[shaking], error[shaking], sd[shaking]


def horizontal_rms(values: FloatArray) -> float:
    """Return the root mean square of vectors, east and north, their mean taken off."""
    flat = values[:, :2] - values[:, :2].mean(axis=0)
    return float(np.sqrt((flat**2).sum(axis=1).mean()))


def test_what_may_creep_costs_nothing_where_nothing_creeps(run: FusionBench) -> None:
    """Stated: 0.8 mm/sqrt(s) times dilutions of 1, 1, 2. True: none, as on the bench."""
    seconds = np.arange(30.0)
    common = 0.0008**2 * seconds[:, None, None] * np.diag([1.0, 1.0, 4.0])
    still = np.zeros((len(seconds), 3))
    apart, together = (
        fused(run, creeping(run, still, common, apart=named)) for named in (True, False)
    )
    # Riccati, one axis: a walk of q = 3 mm/s/sqrt(s) (STIM300), positions of 1 mm at 50 Hz, whose
    # density is r^2; what comes out is predicted over D and the interval.
    q, r, ahead = 3e-3, 1e-3 * np.sqrt(0.02), 0.1 + 0.02
    w = np.sqrt(q / r)
    place, both, speed = r**2 * np.array([np.sqrt(2.0) * w, w**2, np.sqrt(2.0) * w**3])
    limit = np.sqrt(2.0 * (place + 2.0 * ahead * both + ahead**2 * speed))
    assert 0.8 * limit < horizontal_rms(apart[1]) < 1.25 * limit
    assert horizontal_rms(together[1]) > 1.25 * horizontal_rms(apart[1])


def test_real_satellites_creep_and_the_sigma_says_so(run: FusionBench, watched: Watched) -> None:
    """A real antenna's creep over 30 s, of 17 calibrations one: it is in error and sigma."""
    creep = watched.displacement[8] - watched.displacement[8, :1]
    common = watched.covariance[8]
    t, error, sd = fused(run, creeping(run, creep, common, apart=True))
    off = np.array([np.interp(t - BEGIN, np.arange(len(creep)), axis) for axis in creep.T]).T
    # What the filter adds to the creep is what it adds without one.
    assert horizontal_rms(error - off) < 1.3e-3
    assert 0.2 < float(np.sqrt(np.mean((error / sd) ** 2))) < 2.0
