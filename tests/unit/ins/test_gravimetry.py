"""Gravimetry: signs and Eotvos in closed form, the filter by SciPy, the bench's true field."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.signal import freqz

from deepseis_core import geodesy
from deepseis_core.constants import WGS84_A, WGS84_EARTH_RATE
from deepseis_core.errors import InputError
from deepseis_core.imu_grades import MGAL
from deepseis_ins.gravimetry import (
    GravityFilter,
    disturbance,
    eotvos,
    gravity_series,
    low_pass,
    low_pass_taps,
)
from deepseis_sim.gravity_field import GravityField
from deepseis_sim.imu import ImuSynthesizer
from deepseis_sim.motions import Still
from deepseis_sim.site import Site

FILTER = GravityFilter()


def test_eotvos_is_the_change_of_centrifugal_acceleration():
    """On the equator eastward: ((w R + v)^2 - (w R)^2) / R; northward v^2 / R_M."""
    v, place = 20.0, [0.0, 0.0, 0.0]
    turning = WGS84_EARTH_RATE * WGS84_A
    expected = ((turning + v) ** 2 - turning**2) / WGS84_A
    assert eotvos(place, [0.0, v, 0.0]) == pytest.approx(expected, rel=1e-9)
    meridian = WGS84_A * (1.0 - 0.00669437999014)
    assert eotvos(place, [v, 0.0, 0.0]) == pytest.approx(v**2 / meridian, rel=1e-9)


def test_eotvos_is_that_of_harlan_on_the_sphere():
    """Harlan 1968: 4.040 v cos L sin A + 0.001211 v^2 mGal, v in km/h, to his four digits."""
    v, latitude, azimuth = 72.0, np.radians(45.0), np.radians(60.0)
    harlan = 4.040 * v * np.cos(latitude) * np.sin(azimuth) + 0.001211 * v**2
    speed = v / 3.6
    ours = eotvos([latitude, 0.0, 0.0], [speed * np.cos(azimuth), speed * np.sin(azimuth), 0.0])
    assert ours / MGAL == pytest.approx(harlan, rel=3e-3)


def test_at_rest_the_disturbance_is_what_gravity_has_in_excess():
    """Stronger gravity pulls more: what holds against it is greater, and so is dg."""
    place = [0.7, 0.1, 300.0]
    normal = float(geodesy.normal_gravity(place[0], place[2]))
    found = disturbance(normal + 25 * MGAL, 0.0, place, np.zeros(3))
    assert found / MGAL == pytest.approx(25.0, abs=1e-9)


def test_an_imu_at_rest_in_the_benchs_field_reads_its_disturbance():
    site = Site([0.62, 2.44, 50.0])
    field = GravityField(amplitude_mgal=80.0).build(5)
    made = ImuSynthesizer(Still(), site, 100.0, gravity=field).increments(0, 200)
    force_up = made.delta_vel.sum(axis=0)[2] / 2.0
    found = disturbance(force_up, 0.0, site.origin_geodetic, np.zeros(3))
    assert found == pytest.approx(float(field(np.zeros((1, 3)))[0]), abs=1e-3 * MGAL)


@pytest.mark.parametrize("window", ["blackman", "hamming", "hann", "boxcar"])
def test_the_filters_response_is_that_of_its_taps_by_scipy(window):
    """Half at the cut-off, 1 at zero; a sine comes out as large as freqz says, not shifted.

    The half amplitude is exact where the window's transition, some 6 / length, ends before zero.
    """
    config = replace(FILTER, window=window, half_length=600.0)
    taps = low_pass_taps(config, 1.0)
    half = taps.size // 2
    f = np.array([0.0, 0.002, config.cutoff_hz, 0.012, 0.03])
    _, response = freqz(taps, worN=f, fs=1.0)
    real = np.real(response * np.exp(2j * np.pi * f * half))
    assert real[0] == pytest.approx(1.0, abs=1e-12)
    # A boxcar leaks: 1 / (pi^2 f L) of its ripple at zero is in its normalisation.
    assert real[2] == pytest.approx(0.5, abs=0.02 if window == "boxcar" else 0.002)
    t = np.arange(4000.0)
    for frequency, gain in zip(f[1:], real[1:], strict=True):
        out = low_pass(np.sin(2.0 * np.pi * frequency * t), config, 1.0)
        inner = slice(1000, 3000)
        assert_allclose(out[inner], gain * np.sin(2.0 * np.pi * frequency * t[inner]), atol=1e-9)


def test_the_blackman_filter_stops_vibration():
    """Beyond cut-off and transition, 3 / half length, 70 dB down (Blackman: 74)."""
    _, response = freqz(low_pass_taps(FILTER, 1.0), worN=np.linspace(0.028, 0.5, 500), fs=1.0)
    assert np.abs(response).max() < 10 ** (-70 / 20)


def test_ends_of_a_record_stay_at_the_level_of_their_rests():
    record = np.concatenate([np.full(60, 3.0), np.full(800, 5.0), np.full(60, 4.0)])
    out = low_pass(record, FILTER, 1.0)
    assert out.size == record.size
    # The step lies 60 s from the end: within the filter, whose rise is 1 / (2 f) = 60 s or so.
    assert out[0] == pytest.approx(3.0, abs=0.25)
    assert out[-1] == pytest.approx(4.0, abs=0.12)
    assert_allclose(low_pass(np.full(90, 7.0), FILTER, 1.0), 7.0, atol=1e-9)


def test_the_rate_of_the_difference_is_the_disturbance_across_gaps():
    """A constant disturbance of 30 mGal; vibration is in both velocities and cancels."""
    t = np.arange(0.2, 1200.0, 0.2)
    shaken = 0.3 * np.sin(2.0 * np.pi * 3.1 * t)
    free, outside = shaken + 30 * MGAL * t, shaken.copy()
    outside[(t > 300.0) & (t < 360.0)] = np.nan
    series = gravity_series(t, free, outside, FILTER)
    assert_allclose(series.filtered / MGAL, 30.0, atol=1e-6)
    gap = (series.time > 302.0) & (series.time < 358.0)
    assert not series.measured[gap].any()
    assert series.measured[~((series.time > 298.0) & (series.time < 362.0))].all()


def test_white_noise_comes_out_as_theory_says():
    """Velocity of sd s every second, differentiated: s^2 times the sum of squared tap steps."""
    rng = np.random.default_rng(9)
    s, t = 0.002, np.arange(0.0, 60000.0)
    series = gravity_series(t, s * rng.standard_normal(t.size), np.zeros(t.size), FILTER)
    taps = low_pass_taps(FILTER, 1.0)
    expected = s * np.sqrt(np.sum(np.diff(np.concatenate([[0.0], taps, [0.0]])) ** 2))
    # Some 700 independent values: 3 % sampling error, times three.
    assert series.filtered[500:-500].std() == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize(
    ("config", "rate"),
    [(GravityFilter(cutoff_hz=0.5), 1.0), (GravityFilter(half_length=1.0), 1.0)],
)
def test_a_filter_that_cannot_be_is_refused(config, rate):
    with pytest.raises(InputError, match="gravity filter"):
        low_pass_taps(config, rate)


def test_without_an_outside_velocity_there_is_no_gravity():
    t = np.arange(10.0)
    with pytest.raises(InputError, match="no outside velocity"):
        gravity_series(t, t, np.full(10, np.nan), FILTER)
