from dataclasses import fields, replace
from time import perf_counter
from typing import Any

import allantools  # type: ignore[import-untyped]
import numpy as np
import pytest
from scipy.optimize import nnls

from deepseis_core.errors import InputError
from deepseis_core.imu_errors import GRADES, ImuErrors, ImuFlag, ImuGrade, grade_named
from deepseis_core.imu_grades import STANDARD_GRAVITY, TriadGrade
from deepseis_core.noise_processes import gauss_markov_allan_deviation
from deepseis_core.types import FloatArray

IMPERFECT = [name for name in GRADES if name != "perfect"]
G = STANDARD_GRAVITY


def still(rate_hz: float, count: int) -> tuple[FloatArray, FloatArray]:
    return np.zeros((count, 3)), np.tile([0.0, 0.0, G / rate_hz], (count, 1))


def measured_rates(grade: ImuGrade, rate_hz: float, count: int, seed: int) -> FloatArray:
    """Rates and specific forces of a unit at rest, (count, 6); no gyroscopes: no columns."""
    measured = ImuErrors(grade, rate_hz, seed).apply(0, *still(rate_hz, count))
    parts = [measured.delta_theta] * grade.has_gyros + [measured.delta_vel]
    return np.hstack(parts) * rate_hz


def triads(grade: ImuGrade) -> list[TriadGrade]:
    return [grade.gyros] * grade.has_gyros + [grade.accelerometers]


def allan(rates: FloatArray, rate_hz: float, taus: list[float]) -> FloatArray:
    """Allan deviation of three axes together, by allantools."""
    columns = [
        allantools.oadev(axis, rate=rate_hz, data_type="freq", taus=taus)[1] for axis in rates.T
    ]
    return np.asarray(np.sqrt(np.mean(np.square(columns), axis=0)))


def without(grade: ImuGrade, *words: str) -> ImuGrade:
    """Silence the errors whose names contain one of the words."""
    names = [item.name for item in fields(grade) if any(word in item.name for word in words)]
    silent: dict[str, Any] = dict.fromkeys(names, 0.0)
    return replace(grade, **silent)


@pytest.mark.parametrize("name", IMPERFECT)
def test_random_walks_are_recovered_from_an_hour_at_rest(name: str) -> None:
    grade = GRADES[name]
    rates = measured_rates(grade, 100.0, 360_000, seed=11)
    for k, triad in enumerate(triads(grade)):
        # Near 1 s white noise rules, but for a STIM300's accelerometers: fit both.
        taus = np.array([0.5, 1.0, 2.0, 4.0])
        variance = allan(rates[:, 3 * k : 3 * k + 3], 100.0, list(taus)) ** 2
        wander = gauss_markov_allan_deviation(1.0, triad.correlation_time, taus) ** 2
        table = np.column_stack([1.0 / taus, wander, 1.0 / taus**2]) / variance[:, None]
        size = np.abs(table).max(axis=0)
        white = nnls(table / size, np.ones(taus.size))[0][0] / size[0]
        assert np.sqrt(white) == pytest.approx(triad.walk, rel=0.2)
        total = np.sqrt(triad.walk**2 / taus + triad.instability**2 * wander)
        np.testing.assert_allclose(np.sqrt(variance), total, rtol=0.1)


@pytest.mark.parametrize("name", IMPERFECT)
def test_in_run_biases_are_recovered(name: str) -> None:
    # With correlation times up to 3 h this takes 1000 of them, and no white noise above it.
    grade = without(GRADES[name], "walk", "resolution")
    for k, triad in enumerate(triads(grade)):
        rate_hz = 10.0 / triad.correlation_time
        rates = measured_rates(grade, rate_hz, 10_000, seed=12)[:, 3 * k : 3 * k + 3]
        peak = allan(rates, rate_hz, [1.9 * triad.correlation_time])[0]
        assert peak / 0.617 == pytest.approx(triad.instability, rel=0.2)


