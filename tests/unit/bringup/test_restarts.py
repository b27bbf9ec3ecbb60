"""The restart of nodes: the policy by a clock of its own, the supervisor on small processes."""

import stat
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from deepseis_bringup import executables, supervisor
from deepseis_bringup.graph import NodeSpec
from deepseis_bringup.restarts import RestartConfig, Restarts, State
from deepseis_bringup.silence import Silence
from deepseis_bringup.station import end_silence
from deepseis_bringup.supervisor import NodeFailureError, Supervisor
from deepseis_core.errors import InputError

KILLED = "was killed by signal 9"


class Clock:
    now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


def test_the_first_restart_comes_at_once_and_later_ones_wait_longer(clock):
    restarts = Restarts(RestartConfig(limit=5, backoff_s=(0.0, 0.5, 2.0)), clock=clock)
    waited = []
    for _ in range(5):
        assert restarts.died("fusion", KILLED)
        begin = clock.now
        while not restarts.due():
            clock.now += 0.25
        waited.append(clock.now - begin)
    assert waited == [0.0, 0.5, 2.0, 2.0, 2.0]
    assert (restarts.count, restarts.fates["fusion"].restarts) == (5, 5)


def test_after_the_limit_a_death_is_final(clock):
    restarts = Restarts(RestartConfig(limit=2, backoff_s=(0.0,)), clock=clock)
    assert [restarts.died("pvt", KILLED) for _ in range(3)] == [True, True, False]
    assert restarts.died("fusion", KILLED)  # each node has its own limit


def test_a_node_that_lived_long_enough_may_die_again(clock):
    restarts = Restarts(RestartConfig(limit=1, window_s=60.0), clock=clock)
    assert restarts.died("pvt", KILLED)
    clock.now += 59.0
    assert not restarts.died("pvt", KILLED)
    clock.now += 2.0
    assert restarts.died("pvt", KILLED)


@pytest.mark.parametrize("name", ["if_source", "recorder"])
def test_without_source_or_recorder_there_is_no_run(clock, name):
    assert not Restarts(clock=clock).died(name, KILLED)


def test_it_says_who_is_missing(clock):
    restarts = Restarts(RestartConfig(backoff_s=(0.0,)), clock=clock)
    assert restarts.text() == "all nodes run"
    restarts.died("fusion", KILLED)
    assert restarts.text() == "fusion waits to be started again: it was killed by signal 9"
    assert restarts.waits("fusion")
    assert restarts.due() == ["fusion"]
    assert restarts.due() == []
    assert (restarts.missing, restarts.fates["fusion"].state) == (["fusion"], State.JOINING)
    clock.now += 1.25
    restarts.joined("fusion")
    assert (restarts.missing, restarts.count) == ([], 1)
    assert restarts.fates["fusion"].away_s == 1.25


# The supervisor: processes are small scripts that read their parameters.

SOURCE = """
import pathlib, time
lives, until = pathlib.Path({here!r}) / "lives", time.monotonic() + 30.0
while time.monotonic() < until:
    if lives.exists() and len(lives.read_text()) > {lives}:
        break
    time.sleep(0.02)
"""
NODE = """
import pathlib, signal, sys, time
here = pathlib.Path({here!r})
lives = here / "lives"
lives.write_text(lives.read_text() + "+" if lives.exists() else "+")
given = sys.argv[sys.argv.index("--params-file") + 1]
(here / "given").write_text(pathlib.Path(given).read_text())
print("born", flush=True)
if len(lives.read_text()) <= {deaths}:
    sys.exit({status})
signal.signal(signal.SIGINT, lambda *_: sys.exit(0))
time.sleep(60)
"""


def script(path, text):
    path.write_text(f"#!{sys.executable}\n{text}")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


@pytest.fixture
def supervise(tmp_path, monkeypatch):
    def make(*, deaths, status=1, restarts=None):
        scripts = {
            "if_source": script(
                tmp_path / "if_source", SOURCE.format(here=str(tmp_path), lives=deaths)
            ),
            "fusion": script(
                tmp_path / "fusion",
                NODE.format(here=str(tmp_path), deaths=deaths, status=status),
            ),
        }
        monkeypatch.setattr(executables, "executable", lambda _package, name: scripts[name])
        specs = [NodeSpec(n, "p", n, n, (), (), n, {"mode": "realtime"}) for n in scripts]
        return Supervisor(specs, tmp_path / "run", restarts=restarts)

    return make


def lives(tmp_path):
    return len(Path(tmp_path / "lives").read_text())


def test_a_node_that_dies_in_real_time_is_started_again_to_join(supervise, tmp_path):
    restarts = Restarts(RestartConfig(backoff_s=(0.0, 0.1)))
    nodes = supervise(deaths=2, restarts=restarts)
    nodes.start()
    nodes.wait(timeout=40)
    nodes.stop()
    assert (lives(tmp_path), restarts.count) == (3, 2)
    assert "rejoin: true" in (tmp_path / "given").read_text()
    assert nodes.statuses() == {"if_source": 0, "fusion": 0}
    assert nodes.log_of("fusion").read_text().count("born") == 3  # no life's words are lost


