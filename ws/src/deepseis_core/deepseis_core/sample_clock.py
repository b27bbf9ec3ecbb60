"""The station's clock: IF samples, and the coarse UTC that goes with them."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime

from deepseis_core.errors import InputError

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


@dataclass(frozen=True)
class SampleClock:
    """Coarse time of samples: UTC of sample 0 and the nominal rate, in integers.

    Parameters
    ----------
    start_utc_ns : int
        UTC of sample 0 [ns since 1970].
    sample_rate_hz : float
        Nominal rate [Hz], resolved to 1 mHz.

    Examples
    --------
    >>> SampleClock(10, 4e6).utc_ns(4)
    1010
    """

    start_utc_ns: int
    sample_rate_hz: float

    def offset_ns(self, sample_index: int) -> int:
        """Time from sample 0 to a sample [ns]."""
        return sample_index * 1_000_000_000_000 // round(self.sample_rate_hz * 1e3)

    def utc_ns(self, sample_index: int) -> int:
        """UTC of a sample [ns since 1970]."""
        return self.start_utc_ns + self.offset_ns(sample_index)

    def sample_at(self, utc_ns: int) -> int:
        """Last whole sample at or before a UTC [ns since 1970], its rounding to ns undone.

        Examples
        --------
        >>> clock = SampleClock(10, 3e6)
        >>> [clock.sample_at(clock.utc_ns(n)) for n in (0, 1, 2, 1000000)]
        [0, 1, 2, 1000000]
        """
        rate_mhz = round(self.sample_rate_hz * 1e3)
        return ((utc_ns - self.start_utc_ns + 1) * rate_mhz - 1) // 1_000_000_000_000

    @classmethod
    def from_sample(cls, sample_index: int, utc_ns: int, sample_rate_hz: float) -> SampleClock:
        """Make the clock that shows ``utc_ns`` at ``sample_index``."""
        zero = cls(0, sample_rate_hz)
        return cls(utc_ns - zero.offset_ns(sample_index), sample_rate_hz)


def utc_ns_from_iso(text: str) -> int:
    """UTC nanoseconds since 1970 of an ISO 8601 text; without a zone it is UTC.

    Raises
    ------
    InputError
        The text is no ISO 8601 time.

    Examples
    --------
    >>> utc_ns_from_iso("1970-01-01T00:00:01.5")
    1500000000
    """
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        hint = "such as 2022-01-01T02:00:00"
        raise InputError(f"time {text!r}", "is not ISO 8601", hint) from None
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=UTC)
    delta = moment - _EPOCH
    return (delta.days * 86_400 + delta.seconds) * 1_000_000_000 + delta.microseconds * 1000