def test_walk_and_in_run_bias_are_told_apart_in_one_record() -> None:
    # The one grade whose wander (60 and 30 s) rises above its white noise within hours.
    grade = GRADES["stim300"]
    rates = measured_rates(grade, 100.0, 1_080_000, seed=13)
    taus = np.array([0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0])
    for k, triad in enumerate(triads(grade)):
        variance = allan(rates[:, 3 * k : 3 * k + 3], 100.0, list(taus)) ** 2
        wander = gauss_markov_allan_deviation(1.0, triad.correlation_time, taus) ** 2
        table = np.column_stack([1.0 / taus, wander]) / variance[:, None]
        size = np.abs(table).max(axis=0)
        white, bias = nnls(table / size, np.ones(taus.size))[0] / size
        assert np.sqrt(white) == pytest.approx(triad.walk, rel=0.2)
        assert np.sqrt(bias) == pytest.approx(triad.instability, rel=0.2)


@pytest.mark.parametrize("noisy", [False, True])
@pytest.mark.parametrize("name", IMPERFECT)
def test_constant_errors_are_recovered_from_positions(name: str, noisy: bool) -> None:
    # Each axis up and down, and turned either way, a minute each: the six-position test.
    grade, rate_hz, minute = GRADES[name], 100.0, 6000
    if not noisy:
        grade = without(grade, "walk", "instability", "resolution")
    unit = ImuErrors(grade, rate_hz, seed=14)
    axes = np.vstack([np.eye(3), -np.eye(3)])
    forces, turns = G * axes, 1.0 * np.roll(axes, 1, axis=0)
    seen = []
    for k in range(6):
        true = [np.tile(item[k] / rate_hz, (minute, 1)) for item in (turns, forces)]
        out = unit.apply(k * minute, true[0], true[1])
        seen.append(np.hstack([out.delta_theta, out.delta_vel]).mean(axis=0) * rate_hz)
    truth, means = unit.truth(0, 6 * minute), np.array(seen)
    design = np.hstack([np.ones((6, 1)), turns, forces])
    for k, triad in enumerate([grade.gyros, grade.accelerometers]):
        if k == 0 and not grade.has_gyros:
            continue
        true = [truth.gyro_bias, truth.accel_bias][k].mean(axis=0)
        matrix = [truth.gyro_matrix, truth.accel_matrix][k]
        columns = design[:, [0, 1, 2, 3]] if k == 0 else design[:, [0, 4, 5, 6]]
        felt = means[:, 3 * k : 3 * k + 3] - (0.0 if k else forces @ truth.gyro_g_matrix.T)
        fit = np.linalg.lstsq(columns, felt, rcond=None)[0]
        # What is left: white noise of 60 s, and the wander from minute to minute.
        wander = [truth.gyro_bias, truth.accel_bias][k].reshape(6, minute, 3).mean(axis=1)
        noise = 4.0 * (triad.walk / np.sqrt(60.0) + np.ptp(wander, axis=0).max()) + 1e-12
        np.testing.assert_allclose(fit[0], true, atol=noise)
        np.testing.assert_allclose(fit[1:].T - np.eye(3), matrix, atol=noise / [1.0, G][k])
        assert np.abs(np.diag(matrix)).max() < 4.0 * triad.scale
        off = matrix - np.diag(np.diag(matrix))
        assert np.abs(off).max() < 4.0 * triad.misalignment


def test_what_is_drawn_has_the_grades_size() -> None:
    grade = GRADES["stim300"]
    units = [ImuErrors(grade, 100.0, seed).truth(0, 1) for seed in range(400)]
    off = ~np.eye(3, dtype=bool)
    rms = {
        "gyro bias": (np.array([u.gyro_bias for u in units]), (5.0**2 + 10.0**2) ** 0.5),
        "scale": (np.array([np.diag(u.accel_matrix) for u in units]), 1e-3),
        "misalignment": (np.array([u.gyro_matrix[off] for u in units]), 1e-3),
        "g": (np.array([u.gyro_g_matrix for u in units]), np.deg2rad(1.0) / 3600.0 / G),
    }
    rms["gyro bias"] = (rms["gyro bias"][0], rms["gyro bias"][1] * np.deg2rad(1.0) / 3600.0)
    for values, expected in rms.values():
        assert np.sqrt(np.mean(values**2)) == pytest.approx(expected, rel=0.1)


