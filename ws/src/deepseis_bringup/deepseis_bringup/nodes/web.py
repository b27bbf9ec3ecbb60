"""Node: the live page of a running graph."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from deepseis_bringup.live.guard import Guard, token_from
from deepseis_bringup.live.model import LiveModel
from deepseis_bringup.live.server import PageServer
from deepseis_core.config import setting
from deepseis_core.ros import codecs, qos
from deepseis_core.ros.cdr import Codec
from deepseis_core.ros.main import Process, run
from deepseis_core.ros.parameters import declare, reject_unknown
from deepseis_core.status_names import is_of, node_of
from deepseis_msgs.msg import Watermark

EVERY = QoSProfile(depth=500, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Every message counts on the page, but nobody waits until the page has it."""
NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Only the newest is looked at."""
SOURCE = "flow/if_source"
DISCOVER_S = 2.0
"""Time between looks for topics of satellites [s]."""
LOOPS_S = 0.2
"""Time between looks at the loops, of which only the newest counts [s]."""


@dataclass(frozen=True)
class WebConfig:
    """Where the live page is, and who may look."""

    address: str = setting("127.0.0.1", "IP address to listen on; others need a token [-]")
    port: int = setting(8765, "0: any that is free [-]", low=0, high=65535)
    token_file: str = setting("", "file with the token; else DEEPSEIS_WEB_TOKEN [path]")
    names: list[str] = setting([], "host names of the page, of a reverse proxy for one [-]")


class WebNode(Node):
    """In: nearly all topics but the samples. Out: a page. Parameters: WebConfig.

    An onlooker: no credit and no receipt is waited for, and it subscribes only when samples flow,
    so that no publisher takes it for one of the readers that it needs. Messages are fetched by the
    server's thread; nothing is called back.
    """

    def __init__(self, process: Process) -> None:
        super().__init__("web", start_parameter_services=False)
        config = declare(self, WebConfig)
        reject_unknown(self)
        guard = Guard(config.address, token_from(config.token_file), tuple(config.names))
        self.model = LiveModel()
        self.inputs: list[tuple[Any, Callable[[Any, int], None]]] = []
        self.loops: dict[str, tuple[Any, Callable[[Any, int], None]]] = {}
        self.discovered_at = self.looked_at = 0.0
        self.listen(SOURCE, Watermark, EVERY, self.on_source, raw=False)
        self.server = PageServer(
            self.model, guard, config.port, self.feed, lambda text: process.stop(1, text)
        )
        self.server.start()
        print(f"live page: {self.server.address}", flush=True)

    def listen(
        self,
        topic: str,
        kind: Any,
        profile: QoSProfile,
        take: Callable[[Any, int], None],
        raw: bool = True,
    ) -> tuple[Any, Callable[[Any, int], None]]:
        """Subscribe; ``take(message, sent_ns)`` is for `feed` to call."""
        subscription = self.create_subscription(kind, topic, lambda _msg: None, profile, raw=raw)
        self.inputs.append((subscription, take))
        return self.inputs[-1]

    def listen_to(
        self, codec: Codec[Any], topic: str, profile: QoSProfile, take: Callable[..., None]
    ) -> tuple[Any, Callable[[Any, int], None]]:
        """Subscribe to one of our types; ``take(value, utc_ns, sent_ns)``."""

        def on_bytes(data: bytes, sent_ns: int) -> None:
            value, utc_ns = codec.decode(data)
            take(value, utc_ns, sent_ns)

        return self.listen(topic, codec.msg_type, profile, on_bytes)

    def join(self) -> None:
        """Subscribe to the graph, now that it runs."""
        model = self.model
        self.listen_to(
            codecs.DISPLACEMENT,
            "seismo/displacement",
            EVERY,
            lambda value, _utc, sent: model.take_displacement(value, sent),
        )
        values: list[tuple[Codec[Any], str, QoSProfile, Callable[[Any], None]]] = [
            (codecs.INS_SOLUTION, "ins/solution", EVERY, model.take_solution),
            (codecs.PRECISE_POSITION, "gnss/precise", EVERY, model.take_precise),
            (codecs.OBSERVATIONS, "gnss/observations", EVERY, model.take_observations),
            (codecs.PVT, "gnss/pvt", NEWEST, model.take_pvt),
            (codecs.STATION, "station", qos.LATCHED, model.take_station),
        ]
        for codec, topic, profile, take in values:
            self.listen_to(codec, topic, profile, lambda v, _utc, _sent, take=take: take(v))
        stamped: list[tuple[Codec[Any], str, Callable[[Any, int], None]]] = [
            (codecs.MOTION_STATE, "motion/state", model.take_motion_state),
            (codecs.SEISMIC_EVENT, "seismo/event", model.take_event),
        ]
        for codec, topic, give in stamped:
            self.listen_to(
                codec, topic, qos.LATCHED, lambda v, utc, _sent, give=give: give(v, utc)
            )
        self.listen("/diagnostics", DiagnosticArray, EVERY, self.on_diagnostics, raw=False)

    def discover(self) -> None:
        """Subscribe to the satellites that there are."""
        space = self.get_namespace().rstrip("/") + "/tracking/"
        for name, _ in self.get_topic_names_and_types():
            if not name.startswith(space) or name in self.loops or not name.endswith("/epochs"):
                continue
            self.loops[name] = self.listen_to(
                codecs.TRACKING_EPOCHS,
                name,
                NEWEST,
                lambda v, _utc, _sent: self.model.take_tracking(v),
            )
            self.inputs.remove(self.loops[name])

    def feed(self) -> None:
        """Give the model what has come."""
        for subscription, take in self.inputs[:]:
            fetch(subscription, take)
        now = time.monotonic()
        if len(self.inputs) > 1 and now - self.discovered_at > DISCOVER_S:
            self.discovered_at = now
            self.discover()
        if now - self.looked_at > LOOPS_S:
            self.looked_at = now
            for subscription, take in self.loops.values():
                fetch(subscription, take)

    def on_source(self, msg: Watermark, sent_ns: int) -> None:
        """Follow the source; join when it sends."""
        if msg.valid_through < 0:
            return
        if len(self.inputs) == 1:
            self.join()
        self.model.take_source(msg.valid_through, sent_ns, ended=msg.end_of_stream)

    def on_diagnostics(self, msg: DiagnosticArray, _sent_ns: int) -> None:
        """Take statuses."""
        for status in msg.status:
            values = {pair.key: pair.value for pair in status.values}
            if is_of(status.name, self.get_namespace()):
                name = node_of(status)
                self.model.take_diagnostic(name, status.level[0], status.message, values)

    def close(self) -> None:
        """End the page."""
        self.server.close()


def fetch(subscription: Any, take: Callable[[Any, int], None]) -> None:
    """Take all that waits at a subscription, with the time when it was sent [ns]."""
    with subscription.handle:
        while found := subscription.handle.take_message(subscription.msg_type, subscription.raw):
            message, info = found
            take(message, int(info["source_timestamp"]))


def main() -> None:
    """Run the node."""
    run(lambda process: process.nodes.append(WebNode(process)), "web")


if __name__ == "__main__":
    main()
