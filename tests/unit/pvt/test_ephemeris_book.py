from dataclasses import replace

import numpy as np
import pytest
from unit.pvt.tracked_signals import TOW, WEEK, ephemeris

from deepseis_pvt.ephemeris_book import EphemerisBook, week_of

NOW = (WEEK * 604800 + TOW) * 10**9
BASE = ephemeris(7)


def book(*ephemerides, **settings):
    """Return a book of these."""
    made = EphemerisBook(7200.0, **settings)
    for item in ephemerides:
        made.add(item)
    return made


def test_an_ephemeris_counts_from_its_sample_on():
    made = book(replace(BASE, effective_sample_index=1000))
    assert made.find("G07", 999, NOW) is None
    found = made.find("G07", 1000, NOW)
    assert found is not None
    assert found[0].satellite == "G07"
    assert made.find("G08", 1000, NOW) is None


def test_the_nearest_toe_wins_and_of_equal_ones_the_later_message():
    old = replace(BASE, toe=TOW - 6000.0, effective_sample_index=10)
    new = replace(BASE, toe=TOW + 1000.0, effective_sample_index=20)
    again = replace(new, iode=99, effective_sample_index=30)
    made = book(again, new, old)
    assert made.find("G07", 15, NOW)[0] is old
    assert made.find("G07", 25, NOW)[0] is new
    assert made.find("G07", 35, NOW)[0] is again


def test_old_and_unhealthy_ephemerides_are_not_used():
    assert book(replace(BASE, toe=TOW - 7201.0)).find("G07", 0, NOW) is None
    ill = replace(BASE, health=63)
    assert book(ill).find("G07", 0, NOW) is None
    assert book(ill, use_unhealthy=True).find("G07", 0, NOW)[0] is ill


def test_before_the_week_is_known_the_time_of_week_decides():
    made = book(BASE)
    assert made.find("G07", 0, TOW * 10**9) is None
    assert made.find("G07", 0, TOW * 10**9, week_known=False)[0] is BASE
    first_second = replace(BASE, week=WEEK + 1, toe=0.0)
    assert book(first_second).find("G07", 0, 604_799 * 10**9, week_known=False) is not None


@pytest.mark.parametrize(
    ("toe", "tow_ms", "weeks"), [(0.0, 604_799_000, -1), (604_784.0, 5, 1), (7200.0, 0, 0)]
)
def test_the_week_of_a_time_of_week_is_that_nearest_to_toe(toe, tow_ms, weeks):
    assert week_of(replace(BASE, toe=toe), tow_ms) == WEEK + weeks


def test_the_same_ephemeris_twice_is_one():
    made = book(BASE)
    assert not made.add(replace(BASE))
    assert made.add(replace(BASE, iode=12))


def test_the_newest_ionosphere_in_force_is_used():
    one = replace(BASE, iono_alpha=(1.0,) * 4, iono_beta=(2.0,) * 4, effective_sample_index=50)
    made = book(one)
    assert made.klobuchar(49) is None
    assert made.klobuchar(50).tolist() == [1.0] * 4 + [2.0] * 4
    made.add_klobuchar([3.0] * 4, [4.0] * 4, 70)
    assert made.klobuchar(70)[0] == 3.0
    made.forget(80, NOW)
    assert made.klobuchar(80)[0] == 3.0
    with pytest.raises(ValueError, match="four"):
        made.add_klobuchar([1.0], [2.0])


def test_what_can_no_longer_be_chosen_is_forgotten():
    made = book(BASE, replace(BASE, effective_sample_index=500, toe=TOW + 7200.0))
    later = NOW + 10_000 * 10**9
    before = made.find("G07", 600, later)
    made.forget(600, later)
    assert made.find("G07", 600, later) == before
    assert len(made._known["G07"]) == 1
    assert np.isfinite(before[1]).all()
