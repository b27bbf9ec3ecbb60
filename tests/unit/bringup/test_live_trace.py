"""Rings and envelopes of the live page: bounded, and no peak is lost."""

import numpy as np
import pytest

from deepseis_bringup.live.trace import LEVELS, Level, Ring, Trace

RATE = 200.0


def pushed(values, chunks, levels=LEVELS, interval=1 / RATE):
    trace = Trace("t", ("z",), levels)
    times = np.arange(len(values)) * interval
    for part in np.split(np.arange(len(values)), chunks):
        trace.push(times[part], values[part, None], interval)
    return trace


@pytest.mark.parametrize("sizes", [[1], [3, 1, 7], [400]])
def test_a_ring_holds_the_newest_rows_in_order(sizes):
    ring, sent = Ring(100, 1), 0
    for k in range(300):
        n = sizes[k % len(sizes)]
        numbers = np.arange(sent, sent + n, dtype=float)
        ring.push(numbers, numbers[:, None].astype(np.float32))
        sent += n
        times, rows = ring.since(max(0, sent - 100))
        assert times.tolist() == list(range(max(0, sent - 100), sent))
        assert rows[:, 0].tolist() == times.tolist()
    assert ring.count == sent
    assert len(ring.since(sent - 7)[0]) == 7
    assert ring.since(0, most=5)[0].tolist() == list(range(sent - 5, sent))


def test_envelopes_do_not_depend_on_how_samples_are_cut():
    values = np.random.default_rng(1).normal(size=5000)
    whole = pushed(values, [])
    for chunks in ([1, 2, 3, 2000], list(range(4, 5000, 4)), list(range(1, 5000, 97))):
        cut = pushed(values, chunks)
        for one, other in zip(whole.rings, cut.rings, strict=True):
            for a, b in zip(one.since(0), other.since(0), strict=True):
                np.testing.assert_array_equal(a, b)


def test_envelopes_are_the_least_and_greatest_values_of_their_cells():
    values = np.random.default_rng(2).normal(size=4001)
    times, rows = pushed(values, list(range(3, 4001, 3))).rings[1].since(0)
    cells = values[:4000].reshape(-1, 20).astype(np.float32)
    np.testing.assert_array_equal(rows, np.c_[cells.min(axis=1), cells.max(axis=1)])
    np.testing.assert_allclose(times, (np.arange(200) + 0.5) * 0.1, atol=1e-9)


def test_one_sample_of_a_peak_is_in_every_level():
    values = np.zeros(200 * 100)
    values[12_345] = 19.6
    trace = pushed(values, list(range(4, len(values), 4)))
    for ring in trace.rings:
        assert ring.since(0)[1].max() == np.float32(19.6)


def test_memory_does_not_grow_with_time():
    trace = Trace("t", ("a", "b", "c"))
    sizes = set()
    for k in range(40):
        times = k * 100.0 + np.arange(20_000) / RATE
        trace.push(times, np.zeros((20_000, 3)), 1 / RATE)
        buffers = [(r._times.nbytes, r._rows.nbytes) for r in trace.rings]
        sizes.add(tuple(buffers))
    assert len(sizes) == 1
    lengths = [len(ring.since(0)[0]) for ring in trace.rings]
    assert lengths == [12_000, 6000, 3600]


def test_late_and_repeated_samples_are_left_out():
    trace = Trace("t", ("z",), (Level(0.0, 10.0), Level(0.1, 10.0)))
    for times in ([0.0, 0.005, 0.01], [0.005, 0.01, 0.015], [0.0]):
        trace.push(np.array(times), np.zeros((len(times), 1)), 0.005)
    assert trace.rings[0].since(0)[0].tolist() == [0.0, 0.005, 0.01, 0.015]


def test_a_run_that_begins_anew_or_at_another_rate_forgets_what_was():
    trace = pushed(np.zeros(2000), [])
    trace.push(np.array([0.0]), np.zeros((1, 1)), 1 / RATE)
    assert (trace.generation, trace.rings[0].count) == (2, 1)
    trace.push(np.array([0.01]), np.zeros((1, 1)), 0.01)
    assert (trace.generation, trace.rings[0].room) == (3, 6000)


def test_what_is_not_known_does_not_hide_what_is():
    values = np.full(41, np.nan)
    values[7] = -3.0
    rows = pushed(values, [5, 9]).rings[1].since(0)[1]
    np.testing.assert_array_equal(rows, [[-3.0, -3.0], [np.nan, np.nan]])
