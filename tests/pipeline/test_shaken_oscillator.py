"""A shaken oscillator is known before its phase has swung far: by the clock's phase, or given."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fusion_bench import FusionBench, precise_positions

from deepseis_core.errors import InputError
from deepseis_core.types import FloatArray, PrecisePosition
from deepseis_ins.fusion_config import FusionConfig
from deepseis_ins.fusion_engine import FusionEngine

GAMMA = np.array([0.6e-9, -0.5e-9, 0.6e-9])
"""Forward, left, up [1/g]."""
BEGIN, RAMP = 12.0, 2.0
"""Of the motion [s]."""


@pytest.fixture(scope="module")
def run() -> FusionBench:
    """Still, then on a circle of 50 cm at 1 Hz, 2 g, the oscillator with it."""
    return FusionBench(
        "sine-1hz",
        "span-fsas",
        f"duration={BEGIN + 6.0}",
        f"motion.0.start={BEGIN}",
        "motion.0.duration=6.0",
        f"motion.0.ramp={RAMP}",
        "receiver.oscillator.on_table=true",
        f"receiver.oscillator.g_sensitivity={GAMMA.tolist()}",
    )


@pytest.fixture(scope="module")
def precise(run: FusionBench) -> list[PrecisePosition]:
    """Positions and clocks with 1 mm of noise."""
    return precise_positions(run)


def shaken(config: FusionConfig, run: FusionBench, precise: list[PrecisePosition]) -> FusionEngine:
    """Return an engine that has worked up to the ramp's end."""
    engine = run.engine(config, precise=precise)
    run.run(engine, BEGIN + RAMP)
    assert engine.oscillator is not None
    return engine


def sensitivity(engine: FusionEngine) -> tuple[FloatArray, FloatArray]:
    """Return what it has found and one sigma, forward, left, up [1/g]."""
    assert engine.oscillator is not None
    found = engine.oscillator.sensitivity * [1.0, -1.0, -1.0]
    return np.asarray(found), engine.oscillator.sensitivity_sd


def test_the_phase_of_the_clock_tells_it_within_the_ramp(
    run: FusionBench, precise: list[PrecisePosition]
) -> None:
    on = FusionConfig(oscillator_on_body=True)
    found, sd = sensitivity(shaken(on, run, precise))
    assert found[:2] == pytest.approx(GAMMA[:2], rel=0.1)
    assert np.abs(found - GAMMA)[:2].max() < 4.0 * sd[:2].max()
    # By the drift of PVT, 0.1 m/s of noise, it is known a fifth as well.
    _, by_drift = sensitivity(shaken(on, run, []))
    assert (sd[:2] < 0.2 * by_drift[:2]).all()
    assert sd[2] > 1e-9  # that axis is not shaken


def test_what_an_operator_has_calibrated_holds_from_the_start(run: FusionBench) -> None:
    given = FusionConfig(
        oscillator_on_body=True,
        oscillator_sensitivity=GAMMA.tolist(),
        oscillator_sensitivity_sd=1e-10,
    )
    engine = run.engine(given)
    run.run(engine, BEGIN)
    found, sd = sensitivity(engine)
    assert found == pytest.approx(GAMMA, rel=1e-3)
    assert sd == pytest.approx(1e-10, rel=0.02)
    assert engine.oscillator is not None
    said = [float(text) for text in engine.oscillator.report()["g_sensitivity_ppb"].split()]
    assert said == pytest.approx(1e9 * GAMMA, abs=1e-3)


def test_a_clock_that_jumps_teaches_nothing(
    run: FusionBench, precise: list[PrecisePosition]
) -> None:
    jumped = [
        replace(item, clock_bias=item.clock_bias + 0.1 * (item.sample_index > 5.2e7))
        for item in precise
    ]
    engine = shaken(FusionConfig(oscillator_on_body=True), run, jumped)
    assert sensitivity(engine)[0][:2] == pytest.approx(GAMMA[:2], rel=0.1)


def test_a_sensitivity_is_three_numbers(run: FusionBench) -> None:
    with pytest.raises(InputError, match="three numbers"):
        run.empty_engine(FusionConfig(oscillator_on_body=True, oscillator_sensitivity=[1e-9]))
