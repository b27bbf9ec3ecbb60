"""The fusion follows positions against a base, and goes over to others and back without a bump."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from fusion_bench import FusionBench, Outputs, as_bytes, precise_positions

from deepseis_core.types import DisplacementSource, FloatArray, PrecisePosition, PreciseStatus
from deepseis_ins.fusion_config import FusionConfig

RATE = 4_000_000
SHAKING = (10.0, 24.0)
"""[s]"""
LOST = (14.0, 17.0)
"""Without the base [s]."""
SECONDS = 28.0
NOISE = (0.6e-3, 0.8e-3, 1.6e-3)
"""Against the base, east, north, up: as measured on the bench [m]."""
CREEP = 1e-3
"""Of the station alone [m/sqrt(s)]."""
FRAMES = np.array([0.11, -0.07, 0.23])
"""Constant difference of positions against the base from the survey [m]."""


@pytest.fixture(scope="module")
def run() -> FusionBench:
    """Still, 14 s on a circle of 12 cm at 2 Hz (2 g), still."""
    length = SHAKING[1] - SHAKING[0]
    circle = f"{{kind: circle, radius: 0.12, frequency_hz: 2.0, start: 10.0, duration: {length}}}"
    return FusionBench("sine-2hz", "stim300", f"duration={SECONDS:g}", f"motion=[{circle}]")


@pytest.fixture(scope="module")
def alone(run: FusionBench) -> list[PrecisePosition]:
    """Positions of the station alone, which creep."""
    return precise_positions(run, walk=CREEP)


@pytest.fixture(scope="module")
def against_base(run: FusionBench) -> list[PrecisePosition]:
    """Positions against a base, in a frame of their own."""
    made = precise_positions(run, seed=2, sd=NOISE, walk=0.0)
    fixed = {"method": "rtk", "status": PreciseStatus.FIX, "base_age": 0.2, "ratio": 50.0}
    nan = float("nan")
    return [
        replace(
            item, displacement_enu=item.displacement_enu + FRAMES, clock_bias=nan, **fixed  # type: ignore[arg-type]
        )
        for item in made
    ]  # fmt: skip


def changed(
    positions: Sequence[PrecisePosition], begin: float, end: float, **values: object
) -> list[PrecisePosition]:
    """Return positions with other values in an interval [s]."""
    return [
        replace(p, **values) if begin <= p.sample_index / RATE < end else p  # type: ignore[arg-type]
        for p in positions
    ]


def fused(outputs: Outputs) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return times [s], errors and sigmas of the fused motion, (n, 3) [m]."""
    source = DisplacementSource.FUSED
    found = [m for span in outputs.spans for m in span.motion if m.source == source]
    start, motion = outputs.run.bench.start, outputs.run.bench.motion
    t = np.concatenate([(m.tow_ns - start.tow_ns) * 1e-9 for m in found])
    truth = motion.at(t).position - motion.at(np.zeros(1)).position
    value = np.concatenate([m.displacement for m in found])
    return t, value - truth, np.concatenate([m.displacement_sd for m in found])


def rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.fixture(scope="module")
def whole(
    run: FusionBench, alone: list[PrecisePosition], against_base: list[PrecisePosition]
) -> Outputs:
    """The run with the base all the time."""
    return run.run(run.engine(precise=alone, rtk=against_base))


def test_with_a_base_nothing_creeps_and_its_frame_is_no_displacement(
    run: FusionBench, alone: list[PrecisePosition], whole: Outputs
) -> None:
    t, error, sd = fused(whole)
    _, without, _ = fused(run.run(run.engine(precise=alone)))
    shaking = (t > SHAKING[0]) & (t < SHAKING[1])
    # Half of what white noise of NOISE leaves at 50 Hz; nothing of FRAMES.
    assert np.all(np.abs(error[shaking].mean(axis=0)) < 1e-3)
    assert np.all(error[shaking].std(axis=0) < [0.7e-3, 0.7e-3, 1.2e-3])
    assert rms(error[shaking]) < 0.5 * rms(without[shaking])
    assert 0.3 < rms(error[shaking] / sd[shaking]) < 1.6


