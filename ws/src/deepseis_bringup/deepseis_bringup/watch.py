"""Follows a running graph's progress from outside: how far the source and the PVT are."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Mapping
from types import TracebackType
from typing import Any, Self

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from deepseis_bringup.graph import ONLOOKER
from deepseis_bringup.restart_report import RestartReport
from deepseis_bringup.restarts import Restarts
from deepseis_bringup.supervisor import StandstillError
from deepseis_core.ros import qos
from deepseis_core.ros.convert import ns_from_stamp
from deepseis_core.ros.reach import choose_reach
from deepseis_msgs.msg import Watermark

PATIENCE = 180.0
"""A run in which no node says anything for so long stands still [s]: compiling takes less."""


class GraphWatch:
    """A listener on ``flow/if_source``; a context manager.

    It says on ``flow/watch`` when it is there: a graph that is described as watched waits for
    that, since joining may take longer than a short run.

    Parameters
    ----------
    environment : mapping
        Of the graph's processes: its ROS_DOMAIN_ID counts.
    namespace : str
        The station's name, or empty.
    members : iterable of str
        Whose progress to follow besides the source's.
    restarts : Restarts, optional
        Real time: told on ``/diagnostics``.
    """

    def __init__(
        self,
        environment: Mapping[str, str],
        namespace: str = "",
        members: Iterable[str] = (),
        restarts: Restarts | None = None,
    ) -> None:
        choose_reach(os.environ)
        number = environment.get("ROS_DOMAIN_ID")
        self.context = Context()
        rclpy.init(context=self.context, domain_id=int(number) if number else None)
        self.node = Node(
            "watch",
            context=self.context,
            namespace=namespace,
            start_parameter_services=False,
            enable_rosout=False,
        )
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.valid_through, self.utc_ns = -1, 0
        self.report = RestartReport(self.node, restarts) if restarts is not None else None
        self.started_at = self.ended_at = 0.0
        self.moved_at = time.monotonic()
        self.said: dict[str, Watermark] = {}
        self._there = False
        self._onlooker = self.node.create_publisher(
            Watermark, f"flow/{ONLOOKER}", qos.STREAM_LATCHED
        )
        self._source = self.node.create_subscription(
            Watermark, "flow/if_source", self._on_source, qos.STREAM_LATCHED
        )
        for member in members:
            self.node.create_subscription(
                Watermark, f"flow/{member}", self._on_member, qos.STREAM_LATCHED
            )

    def _on_member(self, msg: Watermark) -> None:
        self._heard(msg)

    def _heard(self, msg: Watermark) -> None:
        """Take a watermark; one that is repeated is no progress."""
        before = self.said.get(msg.node)
        if before is None or _progress(before) != _progress(msg):
            self.moved_at = time.monotonic()
        self.said[msg.node] = msg

    def require_progress(self) -> None:
        """Complain if nobody has said anything for `PATIENCE`.

        Raises
        ------
        StandstillError
            Naming how far each member is.
        """
        if time.monotonic() - self.moved_at < PATIENCE:
            return
        places = [
            f"{name} {'ended' if msg.end_of_stream else f'at sample {msg.valid_through}'}"
            for name, msg in sorted(self.said.items())
        ]
        reason = f"nothing has moved for {PATIENCE:g} s: {', '.join(places) or 'nobody spoke'}"
        raise StandstillError("graph", reason, "its nodes wait for each other; see the logs")

    def _on_source(self, msg: Watermark) -> None:
        now = time.monotonic()
        if msg.valid_through >= 0 and not self.started_at:
            self.started_at = now
        self._heard(msg)
        if msg.valid_through > self.valid_through:
            self.ended_at = now
        self.valid_through = max(self.valid_through, msg.valid_through)
        if msg.valid_through >= 0:
            self.utc_ns = ns_from_stamp(msg.header.stamp)

    def poll(self) -> int:
        """Take what has come; returns the last sample sent."""
        if not self._there and self._source.get_publisher_count():
            self._there = True
            self._onlooker.publish(Watermark(node=ONLOOKER, ready=True))
        for _ in range(len(self.said) + 1):
            self.executor.spin_once(timeout_sec=0.0)
        if self.report is not None:
            self.report.poll(self.utc_ns)
        return self.valid_through

    def elapsed(self) -> float:
        """Wall time from the first block to now [s]."""
        return time.monotonic() - self.started_at if self.started_at else 0.0

    def __enter__(self) -> Self:
        """Return the watch."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> Any:
        """Leave the graph."""
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


def _progress(msg: Watermark) -> tuple[int, int, bool, bool]:
    return msg.valid_through, msg.consumed_through, msg.ready, msg.end_of_stream
