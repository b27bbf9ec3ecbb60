"""Precise positions in the fusion: better aiding, displacements to the millimetre, faults."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from fusion_bench import FusionBench, Outputs, as_bytes, precise_positions, watermarks

from deepseis_core.rotation import matrix_from_quat, rotvec_from_matrix
from deepseis_core.types import DisplacementSource, FloatArray, PrecisePosition, PreciseStatus
from deepseis_ins.fusion_config import FusionConfig
from deepseis_ins.ground_motion import PreciseMotion

RATE = 4_000_000
STEP = (0.5, -0.3, 0.2)
"""Left by the earthquake, east, north, up [m]."""
TILT = (2.0, -3.0, 1.0)
"""Left by it too: about east, about north, clockwise from above [deg]."""
SHAKING = (14.0, 26.0)
"""[s]"""
JUMP = (0.05, -0.05, 0.1)
"""[m]"""
NOISE = (1e-3, 1e-3, 2.5e-3)
OFF = np.array([7.0, -4.0, 2.0])
"""[m]"""


@pytest.fixture(scope="module")
def run() -> FusionBench:
    """Still, 12 s on a circle of 12 cm at 2 Hz (2 g) with a step of 0.6 m and a tilt, still."""
    (east, north, up), (pitch, roll, heading) = STEP, TILT
    motion = (
        f"[{{kind: circle, radius: 0.12, frequency_hz: 2.0, start: {SHAKING[0]}, duration: 12.0}},"
        f" {{kind: offset, east: {east}, north: {north}, up: {up}, start: 18.0, rise: 3.0}},"
        f" {{kind: tilt, pitch_deg: {pitch}, roll_deg: {roll}, heading_deg: {heading},"
        " start: 18.0, rise: 3.0}]"
    )
    return FusionBench("sine-2hz", "stim300", "duration=40", f"motion={motion}")


@pytest.fixture(scope="module")
def precise(run: FusionBench) -> list[PrecisePosition]:
    """Positions with noise that creep."""
    return precise_positions(run)


@pytest.fixture(scope="module")
def outputs(run: FusionBench, precise: list[PrecisePosition]) -> Outputs:
    """The run with them."""
    return run.run(run.engine(precise=precise))


def displacement(
    outputs: Outputs, source: DisplacementSource = DisplacementSource.FUSED
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return times, errors and sigmas of the ground motion of a source, (n, 3) [m]."""
    found = [m for span in outputs.spans for m in span.motion if m.source == source]
    start = outputs.run.bench.start
    t = np.concatenate([(m.tow_ns - start.tow_ns) * 1e-9 for m in found])
    # By phases alone it is the antenna's: a tilt swings it about the IMU.
    bench, arm = outputs.run.bench, np.zeros(3)
    if source == DisplacementSource.GNSS:
        arm = np.asarray(bench.scenario.lever_arm)
    at, before = bench.motion.at(t), bench.motion.at(np.zeros(1))
    truth = at.position + at.C_enu_b @ arm - before.position - before.C_enu_b @ arm
    value = np.concatenate([m.displacement for m in found])
    return t, value - truth, np.concatenate([m.displacement_sd for m in found])


def rms(values: FloatArray) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def test_aiding_is_several_times_better_than_by_single_points(
    run: FusionBench, outputs: Outputs
) -> None:
    by_points = run.run(run.engine(FusionConfig(precise=False)), 26.0).between(*SHAKING)
    moving = outputs.between(*SHAKING)
    assert rms(moving.error()) < 0.5 * rms(by_points.error())
    # 3 mm/s/sqrt(s) of accelerometers against 1.7 mm at 50 Hz, of a second's third: 2 to 3 mm/s.
    assert rms(moving.error()) < 0.0035
    assert 0.7 < rms(moving.error()) / rms(moving.sd()) < 1.5
    ratio = np.std(moving.phase_error(3.0)[:, 500:]) / np.std(by_points.phase_error(3.0)[:, 500:])
    assert ratio < 0.75


def test_displacement_to_a_millimetre_and_the_step_stays(outputs: Outputs) -> None:
    t, error, sd = displacement(outputs)
    assert np.all(np.diff(t) == pytest.approx(0.005, abs=1e-6))
    shaking = (t > SHAKING[0]) & (t < SHAKING[1])
    # Creeping adds 2e-4 sqrt(12 s) = 0.7 mm to what the filter leaves of the noise.
    assert np.all(np.std(error[shaking], axis=0) < [1.2e-3, 1.2e-3, 2.0e-3])
    left = t > 35.0
    assert np.abs(error[left]).max() < 0.005
    normalised = error / sd
    assert 0.3 < rms(normalised[shaking]) < 1.6
    assert rms(normalised[left]) < 2.5  # one draw of what crept
    assert np.abs(error[t < SHAKING[0] - 0.1]).max() < 0.001


