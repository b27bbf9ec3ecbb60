"""What the live page's frames say of a station's values."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from live_feed import SATELLITES, START, Feed

from deepseis_bringup.live.frames import LONGEST_S, FrameWriter
from deepseis_bringup.live.model import LiveModel
from deepseis_core.types import Lli, TrackingMode


class Clock:
    now = 100.0

    def __call__(self):
        self.now += 1e-3
        return self.now


@pytest.fixture
def model():
    return LiveModel(Clock())


def opened(frame):
    """Read a frame as the page does."""
    length = int.from_bytes(frame[:4], "little")
    header, at = json.loads(frame[4 : 4 + length]), 4 + length
    found = {}
    for block in header["blocks"]:
        assert at % 8 == 0
        n, columns = block["count"], block["columns"]
        times = np.frombuffer(frame, "<f8", n, at)
        values = np.frombuffer(frame, "<f4", n * columns, at + 8 * n).reshape(n, columns)
        at += 8 * n + 8 * -(-n * columns // 2)
        found[block["trace"], block["level"]] = (block, times, values)
    assert at == len(frame)
    return header, found


def test_frames_put_together_are_what_was_fed(model):
    feed, writer = Feed(model, quake_s=6.0), FrameWriter(model)
    parts = []
    for _ in range(70):
        feed.advance(0.1)
        _, blocks = opened(writer.next())
        parts.append(blocks["motion", 0])
    times = np.concatenate([part[1] for part in parts])
    values = np.concatenate([part[2] for part in parts])
    again = LiveModel(Clock())
    Feed(again, quake_s=6.0).advance(7.0)
    whole_times, whole_values = again.traces["motion"].rings[0].since(0)
    np.testing.assert_array_equal(times, whole_times)
    np.testing.assert_array_equal(values, whole_values)
    np.testing.assert_allclose(np.diff(times), 0.005, atol=1e-6)
    assert times[-1] == pytest.approx(7.0, abs=1e-6)
    assert parts[0][0]["fresh"]
    assert not any(block["fresh"] or block["lost"] for block, *_ in parts[1:])


def test_a_browser_that_comes_late_gets_what_is_kept(model):
    Feed(model).advance(0.02)
    model.traces["motion"].push(np.arange(5, 18_001) / 200, np.zeros((17_996, 9)), 1 / 200)
    header, blocks = opened(FrameWriter(model).next())
    assert [len(blocks["motion", level][1]) for level in range(3)] == [12_000, 900, 90]
    assert blocks["motion", 0][1][0] == pytest.approx(30.005)
    assert header["origin_ms"] == START.to_utc_ns() / 1e6


def test_a_slow_browser_gets_the_newest_samples_and_every_cell(model):
    feed, writer = Feed(model, quake_s=3.0), FrameWriter(model)
    feed.advance(1.0)
    writer.next()
    feed.advance(12.0)
    _, blocks = opened(writer.next())
    block, times, _ = blocks["motion", 0]
    assert len(times) == LONGEST_S * 200
    assert block["lost"] == 2400 - len(times)
    assert times[-1] == pytest.approx(13.0)
    _, cells, values = blocks["motion", 1]
    assert len(cells) == 120
    assert values.max() >= 19.6  # the peak, which was in a sample that was skipped
    assert writer.skipped > 0


def test_a_run_that_begins_anew_replaces_what_a_browser_has(model):
    writer = FrameWriter(model)
    Feed(model).advance(8.0)
    writer.next()
    Feed(model).advance(0.2)
    _, blocks = opened(writer.next())
    block, times, _ = blocks["motion", 0]
    assert (block["fresh"], len(times)) == (True, 40)


def test_the_state_tells_the_event_and_its_peaks(model):
    feed = Feed(model, quake_s=2.0)
    feed.advance(10.0)
    event = model.state()["events"][-1]
    assert not event["ended"]
    assert event["onset_ms"] == START.to_utc_ns() // 10**6 + 2000
    assert (event["pga"], event["pgv"], event["pgd"]) == (19.6, 0.62, 0.213)
    assert model.state()["motion"]["state"] == "moving"
    assert model.state()["motion"]["ratio"] == [2.0] * 6  # of standard deviations
    feed.advance(15.0)
    state = model.state()
    assert state["events"][-1]["ended"]
    assert state["motion"]["state"] == "static"
    assert state["motion"]["since_ms"] - START.to_utc_ns() // 10**6 == pytest.approx(
        22_000, abs=1001
    )


def test_the_state_tells_how_every_satellite_is_tracked(model):
    Feed(model).advance(1.0)
    rows = {row["name"]: row for row in model.state()["satellites"]}
    assert sorted(rows) == sorted(SATELLITES)
    first, last = rows[SATELLITES[0]], rows[SATELLITES[-1]]
    assert (first["mode"], first["aided"], first["aid_age_ms"]) == ("aided", True, 0.0)
    assert (last["mode"], last["aided"], last["aid_age_ms"]) == ("own loop", False, None)
    assert first["phase_lock"]
    assert first["used"]
    assert first["elevation_deg"] == pytest.approx(np.degrees(0.2), abs=0.05)


def test_units_of_the_filter(model):
    Feed(model).advance(1.0)
    told = model.state()["filter"]
    assert told["name"] == "loose"
    assert told["attitude_sd"] == pytest.approx([np.degrees(2e-4)] * 3, rel=1e-3)
    assert told["gyro_bias_deg_h"] == pytest.approx([2e-7 * 206264.8] * 3, rel=1e-2)
    assert told["accelerometer_bias_ug"] == pytest.approx([4e-4 / 9.80665e-6] * 3, rel=1e-4)
    assert told["accepted"] == 10


def test_innovations_stand_at_the_time_of_their_epoch(model):
    Feed(model).advance(2.0)
    times, values = model.traces["innovation"].rings[0].since(0)
    np.testing.assert_allclose(times, 0.085 + 0.1 * np.arange(20), atol=1e-6)
    assert np.isfinite(values[:, :6]).all()
    assert np.isnan(values[:, 6:]).all()  # a loose filter has no ranges


def test_of_a_tight_filters_satellites_the_greatest_innovation_is_shown(model):
    feed = Feed(model)
    feed.advance(0.04)
    innovation = np.full(70, np.nan, np.float32)
    innovation[[6, 9, 37, 40]] = [1.0, -4.0, 0.5, 3.0]  # ranges of G01, G04, G32; a rate of G03
    kept = {}
    model.take_solution = lambda value: kept.setdefault("solution", value)
    feed.block()
    index = kept["solution"].sample_index[-1:]
    del model.take_solution
    model.take_solution(
        replace(
            kept["solution"],
            innovation_sample_index=index,
            innovation=innovation,
            innovation_sd=np.full(70, 2.0, np.float32),
            innovation_size=70,
            innovation_accepted=np.ones(1, bool),
        )
    )
    values = model.traces["innovation"].rings[0].since(0)[1]
    assert values[-1, 6:].tolist() == [-2.0, 1.5]


def test_latency_is_from_the_sources_sending_to_the_motions(model):
    Feed(model).advance(3.0)
    _, values = model.traces["latency"].rings[0].since(0)
    assert len(values) > 100
    np.testing.assert_allclose(values, 60.0, atol=0.01)


def test_silence_is_told(model):
    Feed(model).advance(1.0)
    model.clock.now += 5.0
    state = model.state()
    assert state["silent_s"]["motion"] == pytest.approx(5.0, abs=0.2)
    assert all(row["silent_s"] >= 5.0 for row in state["satellites"])
    assert state["diagnostics"][0]["silent_s"] >= 5.0


def test_slips_are_losses_of_a_phase_that_was_there(model):
    """Marks of one satellite: it begins, its polarity is known, it slips, it is lost and back."""
    feed = Feed(model)
    feed.loops(100)
    whole = model.satellites
    told = [Lli.SLIP | Lli.HALF_CYCLE, Lli.HALF_CYCLE, Lli.SLIP, 0, Lli.SLIP, 0]
    told += [Lli.SLIP | Lli.HALF_CYCLE, Lli.HALF_CYCLE, Lli.SLIP, 0]
    counts = []
    for lli in told:
        whole.take_observations(
            SimpleNamespace(satellites=("G30",), lli=np.array([lli]), lock_time=np.zeros(1))
        )
        counts.append(whole._seen["G30"].slips)
    assert counts == [0, 0, 0, 0, 1, 1, 2, 2, 2, 2]


def test_after_the_end_the_last_picture_stays_as_it_was(model):
    feed = Feed(model)
    feed.advance(1.0)
    model.take_source(feed.step * 80_000, 0, ended=True)
    before = model.state()
    model.clock.now += 600.0
    assert model.state() == before
    assert before["satellites"]
    assert before["silent_s"]["motion"] < 1.0


def test_an_empty_model_has_a_state_too(model):
    header, blocks = opened(FrameWriter(model).next())
    assert header["state"]["events"] == []
    assert not blocks


def test_an_idle_satellite_that_no_position_uses_is_not_listed(model):
    feed = Feed(model)
    feed.loops(100)
    before = model.satellites.rows(0.0)
    assert len(before) == len(SATELLITES)
    epochs = model.satellites._seen["G03"].epochs
    model.take_tracking(replace(epochs, mode=int(TrackingMode.IDLE), sample_index=np.zeros(0)))
    assert [row["name"] for row in model.satellites.rows(0.0)] == sorted(SATELLITES[1:])
