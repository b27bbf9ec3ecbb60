"""A fusion that joins a running graph, and one whose motion detector has died."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fusion_bench import EVERYTHING, FusionBench, Outputs

from deepseis_core.types import MotionKind
from deepseis_ins.fusion_config import FusionConfig
from deepseis_ins.fusion_engine import FusionEngine
from deepseis_ins.fusion_output import FusionStatus

RATE = 4_000_000
ONSET, JOIN = 12.0, 13.41
"""Of the motion, and in the midst of it [s]."""


@pytest.fixture(scope="module")
def run() -> FusionBench:
    """Twelve seconds at rest, six on a circle of 12 cm at 2 Hz: 2 g."""
    circle = [
        ("radius", "0.12"), ("frequency_hz", "2.0"), ("start", str(ONSET)), ("duration", "6.0"),
    ]  # fmt: skip
    return FusionBench(
        "sine-2hz", "span-fsas", "duration=18", *(f"motion.0.{k}={v}" for k, v in circle)
    )


def after(run: FusionBench, seconds: float) -> dict[str, list]:
    """What a node gets that is there from a moment on."""
    given = vars(run.inputs)
    return {k: [i for i in v if i.sample_index >= seconds * RATE] for k, v in given.items()}


def joined(run: FusionBench, engine: FusionEngine) -> Outputs:
    for sample in (late := after(run, JOIN))["imu"]:
        engine.push_imu(sample)
    for pvt in late["pvt"]:
        engine.push_pvt(pvt)
    engine.push_motion([s for s in run.inputs.motion if s.state == MotionKind.MOVING][-1])
    for valid in (engine.source_valid, engine.imu_valid, engine.motion_valid, engine.pvt_valid):
        valid(EVERYTHING)
    engine.join(round(JOIN * RATE))
    return run.run(engine)


def test_it_aids_again_half_a_second_after_it_joined_a_moving_station(run: FusionBench) -> None:
    outputs = joined(run, run.empty_engine())
    first = outputs.spans[0]
    assert (outputs.time_of(first), first.status) == (13.4, FusionStatus.ALIGNING)
    valid = [item for item in outputs.spans if item.aiding.valid]
    again = outputs.time_of(valid[0])
    assert again - JOIN < 0.5
    assert all(item.aiding.valid for item in outputs.between(again, 18.0).spans)
    ratio = outputs.between(again, 18.0).error() / outputs.between(again, 18.0).sd().mean()
    assert np.abs(ratio).max() < 5
    # As good as what GNSS with its slow error (5 mm/s) unknown allows, two seconds after.
    assert np.sqrt(np.mean(outputs.between(JOIN + 2.0, 18.0).error() ** 2)) < 0.03


def test_its_sigma_covers_its_error_from_the_first_span_on(run: FusionBench) -> None:
    outputs = joined(run, run.empty_engine())
    for begin in np.arange(JOIN + 0.5, 17.5, 0.5):
        part = outputs.between(begin, begin + 0.5)
        assert np.sqrt(np.mean(part.error() ** 2)) < 2.5 * part.sd().mean(), begin


def test_without_a_surveyed_attitude_it_says_that_there_is_no_aiding(run: FusionBench) -> None:
    station = replace(run.bench.station(), imu_orientation_xyzw=np.zeros(4))
    engine = FusionEngine(FusionConfig(), run.grade, run.sample_rate_hz, station, 200.0)
    for ephemeris in run.ephemerides:
        engine.push_ephemeris(ephemeris)
    outputs = joined(run, engine)
    assert not any(item.aiding.valid for item in outputs.spans)


def test_a_station_whose_detector_died_at_rest_is_not_held_at_rest(run: FusionBench) -> None:
    died = 11.0 * RATE
    engine = run.engine(motion=[s for s in run.inputs.motion if s.valid_through < died])
    engine._through["motion"] = int(died)
    spans = []
    while engine.next_sample + engine.block <= run.bench.sample_count:
        spans.append(engine.advance(force=True))
    outputs = Outputs(run, spans)
    assert all(item.aiding.valid for item in outputs.between(6.0, 18.0).spans)
    assert engine.statistics["late_motion"] == (18 - 11) / 0.02 - 1
    # Held at rest, the velocity would be off by the motion's 1.5 m/s.
    error = outputs.between(12.0, 18.0)
    assert np.sqrt(np.mean(error.error() ** 2)) < 0.02
    assert np.abs(error.error()).max() < 5 * error.sd().mean()
