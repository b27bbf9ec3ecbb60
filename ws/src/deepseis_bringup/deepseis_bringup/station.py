"""Runs a station: the graph on its configuration until Ctrl-C or the end of the source."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray

from deepseis_bringup.alert import Alerts
from deepseis_bringup.bags.run_records import versions
from deepseis_bringup.graph import build_graph
from deepseis_bringup.live.live_page import LivePage, live_page
from deepseis_bringup.restarts import Restarts
from deepseis_bringup.silence import Silence
from deepseis_bringup.station_config import StationConfig
from deepseis_bringup.supervisor import Supervisor, running
from deepseis_bringup.watch import GraphWatch
from deepseis_core.errors import InputError
from deepseis_core.rinex_nav import write_whole
from deepseis_core.ros import diagnostics, qos
from deepseis_core.ros.convert import ns_from_stamp
from deepseis_core.ros.steady import every
from deepseis_core.status_names import is_of, node_of
from deepseis_msgs.msg import SeismicEvent, Watermark

DISCOVERY_SECONDS = 1.0
"""How long to look for another graph of the same name before starting [s]."""
DRAIN_SECONDS = 10.0
"""How long the nodes have to work through what the source sent before it was stopped [s]."""
EVENT_FIELDS = (
    *("event_id", "ended", "onset_ratio", "peak_displacement", "peak_velocity"),
    *("peak_acceleration", "hypocentral_distance", "magnitude", "magnitude_sd"),
)
"""Of a message that an alert holds."""
TRACKING = re.compile(r"tracking (\d+)")


class StationWatch(GraphWatch):
    """Listens to the diagnostics as well."""

    def __init__(
        self, namespace: str, say: Callable[[str], None], restarts: Restarts | None = None
    ) -> None:
        super().__init__({}, namespace, restarts=restarts)
        self.say = say
        self.texts: dict[str, str] = {}
        self.levels: dict[str, bytes] = {}
        self.ended: set[str] = set()
        self.silence = Silence()
        self.node.create_subscription(
            DiagnosticArray, "/diagnostics", self._on_diagnostics, qos.STREAM
        )

    def tell_of_events(self, alerts: Alerts) -> None:
        """Hand events to whom alerts them; how that goes is on `/diagnostics`."""
        said = self.node.create_publisher(DiagnosticArray, "/diagnostics", qos.STREAM)

        def on_event(msg: SeismicEvent) -> None:
            values = {name: getattr(msg, name) for name in EVENT_FIELDS}
            onset = ns_from_stamp(msg.onset)
            alerts.push({**values, "onset_utc_ns": onset})

        station = self.node.get_namespace()

        def report() -> None:
            level = diagnostics.WARN if alerts.failed else diagnostics.OK
            text = "alerts were not delivered" if alerts.failed else "ready"
            said.publish(
                diagnostics.array("alert", level, text, alerts.counters(), time.time_ns(), station)
            )

        self.node.create_subscription(SeismicEvent, "seismo/event", on_event, qos.LATCHED)
        every(self.node, 1.0, report)

    def follow_ends(self, members: list[str]) -> None:
        """Collect in ``ended`` who says that nothing more will follow, and who has said so."""
        for member in members:
            self.node.create_subscription(
                Watermark, f"flow/{member}", self._on_member, qos.STREAM_LATCHED
            )

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        for status in msg.status:
            if not is_of(status.name, self.node.get_namespace()):
                continue
            name = node_of(status)
            level, before = bytes(status.level), self.levels.get(name, b"\0")
            self.texts[name], self.levels[name] = status.message, level
            self.silence.hear(name, self.utc_ns / 1e9)
            if level > before:
                self.say(f"{name}: {status.message}")

    def _on_member(self, msg: Watermark) -> None:
        if msg.end_of_stream:
            self.ended.add(msg.node)

    def refuse_namesake(self) -> None:
        """Complain if a graph of this name is seen, started by other means or elsewhere.

        Raises
        ------
        InputError
            Two graphs would work through each other's samples.
        """
        deadline = time.monotonic() + DISCOVERY_SECONDS
        while time.monotonic() < deadline:
            if self.node.count_publishers("flow/if_source"):
                raise _runs_already(self.node.get_namespace())
            time.sleep(0.05)

    def line(self, sample_rate_hz: float) -> str:
        """Say in one line what goes on."""
        played = max(0, self.poll() + 1) / sample_rate_hz
        counts = [TRACKING.search(text) for text in self.texts.values()]
        tracked = sum(int(match[1]) for match in counts if match)
        fix = self.texts.get("pvt", "no fix yet")
        return f"{played:.1f} s played, {tracked} satellites tracked, {fix}"


def _domain() -> str:
    return os.environ.get("ROS_DOMAIN_ID") or "0"


def _runs_already(name: str) -> InputError:
    hint = "stop it, or set ROS_DOMAIN_ID or another station name"
    return InputError(f"station {name}", f"runs already in domain {_domain()}", hint)


@contextmanager
def only_one(station: str) -> Iterator[None]:
    """Hold a station's name in this domain, on this machine, for as long as the process lives.

    Raises
    ------
    InputError
        A station of this name runs already.
    """
    with socket.socket(socket.AF_UNIX) as name:
        try:
            name.bind(f"\0deepseis/{_domain()}/{station}")  # abstract: leaves no file behind
        except OSError:
            raise _runs_already(f"/{station}") from None
        yield


@contextmanager
def terminate_is_interrupt() -> Iterator[None]:
    """Let SIGTERM end the station as Ctrl-C does."""

    def interrupt(_number: int, _frame: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def alerting(config: StationConfig, watch: StationWatch) -> Iterator[None]:
    """Tell of events while the station runs, if anybody is to be told."""
    if not config.alert.is_wanted:
        yield
        return
    with Alerts(config.alert, config.station) as alerts:
        watch.tell_of_events(alerts)
        yield


def run_station(
    config: StationConfig,
    folder: Path,
    *,
    say: Callable[[str], None],
    show: Callable[[str], None] = lambda _line: None,
) -> dict[str, Any]:
    """Run a station until it is interrupted or its source ends.

    Parameters
    ----------
    config : StationConfig
        What to run.
    folder : Path
        Run folder; exists.
    say, show : callable
        Told what happens once, and every tenth of a second how things are.

    Returns
    -------
    dict
        Figures of the run; also in ``summary.json``.

    Raises
    ------
    InputError
        The source cannot be used, a graph of this name runs already, or a node failed.
    """
    graph = config.graph(folder)
    restarts = Restarts() if config.mode == "realtime" else None
    supervisor = Supervisor(
        build_graph(replace(graph, watched=True)),
        folder,
        namespace=config.station,
        restarts=restarts,
    )
    members = [spec.name for spec in supervisor.specs if spec.name != "if_source"]
    started, reason = time.monotonic(), "end of the source"
    with (
        only_one(config.station),
        terminate_is_interrupt(),
        StationWatch(config.station, say, restarts) as watch,
    ):
        watch.refuse_namesake()
        say(f"recording to {graph.record_dir}" if graph.record_dir else "not recording")
        for line in config.estimate(folder):
            say(line)
        with (
            live_page(config.live_page, folder, say, namespace=config.station) as pages,
            alerting(config, watch),
            running(supervisor),
        ):
            try:
                _follow(supervisor, watch, pages, graph.sample_rate_hz, show)
            except KeyboardInterrupt:
                reason = "interrupted"
                say("stopping")
                _drain(supervisor, watch, members)
    figures: dict[str, Any] = {
        "ended_by": reason,
        "mode": config.mode,
        "station": config.station,
        "duration_s": round((watch.valid_through + 1) / graph.sample_rate_hz, 6),
        "wall_time_s": round(time.monotonic() - started, 3),
        "restarts": restarts.count if restarts is not None else 0,
        "nodes_with_warnings": sum(level > b"\0" for level in watch.levels.values()),
        **{f"version_{name}": value for name, value in versions().items()},
    }
    write_whole(folder / "summary.json", json.dumps(figures, indent=2) + "\n")
    return figures


def _follow(
    supervisor: Supervisor,
    watch: StationWatch,
    pages: Sequence[LivePage],
    rate_hz: float,
    show: Callable[[str], None],
) -> None:
    shown = 0.0

    def poll() -> None:
        nonlocal shown
        for _ in range(4):
            watch.poll()
        for page in pages:
            page.tend()
        if time.monotonic() - shown > 0.1:
            shown = time.monotonic()
            show(watch.line(rate_hz))
            end_silence(supervisor, watch)

    supervisor.wait(poll=poll)


def end_silence(supervisor: Supervisor, watch: StationWatch) -> None:
    """Kill a node that lives and says nothing: it is started again like one that has died."""
    restarts, silence = supervisor.restarts, watch.silence
    if restarts is None:
        return
    for missing in restarts.missing:
        silence.forget(missing)
    names = [spec.name for spec in supervisor.specs if spec.name not in restarts.never]
    name = silence.broken(names, watch.utc_ns / 1e9)
    if name is not None and supervisor.processes[name].poll() is None:
        why = f"said nothing for {silence.limit_s:g} s and was killed"
        watch.say(f"{name}: {why}; {supervisor.log_of(name)} may have where it stood")
        supervisor.kill_stuck(name, why)


def _drain(supervisor: Supervisor, watch: StationWatch, members: list[str]) -> None:
    """Stop the source and let the others work through what it has sent."""
    watch.follow_ends(members)
    supervisor.end(["if_source"])
    deadline = time.monotonic() + DRAIN_SECONDS
    while watch.valid_through >= 0 and time.monotonic() < deadline:
        watch.poll()
        if watch.ended.issuperset(members) or supervisor.failed():
            return
        time.sleep(0.005)
