import numpy as np
import pytest

from deepseis_core.imu_grades import grade_named
from deepseis_core.ros import codecs
from deepseis_core.types import ImuSample, MotionKind
from deepseis_ins.motion_engine import MotionEngine, MotionEngineConfig
from deepseis_ins.motion_state import MotionConfig

STEP = 20_000  # samples of 4 MHz in 5 ms


def samples(count, *, moving_from=10**9, missing=()):
    rng = np.random.default_rng(1)
    grade = grade_named("span-fsas")
    sd = grade.accelerometers.walk * np.sqrt(200.0)
    rate_sd = grade.gyros.walk * np.sqrt(200.0)
    for number in range(1, count + 1):
        force = np.array([0.0, 0.0, 9.8]) + sd * rng.standard_normal(3)
        force[0] += 0.5 * (number >= moving_from)
        rate = rate_sd * rng.standard_normal(3)
        if number not in missing:
            yield ImuSample(number * STEP, rate, force, 1e-8, 1e-5)


def engine():
    return MotionEngine(MotionEngineConfig(), MotionConfig(), grade_named("span-fsas"), 200.0, 4e6)


def decide(made, items, cuts):
    """Push in pieces, telling each time how far the data are complete."""
    said, begin = [], 0
    for end in [*cuts, len(items)]:
        for item in items[begin:end]:
            made.push(item)
        through = items[end - 1].sample_index if end else -1
        said += [state for _, states in made.advance(through) for state in states]
        begin = end
    return said


def same(a, b):
    return codecs.MOTION_STATE.encode(a, 0) == codecs.MOTION_STATE.encode(b, 0)


def test_how_the_samples_arrive_changes_nothing():
    items = list(samples(2000, moving_from=1500))
    whole = decide(engine(), items, [])
    pieces = decide(engine(), items, [1, 7, 500, 501, 1499, 1503])
    assert len(whole) == len(pieces)
    assert all(same(a, b) for a, b in zip(whole, pieces, strict=True))


def test_a_step_is_moving_from_its_first_sample_on():
    said = decide(engine(), list(samples(2000, moving_from=1500)), [])
    states = [state.state for state in said]
    assert MotionKind.STATIC in states
    moving = next(state for state in said if state.state == MotionKind.MOVING)
    assert moving.sample_index <= 1499 * STEP
    assert 1500 * STEP <= moving.valid_through <= 1510 * STEP


def test_the_state_is_said_again_every_second():
    said = decide(engine(), list(samples(2000)), [])
    ends = [state.valid_through / 4e6 for state in said]
    assert {float(k) for k in range(1, 11)} <= set(ends)


def test_missing_samples_do_not_stop_the_clock():
    made = engine()
    items = list(samples(1000, missing=range(300, 800)))
    decide(made, items[:299], [])
    list(made.advance(600 * STEP))
    assert made.valid_through == 600 * STEP
    said = decide(made, items[299:], [])
    assert made.valid_through == 1000 * STEP
    assert said[-1].valid_through == 1000 * STEP


@pytest.mark.parametrize("through", [-1, 0, 3 * STEP])
def test_less_than_a_group_decides_nothing(through):
    made = engine()
    for item in samples(3):
        made.push(item)
    assert list(made.advance(through)) == []


def test_a_detector_that_joins_decides_from_there_on():
    items = list(samples(6000, moving_from=5000))
    made, first = engine(), items[3001].sample_index
    made.join(first)
    for item in items[3001:]:
        made.push(item)
    through, states = zip(*made.advance(items[-1].sample_index), strict=True)
    # Whole groups of four from the first that begins with a sample that was seen.
    assert through[0] - first in range(3 * STEP, 7 * STEP)
    assert np.diff(through).tolist() == [4 * STEP] * (len(through) - 1)
    said = [state for group in states for state in group]
    moving = next(s for s in said if s.state == MotionKind.MOVING)
    assert 0 <= 5000 * STEP - moving.sample_index < 20 * STEP  # 0.05 g from one sample to the next
    assert any(s.state == MotionKind.STATIC for s in said)
