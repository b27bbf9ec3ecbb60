"""How long epochs wait in real time, by a clock of the test's own."""

import pytest

from deepseis_pvt.epoch_deadline import EpochDeadline

STEP = 80_000
"""Samples of 20 ms: a block, and the distance of epochs."""


class Clock:
    """Seconds that a test moves on."""

    now = 50.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


def waits(clock, spoken, newest=10**12):
    """Run 3 s in ticks of 10 ms; return how long after its samples each epoch was forced [s].

    ``spoken(tick)`` names the late satellites that speak at a tick.
    """
    deadline, start, epoch, found = EpochDeadline(0.2, clock=clock), clock.now, 0, []
    for tick in range(300):
        clock.now = start + 0.01 * tick
        if tick % 2 == 0:
            deadline.arrived((tick // 2 + 1) * STEP - 1)
        for satellite in spoken(tick):
            deadline.heard(satellite)
        deadline.look()
        while deadline.is_overdue(epoch * STEP, ["G05", "motion"], newest):
            found.append(clock.now - (start + 0.02 * epoch))
            epoch += 1
    return found


def test_while_a_tracker_is_dead_every_epoch_is_forced_so_long_after_its_samples(clock):
    found = waits(clock, lambda _tick: ())
    assert len(found) >= 139  # 20 ms apart, no bursts
    assert min(found) > 0.2 - 1e-9
    assert max(found) < 0.2 + 0.01 + 1e-9


def test_a_tracker_that_has_just_died_is_waited_for_as_one_that_is_silent(clock):
    found = waits(clock, lambda tick: ("G05",) if tick < 5 else ())
    assert 0.2 - 1e-9 < max(found) < 0.21 + 1e-9


def test_satellites_whose_integrations_keep_coming_are_waited_for_four_times_as_long(clock):
    found = waits(clock, lambda tick: ("G05",) if tick % 2 else ())
    assert len(found) >= 109
    assert min(found) > 0.8 - 1e-9
    assert max(found) < 0.8 + 0.01 + 1e-9


def test_where_all_trackers_lag_late_positions_are_better_than_none(clock):
    assert waits(clock, lambda tick: ("G05",) if tick % 2 else (), newest=-1) == []
    assert len(waits(clock, lambda _tick: (), newest=-1)) >= 139, "but not once they are silent"
