"""Samples that are missing: reported, flagged, tracked again, never guessed."""

from collections import defaultdict
from itertools import pairwise

import graph_runs
import numpy as np
import pytest
from graph_runs import RATE, assistance, decode

from deepseis_bringup.bags.mcap_recording import BagWriter
from deepseis_bringup.graph import GraphConfig
from deepseis_bringup.offline import OfflineChain, encode
from deepseis_bringup.runs import Selection
from deepseis_core.ros.codecs import IF_BLOCK
from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import Lli, TrackingFlag
from deepseis_frontend.if_file import IfFile
from deepseis_frontend.if_open import open_source

pytestmark = [pytest.mark.launch, pytest.mark.timeout(60)]

LENGTH = 9.0
FIRST, END = 195 * 80_000, 209 * 80_000
"""Missing samples: 14 whole blocks, from 3.9 s to 4.18 s."""


@pytest.fixture(scope="module")
def sky(tmp_path_factory):
    """Nine satellites: with assistance a fix after 1.4 s."""
    place = tmp_path_factory.mktemp("sky")
    return graph_runs.recording(place, LENGTH, elevation_mask_deg=10.0)


@pytest.fixture(scope="module")
def bag(sky, tmp_path_factory):
    folder = tmp_path_factory.mktemp("gap") / "bag"
    source = IfFile(sky.if_path)
    clock = SampleClock(source.start_utc_ns, source.sample_rate_hz)
    with BagWriter(folder) as writer:
        for block in source.blocks():
            if not FIRST <= block.sample_index < END:
                utc_ns = clock.utc_ns(block.sample_index)
                data = IF_BLOCK.encode(block, utc_ns)
                writer.write("/if/samples", "deepseis_msgs/msg/IfBlock", data, utc_ns, utc_ns)
    return folder


@pytest.fixture(scope="module")
def run(sky, bag, tmp_path_factory):
    return graph_runs.run(
        bag,
        tmp_path_factory.mktemp("run"),
        sky.satellites,
        one_process=False,
        parameters=assistance(sky),
    )


def messages(run, topic, type_name):
    return [decode(f"deepseis_msgs/msg/{type_name}", data) for data in run.payloads()[topic]]


def test_the_gap_is_reported(run):
    text = f"{END - FIRST} samples are missing before sample {END}"
    assert text in run.figures["input_remarks"]
    warnings = [item for item in run.statuses()["if_source"] if item[0] == 1]
    assert warnings
    assert all(text in item[1] and int(item[2]["gap_at_sample"]) == END for item in warnings)
    for name in run.statuses():
        if name.startswith("trackers"):
            level, _, values = run.statuses()[name][-1]
            assert (level, values["gaps"], values["lost"]) == (1, "1", "1")


def test_what_was_recorded_again_has_the_same_gap(run, bag):
    assert run.payloads()["/if/samples"] == graph_runs.payloads(bag)["/if/samples"]


def test_every_satellite_is_lost_asked_for_and_tracked_again(run, sky):
    requests = messages(run, "/acquisition/request", "AcquisitionRequest")
    assert [r.satellite for r in requests] == list(sky.satellites)
    assert {r.sample_index for r in requests} == {END + 80_000}
    for name in sky.satellites:
        batches = messages(run, f"/tracking/{name}/epochs", "TrackingEpochs")
        starts = np.concatenate([b.sample_index for b in batches])
        ends = starts + np.concatenate([b.sample_count for b in batches])
        flags = np.concatenate([b.flags for b in batches])
        # No integration touches a missing sample.
        assert not np.any((ends > FIRST) & (starts < END))
        first = np.flatnonzero(starts >= END)[0]
        assert flags[first] & TrackingFlag.GAP
        assert flags[first] & TrackingFlag.SLIP
        assert not np.any(flags[:first] & TrackingFlag.GAP)
        assert flags[-1] & TrackingFlag.PHASE_LOCK


def test_nothing_is_observed_in_the_gap_and_phases_slip_across_it(run, sky):
    epochs = messages(run, "/gnss/observations", "Observations")
    assert {b.tow_ns - a.tow_ns for a, b in pairwise(epochs)} == {20_000_000}
    for epoch in epochs:
        if FIRST <= epoch.sample_index < END:
            assert list(epoch.satellites) == []
    seen = defaultdict(list)
    for epoch in epochs:
        for name, lli in zip(epoch.satellites, epoch.lli, strict=True):
            seen[name].append((epoch.sample_index, lli))
    for name in sky.satellites:
        after = [lli for sample, lli in seen[name] if sample >= END]
        assert len(after) > 50
        assert after[0] & Lli.SLIP
        assert not any(lli & Lli.SLIP for lli in after[-25:])


def test_positions_come_back_near_the_truth(run, sky):
    truth = np.load(sky.truth_path)["antenna_ecef"][0]
    positions = messages(run, "/gnss/pvt", "Pvt")
    assert all(p.status == 0 for p in positions if FIRST <= p.sample_index < END)
    last = positions[-5:]
    assert all(p.status == 1 for p in last)
    errors = [np.linalg.norm(p.position_ecef - truth) for p in last]
    sigmas = [np.sqrt(np.trace(p.position_covariance_ecef.reshape(3, 3))) for p in last]
    assert max(errors) < 4 * max(sigmas)


def test_the_chain_in_one_process_gives_the_same_bytes(run, sky, bag):
    selection = Selection(str(bag))
    config = GraphConfig(
        source=selection.parameters(),
        sample_rate_hz=RATE,
        satellites=sky.satellites,
        parameters=assistance(sky),
    )
    assert open_source(selection).total_samples is None
    offline = defaultdict(list)
    for output in OfflineChain(config).run():
        offline["/" + output.topic].append(encode(output))
    recorded = run.payloads()
    del recorded["/diagnostics"]
    assert [t for t in recorded.keys() | offline if recorded.get(t) != offline.get(t)] == []
