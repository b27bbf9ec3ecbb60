"""Acquisition on made signals: what is found, how exactly, and how often in noise alone."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

from deepseis_core.errors import InputError
from deepseis_tracking import acquisition_codes as codes
from deepseis_tracking import acquisition_statistics as statistics
from deepseis_tracking.acquisition import Acquirer, AcquisitionConfig

CODE_LENGTH = 1023
CHIP_RATE = 1.023e6
NOISE = 12.0  # r.m.s. of each component [levels]
SHORT = AcquisitionConfig(noncoherent_count=10, doppler_span_hz=2500.0)

LEAKS = AcquisitionConfig(noncoherent_count=20, doppler_span_hz=1500.0)


def satellite(name, cn0_dbhz, code_phase, doppler_hz, rate_hz, count, *, seed=0, bit_start_ms=7):
    """Return one satellite's samples, with random data bits, at the noise of `received`."""
    t = np.arange(count) / rate_hz
    phase = code_phase + (CHIP_RATE + doppler_hz / 1540) * t
    bits = 2 * np.random.default_rng(seed).integers(0, 2, 2 + int(t[-1] / 20e-3)) - 1
    bit = (phase / CODE_LENGTH + 20 - bit_start_ms).astype(int) // 20
    chips = codes.code(name)[phase.astype(int) % CODE_LENGTH]
    amplitude = NOISE * np.sqrt(2 * 10 ** (cn0_dbhz / 10) / rate_hz)
    return amplitude * bits[bit] * chips * np.exp(2j * np.pi * (doppler_hz * t + 0.3))


def received(signal, *, seed=1):
    """Return a signal in white noise as int8 components."""
    rng = np.random.default_rng(seed)
    noisy = [part + rng.normal(0, NOISE, len(signal)) for part in (signal.real, signal.imag)]
    return [np.clip(np.round(part), -127, 127).astype(np.int8) for part in noisy]


def found(detections):
    return {item.satellite: item for item in detections if item.detected}


def test_threshold_of_many_cells_equals_the_gamma_tail_when_noise_is_known():
    cells, sums, probability = 1e5, 25, 1e-6
    threshold = statistics.detection_threshold(probability, cells, sums, 1e7)
    assert_allclose(cells * stats.gamma.sf(sums * threshold, sums), probability, rtol=1e-3)


def test_threshold_rises_where_the_noise_is_estimated_from_few_cells():
    thresholds = [statistics.detection_threshold(1e-6, 1e5, 3, n) for n in (100, 600, 1e6)]
    assert thresholds[0] > thresholds[1] > thresholds[2]


@pytest.mark.parametrize(
    ("coherent_ms", "count", "alternate", "real"),
    [(4, 6, False, False), (10, 4, True, False), (6, 2, False, True)],
)
def test_false_alarms_in_noise_come_at_the_stated_rate(coherent_ms, count, alternate, real):
    probability, trials = 0.1, 10
    config = AcquisitionConfig(
        coherent_ms=coherent_ms,
        noncoherent_count=count,
        alternate_blocks=alternate,
        doppler_span_hz=400.0,
        false_alarm_probability=probability,
        search_interferers=False,
    )
    acquirer = Acquirer(2.2e6, config)
    alarms = 0
    for seed in range(trials):
        i, q = received(np.zeros(acquirer.samples_needed), seed=seed)
        if real:
            i, q = np.where(i < 0, -1, 1).astype(np.int8), np.zeros_like(q)
        alarms += len(found(acquirer.search(i, q, 0)))
    expected = probability * trials * 32
    # Codes are nearly orthogonal: counts are binomial; 3.5 sigma, and 10 % of the cell count.
    assert abs(alarms - expected) < 3.5 * np.sqrt(expected * 0.9) + 0.1 * expected


@pytest.mark.parametrize("rate_hz", [2.6e6, 4e6, 12e6])
@pytest.mark.parametrize(
    ("code_phase", "doppler_hz", "cn0_dbhz"),
    [(0.02, -2310.0, 45.0), (511.77, 62.5, 40.0), (1022.9, 1999.0, 37.0)],
)
def test_code_phase_and_doppler_are_fine_enough_for_pull_in(
    code_phase, doppler_hz, cn0_dbhz, rate_hz
):
    acquirer = Acquirer(rate_hz, SHORT)
    signal = satellite("G07", cn0_dbhz, code_phase, doppler_hz, rate_hz, acquirer.samples_needed)
    (result,) = acquirer.search(*received(signal), 1234, ["G07"])
    assert result.detected
    assert result.sample_index == 1234
    error = (result.code_phase_chips - code_phase + 500) % CODE_LENGTH - 500
    assert abs(error) < 1 / 8
    assert abs(result.carrier_doppler_hz - doppler_hz) < 10.0
    assert abs(result.carrier_doppler_hz - doppler_hz) < 4 * result.doppler_sd_hz
    assert abs(result.cn0_dbhz - cn0_dbhz) < 1.5  # 40 ms at 37 dB-Hz: sd of the estimate 0.6 dB


def test_doppler_errors_match_the_stated_deviation():
    acquirer = Acquirer(2.2e6, SHORT)
    errors = []
    for seed in range(12):
        doppler_hz = 100.0 * seed + 13.0
        signal = satellite(
            "G07", 40.0, 80.0 * seed, doppler_hz, 2.2e6, acquirer.samples_needed, seed=seed
        )
        (result,) = acquirer.search(
            *received(signal, seed=seed), 0, ["G07"], {"G07": (doppler_hz - 99, doppler_hz + 99)}
        )
        errors.append((result.carrier_doppler_hz - doppler_hz) / result.doppler_sd_hz)
    # 12 errors: r.m.s. of a unit normal within 4 sigma, 4/sqrt(24).
    assert 0.3 < np.sqrt(np.mean(np.square(errors))) < 1.8


