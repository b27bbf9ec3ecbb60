"""Settings, the sample clock, errors, credits."""

from dataclasses import dataclass

import pytest

from deepseis_core.config import check, setting
from deepseis_core.errors import InputError
from deepseis_core.sample_clock import SampleClock, utc_ns_from_iso


@dataclass(frozen=True)
class Example:
    width: float = setting(2.0, "width [m]", low=1.0, high=3.0)
    kind: str = setting("a", "kind [-]", choices=("a", "b"))
    names: list[str] = setting([], "names [-]")


def test_defaults_pass_and_lists_are_not_shared():
    check(Example())
    assert Example().names is not Example().names


@pytest.mark.parametrize(
    ("values", "said"), [({"width": 0.5}, "width = 0.5"), ({"kind": "c"}, "kind = 'c'")]
)
def test_the_first_setting_outside_its_limits_is_named(values, said):
    with pytest.raises(ValueError, match=said):
        check(Example(**values))


@pytest.mark.parametrize("rate_hz", [4e6, 4.092e6, 20.48e6, 5456000.123])
@pytest.mark.parametrize("index", [0, 1, 79_999, 12_345_678_901])
def test_sample_time_is_exact_to_a_nanosecond_and_invertible(rate_hz, index):
    clock = SampleClock(1_700_000_000_123_456_789, rate_hz)
    utc_ns = clock.utc_ns(index)
    exact = index * 10**12 / round(rate_hz * 1000)
    assert abs(utc_ns - clock.start_utc_ns - exact) <= max(1.0, exact * 1e-15)
    assert SampleClock.from_sample(index, utc_ns, rate_hz) == clock


def test_iso_times_are_utc_unless_they_say_otherwise():
    assert utc_ns_from_iso("2022-01-01T02:00:00") == 1_641_002_400_000_000_000
    assert utc_ns_from_iso("2022-01-01T03:00:00+01:00") == 1_641_002_400_000_000_000
    with pytest.raises(InputError, match="not ISO 8601"):
        utc_ns_from_iso("yesterday")