def test_g_sensitivity_turns_force_into_rate() -> None:
    grade = ImuGrade(gyro_g_sensitivity_deg_per_h=100.0)
    unit = ImuErrors(grade, 100.0, 1)
    out = unit.apply(0, *still(100.0, 10))
    expected = unit.truth(0, 1).gyro_g_matrix @ [0.0, 0.0, G] / 100.0
    np.testing.assert_allclose(out.delta_theta, np.tile(expected, (10, 1)), rtol=1e-12)


def test_chunks_do_not_matter() -> None:
    rng = np.random.default_rng(2)
    theta, vel = rng.normal(0.0, 1e-3, (20_000, 3)), rng.normal(0.0, 0.3, (20_000, 3))
    whole = ImuErrors(GRADES["stim300"], 500.0, 3).apply(0, theta, vel)
    unit, done, flags = ImuErrors(GRADES["stim300"], 500.0, 3), 0, 0
    while done < 20_000:
        part = slice(done, done + int(rng.integers(0, 3000)))
        out = unit.apply(done, theta[part], vel[part])
        done += len(out.flags)
        flags += int(np.count_nonzero(out.flags & ImuFlag.ACCEL_CLIPPED))
        np.testing.assert_array_equal(out.delta_theta, whole.delta_theta[part])
        np.testing.assert_array_equal(out.delta_vel, whole.delta_vel[part])
        unit.truth(max(done - 5000, 0), 10)  # asking leaves no trace
    assert flags == np.count_nonzero(whole.flags & ImuFlag.ACCEL_CLIPPED) > 0


def test_a_perfect_unit_gives_back_the_very_bits() -> None:
    rng = np.random.default_rng(2)
    theta, vel = rng.normal(size=(100, 3)), rng.normal(size=(100, 3))
    out = ImuErrors(GRADES["perfect"], 1000.0, 1).apply(0, theta, vel)
    np.testing.assert_array_equal(out.delta_theta, theta)
    np.testing.assert_array_equal(out.delta_vel, vel)
    assert not out.flags.any()


def test_quantised_increments_are_whole_steps_and_their_sums_stay_true() -> None:
    step = 2.0**-10
    unit = ImuErrors(ImuGrade(accel_resolution=step), 100.0, 1)
    vel = np.random.default_rng(1).normal(0.0, 0.3 * step, (5000, 3))
    out = unit.apply(0, np.zeros((5000, 3)), vel).delta_vel
    np.testing.assert_array_equal(np.rint(out / step), out / step)
    assert np.abs(np.cumsum(out - vel, axis=0)).max() <= 0.5001 * step


def test_what_exceeds_the_range_is_clipped_flagged_and_counted() -> None:
    unit = ImuErrors(ImuGrade(accel_range_g=5.0, gyro_range_deg_per_s=100.0), 100.0, 1)
    force = np.array([[1.0, -6.0, 1.0], [4.9, 5.1, -4.9], [0.0, 0.0, 1.0]]) * G
    rate = np.deg2rad([[101.0, 0.0, 0.0], [99.0, 0.0, 0.0], [0.0, 0.0, -500.0]])
    out = unit.apply(0, rate / 100.0, force / 100.0)
    np.testing.assert_allclose(out.delta_vel * 100.0, np.clip(force, -5.0 * G, 5.0 * G))
    np.testing.assert_allclose(np.rad2deg(out.delta_theta * 100.0)[[0, 2], [0, 2]], [100, -100])
    assert out.flags.tolist() == [3, 2, 1]
    assert unit.clipped.tolist() == [1, 0, 1, 0, 2, 0]


