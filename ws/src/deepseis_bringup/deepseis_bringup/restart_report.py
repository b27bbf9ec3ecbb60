"""Says on ``/diagnostics`` which nodes died and were started again, and when they are back.

Nothing as long as all live: then a run in real time has the diagnostics of one in lockstep.
"""

from __future__ import annotations

from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from deepseis_bringup.restarts import Restarts, State
from deepseis_core.ros import diagnostics, qos
from deepseis_msgs.msg import Watermark

NAME = "supervisor"


class RestartReport:
    """Publishes what `Restarts` knows once a node has died: on change and every second.

    Parameters
    ----------
    node : Node
        Publishes and listens.
    restarts : Restarts
        Learns here that a node speaks for samples again.
    """

    def __init__(self, node: Node, restarts: Restarts) -> None:
        self.node, self.restarts = node, restarts
        self.publisher = node.create_publisher(DiagnosticArray, "/diagnostics", qos.STREAM)
        self._listening: dict[str, Any] = {}
        self._said: tuple[str, int, int] = ("", 0, -1)

    def poll(self, utc_ns: int) -> None:
        """Publish if there is something new; ``utc_ns`` is how far the source is."""
        for name, fate in self.restarts.fates.items():
            if fate.state is State.JOINING and name not in self._listening:
                self._listen(name)
        if not self.restarts.fates:
            return
        news = self.restarts.text(), self.restarts.count, utc_ns // 1_000_000_000
        if utc_ns and news != self._said:
            self._said = news
            self._publish(utc_ns)

    def _listen(self, name: str) -> None:
        def on_watermark(msg: Watermark) -> None:
            if msg.ready and msg.valid_through >= 0:
                self.restarts.joined(name)

        self._listening[name] = self.node.create_subscription(
            Watermark, f"flow/{name}", on_watermark, qos.STREAM_LATCHED
        )

    def _publish(self, utc_ns: int) -> None:
        restarts = self.restarts
        level = diagnostics.ERROR if restarts.missing else diagnostics.WARN
        values: dict[str, object] = {"restarts": restarts.count}
        for name, fate in restarts.fates.items():
            values[f"restarts_{name}"] = fate.restarts
            values[f"away_s_{name}"] = f"{fate.away_s:.2f}"
        text, station = restarts.text(), self.node.get_namespace()
        self.publisher.publish(diagnostics.encoded(NAME, level, text, values, utc_ns, station))
