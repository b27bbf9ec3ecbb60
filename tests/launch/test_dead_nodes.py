"""Nodes that are killed: the error names them, and the recording survives."""

import os
import signal
import subprocess
import time
from dataclasses import replace
from pathlib import Path

import graph_runs
import pytest
from graph_runs import DURATION, PROJECT, RATE, command

from deepseis_bringup.bags.info import bag_info
from deepseis_bringup.bags.recovery import recover_bag
from deepseis_bringup.graph import build_graph
from deepseis_bringup.runs import RunOptions, Selection, graph_config
from deepseis_bringup.supervisor import NodeFailureError, Supervisor, own_domain
from deepseis_bringup.watch import GraphWatch
from deepseis_core.mcap_scan import McapScan
from deepseis_frontend.if_bag import decode_if_block
from deepseis_frontend.if_open import open_source

pytestmark = [pytest.mark.launch, pytest.mark.timeout(60)]


def until(condition, seconds=30.0):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "did not happen in time"
        time.sleep(0.02)


def size(folder):
    return sum(path.stat().st_size for path in folder.glob("bag/*.mcap"))


def children(pid):
    """Processes of a process, with their command lines."""
    found = {}
    for task in Path(f"/proc/{pid}/task").iterdir():
        for child in map(int, (task / "children").read_text().split()):
            found[child] = Path(f"/proc/{child}/cmdline").read_bytes().replace(b"\0", b" ")
    return found


def graph(recording, folder, satellites, **options):
    selection = Selection(str(recording.if_path))
    given = RunOptions(satellites=tuple(satellites), **options)
    folder.mkdir(parents=True, exist_ok=True)
    config = graph_config(selection, open_source(selection), folder, given)
    return build_graph(replace(config, watched=True))


def test_a_tracker_killed_in_lockstep_ends_the_run_and_is_named(recorded, tmp_path):
    run = tmp_path / "run"
    arguments = [PROJECT / "deepseis", "replay", recorded.bag, "-o", run]
    with subprocess.Popen(
        arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        until(lambda: size(run) > 4_000_000)
        (victim,) = [pid for pid, line in children(process.pid).items() if b"tracker_con" in line]
        os.kill(victim, signal.SIGKILL)
        output, error = process.communicate(timeout=40)
    assert process.returncode not in (0, None)
    (line,) = error.strip().splitlines()
    assert "node trackers" in line
    assert "killed by signal 9" in line
    assert not output
    result = command("recover", run / "bag")
    assert result.returncode == 0, result.stderr
    info = bag_info(run / "bag")
    assert info.is_whole
    assert 0 < info.topics["/if/samples"].count < DURATION * 50


@pytest.mark.timeout(120)
def test_without_a_supervisor_the_source_names_the_dead_member(recording, satellites, tmp_path):
    specs = graph(recording, tmp_path, satellites, record=False)
    with own_domain() as environment:
        nodes = Supervisor(specs, tmp_path, environment=environment)
        try:
            nodes.start()
            with GraphWatch(environment) as watch:
                until(lambda: watch.poll() > RATE)
            nodes.processes["pvt"].kill()
            # DDS believes in a silent participant for its lease of 30 s.
            nodes.processes["if_source"].wait(timeout=70)
            nodes.processes["trackers"].wait(timeout=30)
        finally:
            nodes.stop()
    assert nodes.processes["if_source"].returncode == 1
    assert "pvt has died" in nodes.last_line("if_source")
    assert nodes.processes["trackers"].returncode == 1
    assert "pvt has died" in nodes.last_line("trackers")


def test_a_killed_recorder_loses_less_than_a_second(recording, satellites, tmp_path):
    specs = graph(recording, tmp_path, satellites, mode="realtime")
    with own_domain() as environment:
        nodes = Supervisor(specs, tmp_path, environment=environment)
        try:
            nodes.start()
            with GraphWatch(environment) as watch:
                until(lambda: watch.poll() > 3 * RATE)
                nodes.processes["recorder"].kill()
                played = watch.poll()
            with pytest.raises(NodeFailureError, match=r"node recorder: was killed by signal 9"):
                nodes.wait(timeout=20)
        finally:
            nodes.stop()
    (path,) = (tmp_path / "bag").glob("*.mcap")
    (before,) = recover_bag(tmp_path / "bag")
    assert not before.was_whole
    blocks = [
        decode_if_block(message.data).block
        for message in McapScan(path).messages(lambda channel: channel.topic == "/if/samples")
    ]
    assert [b.sample_index for b in blocks] == list(range(0, len(blocks) * 80_000, 80_000))
    assert played - 1.0 * RATE < blocks[-1].sample_index + 80_000
    recovered = graph_runs.payloads(tmp_path / "bag")
    assert len(recovered["/diagnostics"]) >= 4
