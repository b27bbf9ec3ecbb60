"""Ionosphere and troposphere against RTKLIB."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from deepseis_core import atmosphere

ALPHA = np.array([0.1211e-7, -0.7451e-8, -0.5960e-7, 0.1192e-6])
BETA = np.array([0.1167e6, -0.2458e6, -0.6554e5, 0.1114e7])
ELEVATION = np.radians([0.5, 5.0, 15.0, 40.0, 89.9])
AZIMUTH = np.radians([0.0, 80.0, 170.0, 260.0, 350.0])
PLACES = [(0.62, 2.44, 10.0), (-1.2, -2.9, 3100.0), (0.0, 0.1, -50.0), (1.5, 3.0, 8800.0)]


@pytest.fixture
def rtklib():
    return pytest.importorskip("pyrtklib")


def array(rtklib, values):
    out = rtklib.Arr1Ddouble(len(values))
    for i, value in enumerate(values):
        out[i] = float(value)
    return out


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("tow", [0.0, 259_200.0 + 14 * 3600, 525_600.0])
def test_klobuchar_agrees_with_rtklib(rtklib, place, tow):
    ours = atmosphere.klobuchar_delay(ALPHA, BETA, place[0], place[1], ELEVATION, AZIMUTH, tow)
    ion, pos = array(rtklib, [*ALPHA, *BETA]), array(rtklib, place)
    for i in range(ELEVATION.size):
        azel = array(rtklib, [AZIMUTH[i], ELEVATION[i]])
        theirs = rtklib.ionmodel(rtklib.gpst2time(2190, tow), ion, pos, azel)
        assert_allclose(ours[i], theirs, rtol=1e-12)  # same equations: rounding


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("humidity", [0.0, 0.7])
def test_troposphere_agrees_with_rtklib(rtklib, place, humidity):
    ours = atmosphere.saastamoinen_delay(place[0], place[2], ELEVATION, humidity)
    pos, time = array(rtklib, place), rtklib.gpst2time(2190, 0.0)
    for i in range(ELEVATION.size):
        azel = array(rtklib, [0.0, ELEVATION[i]])
        assert_allclose(ours[i], rtklib.tropmodel(time, pos, azel, humidity), rtol=1e-12)


def test_the_zenith_delay_at_sea_level_is_that_of_the_textbook():
    zenith = atmosphere.saastamoinen_delay(0.8, 0.0, np.array([np.pi / 2]), 0.5)[0]
    assert 2.3 < zenith < 2.5  # 2.31 m dry and up to 0.2 m wet
    assert atmosphere.saastamoinen_delay(0.8, 0.0, np.array([-0.1]))[0] == 0.0
    night = atmosphere.klobuchar_delay(
        ALPHA, BETA, 0.6, 0.0, np.array([np.pi / 2]), np.zeros(1), 0.0
    )
    assert_allclose(night, 5e-9 * 299792458.0, rtol=1e-3)  # the model's night value at zenith