def test_a_base_lost_and_back_in_mid_quake_is_no_bump(
    run: FusionBench,
    alone: list[PrecisePosition],
    against_base: list[PrecisePosition],
    whole: Outputs,
) -> None:
    lost = changed(against_base, *LOST, status=PreciseStatus.NONE)
    engine = run.engine(precise=alone, rtk=lost)
    outputs = run.run(engine)
    (t, error, sd), (_, steady, _) = fused(outputs), fused(whole)
    apart = error - steady
    before, gap = t < LOST[0], (t > LOST[0]) & (t < LOST[1] + 1.0)
    assert np.abs(apart[before]).max() == 0.0
    # Alone it creeps by 1.7 mm in 3 s, and its noise is larger: 4 sigma.
    assert np.abs(apart[gap]).max() < 4.0 * 2.2e-3
    # From one IMU sample to the next no more than updates do anyway.
    usual = np.abs(np.diff(steady[(t > 11.0) & (t < LOST[0])], axis=0)).max()
    assert np.abs(np.diff(error[gap], axis=0)).max() < 2.5 * usual
    assert engine.statistics["rtk_back"] == 1
    assert engine.statistics["precise_jumps"] == 0
    # What crept is worked off: a tenth of it is left 23 s later; 7 s later half.
    late = (t > 23.0) & (t < SHAKING[1])
    at_return = (t > 17.6) & (t < 18.2)
    left = np.linalg.norm(apart[late].mean(axis=0))
    assert left < 0.75 * np.linalg.norm(apart[at_return].mean(axis=0)) + 4e-4
    assert rms(error[gap] / sd[gap]) < 2.0


def test_other_integers_after_a_loss_are_no_displacement(
    run: FusionBench, alone: list[PrecisePosition], against_base: list[PrecisePosition]
) -> None:
    lost = changed(against_base, *LOST, status=PreciseStatus.NONE)
    wrong = [
        replace(p, displacement_enu=p.displacement_enu + np.array([0.12, 0.05, -0.2]))
        if p.sample_index >= LOST[1] * RATE
        else p
        for p in lost
    ]
    engine = run.engine(precise=alone, rtk=wrong)
    t, error, _ = fused(run.run(engine, 24.0))
    assert np.abs(error[t > LOST[0]]).max() < 0.012
    assert engine.statistics["rtk_back"] == 1


@pytest.mark.parametrize(
    "values",
    [{"status": PreciseStatus.FLOAT}, {"base_age": 6.0}, {"base_age": float("nan")}],
)
def test_without_integers_or_with_an_old_base_they_are_not_used(
    run: FusionBench,
    alone: list[PrecisePosition],
    against_base: list[PrecisePosition],
    values: dict[str, object],
) -> None:
    useless = changed(against_base, 0.0, SECONDS, **values)
    given, without = run.engine(precise=alone, rtk=useless), run.engine(precise=alone)
    got, expected = (run.run(engine, 12.0).spans for engine in (given, without))
    assert [as_bytes(span) for span in got] == [as_bytes(span) for span in expected]
    assert given.statistics["rtk"] == 0


def test_a_base_that_comes_in_mid_quake_is_joined_without_a_bump(
    run: FusionBench, alone: list[PrecisePosition], against_base: list[PrecisePosition]
) -> None:
    late = [p for p in against_base if p.sample_index > 15.0 * RATE]
    engine = run.engine(precise=alone, rtk=late)
    t, error, _ = fused(run.run(engine, 20.0))
    _, without, _ = fused(run.run(run.engine(precise=alone), 20.0))
    assert np.abs((error - without)[t < 18.0]).max() < 4e-3
    assert engine.statistics["rtk"] > 200


def test_it_can_be_left_aside(
    run: FusionBench, alone: list[PrecisePosition], against_base: list[PrecisePosition]
) -> None:
    given = run.engine(FusionConfig(rtk=False), precise=alone, rtk=against_base)
    got = run.run(given, 12.0).spans
    expected = run.run(run.engine(precise=alone), 12.0).spans
    assert [as_bytes(span) for span in got] == [as_bytes(span) for span in expected]


def test_nothing_depends_on_when_they_arrive(
    run: FusionBench,
    alone: list[PrecisePosition],
    against_base: list[PrecisePosition],
    whole: Outputs,
) -> None:
    """Late by up to a second: from then on the fusion is where it would have been."""
    span = (15.0 * RATE, 15.6 * RATE)
    early = [p for p in against_base if not span[0] < p.sample_index < span[1]]
    engine = run.engine(precise=alone, rtk=early)
    run.run(engine, 16.0)
    for position in against_base:
        if span[0] < position.sample_index < span[1]:
            engine.push_rtk(position)
    while engine.next_sample < 16.4 * RATE:
        output = engine.advance()
        assert output is not None
    expected = whole.spans[engine.next_sample // engine.block - 1]
    assert output.aiding.carrier_doppler_hz.tobytes() == (
        expected.aiding.carrier_doppler_hz.tobytes()
    )
    assert engine.statistics["undone"] >= 1
