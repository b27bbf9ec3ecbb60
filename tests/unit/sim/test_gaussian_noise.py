"""The noise is normal, white, and a function of (seed, sample index) alone."""

import numpy as np
import pytest
from scipy import stats

from deepseis_sim.gaussian_noise import BLOCK, gaussian_noise, normal_pair

COUNT = 1_000_000


@pytest.fixture(scope="module")
def noise():
    return gaussian_noise(12345, 0, COUNT).astype(np.complex128)


@pytest.mark.parametrize("part", [np.real, np.imag])
def test_each_component_is_unit_normal(noise, part):
    x = part(noise)
    # Four standard deviations of each estimate from a million values.
    assert abs(x.mean()) < 4 / np.sqrt(COUNT)
    assert abs(x.var() - 1) < 4 * np.sqrt(2 / COUNT)
    assert abs(stats.skew(x)) < 4 * np.sqrt(6 / COUNT)
    assert abs(stats.kurtosis(x)) < 4 * np.sqrt(24 / COUNT)
    assert stats.kstest(x, "norm").pvalue > 1e-4
    assert (np.abs(x) > 4).sum() == pytest.approx(63.3, abs=4 * np.sqrt(63.3))


@pytest.mark.parametrize("lag", [1, 2, 16, 64, BLOCK - 1, BLOCK, BLOCK + 1, 2 * BLOCK])
def test_neither_samples_nor_blocks_are_correlated(noise, lag):
    a, b = noise[lag:], noise[:-lag]
    assert abs((a * b.conj()).mean()) < 4 * 2 / np.sqrt(COUNT)
    power_a, power_b = np.abs(a) ** 2 - 2, np.abs(b) ** 2 - 2
    assert abs((power_a * power_b).mean()) < 4 * 4 / np.sqrt(COUNT)


def test_the_components_are_independent(noise):
    assert abs((noise.real * noise.imag).mean()) < 4 / np.sqrt(COUNT)
    assert abs(((noise.real**2 - 1) * (noise.imag**2 - 1)).mean()) < 4 * 2 / np.sqrt(COUNT)


def test_box_muller_polynomials_equal_the_functions():
    x = np.linspace(0, 2**32 - 1, 40_001).astype(np.uint32)
    y = np.roll(x, 12_345)
    u = (x >> np.uint32(1)).astype(np.float64) / 2**31 + 2.0**-32
    angle = np.pi / 2 * y.astype(np.int32).astype(np.float64) / 2**31
    half = 1 - 2 * (x & np.uint32(1)).astype(np.float64)
    expected = np.sqrt(-2 * np.log(np.minimum(u, 1))) * (half * np.cos(angle) + 1j * np.sin(angle))
    pairs = [complex(*normal_pair(a, b)) for a, b in zip(x, y, strict=True)]
    # Near u = 1 the root turns an error of 3e-7 in the logarithm into 6e-4 of a radius near 0.
    np.testing.assert_allclose(pairs, expected, rtol=0, atol=2e-3)


def test_any_part_equals_the_same_part_of_the_whole():
    whole = gaussian_noise(7, 0, 5000)
    np.testing.assert_array_equal(gaussian_noise(7, 1000, 1500), whole[1000:2500])


def test_seeds_have_nothing_in_common():
    a, b = gaussian_noise(1, 0, 100_000), gaussian_noise(2, 0, 100_000)
    assert abs((a * b.conj()).mean()) < 4 * 2 / np.sqrt(100_000)
