"""GPS time as week and integer nanoseconds; its calendar; conversion to and from UTC.

UTC appears as *Unix nanoseconds*: nanoseconds since 1970-01-01 without leap seconds. Unix time
has no name for a leap second itself: 23:59:60.x shares its number with the 00:00:00.x after it.
"""

from __future__ import annotations

import datetime as dt
from bisect import bisect_right
from dataclasses import dataclass

from deepseis_core.constants import NS_PER_S, NS_PER_WEEK

_EPOCH = dt.datetime(1980, 1, 6)
UNIX_NS_OF_GPS_EPOCH = 315_964_800 * NS_PER_S

# First UTC day after each leap second since the GPS epoch (IERS Bulletin C).
_LEAP_DAYS = (
    *((1981, 7), (1982, 7), (1983, 7), (1985, 7), (1988, 1), (1990, 1), (1991, 1), (1992, 7)),
    *((1993, 7), (1994, 7), (1996, 1), (1997, 7), (1999, 1), (2006, 1), (2009, 1), (2012, 7)),
    *((2015, 7), (2017, 1)),
)
_UTC_STEPS = tuple(  # [ns] of UTC since the GPS epoch, leap seconds not counted
    (dt.datetime(year, month, 1) - _EPOCH).days * 86_400 * NS_PER_S for year, month in _LEAP_DAYS
)
_GPS_STEPS = tuple(step + (i + 1) * NS_PER_S for i, step in enumerate(_UTC_STEPS))

# No leap second comes before this day (Bulletin C of 2026-07; none since 2017-01-01).
LEAP_SECONDS_EXPIRE_UNIX_NS = 1_814_140_800 * NS_PER_S  # 2027-06-28


def leap_seconds_at_utc(unix_ns: int) -> int:
    """Return GPS minus UTC [s] at a Unix time [ns].

    Examples
    --------
    >>> leap_seconds_at_utc(1_483_228_800 * 10**9 - 1), leap_seconds_at_utc(1_483_228_800 * 10**9)
    (17, 18)
    """
    return bisect_right(_UTC_STEPS, unix_ns - UNIX_NS_OF_GPS_EPOCH)


@dataclass(frozen=True, order=True)
class GpsTime:
    """A moment in GPS time; ``tow_ns`` outside the week is carried into ``week``.

    Parameters
    ----------
    week : int
        Full GPS week since 1980-01-06 [weeks].
    tow_ns : int
        Nanoseconds of week [ns].

    Examples
    --------
    >>> GpsTime(2190, 604_800 * 10**9 + 5)
    GpsTime(week=2191, tow_ns=5)
    """

    week: int
    tow_ns: int

    def __post_init__(self) -> None:
        """Carry whole weeks."""
        if isinstance(self.tow_ns, float) or isinstance(self.week, float):
            raise TypeError("GPS time is kept in integers")
        carry, tow_ns = divmod(int(self.tow_ns), NS_PER_WEEK)
        object.__setattr__(self, "week", int(self.week) + carry)
        object.__setattr__(self, "tow_ns", tow_ns)

    @property
    def total_ns(self) -> int:
        """Nanoseconds since the GPS epoch [ns]."""
        return self.week * NS_PER_WEEK + self.tow_ns

    def add_ns(self, ns: int) -> GpsTime:
        """Return the moment ``ns`` later."""
        return GpsTime(self.week, self.tow_ns + ns)

    def diff_ns(self, other: GpsTime) -> int:
        """Return ``self - other`` [ns]."""
        return self.total_ns - other.total_ns

    def tow_s(self) -> float:
        """Return seconds of week, rounded to a double (up to 0.06 ns off): for a person's eye."""
        return self.tow_ns / NS_PER_S

    def leap_seconds(self) -> int:
        """Return GPS minus UTC [s]; a leap second itself still has the old value."""
        return bisect_right(_GPS_STEPS, self.total_ns)

    def to_utc_ns(self) -> int:
        """Return Unix nanoseconds.

        Examples
        --------
        >>> GpsTime(2190, 525_618 * 10**9).to_utc_ns()
        1641002400000000000
        """
        return UNIX_NS_OF_GPS_EPOCH + self.total_ns - self.leap_seconds() * NS_PER_S

    @classmethod
    def from_utc_ns(cls, unix_ns: int) -> GpsTime:
        """Return the GPS time of Unix nanoseconds."""
        leap_ns = leap_seconds_at_utc(unix_ns) * NS_PER_S
        return cls(0, unix_ns - UNIX_NS_OF_GPS_EPOCH + leap_ns)

    @classmethod
    def from_calendar(
        cls, year: int, month: int, day: int, hour: int = 0, minute: int = 0, ns: int = 0
    ) -> GpsTime:
        """Return the moment of a calendar date in GPS time (not UTC); ``ns`` [ns] of the minute.

        Examples
        --------
        >>> GpsTime.from_calendar(2022, 1, 1, 2)
        GpsTime(week=2190, tow_ns=525600000000000)
        """
        elapsed = dt.datetime(year, month, day, hour, minute) - _EPOCH
        return cls(0, (elapsed.days * 86_400 + elapsed.seconds) * NS_PER_S + ns)

    @classmethod
    def from_utc_calendar(
        cls, year: int, month: int, day: int, hour: int = 0, minute: int = 0, ns: int = 0
    ) -> GpsTime:
        """Return the moment of a UTC date; ``ns`` [ns] of the minute, 60e9 and over: leap second.

        Examples
        --------
        >>> GpsTime.from_utc_calendar(2016, 12, 31, 23, 59, 60 * 10**9).tow_ns // 10**9
        17
        """
        minute_start = cls.from_calendar(year, month, day, hour, minute)
        leap_s = leap_seconds_at_utc(UNIX_NS_OF_GPS_EPOCH + minute_start.total_ns)
        return minute_start.add_ns(leap_s * NS_PER_S + ns)

    def to_calendar(self) -> tuple[int, int, int, int, int, int]:
        """Return year, month, day, hour, minute and nanoseconds of minute, in GPS time.

        Examples
        --------
        >>> GpsTime(2190, 525_601_000_000_007).to_calendar()
        (2022, 1, 1, 2, 0, 1000000007)
        """
        minutes, ns = divmod(self.total_ns, 60 * NS_PER_S)
        date = _EPOCH + dt.timedelta(minutes=minutes)
        return date.year, date.month, date.day, date.hour, date.minute, ns

    def day_of_year(self) -> int:
        """Return the day of year, 1 on January 1, in GPS time."""
        return (_EPOCH + dt.timedelta(seconds=self.total_ns // NS_PER_S)).timetuple().tm_yday


def nearest_week(week_mod_1024: int, reference_week: int) -> int:
    """Return the full week with the broadcast remainder nearest to a reference week.

    Examples
    --------
    >>> nearest_week(142, 2190), nearest_week(1023, 2049)
    (2190, 2047)
    """
    return reference_week + (week_mod_1024 - reference_week + 512) % 1024 - 512
