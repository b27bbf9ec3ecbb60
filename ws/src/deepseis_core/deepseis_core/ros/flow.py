"""Flow control between nodes: readiness, watermarks, credits, end of stream.

Every member of the graph announces on ``flow/<name>`` through which sample its outputs are
complete and its inputs consumed. It is *ready* when all its publishers have the subscribers that
the graph's description promises, so nothing published later can be missed.

In real time a node that died is started again and *joins* the running graph: it leaves aside what
comes before it is ready, and begins with the first sample after that (`Flow.entry`).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from rclpy.duration import Duration
from rclpy.node import Node

from deepseis_core.config import setting
from deepseis_core.interface import SHARED_TOPICS
from deepseis_core.miss_log import MissScript
from deepseis_core.ros import diagnostics, qos
from deepseis_core.ros.convert import stamp_from_ns
from deepseis_core.ros.main import Process
from deepseis_core.ros.steady import every
from deepseis_msgs.msg import Watermark

ACKNOWLEDGE_SECONDS = 5.0
"""Time for all readers to acknowledge everything at the end [s]."""


REPEAT_SECONDS = 1.0
"""A node that has nothing new to say repeats its watermark so often [s]."""


@dataclass(frozen=True)
class FlowConfig:
    """A node's place in the graph (filled by the graph's description)."""

    mode: str = setting(
        "lockstep",
        "lockstep: wait for inputs without limit; realtime: with deadlines [-]",
        choices=("lockstep", "realtime"),
    )
    expected_subscribers: list[str] = setting([], "what to wait for: topic=count [-]")
    flow_stride_ms: int = setting(0, "announce that often while nobody waits [ms]", low=0)
    rejoin: bool = setting(False, "realtime: the graph runs already, join it at the present [-]")
    misses: list[str] = setting(
        [], "lockstep: what the run that is replayed did not wait for: input, runs of samples [-]"
    )


class Flow:
    """One node's part in the flow control."""

    def __init__(self, node: Node, process: Process, name: str, config: FlowConfig) -> None:
        self.node, self.process, self.name, self.config = node, process, name, config
        diagnostics.of_station(node.get_namespace())
        self.script = MissScript(config.misses if config.mode == "lockstep" else ())
        self.publisher = node.create_publisher(Watermark, f"flow/{name}", qos.STREAM_LATCHED)
        self.publishers: dict[str, Any] = {}
        self.others: dict[str, Watermark] = {}
        self.ready = False
        self.ended = False
        self.shared_count = 0
        self.entry = -1
        self._subscriptions: list[Any] = []
        self._followers: list[tuple[str, Callable[[Watermark], None]]] = []
        self._last: tuple[int, int, int] = (-1, -1, 0)
        self._other_counts = (0, 0, 0)
        self._pending: Watermark | None = None
        self._newest: Watermark | None = None
        self._said_at = 0.0
        self._announced_ns = 0
        self._on_ready: list[Callable[[], None]] = []
        self._timer = every(node, 0.02, self._check_ready)
        every(node, REPEAT_SECONDS, self._repeat)

    @property
    def lockstep(self) -> bool:
        """Wait for inputs without limit."""
        return self.config.mode == "lockstep"

    def publish_on(self, topic: str, msg_type: Any, profile: Any, node: Node | None = None) -> Any:
        """Create a publisher whose subscribers count for readiness."""
        publisher = (node or self.node).create_publisher(msg_type, topic, profile)
        self.publishers.setdefault(topic, []).append(publisher)
        if topic in SHARED_TOPICS:
            send = publisher.publish

            def publish(msg: Any) -> None:
                self.shared_count += 1
                send(msg)

            publisher.publish = publish
        return publisher

    def follow(
        self, names: Iterable[str], callback: Callable[[Watermark], None] | None = None
    ) -> None:
        """Subscribe to other members' watermarks; the newest is in ``others``."""
        for name in names:
            if callback is not None:
                self._followers.append((name, callback))

            def on_watermark(msg: Watermark, name: str = name) -> None:
                self.others[name] = msg
                if msg.error:
                    self.process.stop(1, f"{name} gave up: {msg.error}")
                elif callback is not None:
                    callback(msg)

            self._subscriptions.append(
                self.node.create_subscription(
                    Watermark, f"flow/{name}", on_watermark, qos.STREAM_LATCHED
                )
            )

    @property
    def rejoins(self) -> bool:
        """The graph runs already; others' counts of what came before do not hold here."""
        return self.config.rejoin and not self.lockstep

    def admits(self, sample_index: int) -> bool:
        """Tell whether what begins at a sample is for this node; the first sets ``entry``.

        A node from the start admits everything: nothing is sent before all are ready.
        """
        if not self.rejoins:
            return True
        if self.entry < 0 and self.ready and sample_index >= 0:
            self.entry = sample_index
        return 0 <= self.entry <= sample_index

    @property
    def came_too_late(self) -> bool:
        """The graph's stream ended before this node was there."""
        return self.rejoins and self.ready and self.entry < 0

    def when_ready(self, callback: Callable[[], None]) -> None:
        """Call back once all endpoints are matched."""
        self._on_ready.append(callback)

    def _missing(self) -> list[str]:
        missing = []
        for entry in self.config.expected_subscribers:
            topic, _, count = entry.rpartition("=")
            for publisher in self.publishers.get(topic, []):
                readers = min(publisher.get_subscription_count(), self._own(topic))
                if readers < int(count):
                    missing.append(topic)
        return missing

    def _own(self, topic: str) -> float:
        """Count this station's readers of a topic that several stations share."""
        if not topic.startswith("/"):
            return math.inf
        space = self.node.get_namespace()
        readers = self.node.get_subscriptions_info_by_topic(topic)
        return sum(reader.node_namespace == space for reader in readers)

    def _check_ready(self) -> None:
        if self._missing():
            return
        self.ready = True
        self._timer.cancel()
        self.send(*self._last[:2])
        self.flush()
        for callback in self._on_ready:
            callback()
        for name, follower in self._followers if self.rejoins else ():
            if name in self.others:  # it may have spoken for the last time
                follower(self.others[name])

    def send(
        self,
        valid_through: int,
        consumed_through: int,
        *,
        event_count: int | None = None,
        ephemeris_count: int = 0,
        precise_count: int = 0,
        observation_count: int = 0,
        end_of_stream: bool = False,
        utc_ns: int = 0,
    ) -> None:
        """Announce progress, at the latest every ``flow_stride_ms`` or at `flush`.

        After the end there is nothing more to announce.
        """
        if self.ended and not end_of_stream:
            return
        count = self._last[2] if event_count is None else event_count
        self._last = (valid_through, consumed_through, count)
        self._other_counts = (ephemeris_count, precise_count, observation_count)
        msg = Watermark(node=self.name, ready=self.ready, end_of_stream=end_of_stream)
        msg.header.stamp = stamp_from_ns(utc_ns)
        msg.valid_through, msg.consumed_through = valid_through, consumed_through
        msg.event_count, msg.ephemeris_count = count, ephemeris_count
        msg.precise_count, msg.observation_count = precise_count, observation_count
        msg.shared_count = self.shared_count
        self._pending = msg
        held_ns = utc_ns - self._announced_ns
        if held_ns >= self.config.flow_stride_ms * 1_000_000 or end_of_stream or utc_ns == 0:
            self._announced_ns = utc_ns
            self.flush()

    def flush(self) -> None:
        """Announce what is held back: someone may be waiting for it."""
        if self._pending is not None:
            self.publisher.publish(self._pending)
            self._newest, self._pending = self._pending, None
            self._said_at = time.monotonic()

    def _repeat(self) -> None:
        """Say the newest watermark again: in lockstep all wait for a reader that missed it."""
        if self._newest is not None and time.monotonic() - self._said_at >= REPEAT_SECONDS:
            self.publisher.publish(self._newest)

    def finish(self) -> None:
        """Announce the end after everything published has reached its readers."""
        deadline = time.monotonic() + ACKNOWLEDGE_SECONDS
        for publishers in self.publishers.values():
            for publisher in publishers:
                left = max(0.0, deadline - time.monotonic())  # a reader may have died
                publisher.wait_for_all_acked(Duration(nanoseconds=round(left * 1e9)))
        self.ended = True
        # Readers go on waiting for all that was counted: fewer would say that it is another node.
        ephemerides, precise, observations = self._other_counts
        self.send(
            *self._last[:2],
            ephemeris_count=ephemerides,
            precise_count=precise,
            observation_count=observations,
            end_of_stream=True,
        )

    def fail(self, reason: str) -> None:
        """Tell everybody that this node gives up, and end the process."""
        msg = Watermark(node=self.name, ready=self.ready, error=reason)
        self.publisher.publish(msg)
        self.publisher.wait_for_all_acked(Duration(seconds=2))  # the dead never acknowledge
        self.process.stop(1, reason)