def test_the_tilt_stays(run: FusionBench, outputs: Outputs) -> None:
    solutions = [s.solution for s in outputs.spans if len(s.solution.sample_index)]
    t = np.concatenate([s.sample_index for s in solutions]) / RATE
    orientation = np.concatenate([np.reshape(s.orientation_xyzw, (-1, 4)) for s in solutions])
    true = run.bench.motion.at(t).C_enu_b
    turned = np.degrees(rotvec_from_matrix(true[-1] @ true[0].T))
    assert np.abs(turned).max() > 2.9
    error = rotvec_from_matrix(matrix_from_quat(orientation[-1]) @ true[-1].T)
    before = rotvec_from_matrix(matrix_from_quat(orientation[0]) @ true[0].T)
    sd = np.reshape(solutions[-1].state_sd, (-1, 15))[-1, 6:9]  # north, east, down
    assert np.all(np.abs(error)[[1, 0, 2]] < 3.0 * sd)
    # How much it has turned is known better than how the IMU was surveyed to stand.
    assert np.degrees(np.abs(error - before)).max() < 0.05


def test_precise_positions_alone_are_published_as_they_are(
    outputs: Outputs, precise: list[PrecisePosition]
) -> None:
    t, error, sd = displacement(outputs, DisplacementSource.GNSS)
    assert len(t) == sum(item.sample_index <= 39.88 * RATE for item in precise)
    assert np.std(error, axis=0) == pytest.approx(NOISE, rel=0.35)
    assert sd[0] == pytest.approx(NOISE, rel=1e-6)


def test_what_aided_loops_show_is_told_beside(precise: list[PrecisePosition]) -> None:
    by_loops = {"loops_displacement_enu": np.array([0.1, 0.2, 0.3]), "loops_sd_enu": np.ones(3)}
    motion = PreciseMotion()
    both = [
        shown
        for item in precise[:3]
        for shown in motion.take(replace(item, **by_loops), item.sample_index)  # type: ignore[arg-type]
    ]
    assert [m.source for m in both] == 3 * [DisplacementSource.GNSS, DisplacementSource.AIDED]
    assert both[1].displacement.tolist() == [[0.1, 0.2, 0.3]]
    assert both[1].displacement_sd.tolist() == [[1.0, 1.0, 1.0]]
    assert {m.interval for m in both} == {both[0].interval}
    lone = PreciseMotion()
    shown = [m.source for item in precise[:3] for m in lone.take(item, item.sample_index)]
    assert shown == 3 * [DisplacementSource.GNSS]


def without(precise: Sequence[PrecisePosition], begin: float, end: float) -> list[PrecisePosition]:
    """Say that there is none in an interval [s]."""
    nothing = {"status": int(PreciseStatus.NONE), "displacement_enu": np.full(3, np.nan)}
    inside = [begin <= item.sample_index / RATE < end for item in precise]
    return [
        replace(item, **nothing) if lost else item  # type: ignore[arg-type]
        for item, lost in zip(precise, inside, strict=True)
    ]


def test_positions_of_pvt_while_precise_ones_are_lost(
    run: FusionBench, precise: list[PrecisePosition]
) -> None:
    engine = run.engine(precise=without(precise, 17.0, 22.0))
    t, error, sd = displacement(run.run(engine, 26.0))
    lost, after = (t > 17.2) & (t < 22.0), (t > 23.0) & (t < 26.0)
    assert np.abs(error[lost]).max() < 0.3
    assert rms(error[lost] / sd[lost]) < 2.0
    # The step of 0.6 m has happened meanwhile, and is there.
    assert np.abs(error[after]).max() < 0.01
    assert engine.statistics["updates"] == pytest.approx(10 * (5.0 - 0.15), abs=2)


def afloat(precise: Sequence[PrecisePosition], begin: float) -> list[PrecisePosition]:
    """Let positions from a time [s] on be from a place that nobody knows."""
    elsewhere = {"status": int(PreciseStatus.CALIBRATING), "datum": 1}
    return [
        replace(item, displacement_enu=item.displacement_enu + OFF, **elsewhere)
        if item.sample_index >= begin * RATE
        else item
        for item in precise
    ]


