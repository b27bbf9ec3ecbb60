"""The closed loop by the clock: lockstep bytes until a miss, within the filter's sigma after.

Replayed with its misses it gives its own bytes throughout.
"""

import contextlib
import os
import signal
import time
from collections import defaultdict
from dataclasses import replace

import graph_runs
import numpy as np
import pytest
from realtime_quake import BUSY, by_the_clock, make_scene, payloads_of

from deepseis_bringup.accept.scene import RATE_HZ, aided
from deepseis_bringup.bags.recorded_misses import recorded_misses
from deepseis_bringup.bags.recording_queue import stamp_of_cdr
from deepseis_bringup.graph import build_graph
from deepseis_bringup.graph_payloads import run_graph
from deepseis_bringup.supervisor import Supervisor, own_domain, running
from deepseis_bringup.watch import GraphWatch
from deepseis_core.ros import codecs
from deepseis_core.types import TrackingFlag
from deepseis_tracking.fallback import AGREED_S

pytestmark = [pytest.mark.launch, pytest.mark.slow, pytest.mark.timeout(400)]

PACE = 0.5 if BUSY else 1.5
STOP, LENGTH = 8.0, 11.0
BEGUN = 1.0
ALONE_SAMPLES = round((AGREED_S + 0.04) * RATE_HZ)
"""From a block without aiding to the last that a loop may work alone: two blocks at the ends."""
STOPPED_S = 0.3
PAUSES = {"fusion": STOP, "trackers": STOP + 1.0, "pvt": STOP + 1.7}
"""Who stands still, and from when on [s]."""
BLOCK_NS = 20_000_000


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return make_scene(tmp_path_factory.mktemp("scene"), LENGTH)


@pytest.fixture(scope="module")
def lockstep(scene, tmp_path_factory):
    return run_graph(scene.config(aided(8.0)), tmp_path_factory.mktemp("lockstep") / "run")


@pytest.fixture(scope="module")
def live(scene, tmp_path_factory):
    """The same by the clock; three processes stand still for 0.3 s each during the motion."""
    folder, config = tmp_path_factory.mktemp("live"), scene.config(aided(8.0))
    config = by_the_clock(config, folder, PACE, output_dir=str(folder))
    stopped = set()
    with own_domain() as environment:
        nodes = Supervisor(build_graph(config), folder, environment=environment)
        with running(nodes), GraphWatch(environment) as watch:

            def poll():
                now = watch.poll() / RATE_HZ
                for name, begin in PAUSES.items():
                    if now > begin and name not in stopped:
                        stopped.add(name)
                        pause(nodes.processes[name].pid)

            nodes.wait(poll=poll, timeout=120)
    run = graph_runs.Run(folder, {})
    return run, payloads_of(run)


@pytest.fixture(scope="module")
def replayed(scene, live, tmp_path_factory):
    """The live run again, in lockstep, waiting for no more than it did."""
    found = recorded_misses(live[0].bag)
    config = replace(scene.config(aided(8.0)), misses=found.by_member)
    return run_graph(config, tmp_path_factory.mktemp("replayed") / "run")


def pause(pid):
    os.kill(pid, signal.SIGSTOP)
    try:
        time.sleep(STOPPED_S)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGCONT)


def misses(run):
    """Runs of samples that each node went on without something: (node, what) to pairs."""
    found = defaultdict(list)
    for name, said in run.statuses().items():
        for _, _, values in said if name.endswith(" misses") else ():
            for what, runs in values.items():
                samples = [text.partition("@")[0] for text in runs.split()]
                pairs = [tuple(map(int, text.split("-"))) for text in samples]
                found[name.removesuffix(" misses"), what] += pairs
    return found


def test_every_miss_is_listed_by_its_samples(live):
    run, payloads = live
    listed = misses(run)
    blocks = set()
    for begin, end in listed["trackers", "aiding"]:
        blocks.update(range(begin, end + 1, 80_000))
    missed = STOPPED_S - 0.05  # the deadline passes first
    around = [b for b in blocks if STOP - 0.5 < b / RATE_HZ < STOP + 1.0]
    assert len(around) >= 0.5 * missed * PACE / 0.02
    level, _, values = run.statuses()["trackers"][-1]
    assert (level, int(values["aid_missed"])) == (1, len(blocks))
    # An integration says it itself: it ends in a block that is listed, or while the loop that
    # went on alone waits for the aiding to agree.
    alone = {b + late for b in blocks for late in range(0, ALONE_SAMPLES + 1, 80_000)}
    for topic, messages in payloads.items():
        for data in messages if topic.startswith("tracking/") else ():
            batch = codecs.TRACKING_EPOCHS.decode(data)[0]
            flagged = bool(np.any(batch.flags & TrackingFlag.AID_MISSED != 0))
            assert not flagged or batch.block_sample_index in alone, topic


def test_until_the_first_miss_the_bytes_are_those_of_lockstep(live, lockstep):
    run, payloads = live
    begins = [begin for runs in misses(run).values() for begin, _ in runs]
    # Before, pvt has nothing to say that the fusion could miss, if it does not wait for it.
    first = min(begin for begin in begins if begin / RATE_HZ > BEGUN)
    if not BUSY:
        assert first / RATE_HZ > STOP - 0.5
    start_ns = stamp_of_cdr(lockstep["imu/data_raw"][0]) - round(1e9 / 200)
    limit_ns = start_ns + round(first / RATE_HZ * 1e9) - BLOCK_NS
    compared = 0
    for topic, expected in lockstep.items():
        if topic == "diagnostics":
            continue
        one, other = (
            [data for data in messages if stamp_of_cdr(data) < limit_ns]
            for messages in (payloads.get(topic, []), expected)
        )
        assert one == other, topic
        compared += len(one)
    assert compared > 100


def test_a_replay_with_its_misses_gives_its_bytes(live, replayed, lockstep):
    run, payloads = live
    kinds = {(node, "pvt" if what.startswith("G") else what) for node, what in misses(run)}
    assert kinds >= {("trackers", "aiding"), ("fusion", "pvt"), ("pvt", "pvt")}
    topics = sorted(lockstep.keys() - {"diagnostics"})
    assert len(topics) > 15
    assert [t for t in topics if payloads.get(t) != replayed.get(t)] == []
    assert [t for t in topics if payloads.get(t) != lockstep.get(t)] != []


def test_the_samples_are_the_same_throughout(live, lockstep):
    assert live[1]["imu/data_raw"] == lockstep["imu/data_raw"]


def test_after_misses_it_stays_within_the_filter_s_own_sigma(live, lockstep):
    spans = [
        {span.valid_from: span for span in map(decode, messages["aiding/doppler"]) if span.valid}
        for messages in (live[1], lockstep)
    ]
    both = sorted(spans[0].keys() & spans[1].keys())
    assert len([b for b in both if b > STOP * RATE_HZ]) > 75
    for begin in both:
        one, other = spans[0][begin], spans[1][begin]
        assert one.satellites == other.satellites
        shape = len(one.satellites), one.knot_count
        apart = np.abs(one.carrier_doppler_hz - other.carrier_doppler_hz).reshape(shape)
        sigma = np.hypot(one.doppler_sd_hz, other.doppler_sd_hz)
        assert (apart.max(axis=1) <= 3.0 * sigma).all(), begin / RATE_HZ


def decode(data):
    return codecs.DOPPLER_AIDING.decode(data)[0]
