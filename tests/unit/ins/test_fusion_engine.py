"""The order in which the fusion works, and what it does when something is missing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fusion_bench import EVERYTHING, FusionBench, as_bytes, motion, watermarks

from deepseis_core.constants import L1_WAVELENGTH
from deepseis_core.errors import InputError
from deepseis_core.hidden_motion import hidden_motion
from deepseis_core.imu_grades import grade_named
from deepseis_core.miss_log import EVER, MissLog, MissScript
from deepseis_core.types import MotionKind, MotionState, PvtStatus
from deepseis_ins.fusion_config import FusionConfig
from deepseis_ins.fusion_engine import FusionEngine
from deepseis_ins.fusion_output import FusionStatus

RATE = 4_000_000
ONSET = 12.0
"""Of the motion [s]."""
DELAY = 0.1


@pytest.fixture(scope="module")
def run() -> FusionBench:
    """Twelve seconds at rest, six on a circle of 12 cm at 2 Hz: 2 g."""
    circle = [
        ("radius", "0.12"), ("frequency_hz", "2.0"), ("start", str(ONSET)), ("duration", "6.0"),
    ]  # fmt: skip
    return FusionBench(
        "sine-2hz", "span-fsas", "duration=18", *(f"motion.0.{k}={v}" for k, v in circle)
    )


@pytest.fixture(scope="module")
def plain(run: FusionBench) -> list[bytes]:
    """All spans of an undisturbed run."""
    return [as_bytes(item) for item in run.run(run.engine()).spans]


def test_nothing_depends_on_the_order_of_arrival(run: FusionBench, plain: list[bytes]) -> None:
    random = np.random.default_rng(7)
    engine = run.empty_engine()
    pushes = [(item.sample_index, engine.push_imu, item) for item in run.inputs.imu]
    pushes += [(item.sample_index, engine.push_pvt, item) for item in run.inputs.pvt]
    pushes += [(item.valid_through, engine.push_motion, item) for item in run.inputs.motion]
    got = []
    for begin in range(0, run.bench.sample_count, 700_001):
        chunk = [item for item in pushes if begin <= item[0] < begin + 700_001]
        random.shuffle(chunk)  # type: ignore[arg-type]
        for _, push, item in chunk:
            push(item)
        for valid in random.permutation(np.array(watermarks(engine))):
            valid(begin + 700_000)
            while (output := engine.advance()) is not None:
                got.append(as_bytes(output))
    assert got[: len(plain)] == plain


def test_it_waits_for_each_input_and_names_it(run: FusionBench) -> None:
    engine = run.empty_engine()
    for valid, name in zip(watermarks(engine), ("samples", "imu", "motion"), strict=False):
        assert engine.waiting_for() == name
        assert engine.advance() is None
        valid(80_000)
    assert engine.waiting_for() == ""  # nothing is due from PVT before D
    assert engine.advance() is not None
    engine.pvt_valid(80_000)
    engine.source_valid(EVERYTHING)
    engine.imu_valid(EVERYTHING)
    engine.motion_valid(EVERYTHING)
    while engine.advance() is not None:
        pass
    # PVT through 0.02 s serves spans that begin up to D later.
    assert engine.waiting_for() == "pvt"
    assert engine.next_sample == 560_000


def test_every_span_is_spoken_of_from_the_start(run: FusionBench, plain: list[bytes]) -> None:
    spans = run.run(run.engine()).spans
    ends = [item.aiding.valid_through for item in spans]
    assert [item.aiding.valid_from for item in spans] == [0, *(end + 1 for end in ends[:-1])]
    before = [item for item in spans if item.status is FusionStatus.ALIGNING]
    assert before
    assert not any(item.aiding.valid or item.aiding.satellites for item in before)
    # 5 s of quiet are what the detector wants; the filter works D behind.
    assert len(before) == pytest.approx((5.0 + DELAY) / 0.02, abs=2)
    assert all(item.aiding.valid for item in spans[len(before) :])
    assert len(plain) == len(spans)


def test_a_position_acts_after_d_and_not_before(run: FusionBench, plain: list[bytes]) -> None:
    changed = list(run.inputs.pvt)
    number = next(k for k, item in enumerate(changed) if item.sample_index > 15 * RATE)
    faster = changed[number].velocity_ecef + np.array([0.05, 0.0, 0.0])
    changed[number] = replace(changed[number], velocity_ecef=faster)
    spans = run.run(run.engine(pvt=changed)).spans
    differing = [k for k, (a, b) in enumerate(zip(plain, spans, strict=True)) if a != as_bytes(b)]
    first = spans[differing[0]].aiding.valid_from
    due = changed[number].sample_index + DELAY * RATE
    assert due <= first < due + 80_000


def test_late_inputs_in_realtime_lead_back_to_the_same_bytes(
    run: FusionBench, plain: list[bytes]
) -> None:
    engine = run.empty_engine()
    for state in run.inputs.motion:
        engine.push_motion(state)
    late = (14.0 * RATE, 14.3 * RATE)  # everything of these 0.3 s comes 0.5 s late
    for item in run.inputs.imu:
        if not late[0] <= item.sample_index < late[0] + 40_000:
            engine.push_imu(item)
    for pvt in run.inputs.pvt:
        if not late[0] <= pvt.sample_index < late[1]:
            engine.push_pvt(pvt)
    for valid in watermarks(engine):
        valid(EVERYTHING if valid != engine.imu_valid else int(late[0]) - 1)
    got = []
    while engine.next_sample + engine.block <= run.bench.sample_count:
        if engine.next_sample >= 14.8 * RATE and engine._through["imu"] < EVERYTHING:
            for item in run.inputs.imu:
                if late[0] <= item.sample_index < late[0] + 40_000:
                    engine.push_imu(item)
            for pvt in run.inputs.pvt:
                if late[0] <= pvt.sample_index < late[1]:
                    engine.push_pvt(pvt)
            engine.imu_valid(EVERYTHING)
        output = engine.advance(force=True)
        assert output is not None
        got.append((engine.next_sample - engine.block, as_bytes(output), output))
    flagged = [begin for begin, _, output in got if output.late]
    assert flagged[0] == 14.0 * RATE - 80_000
    assert flagged[-1] < 14.8 * RATE
    after = [k for k, (begin, _, _) in enumerate(got) if begin >= 14.8 * RATE]
    assert [got[k][1] for k in after] == [plain[k] for k in after]
    assert any(got[k][1] != plain[k] for k in range(after[0]))


def test_a_replay_of_what_was_not_waited_for_gives_the_same_bytes(
    run: FusionBench, plain: list[bytes]
) -> None:
    random, engine, log, got = np.random.default_rng(5), run.empty_engine(), MissLog(), []
    inputs = [
        (run.inputs.imu, engine.push_imu, engine.imu_valid),
        (run.inputs.motion, engine.push_motion, engine.motion_valid),
        (run.inputs.pvt, engine.push_pvt, engine.pvt_valid),
    ]
    places, engine_end = [0, 0, 0], run.bench.sample_count
    late_until = [0, 0, 0]
    while engine.next_sample + engine.block <= engine_end:
        now = engine.next_sample + engine.block
        for k, (items, push, valid) in enumerate(inputs):
            if random.random() < 0.02:  # it hangs for up to a second
                late_until[k] = now + int(random.integers(0, RATE))
            if now < late_until[k]:
                continue
            # Some messages are there before the watermark that speaks for them.
            ahead = now + int(random.integers(0, 400_000))
            while places[k] < len(items) and _at(items[places[k]]) <= ahead:
                push(items[places[k]])
                places[k] += 1
            valid(now)
        engine.source_valid(now)
        output = engine.advance(force=True)
        assert output is not None
        got.append(as_bytes(output))
        for what, through in engine.missed.items():
            log.note(what, now - engine.block, engine.block, through)
    script = MissScript(f"{what} {runs}" for what, runs in log.take().items())
    assert {what for what in ("imu", "motion", "pvt") if script.limit(what, 0) < EVER} == {
        "imu", "motion", "pvt",
    }  # fmt: skip
    assert sum(a != b for a, b in zip(got, plain, strict=True)) > 100
    replayed = [as_bytes(item) for item in run.run(run.engine(script=script)).spans]
    assert replayed == got


def _at(item: object) -> int:
    """Return the sample through which a message is known."""
    return int(item.valid_through if isinstance(item, MotionState) else item.sample_index)  # type: ignore[attr-defined]


def test_a_constraint_that_overlapped_the_motion_is_undone_exactly(run: FusionBench) -> None:
    # So late as a SPAN-FSAS can hide 0.4 mm, which casts no doubt on the rest before.
    onset, noticed = int(13.02 * RATE), int(13.42 * RATE)
    still = motion(MotionKind.STATIC, 0, int(5 * RATE))
    late = [still, motion(MotionKind.MOVING, onset, noticed)]
    early = [still, motion(MotionKind.MOVING, onset, onset)]
    by_late = run.run(run.engine(motion=late), 16.0).between(12.0, 16.0)
    by_early = run.run(run.engine(motion=early), 16.0).between(12.0, 16.0)
    same = np.array(
        [
            a.aiding.carrier_doppler_hz.tobytes() == b.aiding.carrier_doppler_hz.tobytes()
            for a, b in zip(by_late.spans, by_early.spans, strict=True)
        ]
    )
    begins = np.array([item.aiding.valid_from for item in by_late.spans])
    # The first constraint that is none acts D after the onset; once noticed it has never been.
    assert same[begins < onset + DELAY * RATE].all()
    assert not same[(begins >= onset + 2 * DELAY * RATE) & (begins < noticed)].any()
    assert same[begins >= noticed].all()


def test_a_motion_noticed_later_than_can_be_undone_leaves_it_as_unsure_as_that(
    run: FusionBench,
) -> None:
    """Six seconds late, of which three are undone: the ground may have gone for six."""
    still = motion(MotionKind.STATIC, 0, int(4 * RATE))
    late = motion(MotionKind.MOVING, int(5.5 * RATE), int(11.5 * RATE))
    engine = run.engine(FusionConfig(undo_s=3.0), motion=[still, late])
    run.run(engine, 11.8)
    assert engine.statistics["doubted"] == 1
    far, _ = hidden_motion(run.grade.accelerometers.walk, 6.0)
    sd = np.sqrt(np.diag(engine.delayed.covariances()[1]))
    assert (sd > far).all()
    assert (sd < 2.0 * far).all()


def test_a_second_without_imu_data_is_said_and_over_within_two_seconds(
    run: FusionBench,
) -> None:
    there = [s for s in run.inputs.imu if not 13.5 * RATE < s.sample_index <= 14.5 * RATE]
    outputs = run.run(run.engine(imu=there))
    # The last sample goes on for 25 ms; beyond, nobody knows.
    lost = outputs.between(13.52, 14.5).spans
    assert {item.status for item in lost} == {FusionStatus.IMU_LOST}
    assert not any(item.aiding.valid for item in lost)
    later = outputs.between(14.5, 18.0)
    again = next(later.time_of(item) for item in later.spans if item.aiding.valid)
    assert 14.6 <= again < 15.5
    error = outputs.between(again, 18.0)
    assert np.abs(error.error()).max() < 5 * np.max(error.sd())
    assert np.sqrt(np.mean(outputs.between(16.5, 18.0).error() ** 2)) < 0.05


def test_one_missing_sample_is_bridged(run: FusionBench) -> None:
    there = [s for s in run.inputs.imu if s.sample_index != 14 * RATE + 20_000]
    engine = run.engine(imu=there)
    outputs = run.run(engine)
    assert all(item.aiding.valid for item in outputs.between(6.0, 18.0).spans)
    assert engine.statistics["missing"] == 2  # and the first of all, whose interval has no start
    # A straight line through 10 ms at 2 g, 2 Hz: a w^2 T^3 / 12, once.
    assert np.abs(outputs.between(14.1, 18.0).error()).max() < 0.02


def test_a_third_of_the_samples_missing_leaves_the_aiding_there_and_honest(
    run: FusionBench,
) -> None:
    random = np.random.default_rng(3)
    there = [
        item for item in run.inputs.imu
        if not (13.0 * RATE < item.sample_index < 17.0 * RATE and random.random() < 0.3)
    ]  # fmt: skip
    engine = run.engine(imu=there)
    outputs = run.run(engine)
    assert engine.statistics["missing"] > 200
    sparse = outputs.between(13.0, 17.0)
    assert np.mean([item.aiding.valid for item in sparse.spans]) > 0.98
    error = np.concatenate([
        e[:, :-1] / (s.aiding.doppler_sd_hz * L1_WAVELENGTH)[:, None]
        for e, s in zip(sparse.velocity_errors, sparse.spans, strict=True) if e is not None
    ]).ravel()  # fmt: skip
    assert 0.3 < np.sqrt(np.mean(error**2)) < 1.2
    assert np.abs(error).max() < 5.0
    assert np.sqrt(np.mean(sparse.error() ** 2)) < 0.02  # 0.002 m/s with all samples


def test_without_positions_it_goes_on_and_says_how_sure_it_is(run: FusionBench) -> None:
    there = [item for item in run.inputs.pvt if item.sample_index < 12.5 * RATE]
    outputs = run.run(run.engine(pvt=there))
    sd = [outputs.between(t, t + 0.02).sd().mean() for t in (13.0, 15.0, 17.9)]
    assert sd[0] < sd[1] < sd[2]
    end = outputs.between(17.0, 18.0)
    assert all(item.aiding.valid for item in end.spans)
    assert np.abs(end.error()).max() < 4 * end.sd().mean()


def test_empty_positions_are_nothing(run: FusionBench, plain: list[bytes]) -> None:
    nothing = replace(run.inputs.pvt[-1], status=int(PvtStatus.NONE), sample_index=13 * RATE + 5)
    outputs = run.run(run.engine(pvt=[*run.inputs.pvt, nothing]))
    assert [as_bytes(item) for item in outputs.spans] == plain


def test_clipping_is_counted_and_makes_it_less_sure(run: FusionBench) -> None:
    limit = 15.0
    clipped = [
        replace(item, linear_acceleration=np.clip(item.linear_acceleration, -limit, limit))
        for item in run.inputs.imu
    ]
    narrow = FusionBench.__new__(FusionBench)
    narrow.__dict__.update(run.__dict__)
    narrow.grade = replace(grade_named("span-fsas"), accel_range_g=limit / 9.80665)
    engine = narrow.engine(imu=clipped)
    outputs = narrow.run(engine)
    assert engine.statistics["clipped"] > 100
    moving = outputs.between(14.0, 18.0)
    assert moving.sd().mean() > 5 * run.run(run.engine(), 15.0).between(14.0, 15.0).sd().mean()
    assert np.sqrt(np.mean(moving.error() ** 2)) < 3 * moving.sd().mean()


def test_clipping_at_a_range_that_nobody_told_is_noticed(run: FusionBench) -> None:
    limit = 15.0
    clipped = [
        replace(item, linear_acceleration=np.clip(item.linear_acceleration, -limit, limit))
        for item in run.inputs.imu
    ]
    engine = run.engine(imu=clipped)
    outputs = run.run(engine)
    at_limit = [np.abs(item.linear_acceleration).max() == limit for item in clipped]
    # 2 g at 2 Hz stays beyond 15 m/s^2 for 0.11 s at a time: all but the first two samples.
    assert 0.8 * np.sum(at_limit) < engine.statistics["clipped"] <= np.sum(at_limit)
    plain = run.engine()
    run.run(plain)
    assert plain.statistics["clipped"] == 0
    moving = outputs.between(14.0, 18.0)
    assert np.sqrt(np.mean(moving.error() ** 2)) < 3 * moving.sd().mean()


def test_missing_data_have_moved_the_station_too(run: FusionBench) -> None:
    there = [s for s in run.inputs.imu if not 13.5 * RATE < s.sample_index <= 14.0 * RATE]
    outputs = run.run(run.engine(imu=there), 14.2)
    motion = [m for item in outputs.between(13.5, 14.0).spans for m in item.motion]
    start = run.bench.start.tow_ns
    t = np.array([(m.tow_ns[-1] - start) * 1e-9 for m in motion])
    true = run.bench.motion.at(t).position - run.bench.motion.at(np.zeros(1)).position
    error = np.array([m.displacement[-1] for m in motion]) - true
    ratio = np.abs(error) / np.array([m.displacement_sd[-1] for m in motion])
    assert np.abs(error).max() > 0.1  # 2 g over D and more: not to be known
    assert ratio.max() < 4.0


def test_the_imu_dies(run: FusionBench) -> None:
    there = [item for item in run.inputs.imu if item.sample_index < 13 * RATE]
    engine = run.engine(imu=there)
    ends = 50 * RATE
    statuses = []
    while engine.next_sample < ends:
        output = engine.advance()
        assert output is not None
        statuses.append(output.status)
        assert not (output.aiding.valid and engine.next_sample > 13.03 * RATE)
    assert statuses[round(14 / 0.02)] is FusionStatus.IMU_LOST
    assert statuses[-1] is FusionStatus.ALIGNING
    assert engine.statistics["restarts"] == 1


def test_memory_does_not_grow(run: FusionBench) -> None:
    engine = run.engine()
    engine.history.forget(0)
    run.run(engine)
    assert engine.delayed is not None
    assert len(engine.delayed._steps) < 100
    assert engine.history.end - engine.history.first < 4096
    assert len(engine.timeline._decisions) < 20


def test_a_survey_that_gravity_contradicts_gives_the_heading_alone(run: FusionBench) -> None:
    engine = run.empty_engine()
    turned = np.array([np.sin(np.radians(2.0)), 0.0, 0.0, np.cos(np.radians(2.0))])
    station = replace(run.bench.station(), imu_orientation_xyzw=turned)
    engine = FusionEngine(FusionConfig(), run.grade, run.sample_rate_hz, station, 200.0)
    for sample in run.inputs.imu:
        engine.push_imu(sample)
    for state in run.inputs.motion:
        engine.push_motion(state)
    for pvt in run.inputs.pvt:
        engine.push_pvt(pvt)
    for valid in watermarks(engine):
        valid(EVERYTHING)
    outputs = run.run(engine, 8.0)
    assert engine.statistics["corrected_surveys"] == 1
    up = outputs.spans[-1].solution.orientation_xyzw[-1]
    # Levelled, to the accelerometers' bias of 1 mg.
    assert np.hypot(up[0], up[1]) < 0.5 * 3e-3


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"monument_ecef": np.zeros(3)}, "not on Earth"),
        ({"imu_orientation_xyzw": np.array([1.0, 1.0, 0.0, 0.0])}, "no attitude"),
        ({"imu_to_antenna": np.array([np.nan, 0.0, 0.0])}, "lever arm"),
    ],
)
def test_a_senseless_station_is_refused(
    run: FusionBench, change: dict[str, np.ndarray], said: str
) -> None:
    station = replace(run.bench.station(), **change)
    with pytest.raises(InputError, match=said):
        FusionEngine(FusionConfig(), run.grade, run.sample_rate_hz, station, 200.0)


def test_an_imu_without_gyroscopes_is_refused(run: FusionBench) -> None:
    grade = grade_named("accelerometers")
    with pytest.raises(InputError, match="gyroscopes"):
        FusionEngine(FusionConfig(), grade, RATE, run.bench.station(), 200.0)