def test_after_a_second_without_phases_their_place_is_what_the_imu_says(
    run: FusionBench, precise: list[PrecisePosition]
) -> None:
    lost = without(precise, 17.0, 18.0)
    unknown = run.run(run.engine(precise=without(precise, 17.0, 40.0)), 26.0)
    t, error, sd = displacement(run.run(run.engine(precise=afloat(lost, 18.0)), 26.0))
    whole = displacement(run.run(run.engine(precise=precise), 26.0))[1]
    after = (t > 18.3) & (t < 25.8)
    # The second at 2 g: attitude (0.01 deg) and biases, and PVT's positions, to some mm.
    extra = (error - whole)[after]
    assert np.abs(extra).max() < 0.012
    assert np.std(extra, axis=0).max() < 0.001, "one offset, and no motion of its own"
    assert 0.3 < rms((error / sd)[after]) < 1.6
    assert rms(extra) < 0.3 * rms(displacement(unknown)[1][after])
    # A filter that does not know its own place so well leaves it to PVT.
    lost_too = run.engine(FusionConfig(afloat_sd=0.001), precise=afloat(lost, 18.0))
    left = displacement(run.run(lost_too, 26.0))[1] - displacement(unknown)[1]
    assert np.abs(left).max() < 1e-6  # of dt: what was not used is an epoch all the same


def test_positions_shown_as_motion_are_an_epoch_apart_also_after_a_loss(
    run: FusionBench, precise: list[PrecisePosition]
) -> None:
    spans = run.run(run.engine(precise=without(precise, 10.0, 12.0)), 14.0).spans
    shown = [m for s in spans for m in s.motion if m.source == DisplacementSource.GNSS]
    assert len(shown) > 300
    # The bench's receiver clock runs 1e-7 fast.
    assert [m.interval for m in shown] == pytest.approx([0.02] * len(shown), abs=1e-8)


def test_a_jump_of_precise_positions_is_no_displacement(
    run: FusionBench, precise: list[PrecisePosition]
) -> None:
    jumped = [
        replace(item, displacement_enu=item.displacement_enu + np.array(JUMP))
        if item.sample_index > 16.0 * RATE
        else item
        for item in precise
    ]
    engine = run.engine(precise=jumped)
    t, error, sd = displacement(run.run(engine, 26.0))
    shaking = (t > 16.0) & (t < SHAKING[1])
    assert engine.statistics["precise_jumps"] == 1
    assert np.abs(error[shaking]).max() < 0.02
    assert rms(error[shaking] / sd[shaking]) < 2.5


def test_noise_is_told_while_still(run: FusionBench, precise: list[PrecisePosition]) -> None:
    """Formal sigmas three times too large change little."""
    wrong = [replace(item, covariance_enu=9.0 * item.covariance_enu) for item in precise]
    engine = run.engine(precise=wrong)
    run.run(engine, 14.0)
    assert engine.delayed is not None
    (error,) = engine.delayed.offsets.precise.values()
    assert error.noise_share == pytest.approx(1.0 / 3.0, rel=0.15)


def test_nothing_depends_on_when_they_arrive(
    run: FusionBench, precise: list[PrecisePosition], outputs: Outputs
) -> None:
    random = np.random.default_rng(3)
    engine = run.engine(precise=())
    engine._through["pvt"] = -1
    late = sorted(precise, key=lambda item: item.sample_index + random.uniform(0.0, 0.4 * RATE))
    got = []
    for begin in range(0, 16 * RATE, RATE):
        chunk = [item for item in late if begin <= item.sample_index < begin + RATE]
        for item in chunk:
            engine.push_precise(item)
        watermarks(engine)[3](begin + RATE - 1)
        while (output := engine.advance()) is not None:
            got.append(as_bytes(output))
    assert got[:790] == [as_bytes(span) for span in outputs.spans[:790]]
    # Late in real time: from then on it is where it would have been.
    early = [item for item in precise if not 15.0 * RATE < item.sample_index < 15.3 * RATE]
    engine = run.engine(precise=early)
    run.run(engine, 15.6)
    for item in precise:
        if 15.0 * RATE < item.sample_index < 15.3 * RATE:
            engine.push_precise(item)
    while engine.next_sample < 16 * RATE:
        output = engine.advance()
        assert output is not None
    position = engine.next_sample // engine.block - 1
    assert output.aiding.carrier_doppler_hz.tobytes() == (
        outputs.spans[position].aiding.carrier_doppler_hz.tobytes()
    )
    assert engine.statistics["undone"] >= 1
