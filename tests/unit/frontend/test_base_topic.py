"""Another station as a base: what it says, on our clock."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from deepseis_core.errors import InputError
from deepseis_core.geodesy import ecef_from_enu
from deepseis_core.gps_time import GpsTime
from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import Observations, Station
from deepseis_frontend.base_events import Arcs, BaseReference, Row
from deepseis_frontend.base_player import BasePlayer
from deepseis_frontend.base_topic import LIMIT, StationBase
from deepseis_frontend.ntrip import address_of

START = GpsTime(2399, 415_255 * 10**9)
CLOCK = SampleClock(START.to_utc_ns(), 4e6)
MONUMENT = np.array([-3896562.0, 3137540.0, 3969230.0])


def said(number: int) -> Observations:
    """Return an epoch of 50 Hz, on the other station's own count of samples."""
    row = Row("G05", 2.1e7, 1.1e8, 1200.0, 45.0, 0)
    return Arcs(0.02).epoch(START.add_ns(number * 20_000_000), 77 + 80_000 * number, [row])


def station(lever: float = 1.5) -> Station:
    own = BaseReference(0, MONUMENT, "KOBE").station()
    return replace(own, antenna_lever_arm=np.array([0.0, 0.0, lever]))


def test_epochs_are_put_on_our_clock_ten_a_second() -> None:
    base = StationBase(address_of("station://KOBE"), CLOCK)
    assert not base.connected
    base.push_station(station(), CLOCK.start_utc_ns)
    for number in range(26):
        base.push_epoch(said(number))
    base.push_epoch(said(20))  # repeated
    player = BasePlayer(base, CLOCK, now=lambda: 0.0)
    reference, *epochs = player.due(10**9)
    assert isinstance(reference, BaseReference)
    place = ecef_from_enu(np.array([0.0, 0.0, 1.5]), MONUMENT)
    np.testing.assert_allclose(reference.position_ecef, place, atol=1e-6)
    samples = [e.sample_index for e in epochs if isinstance(e, Observations)]
    assert samples == [400_000 * k for k in range(6)]
    assert [e.interval for e in epochs if isinstance(e, Observations)] == [0.1] * 6
    assert base.counts == {"epochs": 6, "repeated": 1, "overrun": 0}
    assert player.counts["epochs"] == 6


def test_a_station_that_says_where_it_is_again_is_no_news() -> None:
    base = StationBase(address_of("station://KOBE"), CLOCK)
    for lever in (1.5, 1.5, 1.6):
        base.push_station(station(lever), CLOCK.start_utc_ns)
    assert len(base.take()) == 2


def test_what_nobody_takes_does_not_grow_for_ever() -> None:
    base = StationBase(address_of("station://KOBE"), CLOCK)
    for number in range(0, 5 * LIMIT + 50, 5):
        base.push_epoch(said(number))
    assert len(base.take()) == LIMIT
    assert base.counts["overrun"] == 10


@pytest.mark.parametrize("text", ["station://", "station://a/b", "station://2nd", "station://a b"])
def test_what_is_no_station_s_name_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="names no station"):
        address_of(text)


def test_a_base_whose_time_is_set_back_is_heard_again() -> None:
    """It was an hour ahead, and is right now; what comes twice is still left out."""
    base = StationBase(address_of("station://KOBE"), CLOCK)
    hour = 3600 * 50
    for number in (hour, hour + 5, 0, 5, 10, 5):
        base.push_epoch(said(number))
    assert base.counts["repeated"] == 1
    player = BasePlayer(base, CLOCK, waits=False, now=lambda: 0.0)
    samples = [
        event.sample_index for event in player.due(10**7) if isinstance(event, Observations)
    ]
    assert samples == [0, 400_000, 800_000]
    assert player.counts["dropped"] == 2
