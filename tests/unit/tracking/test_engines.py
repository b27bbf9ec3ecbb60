"""Slots, watermarks and waiting of the two engines: nothing depends on the order of arrival."""

import numpy as np
import pytest

from deepseis_core.errors import InputError
from deepseis_core.lnav import UtcParameters
from deepseis_core.types import (
    AcquisitionResult,
    Aiding,
    IfBlock,
    TrackingFlag,
    TrackingMode,
)
from deepseis_tracking import acquisition_engine
from deepseis_tracking.acquisition import AcquisitionConfig, Detection
from deepseis_tracking.acquisition_engine import AcquisitionEngine, RetryConfig
from deepseis_tracking.channel import TrackingConfig
from deepseis_tracking.engine import SlotConfig, TrackingEngine, check_satellites

RATE = 2e6
COUNT = 40_000
SLOT = 1_000_000
SATELLITES = ("G05", "G07")


def block(index, amplitude=10):
    """A block of noise."""
    data = np.random.default_rng(index).integers(-amplitude, amplitude, 2 * COUNT)
    return IfBlock(index * COUNT, COUNT, RATE, 0.0, "iq8", data.astype(np.int8).view(np.uint8))


def result(satellite="G05", effective=SLOT):
    """A detection that takes effect at the second slot."""
    return AcquisitionResult(
        satellite, True, 0, effective, 100.0, 500.0, 3.0, 9.0, 3.0, 1e-6, 40.0
    )


def engine(**options):
    """A tracking engine for two satellites."""
    return TrackingEngine(SATELLITES, TrackingConfig(), SlotConfig(), **options)


def test_satellite_names_are_checked_and_ordered():
    assert check_satellites(["G31", "G02", "G31"]) == ("G02", "G31")
    with pytest.raises(InputError, match="G33"):
        check_satellites(["G33"])


def test_idle_channels_promise_to_the_end_of_the_slot_and_speak_once_a_slot():
    tracker = engine()
    tracker.acquisition_valid(10 * SLOT, 0)
    spoken = []
    for index in range(30):
        tracker.push_block(block(index))
        spoken += [(index, e.satellite, e.valid_through) for e in tracker.advance().epochs]
    assert spoken == [
        (0, "G05", SLOT - 1),
        (0, "G07", SLOT - 1),
        (25, "G05", 2 * SLOT - 1),
        (25, "G07", 2 * SLOT - 1),
    ]


def test_a_slot_waits_for_the_acquisition_and_for_every_result_it_announced():
    tracker = engine()
    for index in range(26):
        tracker.push_block(block(index))
    for _ in range(25):
        assert tracker.advance() is not None
    assert tracker.waiting_for() == "acquisition"
    assert tracker.advance() is None
    tracker.acquisition_valid(2 * SLOT - 1, 1)
    assert tracker.advance() is None, "one result is still on its way"
    tracker.push_result(result())
    assert tracker.advance() is not None
    assert tracker.channels["G05"].mode == TrackingMode.PULL_IN
    assert tracker.channels["G07"].mode == TrackingMode.IDLE


def test_results_may_come_early_in_any_order():
    outcomes = []
    for order in ((0, 1), (1, 0)):
        tracker = engine()
        both = [result("G05"), result("G07")]
        for k in order:
            tracker.push_result(both[k])
        tracker.acquisition_valid(2 * SLOT - 1, 2)
        for index in range(27):
            tracker.push_block(block(index))
            outcome = tracker.advance()
        outcomes.append([(e.satellite, e.prompt_i.tolist()) for e in outcome.epochs])
    assert outcomes[0] == outcomes[1]
    assert len(outcomes[0]) == 2


def test_missing_samples_drop_the_channel_flag_the_gap_and_ask_for_a_search():
    tracker = engine(wait_acquisition=False)
    tracker.push_result(result())
    outputs = []
    for index in [*range(30), *range(33, 36)]:
        tracker.push_block(block(index))
        outputs.append(tracker.advance())
    assert tracker.counters["gaps"] == 1
    after = outputs[30]
    assert after.requests == [("G05", 34 * COUNT)]
    assert tracker.channels["G05"].mode == TrackingMode.IDLE
    pending = int(tracker.channels["G05"].state["pending_flags"])
    assert pending & TrackingFlag.GAP
    assert pending & TrackingFlag.SLIP
    assert tracker.health()[0], "a gap is a warning"


def test_aiding_is_waited_for_unless_forced():
    tracker = engine(wait_acquisition=False, wait_aiding=True)
    tracker.push_block(block(0))
    assert tracker.waiting_for() == "aiding"
    assert tracker.advance() is None
    assert tracker.advance(force=True) is not None
    assert tracker.counters["aid_missed"] == 1


