"""Timers that a wall clock which is set does not stop.

A timer of rclpy goes by the node's clock, the wall clock: set back by an hour, it would not fire
for an hour, and every deadline of real time would be an hour late.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node


def every(node: Node, seconds: float, callback: Callable[[], object]) -> Any:
    """Call back at a steady period; returns the timer."""
    steady = Clock(clock_type=ClockType.STEADY_TIME)
    return node.create_timer(seconds, callback, clock=steady)
