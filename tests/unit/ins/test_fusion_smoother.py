"""The fusion's smoothed motion: whole, better, without jumps, and undone with the filter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fusion_bench import EVERYTHING, FusionBench, Outputs, as_bytes, precise_positions, watermarks
from numpy.testing import assert_allclose, assert_array_equal

from deepseis_core.errors import InputError
from deepseis_core.types import Displacement, DisplacementSource, FloatArray
from deepseis_ins.fusion_config import FusionConfig

RATE = 4_000_000
ONSET, SECONDS, LAG = 10.0, 22.0, 4.0
CONFIG = FusionConfig(smoothing_lag_s=LAG)


@pytest.fixture(scope="module")
def run() -> FusionBench:
    """Ten seconds at rest, then a circle of 12 cm at 2 Hz: 2 g."""
    circle = [("radius", "0.12"), ("frequency_hz", "2.0"), ("start", str(ONSET)),
              ("duration", str(SECONDS - ONSET))]  # fmt: skip
    return FusionBench(
        "sine-2hz", "span-fsas", f"duration={SECONDS:g}", *(f"motion.0.{k}={v}" for k, v in circle)
    )


@pytest.fixture(scope="module")
def given(run: FusionBench) -> Outputs:
    """An undisturbed run with precise positions ten times a second."""
    return run.run(run.engine(CONFIG, precise=precise_positions(run, rate_hz=10.0)))


def joined(outputs: Outputs, *, smoothed: bool) -> dict[str, FloatArray]:
    """Return fused motion one message after the other."""
    parts: list[Displacement] = [
        motion
        for span in outputs.spans
        for motion in span.motion
        if motion.smoothed is smoothed and motion.source == DisplacementSource.FUSED
    ]
    names = ("tow_ns", "displacement", "velocity", "acceleration", "displacement_sd")
    return {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}


def truth(run: FusionBench, tow_ns: FloatArray) -> FloatArray:
    """Return the true displacement at GPS times."""
    time = (tow_ns - run.bench.start.tow_ns) * 1e-9
    return np.asarray(run.bench.motion.at(time).position)


def test_every_epoch_comes_once_after_the_lag(run: FusionBench, given: Outputs) -> None:
    late = joined(given, smoothed=True)
    assert_allclose(np.diff(late["tow_ns"]), 5_000_000, atol=2_000)
    seconds = (late["tow_ns"][[0, -1]] - run.bench.start.tow_ns) * 1e-9
    assert seconds[0] < 5.5
    # D, the lag and a batch behind the end.
    assert SECONDS - LAG - 0.1 - 0.4 < seconds[1] < SECONDS - LAG
    for span in given.spans:
        for motion in span.motion:
            if motion.smoothed:
                age = span.aiding.valid_through / RATE + 1.0 - LAG
                assert (motion.tow_ns[-1] - run.bench.start.tow_ns) * 1e-9 < age


def test_it_is_better_and_has_no_jumps(run: FusionBench, given: Outputs) -> None:
    errors = {}
    for smoothed in (False, True):
        motion = joined(given, smoothed=smoothed)
        seconds = (motion["tow_ns"] - run.bench.start.tow_ns) * 1e-9
        inside = (seconds > ONSET + 2.0) & (seconds < SECONDS - LAG - 1.0)
        errors[smoothed] = (motion["displacement"] - truth(run, motion["tow_ns"]))[inside]
    rms = {key: np.sqrt(np.mean(each**2, axis=0)) for key, each in errors.items()}
    jumps = {key: np.abs(np.diff(each, axis=0)).max(axis=0) for key, each in errors.items()}
    assert np.linalg.norm(rms[True]) < 0.9 * np.linalg.norm(rms[False])
    assert np.all(jumps[True] < 0.3 * jumps[False])
    late = joined(given, smoothed=True)
    assert np.isfinite(late["displacement_sd"]).all()
    # Not larger than what it says: 4 sigma of 11 s of errors that creep, white noise smoothed.
    assert np.all(np.abs(errors[True]).max(axis=0) < 4.0 * late["displacement_sd"].max(axis=0))


def test_what_holds_now_does_not_depend_on_it(run: FusionBench, given: Outputs) -> None:
    precise = precise_positions(run, rate_hz=10.0)
    plain = run.run(run.engine(precise=precise))
    for with_it, without in zip(given.spans, plain.spans, strict=True):
        forward = tuple(motion for motion in with_it.motion if not motion.smoothed)
        assert as_bytes(replace(with_it, motion=forward)) == as_bytes(without)


def test_what_comes_late_is_smoothed_as_if_in_time(run: FusionBench, given: Outputs) -> None:
    engine, precise = run.empty_engine(CONFIG), precise_positions(run, rate_hz=10.0)
    late = (13.0 * RATE, 13.4 * RATE)
    for state in run.inputs.motion:
        engine.push_motion(state)
    for sample in run.inputs.imu:
        engine.push_imu(sample)
    for pvt in run.inputs.pvt:
        engine.push_pvt(pvt)
    for position in precise:
        if not late[0] <= position.sample_index < late[1]:
            engine.push_precise(position)
    for valid in watermarks(engine):
        valid(EVERYTHING)
    spans, told = [], False
    while engine.next_sample + engine.block <= run.bench.sample_count:
        if not told and engine.next_sample >= 14.5 * RATE:
            for position in precise:
                if late[0] <= position.sample_index < late[1]:
                    engine.push_precise(position)
            told = True
        output = engine.advance()
        assert output is not None
        spans.append(output)
    assert engine.statistics["undone"] > 0
    got, expected = joined(Outputs(run, spans), smoothed=True), joined(given, smoothed=True)
    seconds = (got["tow_ns"] - run.bench.start.tow_ns) * 1e-9
    # What came out before they came did not know of them; D and batches later all does.
    since, before = seconds > 14.5 - LAG + 0.2, seconds < 13.0 - LAG - 0.4
    assert since.any()
    for name in got:
        assert_array_equal(got[name][since], expected[name][since])
        assert_array_equal(got[name][before], expected[name][before])
    assert np.any(got["displacement"] != expected["displacement"])


def test_a_lag_within_which_steps_can_be_undone_is_refused(run: FusionBench) -> None:
    with pytest.raises(InputError, match="can be undone"):
        run.engine(FusionConfig(smoothing_lag_s=2.0))


def test_a_lag_of_a_second_has_nearly_all_of_it(run: FusionBench, given: Outputs) -> None:
    """It takes a shorter memory of what can be undone."""
    config = FusionConfig(smoothing_lag_s=1.0, undo_s=0.8)
    short = run.run(run.engine(config, precise=precise_positions(run, rate_hz=10.0)))
    rms = []
    for outputs, smoothed in ((short, False), (short, True), (given, True)):
        motion = joined(outputs, smoothed=smoothed)
        seconds = (motion["tow_ns"] - run.bench.start.tow_ns) * 1e-9
        inside = (seconds > ONSET + 2.0) & (seconds < SECONDS - LAG - 1.0)
        error = (motion["displacement"] - truth(run, motion["tow_ns"]))[inside]
        rms.append(np.sqrt(np.mean(np.sum(error**2, axis=1))))
    forward, second, longer = rms
    assert second < 0.9 * forward
    assert second < longer + 0.3 * (forward - longer)