def aid(through):
    """Aiding of the block that ends with a sample."""
    first = through + 1 - COUNT
    return Aiding(
        "fusion", first, through, True, first, COUNT // 3, 4, ("G05",), np.zeros(4), np.zeros(4),
        float("nan"), np.ones(1, np.float32),
    )  # fmt: skip


def test_the_block_after_a_gap_needs_no_aiding_whatever_has_come():
    """Who makes the aiding waits for observations through the gap: waiting for it is for ever."""
    outcomes = []
    for early in (False, True):
        tracker = engine(wait_acquisition=False, wait_aiding=True)
        tracker.push_result(result(effective=0))
        for index in range(3):
            tracker.push_block(block(index))
            tracker.push_aiding(aid((index + 1) * COUNT - 1))
            assert tracker.advance() is not None
        for index in range(12, 14):
            tracker.push_block(block(index))
        if early:
            for index in range(3, 14):
                tracker.push_aiding(aid((index + 1) * COUNT - 1))
        after = tracker.advance()
        assert [e.satellite for e in after.epochs] == ["G05"]
        assert after.requests == [("G05", 13 * COUNT)]
        assert not after.missed
        if not early:
            assert tracker.waiting_for() == "aiding", "the next one waits again"
            for index in range(3, 14):
                tracker.push_aiding(aid((index + 1) * COUNT - 1))
        assert tracker.advance() is not None
        assert tracker.counters["aid_missed"] == 0
        channel = tracker.channels["G05"]
        outcomes.append((tracker.health(), after.epochs[0].valid_through, channel.aiding.through))
    assert outcomes[0] == outcomes[1]


@pytest.mark.parametrize("size", [0, 1, 5])
def test_aiding_whose_tables_do_not_fit_is_refused_not_stumbled_over(size):
    tracker = engine(wait_acquisition=False, wait_aiding=True)
    tracker.push_result(result(effective=0))
    for index, table in enumerate((4, size)):
        made = Aiding(
            "fusion", index * COUNT, (index + 1) * COUNT - 1, True, index * COUNT, COUNT // 3, 4,
            ("G05",), np.zeros(table), np.zeros(4), float("nan"), np.zeros(1, np.float32),
        )  # fmt: skip
        tracker.push_block(block(index))
        tracker.push_aiding(made)
        assert tracker.advance() is not None
    assert tracker.health()[2]["aid_invalid"] == 1


@pytest.mark.parametrize(("told", "warns"), [(18, False), (19, True)])
def test_leap_seconds_other_than_the_table_s_are_a_warning(told, warns):
    tracker = engine(wait_acquisition=False)
    tracker.push_block(block(0))
    assert tracker.advance() is not None
    tracker.channels["G05"].decoder.utc = UtcParameters(
        week_t=2400, leap_s=told, week_lsf=2400, leap_lsf_s=told
    )
    lost, text, values = tracker.health()
    assert (lost, values["leap_seconds"]) == (warns, told)
    assert ("19 s by the satellites, 18 s by the table" in text) == warns


def test_a_search_that_does_not_fit_into_a_slot_is_refused():
    with pytest.raises(InputError, match="slot"):
        AcquisitionEngine(
            SATELLITES, AcquisitionConfig(noncoherent_count=126), SlotConfig(), RetryConfig()
        )


class FakeAcquirer:
    """Finds whom it is told to."""

    samples_needed = 3 * COUNT
    found: tuple[str, ...] = ()

    def __init__(self, rate_hz, config):
        self.calls = []

    def search(self, i, q, sample_index, satellites):
        """Detect the satellites in ``found``."""
        self.calls.append((sample_index, len(i), tuple(satellites)))
        return [
            Detection(s, s in self.found, sample_index, 1.0, 2.0, 3.0, 9.0, 3.0, 1e-6, 40.0)
            for s in satellites
        ]


@pytest.fixture
def searcher(monkeypatch):
    """An acquisition engine whose search is a fake."""
    monkeypatch.setattr(acquisition_engine, "Acquirer", FakeAcquirer)
    monkeypatch.setattr(FakeAcquirer, "found", ("G07",))
    return AcquisitionEngine(
        SATELLITES, AcquisitionConfig(), SlotConfig(), RetryConfig(retry_s=2.0)
    )


def run(searcher, indices):
    """Push blocks; returns results and the watermark after each."""
    results, watermarks = [], []
    for index in indices:
        searcher.push_block(block(index))
        found = searcher.advance()
        results += found or []
        watermarks.append(searcher.valid_through)
    return results, watermarks


