"""A base beside the signal: never ahead of it, waited for in lockstep only, lost and back."""

from itertools import chain

import numpy as np
from unit.frontend.test_base_stream import CLOCK, EPOCHS, PLACE

from deepseis_core.types import Observations
from deepseis_frontend.base_events import BaseReference, in_order, utc_of
from deepseis_frontend.base_player import BasePlayer

RATE = 4_000_000
REFERENCE = BaseReference(utc_of(EPOCHS[3]), PLACE, "base")


class Live:
    """Gives what a test has put into it."""

    def __init__(self):
        self.events = []

    def take(self):
        taken, self.events = self.events, []
        return taken


class Hand:
    """A clock that a test sets."""

    def __init__(self):
        self.seconds = 0.0

    def __call__(self):
        return self.seconds


def test_a_recorded_base_follows_the_signal_and_is_complete_to_it():
    player = BasePlayer([REFERENCE, *EPOCHS[3:]], CLOCK)
    seen = []
    for through in range(-1, 12 * RATE, RATE // 2):
        assert player.complete_through(through) == through
        new = player.due(through)
        player.announce(through)
        assert all(e.sample_index <= through for e in new if isinstance(e, Observations))
        seen += new
    assert seen == [REFERENCE, *EPOCHS[3:12]]
    assert player.counts["late"] == player.counts["dropped"] == 0


def test_a_base_without_epochs_is_lost_and_comes_back():
    player = BasePlayer([*EPOCHS[:4], *EPOCHS[12:]], CLOCK, 5.0)
    lost = []
    for second in range(16):
        player.due(second * RATE)
        lost.append(player.look(second * RATE))
    assert [k for k, each in enumerate(lost) if each] == [9, 10, 11]
    assert player.counts["lost"] == 1
    assert player.age_s(20 * RATE) == 5.0


def test_lockstep_waits_for_a_live_base_until_it_is_silent():
    live, hand = Live(), Hand()
    player = BasePlayer(live, CLOCK, 5.0, now=hand)
    assert player.complete_through(2 * RATE) == -1
    live.events += EPOCHS[:3]
    assert player.complete_through(8 * RATE) == 2 * RATE
    assert player.due(2 * RATE) == EPOCHS[:3]
    player.announce(2 * RATE)
    hand.seconds = 4.9
    assert player.complete_through(8 * RATE) == 2 * RATE
    hand.seconds = 5.1
    assert player.complete_through(8 * RATE) == 8 * RATE
    assert player.due(8 * RATE) == []
    player.announce(8 * RATE)
    # Back again: what it missed to say is late, and it is waited for.
    live.events += EPOCHS[3:11]
    assert player.complete_through(12 * RATE) == 10 * RATE
    assert player.due(10 * RATE) == EPOCHS[3:11]
    assert player.counts["late"] == 6


def test_in_real_time_nobody_waits():
    live = Live()
    player = BasePlayer(live, CLOCK, 5.0, waits=False)
    assert player.complete_through(3 * RATE) == 3 * RATE
    player.announce(3 * RATE)
    live.events += [*EPOCHS[2:5], EPOCHS[39]]
    assert player.complete_through(3 * RATE + RATE // 2) == 3 * RATE + RATE // 2
    assert player.due(3 * RATE + RATE // 2) == EPOCHS[2:4]
    assert player.counts == {"epochs": 2, "late": 2, "dropped": 1, "lost": 0}
    live.events += EPOCHS[1:3]
    player.complete_through(5 * RATE)
    assert player.due(5 * RATE) == EPOCHS[4:5]
    assert player.counts["dropped"] == 3


def test_who_joins_leaves_aside_what_is_past():
    player = BasePlayer([REFERENCE, *EPOCHS], CLOCK)
    player.begin_at(7 * RATE - 5)
    assert player.due(9 * RATE) == [REFERENCE, *EPOCHS[7:10]]


def test_a_bags_events_are_put_in_order():
    shuffled = [EPOCHS[0], EPOCHS[1], EPOCHS[3], EPOCHS[2], EPOCHS[4], REFERENCE, *EPOCHS[5:]]
    got = list(in_order(shuffled))
    assert got[3] is REFERENCE or got.index(REFERENCE) < got.index(EPOCHS[3])
    assert len(got) == len(shuffled)
    assert list(chain(in_order([]))) == []
    assert np.array_equal(REFERENCE.station().monument_ecef, PLACE)