def test_code_doppler_is_followed_over_half_a_second():
    config = AcquisitionConfig(noncoherent_count=125)
    acquirer = Acquirer(2.2e6, config)
    signal = satellite("G19", 30.0, 300.3, 4700.0, 2.2e6, acquirer.samples_needed)
    (result,) = acquirer.search(*received(signal), 0, ["G19"], {"G19": (4500.0, 4900.0)})
    assert (
        result.detected
    )  # 4700 Hz move the code by 1.5 chips: unfollowed, half the power is lost
    assert abs(result.code_phase_chips - 300.3) < 1 / 8
    assert abs(result.carrier_doppler_hz - 4700.0) < 10.0


def test_ten_milliseconds_between_data_bits_find_what_bits_would_destroy():
    plain = AcquisitionConfig(coherent_ms=10, noncoherent_count=4, doppler_span_hz=400.0)
    acquirer = Acquirer(2.2e6, AcquisitionConfig(**{**vars(plain), "alternate_blocks": True}))
    signal = satellite("G05", 40.0, 10.0, 130.0, 2.2e6, acquirer.samples_needed, bit_start_ms=5)
    (result,) = acquirer.search(*received(signal), 0, ["G05"])
    assert result.detected
    assert abs(result.carrier_doppler_hz - 130.0) < 10.0


@pytest.mark.parametrize("strong", ["G07", "PRN194", "PRN184"])
def test_a_strong_satellite_fakes_none_and_hides_none(strong):
    acquirer = Acquirer(2.2e6, LEAKS)
    count = acquirer.samples_needed
    signal = satellite(strong, 54.0, 200.0, 90.0, 2.2e6, count)
    signal += satellite("G22", 33.0, 700.5, -640.0, 2.2e6, count, seed=5)
    results = found(acquirer.search(*received(signal), 0))
    assert set(results) == {"G22"} | ({strong} & set(codes.GPS))
    assert abs(results["G22"].code_phase_chips - 700.5) < 1 / 8


def test_a_strong_satellite_not_asked_for_fakes_none():
    acquirer = Acquirer(2.2e6, LEAKS)
    signal = satellite("G07", 54.0, 200.0, 90.0, 2.2e6, acquirer.samples_needed)
    others = [name for name in codes.GPS if name != "G07"]
    assert not found(acquirer.search(*received(signal), 0, others))


def test_spurs_and_offset_neither_fake_nor_hide():
    acquirer = Acquirer(4e6, AcquisitionConfig(noncoherent_count=10))
    t = np.arange(acquirer.samples_needed) / 4e6
    signal = satellite("G03", 40.0, 50.0, -1500.0, 4e6, len(t)) + 15.0
    signal += 12.0 * np.exp(2j * np.pi * 200e3 * t) + 8.0 * np.exp(-2j * np.pi * 511_500 * t)
    assert set(found(acquirer.search(*received(signal), 0))) == {"G03"}


def test_real_samples_are_found_at_the_side_of_the_centre():
    config = AcquisitionConfig(
        coherent_ms=6, noncoherent_count=2, doppler_centre_hz=-500.0, doppler_span_hz=3000.0
    )
    acquirer = Acquirer(4.092e6, config)
    signal = satellite("G13", 46.0, 321.0, -1610.0, 4.092e6, acquirer.samples_needed)
    i, q = received(2 * signal.real + 0j)
    results = found(acquirer.search(i, np.zeros_like(q), 0))
    assert set(results) == {"G13"}
    assert abs(results["G13"].carrier_doppler_hz + 1610.0) < 10.0


def test_window_narrows_search_and_lowers_the_threshold():
    acquirer = Acquirer(2.2e6, SHORT)
    i, q = received(np.zeros(acquirer.samples_needed))
    wide, narrow = acquirer.search(i, q, 0, ["G01", "G02"], {"G02": (100.0, 400.0)})
    assert narrow.threshold < wide.threshold
    assert 0.0 <= narrow.carrier_doppler_hz <= 500.0


def test_same_samples_give_identical_results():
    acquirer = Acquirer(2.2e6, SHORT)
    signal = satellite("G07", 45.0, 3.3, 700.0, 2.2e6, acquirer.samples_needed)
    i, q = received(signal)
    again = Acquirer(2.2e6, SHORT).search(i, q, 5)
    assert acquirer.search(i, q, 5) == again
    assert acquirer.search(i.astype(np.int16), q.astype(np.int16), 5) == again


def test_short_input_is_refused_with_the_number_needed():
    with pytest.raises(InputError, match="needs 88000 samples, got 10"):
        Acquirer(2.2e6, SHORT).search(np.zeros(10, np.int8), np.zeros(10, np.int8), 0)


@pytest.mark.parametrize(
    ("name", "octal"),
    [
        ("PRN120", 0o671),
        ("PRN126", 0o13),
        ("PRN131", 0o1226),
        ("PRN138", 0o1327),
        ("PRN193", 0o727),
    ],
)
def test_codes_of_other_systems_begin_as_the_specification_says(name, octal):
    logic = (1 - codes.code(name)[:10].astype(int)) // 2
    assert int("".join(map(str, logic)), 2) == octal  # IS-GPS-200, tables 6-I: first ten chips
