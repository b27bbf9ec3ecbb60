"""Time of a cold and a warm acquisition of 100 ms: ``pytest benchmarks/bench_acquisition.py``."""

import numpy as np
import pytest

from deepseis_tracking.acquisition import Acquirer, AcquisitionConfig
from deepseis_tracking.acquisition_codes import GPS, code

pytestmark = pytest.mark.benchmark


def sky_like_signal(rate_hz, count):
    """Ten satellites of 36 to 48 dB-Hz in noise."""
    rng = np.random.default_rng(1)
    t = np.arange(count) / rate_hz
    signal = rng.normal(0, 12, count) + 1j * rng.normal(0, 12, count)
    for k, name in enumerate(GPS[::3][:10]):
        doppler_hz = -4000.0 + 800 * k
        phase = (1.023e6 + doppler_hz / 1540) * t + 100.0 * k
        amplitude = 12 * np.sqrt(2 * 10 ** ((36 + 12 * k / 9) / 10) / rate_hz)
        chips = code(name)[phase.astype(int) % 1023]
        signal += amplitude * chips * np.exp(2j * np.pi * doppler_hz * t)
    return [
        np.clip(np.round(part), -127, 127).astype(np.int8) for part in (signal.real, signal.imag)
    ]


@pytest.mark.parametrize("span_hz", [5e3, 10e3])
@pytest.mark.parametrize("rate_hz", [4e6, 12e6, 20.48e6, 24e6])
def test_cold_search_of_32_satellites(benchmark, rate_hz, span_hz):
    acquirer = Acquirer(rate_hz, AcquisitionConfig(doppler_span_hz=span_hz))
    i, q = sky_like_signal(rate_hz, acquirer.samples_needed)
    acquirer.search(i, q, 0)  # compiles
    results = benchmark.pedantic(acquirer.search, (i, q, 0), rounds=3)
    assert sum(item.detected for item in results) == 10


def test_warm_search_of_12_satellites_in_600_hz(benchmark):
    acquirer = Acquirer(4e6)
    i, q = sky_like_signal(4e6, acquirer.samples_needed)
    names = [*GPS[::3][:10], "G02", "G03"]
    windows = {name: (-4300.0 + 800 * k, -3700.0 + 800 * k) for k, name in enumerate(names[:10])}
    windows |= dict.fromkeys(names[10:], (-300.0, 300.0))
    acquirer.search(i, q, 0, names, windows)
    results = benchmark.pedantic(acquirer.search, (i, q, 0, names, windows), rounds=3)
    assert sum(item.detected for item in results) == 10


def test_snapshot_of_12_ms(benchmark):
    config = AcquisitionConfig(coherent_ms=6, noncoherent_count=2)
    acquirer = Acquirer(4.092e6, config)
    i, q = sky_like_signal(4.092e6, acquirer.samples_needed)
    acquirer.search(i, q, 0)
    benchmark.pedantic(acquirer.search, (i, q, 0), rounds=3)
