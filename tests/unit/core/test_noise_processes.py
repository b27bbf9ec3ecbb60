import allantools  # type: ignore[import-untyped]
import numpy as np
import pytest
from scipy.signal import welch

from deepseis_core.errors import InputError
from deepseis_core.noise_processes import (
    BLOCK,
    FlickerNoise,
    GaussMarkovNoise,
    RandomWalkNoise,
    StreamedNoise,
    WhiteNoise,
    flicker_bank,
    gauss_markov_allan_deviation,
)


def every_kind() -> list[StreamedNoise]:
    return [
        WhiteNoise(5, 1, 3),
        GaussMarkovNoise(5, 1, [1.0, 2.0, 0.0], [3.0, 400.0, 1.0], 0.01),
        RandomWalkNoise(5, 1, [1.0, 0.1], 0.01),
        FlickerNoise(5, 1, 1e-3, 0.01),
    ]


@pytest.mark.parametrize("kind", range(4))
def test_values_do_not_depend_on_chunks_nor_on_the_order_of_asking(kind: int) -> None:
    length = 5 * BLOCK
    whole = every_kind()[kind](0, length)
    noise = every_kind()[kind]
    cuts = np.r_[0, np.sort(np.random.default_rng(1).integers(0, length, 30)), length]
    spans = list(zip(cuts[:-1], np.diff(cuts), strict=True))
    for first, count in [*spans[::-1], *spans]:
        part = noise(int(first), int(count))
        np.testing.assert_array_equal(part, whole[first : first + count])
    np.testing.assert_array_equal(noise(length - 1, 1), whole[-1:])


def test_memory_is_a_few_blocks_and_one_state_a_block() -> None:
    noise = GaussMarkovNoise(1, 1, np.ones(6), 100.0, 1e-3)
    noise(3_599_999, 1)
    assert len(noise._recent) <= 4
    assert sum(state.nbytes for state in noise._states) < 50_000


def test_streams_seeds_and_blocks_are_independent() -> None:
    series = [WhiteNoise(s, t, 1)(0, 2 * BLOCK)[:, 0] for s, t in ((1, 1), (1, 2), (2, 1))]
    halves = np.reshape(series, (6, BLOCK))
    starts = WhiteNoise(1, 1, 1).start_normals(BLOCK)  # not block 0 again
    correlation = np.corrcoef(np.vstack([halves, starts])) - np.eye(7)
    assert np.abs(correlation).max() < 4.5 / np.sqrt(BLOCK)


def test_gauss_markov_is_stationary_from_the_first_sample() -> None:
    # 4000 columns are 4000 independent runs: the deviation is known to 1.1 %.
    noise = GaussMarkovNoise(3, 1, np.full(4000, 2.0), 50.0, 10.0)(0, 40)
    assert noise[0].std() == pytest.approx(2.0, rel=0.05)
    assert noise[39].std() == pytest.approx(2.0, rel=0.05)
    lagged = np.mean(noise[0] * noise[5]) / 4.0
    assert lagged == pytest.approx(np.exp(-1.0), abs=0.06)


@pytest.mark.parametrize("step", [0.01, 1.0, 30.0])
def test_gauss_markov_discretisation_is_exact_at_any_step(step: float) -> None:
    noise = GaussMarkovNoise(3, 1, 1.0, 10.0, step)(0, 400_000)[:, 0]
    decay = np.exp(-step / 10.0)
    innovation = noise[1:] - decay * noise[:-1]
    assert innovation.std() == pytest.approx(np.sqrt(1.0 - decay**2), rel=0.01)


def test_gauss_markov_allan_deviation_is_that_of_the_standard() -> None:
    tau = np.geomspace(0.5, 5.0, 2000)
    curve = gauss_markov_allan_deviation(1.0, 1.0, tau)
    # IEEE Std 952-1997, C.1.7: 0.437 q_c sqrt(T) at 1.89 T, with q_c = sigma sqrt(2 / T).
    assert tau[curve.argmax()] == pytest.approx(1.89, abs=0.01)
    assert curve.max() == pytest.approx(0.437 * np.sqrt(2.0), abs=0.001)
    # Far below T a random walk of rate K = q_c: K sqrt(tau / 3); without a jump between branches.
    short = np.array([1e-6, 0.99e-3, 1.01e-3])
    np.testing.assert_allclose(
        gauss_markov_allan_deviation(1.0, 1.0, short), np.sqrt(2.0 * short / 3.0), rtol=1e-3
    )


def test_gauss_markov_allan_deviation_is_measured() -> None:
    noise = GaussMarkovNoise(8, 1, 3.0, 20.0, 1.0)(0, 400_000)[:, 0]
    tau, measured, _, _ = allantools.oadev(
        noise, rate=1.0, data_type="freq", taus=[4, 10, 38, 100, 400]
    )
    # A sample of the process is its value, theory's is the mean over the step: 1 % at 4 steps.
    np.testing.assert_allclose(measured, gauss_markov_allan_deviation(3.0, 20.0, tau), rtol=0.05)


def test_random_walk_grows_with_the_square_root_of_time() -> None:
    noise = RandomWalkNoise(4, 1, np.full(4000, 0.5), 0.25)(0, 401)
    np.testing.assert_array_equal(noise[0], 0.0)
    assert noise[400].std() == pytest.approx(0.5 * np.sqrt(100.0), rel=0.05)


def test_flicker_density_is_one_over_frequency_over_four_decades() -> None:
    noise = FlickerNoise(6, 1, 2.0, 0.01)(0, 2_000_000)[:, 0]
    for frequency, length in ((0.01, 200_000), (0.1, 50_000), (1.0, 10_000), (10.0, 2_000)):
        density_hz, density = welch(noise, 100.0, nperseg=length)
        band = (density_hz > frequency / 1.5) & (density_hz < frequency * 1.5)
        assert np.mean(density[band] * density_hz[band]) == pytest.approx(2.0, rel=0.1)


def test_flicker_allan_deviation_is_flat() -> None:
    noise = FlickerNoise(7, 1, 1.0, 0.01)(0, 1_000_000)[:, 0]
    _, measured, _, _ = allantools.oadev(noise, rate=100.0, data_type="freq", taus=[0.1, 1, 10])
    np.testing.assert_allclose(measured, np.sqrt(2.0 * np.log(2.0)), rtol=0.05)


def test_flicker_bank_ripples_less_than_a_percent() -> None:
    sigma, time = flicker_bank(1.0, 1e-4, 1e5)
    frequency = np.geomspace(1e-4, 10.0, 500)[:, None]
    density = (4.0 * sigma**2 * time / (1.0 + (2.0 * np.pi * frequency * time) ** 2)).sum(axis=1)
    np.testing.assert_allclose(density * frequency[:, 0], 1.0, rtol=0.01)


@pytest.mark.parametrize(
    ("sigma", "time", "step"), [(-1.0, 1.0, 1.0), (1.0, 0.0, 1.0), (1.0, 1.0, 0.0), (np.nan, 1, 1)]
)
def test_impossible_processes_are_refused(sigma: float, time: float, step: float) -> None:
    with pytest.raises(InputError, match="needs sigma"):
        GaussMarkovNoise(1, 1, sigma, time, step)


def test_impossible_questions_are_refused() -> None:
    with pytest.raises(InputError, match="from -1"):
        WhiteNoise(1, 1, 1)(-1, 5)
    with pytest.raises(InputError, match="whole numbers from 0"):
        WhiteNoise(-1, 1, 1)
    assert WhiteNoise(1, 1, 2)(7, 0).shape == (0, 2)
