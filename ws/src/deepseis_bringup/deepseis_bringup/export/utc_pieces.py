"""GPS time of samples to UTC: cut where a UTC day or a leap second begins or ends."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from deepseis_core.constants import NS_PER_S
from deepseis_core.gps_time import GpsTime
from deepseis_core.types import IntArray

DAY_NS = 86_400 * NS_PER_S


@dataclass(frozen=True)
class UtcMoment:
    """A moment of UTC, told apart from the leap second with which it shares its number.

    ``day_ns`` is the midnight before [ns since 1970]; ``unix_ns`` counts on through a leap
    second, so 23:59:60.x lies a day and x after its ``day_ns``.
    """

    unix_ns: int
    leap: bool

    @property
    def day_ns(self) -> int:
        """Midnight before it [ns since 1970]."""
        return (self.unix_ns - NS_PER_S * self.leap) // DAY_NS * DAY_NS

    @classmethod
    def of_gps_ns(cls, gps_ns: int) -> UtcMoment:
        """Return the UTC of nanoseconds since the GPS epoch.

        Examples
        --------
        >>> start = GpsTime.from_utc_calendar(2016, 12, 31, 23, 59).total_ns
        >>> [UtcMoment.of_gps_ns(start + s * 10**9).leap for s in (59, 60, 61)]
        [False, True, False]
        """
        time = GpsTime(0, gps_ns)
        unix_ns = time.to_utc_ns()
        return cls(unix_ns, GpsTime.from_utc_ns(unix_ns) != time)

    def iso(self, digits: int = 6) -> str:
        """Return it as ISO 8601, a leap second as 60.

        Examples
        --------
        >>> UtcMoment.of_gps_ns(GpsTime.from_utc_calendar(2026, 1, 2, 3, 4, 0).total_ns).iso(0)
        '2026-01-02T03:04:00Z'
        >>> UtcMoment.of_gps_ns(GpsTime.from_utc_calendar(2016, 12, 31, 23, 59, 60 * 10**9 + 5000)
        ...     .total_ns).iso()
        '2016-12-31T23:59:60.000005Z'
        """
        since = self.unix_ns - NS_PER_S * self.leap - self.day_ns
        minutes, ns = divmod(since, 60 * NS_PER_S)
        second, rest = divmod(ns + NS_PER_S * self.leap, NS_PER_S)
        date = np.datetime64(self.day_ns // DAY_NS, "D")
        clock = f"{minutes // 60:02d}:{minutes % 60:02d}:{second:02d}"
        fraction = f".{rest:09d}"[: 1 + digits] if digits else ""
        return f"{date}T{clock}{fraction}Z"


def cut_at_days(gps_ns: IntArray) -> Iterator[slice]:
    """Cut samples so that each part lies in one UTC day, and in a leap second or outside.

    Parameters
    ----------
    gps_ns : ndarray of int64, shape (n,)
        Times of the samples since the GPS epoch, rising [ns].
    """

    def place(k: int) -> tuple[int, bool]:
        moment = UtcMoment.of_gps_ns(int(gps_ns[k]))
        return moment.day_ns, moment.leap

    first = 0
    while first < len(gps_ns):
        here = place(first)
        low, high = first, len(gps_ns)  # the part reaches at least to low, not to high
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (middle, high) if place(middle) == here else (low, middle)
        yield slice(first, high)
        first = high


def gps_ns_of_utc(unix_ns: int) -> int:
    """Return nanoseconds since the GPS epoch of Unix nanoseconds."""
    return GpsTime.from_utc_ns(unix_ns).total_ns
