"""GPS time: calendar, leap seconds, week crossings."""

import datetime as dt

import pytest

from deepseis_core import gps_time
from deepseis_core.gps_time import GpsTime, nearest_week

S = 10**9


@pytest.mark.parametrize(
    ("utc", "week", "tow_s"),
    [  # week and second of week of known moments
        ((1980, 1, 6, 0, 0, 0), 0, 0),
        ((1999, 8, 21, 23, 59, 47), 1024, 0),  # first rollover of the ten-bit week
        ((2019, 4, 6, 23, 59, 42), 2048, 0),  # second rollover
        ((2011, 3, 11, 5, 46, 36), 1626, 452811),  # Tohoku record in shared data: GPS - UTC = 15
    ],
)
def test_known_moments(utc, week, tow_s):
    *minute, second = utc
    moment = GpsTime.from_utc_calendar(*minute, second * S)
    assert moment == GpsTime(week, tow_s * S)
    unix = dt.datetime(*utc, tzinfo=dt.UTC).timestamp()
    assert moment.to_utc_ns() == int(unix) * S
    assert GpsTime.from_utc_ns(int(unix) * S) == moment


def test_every_leap_second_moves_gps_minus_utc_by_one_and_round_trips_around_it():
    for i, step in enumerate(gps_time._UTC_STEPS):
        unix = gps_time.UNIX_NS_OF_GPS_EPOCH + step
        before, after = GpsTime.from_utc_ns(unix - 1), GpsTime.from_utc_ns(unix)
        assert after.diff_ns(before) == S + 1
        assert (before.leap_seconds(), after.leap_seconds()) == (i, i + 1)
        assert before.to_utc_ns() == unix - 1
        assert after.to_utc_ns() == unix
    assert i + 1 == 18


def test_a_leap_second_shares_its_unix_time_with_the_second_after_it():
    leap = GpsTime.from_utc_calendar(2016, 12, 31, 23, 59, 60 * S + 7)
    assert leap.to_utc_ns() == 1_483_228_800 * S + 7
    assert leap.add_ns(S).to_utc_ns() == 1_483_228_800 * S + 7


def test_calendar_round_trips_across_years_and_weeks():
    for total in range(0, 60 * 52 * 604_800 * S, 97_654_321_012_345_678):
        moment = GpsTime(0, total)
        year, month, day, hour, minute, ns = moment.to_calendar()
        assert GpsTime.from_calendar(year, month, day, hour, minute, ns) == moment
        assert moment.total_ns == total
        assert moment.day_of_year() == dt.date(year, month, day).timetuple().tm_yday


def test_weeks_carry_both_ways_and_differences_are_exact():
    moment = GpsTime(2190, 5)
    assert moment.add_ns(-6) == GpsTime(2189, gps_time.NS_PER_WEEK - 1)
    assert moment.add_ns(-6).add_ns(6) == moment
    assert GpsTime(2200, 1).diff_ns(moment) == 10 * gps_time.NS_PER_WEEK - 4
    assert GpsTime(2190, 4) < moment


def test_float_seconds_are_refused():
    with pytest.raises(TypeError):
        GpsTime(2190, 1.0)  # type: ignore[arg-type]


def test_ten_bit_weeks_resolve_within_half_a_rollover():
    for reference in (2190, 2048, 3000):
        for full in range(reference - 512, reference + 512):
            assert nearest_week(full % 1024, reference) == full
