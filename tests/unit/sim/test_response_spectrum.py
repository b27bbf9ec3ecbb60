"""Response spectra against closed forms and SciPy's exact simulation of linear systems."""

import time

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import signal

from deepseis_core.errors import InputError
from deepseis_sim.response_spectrum import STEPS_PER_PERIOD, peak_responses, response_spectrum


def simulated(record, step, period, damping, divide=1):
    """Return greatest displacement, velocity, absolute acceleration by lsim (first-order hold)."""
    w = 2 * np.pi / period
    A = np.array([[0.0, 1.0], [-w * w, -2 * damping * w]])
    B, C, D = np.array([[0.0], [-1.0]]), np.eye(2), np.zeros((2, 1))
    fine = np.arange((record.size - 1) * divide + 1) / divide
    ground = np.interp(fine, np.arange(record.size), record)
    _, states, _ = signal.lsim((A, B, C, D), ground, fine * step)
    total = states @ [w * w, 2 * damping * w]
    return np.max(np.abs([states[:, 0], states[:, 1], total]), axis=1)


@pytest.mark.parametrize("damping", [0.0, 0.02, 0.05, 0.3, 0.9])
def test_responses_are_those_of_an_exact_simulation(damping):
    record = np.random.default_rng(3).standard_normal(1500)
    periods = np.array([0.32, 0.64, 1.1, 6.0])  # at least 32 steps: none is divided
    spectrum = response_spectrum(record, 0.01, periods, damping)
    expected = np.transpose([simulated(record, 0.01, T, damping) for T in periods])
    # both are exact for straight pieces: rounding over 1500 steps
    assert_allclose([spectrum.sd, spectrum.sv, spectrum.sa], expected, rtol=1e-9)
    assert_allclose(spectrum.sa_pseudo, (2 * np.pi / periods) ** 2 * expected[0], rtol=1e-9)


def test_a_divided_step_is_still_exact():
    record = np.random.default_rng(4).standard_normal(400)
    period, step = 0.05, 0.01  # 32 steps a period are needed, 5 there: parts of an eighth
    spectrum = response_spectrum(record, step, [period], 0.05)
    expected = simulated(record, step, period, 0.05, divide=8)
    assert_allclose([spectrum.sd[0], spectrum.sv[0], spectrum.sa[0]], expected, rtol=1e-9)


def test_a_sine_in_resonance_is_amplified_by_one_over_twice_the_damping():
    step, period, damping = 0.002, 0.8, 0.05
    t = np.arange(0.0, 40.0, step)  # transient: exp(-0.05 w 40) = 1.5e-7
    spectrum = response_spectrum(np.sin(2 * np.pi / period * t), step, [period], damping)
    # 1e-3: the sine's straight pieces and its peaks between samples
    assert_allclose(spectrum.sa_pseudo, 1 / (2 * damping), rtol=1e-3)
    assert_allclose(spectrum.sv, period / (2 * np.pi) / (2 * damping), rtol=1e-3)
    assert_allclose(spectrum.sa, np.hypot(1.0, 2 * damping) / (2 * damping), rtol=1e-3)


@pytest.mark.parametrize("damping", [0.0, 0.05, 0.4])
def test_a_sudden_push_overshoots_as_the_textbook_says(damping):
    overshoot = 1 + np.exp(-np.pi * damping / np.sqrt(1 - damping**2))
    spectrum = response_spectrum(np.full(2000, 3.0), 0.005, [0.05, 0.3, 2.0], damping)
    # a peak is missed by half a step at most: 1 - cos(pi / 32) = 0.5 %
    assert np.all(spectrum.sa_pseudo <= 3.0 * overshoot * (1 + 1e-12))
    assert_allclose(spectrum.sa_pseudo, 3.0 * overshoot, rtol=1 - np.cos(np.pi / STEPS_PER_PERIOD))


def test_stiff_oscillators_follow_the_ground_and_soft_ones_stay_where_they_are():
    step = 0.005
    t = np.arange(0.0, 8.0, step)
    pulse = np.where(t < 2.0, np.sin(np.pi * t / 2.0) ** 2 * np.sin(np.pi * t), 0.0)
    pulse -= np.roll(pulse, round(2.5 / step))
    displacement = step**2 * np.cumsum(np.cumsum(pulse))
    spectrum = response_spectrum(pulse, step, [0.0, 0.01, 500.0], 0.05)
    assert spectrum.sa[0] == spectrum.sa_pseudo[0] == np.max(np.abs(pulse))
    assert spectrum.sd[0] == 0.0
    assert_allclose(spectrum.sa_pseudo[1], np.max(np.abs(pulse)), rtol=1e-3)
    # w t = 0.1 at the end and 2 xi w t = 0.01: percents
    assert_allclose(spectrum.sd[2], np.max(np.abs(displacement)), rtol=0.03)


def test_peaks_are_those_of_the_spectrum_with_sign_and_moment():
    step = 0.01
    record = np.zeros(3000)
    record[1000:1003] = -2.0
    periods = np.array([0.0, 0.1, 1.0, 4.0])
    peaks = peak_responses(record, step, periods, 0.02)
    spectrum = response_spectrum(record, step, periods, 0.02)
    assert_allclose(np.abs(peaks.pseudo_acceleration), spectrum.sa_pseudo, rtol=1e-14)
    assert np.all(peaks.pseudo_acceleration < 0)
    # after a short knock an oscillator is out furthest a quarter of its period later
    assert_allclose(peaks.time[2:], 10.01 + periods[2:] / 4, atol=0.02)


def test_spectra_scale_with_the_record_and_do_not_depend_on_the_company():
    record = np.random.default_rng(5).standard_normal(2000)
    periods = np.geomspace(0.02, 8.0, 37)
    whole = response_spectrum(record, 0.01, periods)
    double = response_spectrum(2.0 * record, 0.01, periods)
    assert_allclose(double.sd, 2.0 * whole.sd, rtol=1e-12)
    one = response_spectrum(record, 0.01, periods[20:21])
    assert_allclose(one.sa, whole.sa[20:21], rtol=1e-12)


def test_a_long_record_takes_no_time_to_speak_of():
    record = np.random.default_rng(6).standard_normal(100_000)
    periods = np.geomspace(0.04, 6.0, 100)
    response_spectrum(record[:100], 0.005, periods)
    begin = time.perf_counter()
    response_spectrum(record, 0.005, periods)
    assert time.perf_counter() - begin < 1.0  # some 0.03 s


@pytest.mark.parametrize(
    ("record", "step", "periods", "damping"),
    [
        ([1.0], 0.01, [1.0], 0.05),
        ([[1.0, 2.0]], 0.01, [1.0], 0.05),
        ([1.0, np.nan], 0.01, [1.0], 0.05),
        ([1.0, 2.0], 0.0, [1.0], 0.05),
        ([1.0, 2.0], 0.01, [-1.0], 0.05),
        ([1.0, 2.0], 0.01, [np.inf], 0.05),
        ([1.0, 2.0], 0.01, 1.0, 0.05),
        ([1.0, 2.0], 0.01, [1.0], 1.0),
        ([1.0, 2.0], 0.01, [1.0], -0.1),
    ],
)
def test_senseless_input_is_refused(record, step, periods, damping):
    with pytest.raises(InputError, match="response spectrum"):
        response_spectrum(record, step, periods, damping)
