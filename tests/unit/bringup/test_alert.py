"""Alerts: delivered once each, repeated where they fail, never holding anybody up."""

import json
import sys
import threading
import time
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest

from deepseis_bringup.alert import WAITING, AlertConfig, Alerts, checked
from deepseis_core.errors import InputError

EVENT = {"event_id": "A-1", "ended": False, "peak_acceleration": 2.5}


def settled(alerts, done, limit=20.0):
    deadline = time.monotonic() + limit
    while not done() and time.monotonic() < deadline:
        time.sleep(0.01)
    assert done(), alerts.counters()


@pytest.fixture
def hook():
    """A server that answers as its list says, then 200."""

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self):
            body = self.rfile.read(int(self.headers["Content-Length"]))
            server.bodies.append(json.loads(body))
            answer = server.answers.pop(0) if server.answers else 200
            if answer == "slow":
                time.sleep(1.0)
                answer = 200
            self.send_response(answer)
            self.end_headers()

        def log_message(self, *_):
            pass

    server = HTTPServer(("127.0.0.1", 0), Handler)
    server.bodies, server.answers = [], []
    server.address = f"http://127.0.0.1:{server.server_port}/x"
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield server
    server.shutdown()
    server.server_close()


def test_a_command_gets_the_event_as_json_and_no_shell_sees_it(tmp_path):
    out = tmp_path / "told; touch no"
    code = "import sys; open(sys.argv[1], 'ab').write(sys.stdin.buffer.read())"
    config = AlertConfig(command=(sys.executable, "-I", "-S", "-c", code, str(out)))
    with Alerts(config, "kobe") as alerts:
        alerts.push(EVENT)
        alerts.push({**EVENT, "peak_acceleration": 3.0})  # it grows: known already
        alerts.push({**EVENT, "ended": True})
        settled(alerts, lambda: alerts.delivered == 2)
    first, last = [json.loads(line) for line in out.read_text().splitlines()]
    assert first == {"station": "kobe", **EVENT}
    assert last["ended"]
    assert not (tmp_path / "no").exists()


def test_a_webhook_is_tried_again_until_it_answers(hook):
    hook.answers[:] = [500, 404]
    with Alerts(AlertConfig(webhook=hook.address), "a", pause=lambda _s: False) as alerts:
        alerts.push(EVENT)
        settled(alerts, lambda: alerts.delivered == 1)
    assert len(hook.bodies) == 3
    assert alerts.counters()["repeated"] == 2
    assert "404" in alerts.last_error


def test_what_never_answers_is_given_up_and_counted():
    config = AlertConfig(webhook="http://127.0.0.1:9/", attempts=3)
    pauses = []
    with Alerts(config, "a", pause=lambda s: pauses.append(s) is not None) as alerts:
        alerts.push(EVENT)
        settled(alerts, lambda: alerts.failed == 1)
    assert pauses == [1.0, 2.0]
    assert alerts.delivered == 0


def test_the_time_limit_ends_an_attempt(hook):
    hook.answers[:] = ["slow"]
    config = AlertConfig(webhook=hook.address, time_limit_s=0.3, attempts=1)
    with Alerts(config, "a") as alerts:
        alerts.push(EVENT)
        settled(alerts, lambda: alerts.failed == 1)
    slow = AlertConfig(
        command=(sys.executable, "-I", "-S", "-c", "import time; time.sleep(60)"),
        time_limit_s=0.3, attempts=1,
    )  # fmt: skip
    with Alerts(slow, "a") as alerts:
        alerts.push(EVENT)
        settled(alerts, lambda: alerts.failed == 1)
    assert "timed out" in alerts.last_error


def test_only_the_way_that_failed_is_repeated(hook, tmp_path):
    out = tmp_path / "told"
    code = "import sys; open(sys.argv[1], 'ab').write(sys.stdin.buffer.read())"
    command = (sys.executable, "-I", "-S", "-c", code, str(out))
    hook.answers[:] = [500]
    config = AlertConfig(command=command, webhook=hook.address)
    with Alerts(config, "a", pause=lambda _s: False) as alerts:
        alerts.push(EVENT)
        settled(alerts, lambda: alerts.delivered == 1)
    assert len(out.read_text().splitlines()) == 1
    assert len(hook.bodies) == 2


def test_a_flood_is_bounded_and_pushing_never_waits():
    blocked = threading.Event()
    config = AlertConfig(webhook="http://127.0.0.1:9/", attempts=2)
    alerts = Alerts(config, "a", pause=lambda _s: blocked.wait(20.0))
    alerts._worker.start()
    began = time.monotonic()
    for k in range(WAITING + 50):
        alerts.push({**EVENT, "event_id": str(k)})
    assert time.monotonic() - began < 5.0
    assert alerts.failed >= 49
    blocked.set()


def test_no_word_of_the_end_where_it_is_not_wanted():
    alerts = Alerts(AlertConfig(webhook="http://127.0.0.1:9/", on_end=False), "a")
    alerts.push({**EVENT, "ended": True})
    assert alerts.counters()["waiting"] == 0


@pytest.mark.parametrize("config", [
    AlertConfig(webhook="file:///etc/passwd"),
    AlertConfig(command=("a", 1)),
    AlertConfig(webhook="https://a", attempts=0),
])  # fmt: skip
def test_settings_that_make_no_sense_are_refused(config):
    with pytest.raises(InputError):
        checked(config, "my.yaml")
