import numpy as np
import pytest
from unit.pvt.tracked_signals import LOCKED, message

from deepseis_core.types import TrackingFlag
from deepseis_pvt.track_store import BREAK, START, TrackStore


def row(start, count=1000, transmit_ms=5):
    """Return one integration with nothing in its replica."""
    zero = dict.fromkeys(("code_phase_chips", "code_rate_cps", "carrier_phase_cycles"), 0.0)
    return {"sample_index": start, "sample_count": count, "transmit_ms": transmit_ms, **zero}


def test_rows_keep_their_order_while_the_store_grows():
    store = TrackStore(["G01", "G02"])
    for k in range(300):
        store.push(message("G01", 1000 * k, 1000 * k + 999, [row(1000 * k)]))
    rows = store.ints[0, store.head[0] : store.tail[0], START]
    assert rows.tolist() == list(range(0, 300_000, 1000))
    assert store.published.tolist() == [299_999, -1]


def test_rows_worked_through_make_room_for_others():
    store = TrackStore(["G01"])
    for k in range(1000):
        store.push(message("G01", 1000 * k, 1000 * k + 999, [row(1000 * k)]))
        store.head[0] = max(0, store.tail[0] - 10)
    assert store.ints.shape[1] == 64


def test_a_backlog_that_has_been_worked_off_is_given_back():
    store = TrackStore(["G01", "G02"])
    store.push(message("G02", 0, 999, [row(0), row(1000)]))
    for k in range(300):
        rows = [row(10_000 * k + 1000 * j) for j in range(10)]
        store.push(message("G01", 10_000 * k, 10_000 * k + 9999, rows))
    assert store.ints.shape[1] > 3000
    store.head[0] = store.tail[0] - 2
    for k in range(300, 1200):
        rows = [row(10_000 * k + 1000 * j) for j in range(10)]
        store.push(message("G01", 10_000 * k, 10_000 * k + 9999, rows))
        store.head[0] = store.tail[0] - 12
    assert store.ints.shape[1] == store.floats.shape[1] <= 128
    for number, expected in (
        (0, list(range(11_988_000, 12_000_000, 1000))),
        (1, [0, 1000]),
    ):
        waiting = store.ints[number, store.head[number] : store.tail[number], START]
        assert waiting.tolist() == expected


def test_a_satellite_that_never_reports_is_named():
    store = TrackStore(["G01", "G02"])

    def push_forever():
        for k in range(4000):
            rows = [row(20_000 * k + 1000 * j) for j in range(20)]
            store.push(message("G01", 20_000 * k, 20_000 * k + 19_999, rows))

    with pytest.raises(BufferError, match="tracker of G02"):
        push_forever()


def test_phase_breaks_where_rows_do_not_touch_or_lock_is_missing():
    flags = np.array(
        [
            LOCKED,
            LOCKED,
            LOCKED | TrackingFlag.SLIP,
            LOCKED & ~TrackingFlag.PHASE_LOCK,
            LOCKED | TrackingFlag.HALF_CYCLE,
            LOCKED,
        ],
        np.uint16,
    )
    rows = [row(start) for start in (0, 1000, 2000, 3000, 4000, 5001)]
    store = TrackStore(["G01"])
    store.push(message("G01", 0, 9999, rows, flags=flags))
    assert store.ints[0, :6, BREAK].tolist() == [1, 0, 1, 1, 2, 1]
    store.push(message("G01", 10_000, 19_999, [row(6001)]))
    assert store.ints[0, 6, BREAK] == 0


def test_what_does_not_belong_is_counted():
    store = TrackStore(["G01"])
    store.push(message("G07", 0, 999, [row(0)]))
    store.push(message("G01", 0, 1999, [row(0)]))
    store.push(message("G01", 0, 999, [row(0)]))
    store.push(message("G01", 2000, 3999, [row(2000)]), worked_through=5000)
    assert store.counts == {"unknown_satellite": 1, "disordered": 1, "late": 1}
    assert store.tail[0] == 2


def test_ephemerides_announced_hold_work_until_they_arrive():
    store = TrackStore(["G01", "G02"])
    store.push(message("G01", 0, 999, [], ephemeris_count=0))
    assert store.ephemerides_through() > 10**15
    store.push(message("G01", 1000, 1999, [], ephemeris_count=1))
    store.push(message("G01", 2000, 2999, [], ephemeris_count=2))
    store.push(message("G02", 0, 999, [], ephemeris_count=0))
    assert store.ephemerides_through() == 1999
    store.received_ephemeris("G01")
    assert store.ephemerides_through() == 2999
    store.received_ephemeris("G01")
    assert store.ephemerides_through() > 10**15
