"""The page's node: what a graph says is on the page, and a page that hangs holds up nobody."""

import json
import os
import signal
import socket
import subprocess
import threading
import time
import urllib.request
from contextlib import contextmanager

import graph_runs
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from launch.test_nodes import listener
from live_feed import SATELLITES, Feed

from deepseis_bringup.executables import executable
from deepseis_bringup.supervisor import own_domain
from deepseis_core.ros import codecs, diagnostics, qos
from deepseis_msgs.msg import Watermark

pytestmark = [pytest.mark.launch, pytest.mark.timeout(240)]


@contextmanager
def page(environment, *arguments):
    """Run the page's node; yields its process and a function that asks for its state."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    program = str(executable("deepseis_bringup", "web"))
    process = subprocess.Popen(
        [program, "--ros-args", "-p", f"port:={port}", *arguments],
        env={**os.environ, **environment},
        stderr=subprocess.PIPE,
        text=True,
    )

    def state():
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/state", timeout=5) as answer:
                return json.load(answer)
        except OSError:
            assert process.poll() is None, process.stderr.read()
            return {}

    try:
        yield process, state
    finally:
        process.send_signal(signal.SIGCONT)
        process.send_signal(signal.SIGINT)
        errors = process.communicate(timeout=30)[1]
    assert process.returncode == 0, errors


def wait_for(condition, seconds=60.0):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


class OnTopics:
    """Takes what a model takes, and says it on the station's topics."""

    def __init__(self, node):
        self.node, self.publishers = node, {}

    def say(self, topic, codec, profile, value, utc_ns=0):
        publisher = self.publisher(topic, codec.msg_type, profile)
        publisher.publish(codec.encode(value, utc_ns))

    def publisher(self, topic, kind, profile):
        if topic not in self.publishers:
            name = topic if topic.startswith("/") else f"/DSEI/{topic}"
            self.publishers[topic] = self.node.create_publisher(kind, name, profile)
        return self.publishers[topic]

    def take_source(self, valid_through, _sent_ns):
        msg = Watermark(node="if_source", valid_through=valid_through)
        self.publisher("flow/if_source", Watermark, qos.STREAM_LATCHED).publish(msg)

    def take_station(self, value):
        self.say("station", codecs.STATION, qos.LATCHED, value)

    def take_displacement(self, value, _sent_ns):
        self.say("seismo/displacement", codecs.DISPLACEMENT, qos.STREAM, value)

    def take_solution(self, value):
        self.say("ins/solution", codecs.INS_SOLUTION, qos.STREAM, value)

    def take_pvt(self, value):
        self.say("gnss/pvt", codecs.PVT, qos.STREAM, value)

    def take_observations(self, value):
        self.say("gnss/observations", codecs.OBSERVATIONS, qos.STREAM, value)

    def take_tracking(self, value):
        topic = f"tracking/{value.satellite}/epochs"
        self.say(topic, codecs.TRACKING_EPOCHS, qos.STREAM, value)

    def take_motion_state(self, value, utc_ns):
        self.say("motion/state", codecs.MOTION_STATE, qos.LATCHED, value, utc_ns)

    def take_event(self, value, utc_ns):
        self.say("seismo/event", codecs.SEISMIC_EVENT, qos.LATCHED, value, utc_ns)

    def take_diagnostic(self, name, level, text, values):
        said = self.publisher("/diagnostics", DiagnosticArray, qos.STREAM)
        for station, who in (("/DSEI", name), ("/KOBE", "of_another_station")):
            said.publish(diagnostics.encoded(who, bytes([level]), text, values, 0, station))


def test_what_a_graph_says_is_on_the_page():
    with (
        own_domain() as environment,
        listener(environment) as (node, _until),
        page(environment, "-r", "__ns:=/DSEI") as (_, state),
    ):
        feed = Feed(OnTopics(node), quake_s=0.5)

        def told():
            feed.advance(0.2)
            time.sleep(0.1)
            found = state()
            kinds = ("events", "satellites", "motion", "filter", "diagnostics", "sigmas", "pvt")
            wanted = all(found.get(kind) for kind in kinds) and feed.seconds > 1.5
            return wanted and all(row.get("cn0_dbhz") for row in found["satellites"])

        wait_for(told)
        found = state()
    assert found["station"]["name"] == "DSEI"
    assert [row["name"] for row in found["satellites"]] == sorted(SATELLITES)
    assert found["satellites"][0]["aided"]
    assert found["events"][-1]["pga"] == 19.6
    assert found["filter"]["accepted"] > 0
    assert found["sigmas"]["rate_hz"] == 200.0
    assert found["motion"]["state"] == "moving"
    names = {item["name"] for item in found["diagnostics"]}
    assert names >= {"fusion", "pvt"}
    assert "of_another_station" not in names


@pytest.mark.slow
def test_a_page_that_hangs_changes_and_holds_up_nothing(
    recording, satellites, recorded, tmp_path, monkeypatch
):
    with own_domain() as environment, page(environment) as (process, state):
        for name, value in environment.items():
            monkeypatch.setenv(name, value)
        wait_for(lambda: "silent_s" in state())
        joined = threading.Event()

        def hang():
            wait_for(lambda: state()["satellites"])
            process.send_signal(signal.SIGSTOP)
            joined.set()

        thread = threading.Thread(target=hang, daemon=True)
        thread.start()
        run = graph_runs.run(recording.if_path, tmp_path / "run", satellites)
        assert joined.is_set(), "the run was over before the page had joined"
        process.send_signal(signal.SIGCONT)
    before, after = recorded.payloads(), run.payloads()
    assert before.keys() == after.keys()
    for topic in before:
        assert before[topic] == after[topic], topic