@pytest.mark.parametrize(
    ("name", "peak_g"),
    [
        ("span-fsas", 2.2),
        ("mti-g", 2.2),
        ("stim300", 2.2),
        ("accelerometers", 2.2),
        ("high-g", 50.0),
    ],
)
def test_the_scenarios_do_not_clip(name: str, peak_g: float) -> None:
    unit = ImuErrors(GRADES[name], 200.0, 1)
    angle = 2.0 * np.pi * np.arange(2000) / 200.0
    force = G * np.column_stack([peak_g * np.sin(angle), peak_g * np.cos(angle), np.ones(2000)])
    unit.apply(0, np.zeros((2000, 3)), force / 200.0)
    assert not unit.clipped.any()


def test_a_unit_without_gyroscopes_says_so() -> None:
    out = ImuErrors(GRADES["accelerometers"], 100.0, 1).apply(0, *still(100.0, 5))
    assert np.isnan(out.delta_theta).all()
    assert (out.flags == ImuFlag.NO_GYROS).all()
    with_gyros = ImuErrors(GRADES["span-fsas"], 100.0, 1).apply(0, *still(100.0, 5))
    np.testing.assert_array_equal(out.delta_vel, with_gyros.delta_vel)


def test_grades_of_one_seed_differ_in_size_only() -> None:
    def scaled(name: str) -> FloatArray:
        return ImuErrors(GRADES[name], 100.0, 4).truth(0, 1).accel_matrix.diagonal() * 1e6

    np.testing.assert_allclose(scaled("stim300") / 1000.0, scaled("span-fsas") / 300.0)


def test_bad_input_is_refused_in_one_line() -> None:
    unit = ImuErrors(GRADES["span-fsas"], 100.0, 1)
    with pytest.raises(InputError, match="sample 0 is next"):
        unit.apply(1, *still(100.0, 5))
    with pytest.raises(InputError, match="sample 0 is next"):
        unit.apply(0, np.zeros((4, 3)), np.zeros((5, 3)))
    with pytest.raises(InputError, match="one row of three"):
        unit.apply(0, np.zeros(3), np.zeros(3))
    with pytest.raises(InputError, match="not all finite"):
        unit.apply(0, np.zeros((1, 3)), np.array([[0.0, np.nan, 0.0]]))
    with pytest.raises(InputError, match="gives up to 200"):
        ImuErrors(GRADES["span-fsas"], 201.0, 1)
    with pytest.raises(InputError, match="whole numbers from 0"):
        ImuErrors(GRADES["span-fsas"], 100.0, -1)
    with pytest.raises(InputError, match="one of perfect, span-fsas"):
        grade_named("fsas")
    with pytest.raises(InputError, match="accel_bias = -1"):
        ImuGrade(accel_bias=-1.0)
    with pytest.raises(InputError, match="accel_bias is not a number"):
        ImuGrade(accel_bias=np.nan)
    assert unit.apply(0, *still(100.0, 5)).flags.tolist() == [0] * 5  # none of it did harm


@pytest.mark.benchmark
def test_a_million_samples_a_second() -> None:
    theta, vel = still(1000.0, 500_000)
    ImuErrors(GRADES["stim300"], 1000.0, 1).apply(0, theta[:10], vel[:10])
    unit = ImuErrors(GRADES["stim300"], 1000.0, 1)
    start = perf_counter()
    unit.apply(0, theta, vel)
    assert 500_000 / (perf_counter() - start) > 1e6


def test_a_grade_of_ones_own_is_a_known_one_with_changes():
    grade = grade_named("stim300 accel_walk_per_sqrt_h=0.06  has_gyros=false")
    assert grade == replace(GRADES["stim300"], accel_walk_per_sqrt_h=0.06, has_gyros=False)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "is not known"),
        ("tactical", "is not known"),
        ("stim300 accel_bias", "no figure=value"),
        ("stim300 colour=3", "no figure=value"),
        ("stim300 accel_bias=1 accel_bias=2", "given twice"),
        ("stim300 accel_bias=low", "no number"),
        ("stim300 accel_bias=-1", "outside"),
        ("stim300 accel_bias=nan", "not a number"),
        ("stim300 has_gyros=1", "neither true nor false"),
    ],
)
def test_a_grade_that_makes_no_sense_is_refused(text, reason):
    with pytest.raises(InputError, match=reason):
        grade_named(text)