def test_the_watermark_never_promises_past_a_search_under_way(searcher):
    results, watermarks = run(searcher, range(4))
    assert watermarks == [SLOT - 1, SLOT - 1, 2 * SLOT - 1, 2 * SLOT - 1]
    assert [(r.satellite, r.detected) for r in results] == [("G05", False), ("G07", True)]
    assert {r.effective_sample_index for r in results} == {SLOT}


def test_a_satellite_not_found_is_tried_again_later_and_one_found_is_not(searcher):
    run(searcher, range(130))
    calls = searcher._acquirer.calls
    assert [(start, names) for start, _, names in calls] == [
        (0, SATELLITES),
        (4 * SLOT, ("G05",)),
    ]
    assert calls[0][1] == FakeAcquirer.samples_needed


def test_a_request_counts_from_the_next_slot_on_and_trackers_are_waited_for(searcher):
    searcher.expect_trackers(["trackers"])
    run(searcher, range(25))
    searcher.push_block(block(25))
    assert searcher.advance() is None, "the trackers have not spoken for the first slot"
    searcher.tracker_valid("trackers", SLOT - 1, 1)
    assert searcher.advance() is None, "a request is still on its way"
    searcher.push_request("G07", SLOT, "trackers")
    assert searcher.advance() is not None
    run(searcher, range(26, 30))
    assert searcher._acquirer.calls[-1][2] == ("G07",)


def test_a_gap_during_the_search_starts_it_afresh(searcher):
    results, _ = run(searcher, [0, 1, 4, 5, 6])
    assert len(results) == 2
    assert searcher._acquirer.calls == [(4 * COUNT, 3 * COUNT, SATELLITES)]


def test_one_that_joins_within_a_slot_searches_in_the_next_and_hears_requests_then(searcher):
    """Else all have had their turn without a search, and a satellite that is lost waits for it."""
    per_slot = SLOT // COUNT
    run(searcher, range(per_slot - 1, 2 * per_slot + 1))
    assert searcher._acquirer.calls[0][0] == SLOT
    assert searcher._acquirer.calls[0][2] == SATELLITES
    searcher.push_request("G07", 2 * SLOT + COUNT, "trackers")
    run(searcher, range(2 * per_slot + 1, 4 * per_slot))
    assert searcher._acquirer.calls[-1][0] == 3 * SLOT
    assert searcher._acquirer.calls[-1][2] == ("G07",)


def test_a_search_waits_no_longer_than_it_must_for_a_tracker_that_has_died(searcher):
    searcher.expect_trackers(["trackers_g05", "trackers_g07"])
    run(searcher, range(25))
    searcher.tracker_valid("trackers_g05", SLOT - 1, 0)
    searcher.push_block(block(25))
    assert searcher.advance() is None
    assert searcher.advance(force=True) is not None
    assert searcher.valid_through >= 2 * SLOT - 1


def test_a_tracker_that_joins_asks_for_all_and_who_was_not_tracked_keeps_its_turn(searcher):
    run(searcher, range(10))  # G07 found and handed over, G05 has its turn after 2 s
    tracker = engine()
    tracker.join(5 * COUNT, RATE)
    for index in range(5, 10):
        tracker.push_block(block(index))
    outputs = [tracker.advance() for _ in range(5)]
    assert outputs[0].requests == [("G05", 5 * COUNT), ("G07", 5 * COUNT)]
    assert not any(output.requests for output in outputs[1:])
    for satellite, sample in outputs[0].requests:
        searcher.push_request(satellite, sample, "trackers")
    run(searcher, range(10, 40))
    assert searcher._acquirer.calls[-1][0] == SLOT
    assert searcher._acquirer.calls[-1][2] == ("G07",)


def test_a_tracker_that_joins_takes_new_results_and_no_old_ones():
    tracker = engine()
    for effective in (SLOT, 20 * SLOT):  # what a late reader gets: found 9.5 s ago, and just now
        tracker.push_result(result(effective=effective))
    tracker.push_result(result("G07", effective=SLOT))
    tracker.acquisition_valid(30 * SLOT, 500)  # most were found before this process was there
    tracker.join(20 * SLOT + 5 * COUNT, RATE)
    for index in range(505, 560):
        tracker.push_block(block(index))
        assert tracker.advance() is not None
    assert tracker.counters["late_results"] == 1
    assert tracker.channels["G05"].mode != TrackingMode.IDLE
    assert tracker.channels["G07"].mode == TrackingMode.IDLE
