"""Same input, same bytes: on a loaded machine, in other processes, in one process, replayed."""

from collections import defaultdict

import graph_runs
import pytest
from graph_runs import ABSENT, DURATION, RATE, busy_machine

from deepseis_bringup import runs
from deepseis_bringup.graph import GraphConfig
from deepseis_bringup.offline import OfflineChain, encode

pytestmark = [pytest.mark.launch, pytest.mark.timeout(60)]

SEPARATE = "/diagnostics"
"""With one process for each satellite, each has its own status: compared node by node."""


def without(payloads, *topics):
    return {topic: messages for topic, messages in payloads.items() if topic not in topics}


def differing(one, other):
    """Topics whose messages are not the same, byte for byte and in the same order."""
    return sorted(t for t in one.keys() | other.keys() if one.get(t) != other.get(t))


def test_the_run_recorded_every_topic(recorded, recording):
    topics = recorded.payloads()
    assert {f"/tracking/{name}/epochs" for name in recording.satellites} < topics.keys()
    assert len(topics["/if/samples"]) == DURATION * 50
    # Again when the ionosphere's parameters have come.
    assert len(topics["/gnss/ephemeris"]) == 2 * len(recording.satellites)
    assert len(topics["/gnss/observations"]) > 300
    assert len(topics["/gnss/pvt"]) == len(topics["/gnss/fix"]) > 60
    assert len(topics["/gnss/time_reference"]) > 60
    assert len(topics["/acquisition/result"]) == len(recording.satellites) + 1


def test_on_a_loaded_machine_nothing_changes(recorded, recording, satellites, tmp_path):
    with busy_machine():
        loaded = graph_runs.run(recording.if_path, tmp_path, satellites)
    assert differing(recorded.payloads(), loaded.payloads()) == []
    assert recorded.rinex() == loaded.rinex()
    assert len(recorded.rinex()) == 2


def test_with_one_process_for_each_satellite_nothing_changes(
    recorded, recording, satellites, tmp_path
):
    separate = graph_runs.run(
        recording.if_path, tmp_path, satellites, one_process=False, record_if=False
    )
    together = without(recorded.payloads(), SEPARATE, "/if/samples")
    assert differing(together, without(separate.payloads(), SEPARATE)) == []
    assert recorded.rinex() == separate.rinex()
    one, many = recorded.statuses(), separate.statuses()
    for node in ("acquisition", "pvt", "if_source"):
        assert one[node] == many[node]
    assert many.keys() - one.keys() == {f"trackers_{name.lower()}" for name in satellites}


def test_the_chain_in_one_process_gives_the_same_bytes(recorded, recording, satellites):
    config = GraphConfig(
        source={"file": str(recording.if_path)}, sample_rate_hz=RATE, satellites=satellites
    )
    offline = defaultdict(list)
    for output in OfflineChain(config).run():
        offline["/" + output.topic].append(encode(output))
    assert differing(without(recorded.payloads(), SEPARATE), offline) == []


def test_a_replay_of_the_bag_gives_the_same_bytes(recorded, tmp_path):
    options = runs.RunOptions(timeout=50.0)
    summary = runs.replay(recorded.bag, tmp_path, options)
    again = graph_runs.Run(tmp_path, summary)
    assert differing(recorded.payloads(), again.payloads()) == []
    assert recorded.rinex() == again.rinex()
    assert summary["duration_s"] == DURATION


def test_a_satellite_that_is_not_there_is_searched_for_and_idle(recorded):
    epochs = recorded.payloads()[f"/tracking/{ABSENT}/epochs"]
    promises = [graph_runs.decode("deepseis_msgs/msg/TrackingEpochs", data) for data in epochs]
    assert all(not len(p.sample_index) and p.mode == 0 for p in promises)
    assert promises[-1].valid_through >= DURATION * RATE - 1
