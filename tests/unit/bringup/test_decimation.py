"""Decimation: flat, zero phase, nothing folds back, nothing made up."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from deepseis_bringup.export.decimation import Decimator, design_stages
from deepseis_bringup.export.miniseed import sample_times
from deepseis_bringup.export.sample_runs import Run
from deepseis_core.errors import InputError
from deepseis_core.gps_time import GpsTime

START = GpsTime.from_utc_calendar(2022, 1, 1, 2, 0, 10**9 // 4).total_ns
CASES = [(200.0, 1.0, 0.6), (200.0, 50.0, 0.8), (100.0, 50.0, 0.8), (50.0, 1.0, 0.6)]


def sine(frequency, rate_hz, seconds):
    times = sample_times(START, int(seconds * rate_hz), rate_hz)
    phase = 2 * np.pi * frequency * (times - START) * 1e-9
    return Run(times, np.stack([np.sin(phase), np.cos(phase)], axis=1), rate_hz)


@pytest.mark.parametrize(("rate", "out", "fraction"), CASES)
@pytest.mark.parametrize("part", [0.0, 0.1, 0.35, 0.67, 0.99])
def test_below_the_pass_band_edge_samples_are_those_of_the_wave(rate, out, fraction, part):
    run = sine(part * fraction * out / 2, rate, 80.0 / min(out, 5.0) + 5.0)
    kept = Decimator(rate, out, fraction).push(run)
    where = np.searchsorted(run.gps_ns, kept.gps_ns)
    assert np.array_equal(run.gps_ns[where], kept.gps_ns)
    assert_allclose(kept.values, run.values[where], rtol=0, atol=1e-4)


@pytest.mark.parametrize(("rate", "out", "fraction"), CASES)
def test_nothing_folds_back(rate, out, fraction):
    for frequency in np.array([1.0, 1.3, 2.0, 2.7, 9.9]) * out / 2:
        if frequency > rate / 2:
            continue
        kept = Decimator(rate, out, fraction).push(sine(frequency, rate, 60.0 / min(out, 3.0)))
        assert np.abs(kept.values).max() < 1e-4


def test_a_still_station_stays_where_it_is():
    run = sine(0.0, 200.0, 60.0)
    kept = Decimator(200.0, 1.0, 0.6).push(run)
    assert_allclose(kept.values[:, 1], 1.0, rtol=0, atol=1e-13)


def test_kept_samples_lie_on_whole_seconds_and_only_where_the_filter_is_full():
    decimator = Decimator(200.0, 1.0, 0.6)
    run = sine(0.1, 200.0, 60.0)
    kept = decimator.push(run)
    assert set(kept.gps_ns % 10**9) == {0}
    assert set(np.diff(kept.gps_ns)) == {10**9}
    reach = decimator.reach_s * 1e9
    assert run.gps_ns[0] + reach <= kept.gps_ns[0] < run.gps_ns[0] + reach + 2e9
    assert run.gps_ns[-1] - reach - 2e9 < kept.gps_ns[-1] <= run.gps_ns[-1] - reach


@pytest.mark.parametrize("size", [1, 37, 400, 5000])
def test_any_chunking_gives_the_same(size):
    run = sine(0.2, 200.0, 50.0)
    whole = Decimator(200.0, 1.0, 0.6).push(run)
    decimator, parts = Decimator(200.0, 1.0, 0.6), []
    for k in range(0, len(run.gps_ns), size):
        part = slice(k, k + size)
        got = decimator.push(Run(run.gps_ns[part], run.values[part], 200.0, k > 0))
        parts += [got] if got is not None else []
    assert [part.continues for part in parts] == [False] + [True] * (len(parts) - 1)
    assert np.array_equal(np.concatenate([p.gps_ns for p in parts]), whole.gps_ns)
    values = np.concatenate([p.values for p in parts])
    assert_allclose(values, whole.values, rtol=0, atol=1e-13)


def test_nothing_reaches_across_a_gap():
    decimator = Decimator(200.0, 50.0, 0.8)
    before, after = sine(1.0, 200.0, 10.0), sine(1.0, 200.0, 10.0)
    after = Run(after.gps_ns + 10_105_000_000, after.values * 0 + 5.0, 200.0, False)
    decimator.push(before)
    kept = decimator.push(after)
    assert not kept.continues
    assert_allclose(kept.values, 5.0, rtol=0, atol=1e-12)
    assert kept.gps_ns[0] >= after.gps_ns[0] + decimator.reach_s * 1e9 - 1


@pytest.mark.parametrize(("rate", "out"), [(200.0, 30.0), (110.0, 10.0), (50.0, 50.0)])
def test_impossible_ratios_are_named(rate, out):
    with pytest.raises(InputError, match=f"decimation from {rate:g} to {out:g} Hz"):
        design_stages(rate, out, 0.6)
