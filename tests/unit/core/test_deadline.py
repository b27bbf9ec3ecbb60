"""Deadlines count from the arrival of samples, whatever the node does meanwhile."""

import pytest

from deepseis_core.deadline import MOST_NOTED, Deadline

BLOCK = 80_000


class Clock:
    """Seconds that a test moves on."""

    now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


def test_every_block_is_overdue_so_long_after_it_came_and_lateness_does_not_add_up(clock):
    deadline = Deadline(0.2, clock=clock)
    overdue = {}
    for tick in range(200):  # 10 ms each; a block comes every 20 ms
        clock.now = 100.0 + 0.01 * tick
        if tick % 2 == 0:
            deadline.arrived((tick // 2 + 1) * BLOCK - 1)
        through = deadline.look()
        overdue.setdefault(through, clock.now)
    waits = [
        seen - (100.0 + 0.02 * ((through + 1) / BLOCK - 1))
        for through, seen in overdue.items()
        if through >= 0
    ]
    assert len(waits) > 80
    assert min(waits) > 0.2 - 1e-9
    assert max(waits) < 0.2 + 0.01 + 1e-9


def test_a_process_that_stood_still_gives_its_queued_inputs_the_whole_time_again(clock):
    deadline = Deadline(0.05, clock=clock)
    deadline.arrived(BLOCK - 1)
    clock.now += 0.5  # nobody looked
    assert deadline.look() == -1
    clock.now += 0.04
    assert deadline.look() == -1
    clock.now += 0.02
    assert deadline.look() == BLOCK - 1


def test_a_watermark_said_again_does_not_take_back_what_is_overdue(clock):
    deadline = Deadline(0.03, clock=clock)
    deadline.arrived(2 * BLOCK - 1)
    deadline.arrived(BLOCK - 1)
    clock.now += 0.05
    assert deadline.look() == 2 * BLOCK - 1


def test_where_nobody_looks_nothing_piles_up(clock):
    """Lockstep: nodes note arrivals all the same."""
    deadline = Deadline(0.2, clock=clock)
    for number in range(2 * MOST_NOTED):
        deadline.arrived(number)
    assert len(deadline._due) == MOST_NOTED
    deadline.look()
    clock.now += 0.05
    deadline.look()
    clock.now += 0.05
    deadline.look()
    clock.now += 0.09
    assert deadline.look() == -1
    clock.now += 0.09
    assert deadline.look() == 2 * MOST_NOTED - 1
    assert not deadline._due
