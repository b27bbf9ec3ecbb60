"""A station as a user runs it: Ctrl-C, a recording from aside, a namesake, the source's end."""

import json
import os
import signal
import subprocess
import time

import graph_runs
import pytest
from domain_coordinator import domain_id
from graph_runs import PROJECT, command
from sockets import family, internet_addresses

from deepseis_bringup.bags.info import bag_info

pytestmark = [pytest.mark.launch, pytest.mark.timeout(120)]

EPOCHS = "deepseis_msgs/msg/TrackingEpochs"


@pytest.fixture
def domain(monkeypatch):
    with domain_id() as number:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(number))
        yield number


@pytest.fixture
def configure(recording, satellites, tmp_path):
    def write(**values):
        source = {"file": str(recording.if_path), **values.pop("source", {})}
        given = {"station": "DSEI", "source": source, "satellites": list(satellites), **values}
        path = tmp_path / "station.yaml"
        path.write_text(json.dumps(given))  # which is YAML too
        return path

    return write


def start(config, folder):
    return subprocess.Popen(
        [str(PROJECT / "deepseis"), "station", "--config", str(config), "-o", str(folder)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=PROJECT,
        start_new_session=True,
    )


def wait_for_samples(process, bag, size):
    deadline = time.monotonic() + 40.0
    while time.monotonic() < deadline and process.poll() is None:
        if sum(path.stat().st_size for path in bag.glob("*.mcap")) > size:
            return
        time.sleep(0.1)
    process.kill()
    pytest.fail(f"nothing recorded: {process.communicate()}")


def last_block(payload):
    return graph_runs.decode("deepseis_msgs/msg/IfBlock", payload).sample_index


def test_ctrl_c_ends_a_station_with_everything_worked_through(domain, configure, tmp_path):
    folder = tmp_path / "run"
    process = start(configure(source={"pace": 0.4}), folder)  # lasts 70 s
    try:
        wait_for_samples(process, folder / "bag", 2e6)
        reached = internet_addresses(family(process.pid))
        aside = command("record", "--station", "DSEI", "--duration", "4", "-o", tmp_path / "aside")
        namesake = command("station", "--config", configure(), "-o", tmp_path / "second")
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=40)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
    assert process.returncode == 0, err
    assert reached == {"127.0.0.1"}
    assert out.splitlines()[-1] == str(folder)
    assert err.splitlines()[0] == f"recording to {folder / 'bag'}"
    summary = json.loads((folder / "summary.json").read_text())
    assert (summary["ended_by"], summary["station"]) == ("interrupted", "DSEI")

    recorded = graph_runs.payloads(folder / "bag")
    assert bag_info(folder / "bag").is_whole
    assert all(name.startswith("/DSEI/") for name in recorded if name != "/diagnostics")
    end = last_block(recorded["/DSEI/if/samples"][-1])
    tracked = [
        graph_runs.decode(EPOCHS, data[-1]).block_sample_index
        for name, data in recorded.items()
        if name.endswith("/epochs") and len(data) > 100
    ]
    assert len(tracked) >= 5
    assert set(tracked) == {end}

    assert aside.returncode == 0, aside.stderr
    others = graph_runs.payloads(tmp_path / "aside" / "bag")
    samples = others["/DSEI/if/samples"]
    assert samples, (aside.stderr, {name: len(data) for name, data in others.items()})
    first = recorded["/DSEI/if/samples"].index(samples[0])
    assert samples == recorded["/DSEI/if/samples"][first : first + len(samples)]

    assert namesake.returncode == 2
    assert f"station /DSEI: runs already in domain {domain}" in namesake.stderr
    assert not (tmp_path / "second").exists()


def test_a_station_in_lockstep_runs_to_the_end_and_replays_to_the_same_bytes(
    domain, configure, tmp_path
):
    config = configure(
        mode="lockstep",
        source={"length_s": 6.0},
        parameters={"tracker": {"pll_bandwidth_hz": 10.0}},
    )
    done = command("station", "--config", config, "-o", tmp_path / "run")
    assert done.returncode == 0, done.stderr
    assert "ended_by = end of the source" in done.stdout
    again = command("replay", tmp_path / "run", "-o", tmp_path / "again")
    assert again.returncode == 0, again.stderr
    first = graph_runs.payloads(tmp_path / "run" / "bag")
    second = graph_runs.payloads(tmp_path / "again" / "bag")
    named = {name: data for name, data in first.items() if name != "/diagnostics"}
    assert len(named) >= 8
    for name, data in named.items():
        assert second[name.removeprefix("/DSEI")] == data, name


def test_nothing_to_record_is_said(domain, tmp_path):
    result = command("record", "-o", tmp_path / "run")
    assert result.returncode == 2
    line = result.stderr.strip()
    assert f"ROS domain {domain}: nobody publishes a DeepSeis topic there" in line
    assert not (tmp_path / "run").exists()


def test_a_parameter_that_no_node_knows_is_named(domain, configure, tmp_path):
    config = configure(parameters={"tracker": {"pll_bandwith_hz": 10.0}})
    result = command("station", "--config", config, "-o", tmp_path / "run")
    assert result.returncode == 2
    line = result.stderr.strip().splitlines()[-1]
    assert "unknown parameter pll_bandwith_hz" in line
    assert "pll_bandwidth_hz" in line
