"""Trigger counts: the line, its uncertainty, and latches that were missed."""

import numpy as np
import pytest

from deepseis_core.errors import InputError
from deepseis_core.sample_clock import SampleClock
from deepseis_frontend.imu_clock import fit_imu_clock
from deepseis_frontend.imu_file import ImuFile

RATE = 4e6
TRUE_HZ = 200.0013
"""An IMU 6.5 ppm fast."""


def latched(seed=1, jitter=20.0, pairs=120, every=200):
    random = np.random.default_rng(seed)
    counts = every * np.arange(pairs)
    exact = 123_456.7 + counts * RATE / TRUE_HZ
    return counts, np.floor(exact + random.normal(0.0, jitter, pairs)), exact


def test_rate_and_time_come_back_within_their_sigmas():
    ratios = []
    for seed in range(200):
        counts, samples, exact = latched(seed)
        clock = fit_imu_clock(counts, samples)
        error = clock.sample_at(counts[[0, 60, -1]]) + 0.5 - exact[[0, 60, -1]]
        ratios.append(
            [*(error / clock.sd_at(counts[[0, 60, -1]])),
             (clock.rate_hz(RATE) - TRUE_HZ) / clock.rate_sd_hz(RATE)]
        )  # fmt: skip
    mean_square = np.mean(np.square(ratios), axis=0)  # chi-square of 200: 1 +- 0.1
    assert np.min(mean_square) > 0.7
    assert np.max(mean_square) < 1.35


def test_the_sigma_is_that_of_the_textbook():
    counts, samples, _ = latched()
    clock = fit_imu_clock(counts, samples)
    x = counts - counts.mean()
    slope_sd = clock.jitter / np.sqrt(np.sum(x**2))
    assert clock.rate_sd_hz(RATE) == pytest.approx(TRUE_HZ**2 / RATE * slope_sd, rel=0.05)
    assert clock.jitter == pytest.approx(20.0, rel=0.25)
    ahead = clock.sd_at(counts[-1] + 1_000_000)
    assert ahead == pytest.approx(slope_sd * 1_000_000, rel=0.05)


def test_missed_and_late_latches_are_left_out():
    counts, samples, exact = latched()
    samples = samples.copy()
    samples[[7, 30, 31, 90]] += np.array([4000, 9000, 700, 250_000])
    clock = fit_imu_clock(counts, samples)
    assert clock.outliers == 4
    assert np.abs(clock.sample_at(counts) - exact).max() < 4 * clock.sd_at(counts[0]) + 1


def test_without_jitter_the_counter_s_own_step_is_the_uncertainty():
    counts, samples, _ = latched(jitter=0.0)
    clock = fit_imu_clock(counts, samples)
    assert clock.jitter == pytest.approx(1 / np.sqrt(12), rel=0.2)


@pytest.mark.parametrize(("counts", "samples", "reason"), [
    ([0, 1, 2], [0, 1, 2], "3 pairs"),
    ([0, 1, 2, 2], [0, 1, 2, 3], "do not grow"),
    ([0, 1, 2, np.nan], [0, 1, 2, 3], "not finite"),
])  # fmt: skip
def test_what_is_no_line_is_refused(counts, samples, reason):
    with pytest.raises(InputError, match=reason):
        fit_imu_clock(counts, samples)


def test_counters_that_jump_are_refused():
    counts, samples, _ = latched()
    with pytest.raises(InputError, match="straight line"):
        fit_imu_clock(counts, samples + 50_000 * (np.arange(120) // 30))


def test_an_imu_file_that_counts_stands_on_the_if_s_clock(tmp_path):
    counts, samples, _ = latched()
    lines = [f"{n},0,0,9.8,0,0,0" for n in range(1000)]
    (tmp_path / "i.csv").write_text("n,ax,ay,az,gx,gy,gz\n" + "\n".join(lines) + "\n")
    np.savetxt(tmp_path / "t.csv", np.stack([counts, samples], axis=1), "%d", delimiter=",")
    (tmp_path / "i.csv.yaml").write_text(
        "time: {column: n, unit: count, triggers: t.csv}\n"
        "accelerometer: {columns: [ax, ay, az]}\ngyroscope: {columns: [gx, gy, gz]}\n"
    )
    imu = ImuFile(tmp_path / "i.csv", SampleClock(0, RATE))
    assert imu.rate_hz == pytest.approx(TRUE_HZ, abs=1e-3)
    index = np.array([s.sample_index for s in imu.samples()])
    exact = 123_456.7 + np.arange(1000) * RATE / TRUE_HZ
    assert np.abs(index - exact).max() < 20.0
    timing = imu.timing()
    assert abs(timing["rate_measured_hz"] - TRUE_HZ) < 5 * timing["rate_sd_hz"]
    assert 0.2 < timing["time_sd_us"] < 1.0  # 20 samples of 0.25 us, over sqrt(120)


@pytest.mark.parametrize("time", ["unit: count", "triggers: t.csv", "unit: count, triggers: no"])
def test_half_a_description_is_refused(tmp_path, time):
    (tmp_path / "i.csv").write_text("n,ax,ay,az,gx,gy,gz\n0,0,0,9.8,0,0,0\n1,0,0,9.8,0,0,0\n")
    (tmp_path / "i.csv.yaml").write_text(
        f"time: {{column: n, {time}}}\n"
        "accelerometer: {columns: [ax, ay, az]}\ngyroscope: {columns: [gx, gy, gz]}\n"
    )
    with pytest.raises(InputError):
        ImuFile(tmp_path / "i.csv", SampleClock(0, RATE))