def test_a_node_that_ends_well_before_the_source_is_missed_too(supervise, tmp_path):
    nodes = supervise(deaths=1, status=0, restarts=Restarts())
    nodes.start()
    nodes.wait(timeout=40)
    nodes.stop()
    assert lives(tmp_path) == 2


def test_after_too_many_deaths_the_graph_is_stopped_and_the_node_named(supervise, tmp_path):
    nodes = supervise(deaths=99, restarts=Restarts(RestartConfig(limit=2, backoff_s=(0.0,))))
    nodes.start()
    try:
        with pytest.raises(NodeFailureError, match="node fusion: ended with status 1"):
            nodes.wait(timeout=40)
    finally:
        nodes.end(["fusion"])
        nodes.processes["if_source"].kill()
        nodes.stop()
    assert lives(tmp_path) == 3


def test_bad_input_is_no_accident_and_not_tried_again(supervise, tmp_path):
    nodes = supervise(deaths=99, status=2, restarts=Restarts())
    nodes.start()
    try:
        with pytest.raises(InputError):
            nodes.wait(timeout=40)
    finally:
        nodes.processes["if_source"].kill()
        nodes.stop()
    assert lives(tmp_path) == 1


def test_in_lockstep_a_death_ends_the_run(supervise, tmp_path):
    nodes = supervise(deaths=99)
    nodes.start()
    try:
        with pytest.raises(NodeFailureError, match="fusion"):
            nodes.wait(timeout=40)
    finally:
        nodes.processes["if_source"].kill()
        nodes.stop()
    assert lives(tmp_path) == 1


DEAF = """
import faulthandler, signal, time
faulthandler.register(signal.SIGQUIT)
signal.signal(signal.SIGINT, signal.SIG_IGN)
def waits_for_ever():
    print("born", flush=True)
    time.sleep(60)
waits_for_ever()
"""


def test_a_node_that_does_not_end_is_killed_and_its_log_tells_where_it_stood(
    supervise, tmp_path, monkeypatch
):
    monkeypatch.setattr(supervisor, "STOP_SECONDS", 1.0)
    nodes = supervise(deaths=0)
    script(tmp_path / "fusion", DEAF)
    (tmp_path / "lives").write_text("+")
    nodes.start()
    nodes.wait(timeout=40)
    while "born" not in nodes.last_line("fusion"):
        time.sleep(0.02)
    nodes.stop()
    with pytest.raises(NodeFailureError, match="node fusion: did not end within 1 s: killed"):
        nodes.raise_failure()
    assert "waits_for_ever" in nodes.log_of("fusion").read_text()


def test_a_node_that_says_nothing_while_the_source_goes_on_is_started_again(supervise, tmp_path):
    restarts = Restarts(RestartConfig(backoff_s=(0.0,)))
    nodes = supervise(deaths=2, restarts=restarts)
    (tmp_path / "lives").write_text("++")  # neither this life ends by itself nor the next
    script(tmp_path / "if_source", SOURCE.format(here=str(tmp_path), lives=3))
    told = []
    watch = SimpleNamespace(silence=Silence(limit_s=20.0), utc_ns=0, say=told.append)
    watch.silence.hear("fusion", 100.0)
    nodes.start()
    while "born" not in nodes.last_line("fusion"):
        time.sleep(0.02)
    for second in range(100, 121):
        watch.utc_ns = second * 1_000_000_000
        end_silence(nodes, watch)
        nodes.tend("if_source")
    assert (told, restarts.count) == ([], 0)
    watch.utc_ns += 1_000_000_000
    end_silence(nodes, watch)
    nodes.wait(timeout=40)
    nodes.stop()
    assert told == [
        f"fusion: said nothing for 20 s and was killed; {nodes.log_of('fusion')} may have "
        "where it stood"
    ]
    assert restarts.count == 1
    assert restarts.fates["fusion"].reason == "said nothing for 20 s and was killed"
    assert nodes.statuses() == {"if_source": 0, "fusion": 0}


def test_nodes_behind_one_that_stands_still_are_given_time():
    silence = Silence(limit_s=20.0)
    for name in ("trackers", "pvt"):
        silence.hear(name, 0.0)
    assert silence.broken(["trackers", "pvt"], 21.0) == "trackers"
    assert silence.broken(["trackers", "pvt"], 40.0) is None  # not heard of again: it begins
    assert silence.broken(["trackers", "pvt"], 42.0) == "pvt"


CULPRIT = """
import sys, time
time.sleep(1.5)
print("if_source: bag.mcap: is damaged at byte 7", flush=True)
sys.exit(2)
"""
FOLLOWER = """
import sys
print("fusion: if_source gave up: bag.mcap: is damaged at byte 7", flush=True)
sys.exit(1)
"""


def test_who_gave_up_is_named_also_if_it_ends_after_those_that_it_told(supervise, tmp_path):
    nodes = supervise(deaths=0)
    script(tmp_path / "if_source", CULPRIT)
    script(tmp_path / "fusion", FOLLOWER)
    nodes.start()
    with pytest.raises(InputError, match=r"bag\.mcap: is damaged at byte 7") as caught:
        nodes.wait(timeout=40)
    assert not isinstance(caught.value, NodeFailureError)
