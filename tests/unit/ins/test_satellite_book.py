from dataclasses import replace

import numpy as np
import pytest

from deepseis_core.geodesy import ecef_from_geodetic
from deepseis_core.gps_time import GpsTime
from deepseis_ins.satellite_book import RENEWAL_S, SatelliteBook
from deepseis_sim.nominal_constellation import nominal_constellation

RATE = 1000.0
NOON = GpsTime(2399, 388_800 * 10**9)
STATION = ecef_from_geodetic(np.array([0.62, 2.44, 50.0]))


@pytest.fixture(scope="module")
def day():
    """Every two hours of a day, as a daily file of broadcast ephemerides has them."""
    constellation = nominal_constellation(NOON)
    return [
        replace(item, toe=NOON.tow_ns * 1e-9 + 7200.0 * step, iode=step)
        for step in range(-6, 7)
        for item in constellation
    ]


def at(hours):
    return GpsTime(NOON.week, NOON.tow_ns + round(hours * 3600e9))


@pytest.mark.parametrize("hours", [-11.0, -0.2, 0.7, 11.3])
def test_a_days_file_has_satellites_at_any_time_of_the_day(day, hours):
    book = SatelliteBook(-2.0, RATE)
    for item in day:
        book.push(item)
    chosen = book.choose(0, at(hours), STATION)
    assert len(chosen.names) >= 8
    toe = NOON.tow_ns * 1e-9 + 7200.0 * round(hours / 2.0)
    assert np.all(np.any(np.isclose(chosen.packed, toe), axis=1))


def test_what_is_long_over_is_forgotten_and_what_comes_is_not(day):
    book = SatelliteBook(-2.0, RATE)
    for item in day:
        book.push(item)
    step = round(RENEWAL_S * RATE)
    for number, hours in enumerate(np.arange(-12.0, 12.1, 2.0)):
        assert len(book.choose(number * step, at(hours), STATION).names) >= 8
    kept = [item for items in book._effective.values() for item in items]
    assert len(kept) < len(day) / 3
