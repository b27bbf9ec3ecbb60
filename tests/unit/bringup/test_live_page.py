"""The live page beside a run: its options, and that its deaths end nothing."""

import itertools
import socket
from pathlib import Path
from types import SimpleNamespace

import pytest

from deepseis_bringup.commands.web import web_options, with_default_port
from deepseis_bringup.live.live_page import LivePage, page_spec
from deepseis_bringup.live.web_options import PORT, WebOptions
from deepseis_core.errors import InputError


def test_the_option_may_go_without_its_port():
    assert with_default_port(["station", "--web"]) == ["station", "--web", str(PORT)]
    words = ["replay", "bag", "--web", "-o", "x"]
    assert with_default_port(words) == ["replay", "bag", "--web", str(PORT), "-o", "x"]
    assert with_default_port(["replay", "--web", "9000", "b"]) == ["replay", "--web", "9000", "b"]


def test_no_page_unless_asked_for():
    assert web_options(None, None, None, None) is None
    assert web_options(9000, None, None, None) == WebOptions(9000)


def test_the_command_goes_before_the_stations_file():
    file = WebOptions(9000, "10.0.0.1", "/token", ("a.example",))
    assert web_options(None, None, None, None, file) == file
    assert web_options(8000, "127.0.0.1", Path("/t"), ["b"], file) == WebOptions(
        8000, "127.0.0.1", "/t", ("b",)
    )


def test_what_cannot_be_served_is_said_before_anything_starts(monkeypatch):
    monkeypatch.delenv("DEEPSEIS_WEB_TOKEN", raising=False)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(InputError, match="Address already in use"):
            WebOptions(port).check()
    WebOptions(port).check()
    with pytest.raises(InputError, match="needs a token"):
        WebOptions(port, "0.0.0.0").check()
    monkeypatch.setenv("DEEPSEIS_WEB_TOKEN", "correct horse battery staple")
    WebOptions(port, "0.0.0.0").check()


def test_the_token_itself_is_no_parameter(monkeypatch):
    monkeypatch.setenv("DEEPSEIS_WEB_TOKEN", "correct horse battery staple")
    spec = page_spec(WebOptions(9000, token_file="t"))
    assert "horse" not in str(spec.ros_parameters())
    assert not spec.subscribes  # nobody waits for the page


class Processes:
    """Stands for the supervisor of the page's process."""

    def __init__(self):
        self.started, self.status = 0, None

    def start(self):
        self.started, self.status = self.started + 1, None

    def statuses(self):
        return {"web": self.status}

    def last_line(self, _name):
        return "out of memory"


def test_a_page_that_dies_comes_again_after_a_while_that_grows():
    processes, said, clock = Processes(), [], SimpleNamespace(now=0.0)
    page = LivePage(processes, said.append, lambda: clock.now)
    page.start()
    started_at = []
    for tenth in range(700):
        clock.now = tenth / 10
        if processes.status is None:
            processes.status = -9
        before = processes.started
        page.tend()
        started_at += [clock.now] * (processes.started - before)
    waits = [b - a for a, b in itertools.pairwise([0.0, *started_at])]
    assert waits == pytest.approx([1, 2, 4, 8, 16, 30], abs=0.25)
    assert said[0] == "live page was killed by signal 9: out of memory; again in 1 s"
    assert len(said) == 7


def test_a_page_that_lived_long_comes_again_soon():
    processes, clock = Processes(), SimpleNamespace(now=0.0)
    page = LivePage(processes, lambda _text: None, lambda: clock.now)
    page.start()
    for death in (0.0, 10.0, 100.0):
        clock.now, processes.status = death, 1
        page.tend()
        clock.now += 2.0
        page.tend()
    assert processes.started == 4
    clock.now, processes.status = 300.0, 1
    page.tend()
    clock.now = 301.1
    page.tend()
    assert processes.started == 5
