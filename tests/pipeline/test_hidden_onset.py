"""A motion that begins so slowly that the IMU does not feel it is no error of positions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from fusion_bench import FusionBench, precise_positions

from deepseis_core.types import DisplacementSource, PreciseStatus

SLOW = "{kind: offset, east: 0.008, start: 14.0, rise: 8.0}"
"""0.7 mm/s^2 at most: an MTi-G needs 10 to notice."""
FELT = (
    "{kind: sine, amplitude: 0.06, frequency_hz: 0.2, azimuth_deg: 0.0, start: 20.0,"
    " duration: 15.0, ramp: 7.5}"
)


def test_the_fusion_goes_with_the_base_from_where_the_ground_was_before() -> None:
    run = FusionBench("sine-2hz", "mti-g", "duration=26", f"motion=[{SLOW}, {FELT}]")
    noticed = min(m.valid_through for m in run.inputs.motion if m.state == 2) / 4e6
    assert 20.5 < noticed < 23.0
    made = precise_positions(run, seed=2, sd=(0.6e-3, 0.8e-3, 1.6e-3), walk=0.0)
    fixed = {"method": "rtk", "status": PreciseStatus.FIX, "base_age": 0.2, "ratio": 50.0}
    rtk = [replace(item, clock_bias=float("nan"), **fixed) for item in made]  # type: ignore[arg-type]
    engine = run.engine(rtk=rtk)
    spans = run.run(engine).spans
    found = [m for s in spans for m in s.motion if m.source == DisplacementSource.FUSED]
    t = np.concatenate([(m.tow_ns - run.bench.start.tow_ns) * 1e-9 for m in found])
    moved = run.bench.motion.at(t).position - run.bench.motion.at(np.zeros(1)).position
    error = np.concatenate([m.displacement for m in found]) - moved
    # Until then it is said to rest: the 8 mm are the error.
    assert np.abs(error[t < noticed]).max() < 0.009
    after = error[t > noticed + 1.0]
    # Held to what was learnt while it moved already, positions would be off by 6 mm for ever.
    assert np.abs(after.mean(axis=0)).max() < 1e-3
    assert engine.statistics["doubted"] == 1
    assert engine.statistics["precise_jumps"] == 0
