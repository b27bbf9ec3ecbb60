"""The artificial earthquake: the code's spectrum on the motion as delivered, rest around it."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from deepseis_core.errors import InputError
from deepseis_sim.artificial_earthquake import (
    MOTION_KINDS,
    Artificial,
    envelope,
    kaul_amplitudes,
)
from deepseis_sim.design_spectrum import STANDARD_GRAVITY, DesignSpectrum
from deepseis_sim.motion import Surroundings
from deepseis_sim.response_spectrum import response_spectrum

CONFIG = Artificial()
QUICK = Artificial(
    start=5.0,
    duration=20.0,
    t1=(3.0, 4.0, 2.0),
    t2=(12.0, 10.0, 9.0),
    t3=(20.0, 19.0, 18.0),
    tolerance=0.5,
    iterations=2,
)


def around(seed=3):
    return Surroundings((0.6, 2.4, 10.0), 1020.0, seed)


@pytest.fixture(scope="module")
def motion():
    return CONFIG.build(around())


@pytest.fixture(scope="module")
def delivered(motion):
    """Kinematics at 1 kHz, as an inertial sensor would see them."""
    return motion.at(np.arange(900.0, 1020.0, 1e-3))


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_response_spectrum_is_within_5_percent_of_the_codes(delivered, axis):
    periods = np.geomspace(0.04, 5.999, 100)
    got = response_spectrum(delivered.acceleration[:, axis], 1e-3, periods, 0.05)
    expected = CONFIG.spectrum(axis).acceleration(periods)
    assert_allclose(got.sa_pseudo, expected, rtol=0.05)


def test_the_ground_itself_peaks_at_0_45_alpha_max_and_less_so_upwards(delivered):
    peaks = np.max(np.abs(delivered.acceleration), axis=0)
    expected = 0.45 * 0.9 * STANDARD_GRAVITY * np.array([1.0, 1.0, 0.65])
    assert_allclose(peaks, expected, rtol=0.05)


def test_the_ground_rests_before_and_after(motion):
    still = motion.at(np.array([-1e5, 0.0, 899.999, 900.0, 1020.0, 1020.001, 1e5]))
    for item in (still.position, still.velocity, still.acceleration):
        assert_allclose(item, 0.0, atol=1e-11)  # rounding of sums over 24000 steps
    assert motion.span == (900.0, 1020.0)
    assert not motion.rotates


def test_displacement_stays_within_what_such_earthquakes_do(delivered):
    peaks = np.max(np.abs(delivered.position), axis=0)
    # the code's spectral displacement at 6 s, Sa / w^2 = 1.2 m, bounds the order of magnitude
    assert np.all((peaks > 0.1) & (peaks < 2.0))


def test_components_are_independent(delivered):
    together = np.corrcoef(delivered.acceleration.T)
    # 30 s of motion some 5 Hz wide: 300 degrees of freedom, 4 sigma
    assert np.all(np.abs(together[np.triu_indices(3, 1)]) < 4 / np.sqrt(300))


def test_velocity_and_position_are_integrals_of_the_acceleration(delivered):
    step = 1e-3
    for rate, whole in (
        (delivered.acceleration, delivered.velocity),
        (delivered.velocity, delivered.position),
    ):
        sums = np.cumsum(step / 2 * (rate[1:] + rate[:-1]), axis=0)
        # the trapezoid's error, step^2 / 12 of the change of slope: 200 m/s^3 at most
        assert_allclose(sums, whole[1:], atol=step**2 / 12 * 400)


def test_same_seed_same_bytes_other_seed_another_earthquake():
    first, again = QUICK.build(around()), QUICK.build(around())
    assert first.path.knots.tobytes() == again.path.knots.tobytes()
    assert not np.allclose(QUICK.build(around(2)).path.knots, first.path.knots)


def test_the_start_only_shifts_it():
    early, late = QUICK.build(around()), replace(QUICK, start=1005.0).build(around())
    t = np.linspace(0.0, 20.0, 999)
    # a time of 1000 s is exact to 1e-13 s
    assert_allclose(early.at(t + 5.0).velocity, late.at(t + 1005.0).velocity, atol=1e-10)


def test_a_peak_acceleration_scales_the_whole_spectrum():
    plain, scaled = CONFIG.spectrum(0), replace(CONFIG, pga=1.0).spectrum(0)
    assert_allclose(scaled.acceleration(0.0), 1.0, rtol=1e-12)
    T = np.linspace(0.1, 6.0, 9)
    ratio = scaled.acceleration(T) / plain.acceleration(T)
    assert_allclose(ratio, ratio[0], rtol=1e-12)


def test_own_figures_replace_the_tables():
    own = replace(CONFIG, alpha_max=0.5, characteristic_period=0.55).spectrum(1)
    assert own == DesignSpectrum(0.5, 0.55, 0.05)
    assert CONFIG.spectrum(1) == DesignSpectrum(0.9, 0.4, 0.05)


def test_the_envelope_rises_lasts_and_dies_away():
    f = envelope(np.array([0.0, 4.0, 8.0, 20.0, 35.0, 45.0, 120.0]), 8.0, 35.0, 120.0, 0.15)
    assert_allclose(f, [0.0, 0.25, 1.0, 1.0, 1.0, np.exp(-1.5), 0.0], atol=1e-15)


def test_kauls_amplitudes_keep_responses_below_the_spectrum_with_the_chance_asked_for():
    # White noise of two-sided density S makes an oscillator's pseudo-acceleration vary by
    # sigma^2 = pi S w / (2 xi); it stays below Sa throughout Td with the chance (Rice, Poisson)
    # p = exp(-(w Td / pi) exp(-Sa^2 / (2 sigma^2))).
    spectrum, f = DesignSpectrum(0.9, 0.4), np.arange(20, 2000) / 100.0
    w, dw, xi = 2 * np.pi * f, 2 * np.pi / 100.0, 0.05
    C = kaul_amplitudes(f, spectrum, 120.0, 0.85)
    S = C**2 / (4 * dw)
    variance = np.pi * S * w / (2 * xi)
    Sa = spectrum.acceleration(1 / f)
    chance = np.exp(-w * 120.0 / np.pi * np.exp(-(Sa**2) / (2 * variance)))
    assert_allclose(chance, 0.85, rtol=1e-9)


def test_it_is_found_by_its_name():
    assert dict(MOTION_KINDS) == {"artificial": Artificial}


@pytest.mark.parametrize(
    "change",
    [
        {"intensity": "10"},
        {"duration": float("nan")},
        {"duration": 60.0},
        {"t1": (40.0, 10.0, 6.0)},
        {"t3": (36.0, 118.0, 115.0)},
        {"t1": (8.0, 10.0)},
        {"t2": (float("nan"), 40.0, 30.0)},
        {"alpha_max": 0.5, "pga": 1.0},
        {"characteristic_period": 0.01},
        {"frequency_range_hz": (0.3, 40.0)},
        {"frequency_range_hz": (0.1, 20.0)},
        {"frequency_range_hz": (0.1,)},
        {"damping": 0.0},
        {"group": 4},
    ],
)
def test_settings_that_make_no_earthquake_are_refused_in_one_line(change):
    with pytest.raises(InputError) as error:
        replace(CONFIG, **change).build(around())
    assert "\n" not in str(error.value)


def test_a_spectrum_out_of_reach_says_how_near_it_came():
    with pytest.raises(InputError, match="comes within"):
        replace(QUICK, tolerance=0.02, iterations=1).build(around())
