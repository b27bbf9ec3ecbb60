"""Time stamps of messages."""

from __future__ import annotations

from builtin_interfaces.msg import Time


def stamp_from_ns(utc_ns: int) -> Time:
    """UTC nanoseconds since 1970 as a message stamp."""
    return Time(sec=utc_ns // 1_000_000_000, nanosec=utc_ns % 1_000_000_000)


def ns_from_stamp(stamp: Time) -> int:
    """Stamp as UTC nanoseconds since 1970."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
