"""The graph at the pace of the clock: same bytes, and deadlines that let it go on."""

import contextlib
import os
import signal
import time
from dataclasses import replace

import graph_runs
import numpy as np
import pytest
from graph_runs import RATE, assistance, decode

from deepseis_bringup.graph import build_graph
from deepseis_bringup.runs import RunOptions, Selection, graph_config
from deepseis_bringup.supervisor import Supervisor, own_domain, running
from deepseis_bringup.watch import GraphWatch
from deepseis_core.types import TrackingFlag
from deepseis_frontend.if_open import open_source

pytestmark = [pytest.mark.launch, pytest.mark.timeout(60)]

LENGTH, PAUSE = 6.0, 0.5
MISSES = ("forced", "late", "aid_missed", "late_results")


@pytest.fixture(scope="module")
def sky(tmp_path_factory):
    """Nine satellites: with assistance a fix after 1.4 s."""
    place = tmp_path_factory.mktemp("sky")
    return graph_runs.recording(place, LENGTH, elevation_mask_deg=10.0)


def misses(run):
    """Counters of what was not waited for, at the end."""
    last = [statuses[-1][2] for statuses in run.statuses().values()]
    return {name: int(v[name]) for v in last for name in MISSES if int(v.get(name, 0))}


def test_in_real_time_the_bytes_are_those_of_lockstep(sky, tmp_path):
    known = assistance(sky)
    runs = {
        mode: graph_runs.run(
            sky.if_path, tmp_path / mode, sky.satellites, mode=mode, parameters=known
        )
        for mode in ("lockstep", "realtime")
    }
    live, replayed = runs["realtime"], runs["lockstep"]
    # At the clock's pace: an unpaced run takes a second. The watch may see its first block late.
    assert 0.9 * LENGTH <= live.figures["graph_time_s"] < 2 * LENGTH
    one, other = (without_latencies(run.payloads()) for run in (live, replayed))
    assert one["/if/samples"] == other["/if/samples"]
    assert len(other["/gnss/observations"]) > 150
    assert misses(replayed) == {}
    differing = [topic for topic in other if one.get(topic) != other[topic]]
    # Where a busy machine missed a deadline, that is counted; otherwise nothing differs.
    assert not differing or misses(live), differing


def without_latencies(payloads):
    """All messages but those of real time only: how long something took, and room on the disk."""
    others = b" latency\0", b"deepseis: recorder\0"
    kept = [d for d in payloads["/diagnostics"] if not any(name in d for name in others)]
    return {**payloads, "/diagnostics": kept}


def run_with_a_pause(victim, at, recording, folder, satellites, **options):
    """Run in realtime until 2 s after the victim has stood still for half a second."""
    selection = Selection(str(recording.if_path), length_s=at + 2.0)
    parameters = assistance(recording) | options.pop("parameters", {})
    given = RunOptions(
        mode="realtime",
        satellites=satellites,
        parameters=parameters,
        record_if=False,
        **options,
    )
    config = graph_config(selection, open_source(selection), folder, given)
    specs = build_graph(replace(config, watched=True))
    with own_domain() as environment:
        nodes = Supervisor(specs, folder, environment=environment)
        with running(nodes), GraphWatch(environment) as watch:
            paused = False

            def poll():
                nonlocal paused
                if watch.poll() > at * RATE and not paused:
                    paused = True
                    pause(nodes.processes[victim].pid)

            nodes.wait(poll=poll, timeout=40)
    assert set(nodes.statuses().values()) == {0}
    return graph_runs.Run(folder, {})


def pause(pid):
    os.kill(pid, signal.SIGSTOP)
    try:
        time.sleep(PAUSE)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGCONT)


def observed(run):
    """Satellites and tow [ns] of every epoch."""
    data = run.payloads()["/gnss/observations"]
    messages = [decode("deepseis_msgs/msg/Observations", item) for item in data]
    # The last integrations end before the samples do, each satellite's somewhere else.
    return [(m.tow_ns, list(m.satellites)) for m in messages][:-2]


def test_when_pvt_stands_still_it_catches_up_and_nothing_is_missing(sky, tmp_path):
    run = run_with_a_pause("pvt", 4.0, sky, tmp_path, sky.satellites)
    epochs = observed(run)
    steps = np.diff([tow_ns for tow_ns, _ in epochs])
    assert set(steps.tolist()) == {20_000_000}
    assert epochs[-1][1] == list(sky.satellites)
    assert misses(run) == {}


def test_when_one_tracker_stands_still_the_others_go_on_and_it_is_counted(recording, tmp_path):
    chosen = recording.satellites[:5]
    victim = chosen[2]
    run = run_with_a_pause(
        f"trackers_{victim.lower()}", 9.0, recording, tmp_path, chosen, one_process=False
    )
    epochs = observed(run)
    steps = np.diff([tow_ns for tow_ns, _ in epochs])
    assert set(steps.tolist()) == {20_000_000}
    missing = [tow_ns for tow_ns, names in epochs if victim not in names]
    others = [set(chosen) - {victim} <= set(names) for _, names in epochs]
    assert all(others)
    # Forced after the deadline of 0.2 s, which comes anew after each step forward.
    assert 0.1 < len(missing) * 0.02 < PAUSE + 0.5
    levels = [(level, values) for level, _, values in run.statuses()["pvt"]]
    assert int(levels[-1][1]["forced"]) >= len(missing)
    assert levels[-1][0] == 1  # a warning
    assert victim in epochs[-1][1]


def test_when_the_aiding_stands_still_the_loops_go_on_without_it_and_say_so(sky, tmp_path):
    truth = {"truth_file": str(sky.truth_path), "nav_file": str(sky.nav_path)}
    run = run_with_a_pause(
        "truth_aiding",
        4.0,
        sky,
        tmp_path,
        sky.satellites,
        aiding="truth",
        parameters={"truth_aiding": truth},
    )
    level, _, values = run.statuses()["trackers"][-1]
    assert level == 1
    assert 10 <= int(values["aid_missed"]) <= 60  # blocks
    for name in sky.satellites:
        batches = [
            decode("deepseis_msgs/msg/TrackingEpochs", data)
            for data in run.payloads()[f"/tracking/{name}/epochs"]
        ]
        start = np.concatenate([b.sample_index for b in batches]) / RATE
        flags = np.concatenate([b.flags for b in batches])
        aided = np.isfinite(np.concatenate([b.aid_doppler_hz for b in batches]))
        missed = start[flags & TrackingFlag.AID_MISSED != 0]
        # Stopped within some tenths of a second after 4 s.
        assert missed.size > 0
        assert missed.min() > 3.9
        assert missed.max() < 5.75  # it has to agree for 0.25 s first
        assert aided[(start > 2.0) & (start < 3.9)].all()
        assert not aided[start > 3.9].all()
        assert aided[start > 5.8].all()
        assert (flags[start > 2.0] & TrackingFlag.PHASE_LOCK).all()
