"""What a node did by the clock in real time, on ``/diagnostics``: latencies and misses.

They stand in messages of their own, "<node> latency" and "<node> misses": nothing that is compared
between runs depends on the clock, and in lockstep there are none.
"""

from __future__ import annotations

from collections.abc import Mapping

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.duration import Duration
from rclpy.node import Node

from deepseis_core.latency import LatencyMeter
from deepseis_core.miss_log import MissLog
from deepseis_core.ros import diagnostics, qos


class RealtimeReport:
    """Some meters, a log of misses, and where they are published.

    Parameters
    ----------
    node : Node
    name : str
        The flow member.
    meters : mapping of str to str, optional
        What each meter measures, by its name.
    deadline_ms : float
        A longer latency is a warning [ms].

    Attributes
    ----------
    meters : dict of str to LatencyMeter
    misses : MissLog
    """

    def __init__(
        self,
        node: Node,
        name: str,
        meters: Mapping[str, str] | None = None,
        deadline_ms: float = float("inf"),
    ) -> None:
        self.name, self.texts, self.deadline_ms = name, dict(meters or {}), deadline_ms
        self.meters = {key: LatencyMeter() for key in self.texts}
        self.misses = MissLog()
        # Not through the flow: no count of messages, and no readiness, depends on this.
        self.publisher = node.create_publisher(DiagnosticArray, "/diagnostics", qos.STREAM)

    def publish(self, utc_ns: int) -> None:
        """Publish what came since the last call; nothing if nothing did."""
        latencies = {key: meter.summary() for key, meter in self.meters.items()}
        if any(latencies.values()):
            self._publish_latencies(latencies, utc_ns)
        missed = self.misses.take()
        if missed:
            text = "went on without " + ", ".join(missed)
            name = f"{self.name} misses"
            data = diagnostics.encoded(name, diagnostics.WARN, text, missed, utc_ns)
            self.publisher.publish(data)

    def finish(self, utc_ns: int) -> None:
        """Publish what is left, before the node says that it has ended."""
        self.publish(utc_ns)
        self.publisher.wait_for_all_acked(Duration(seconds=1))

    def _publish_latencies(self, found: Mapping[str, Mapping[str, str]], utc_ns: int) -> None:
        values = {f"{key}_{name}": v for key, part in found.items() for name, v in part.items()}
        late = any(float(p.get("p99_ms", 0.0)) > self.deadline_ms for p in found.values())
        level = diagnostics.WARN if late else diagnostics.OK
        text = "; ".join(
            f"{self.texts[key]} {part['median_ms']} ms, at most {part['max_ms']} ms"
            for key, part in found.items()
            if part
        )
        name = f"{self.name} latency"
        self.publisher.publish(diagnostics.encoded(name, level, text, values, utc_ns))
