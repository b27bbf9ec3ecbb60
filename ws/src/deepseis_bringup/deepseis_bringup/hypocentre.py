"""Tells a running station where an earthquake was: its events then have a magnitude."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient

from deepseis_core.errors import InputError
from deepseis_core.ros import codecs, qos
from deepseis_core.ros.codecs import subscribe
from deepseis_core.ros.reach import choose_reach
from deepseis_core.types import SeismicEvent

NODE: Final = "seismic_event"
WAIT_S: Final = 10.0
"""For the station to be found and to answer [s]."""
ASK_AGAIN_S: Final = 2.0
"""A reply may be lost while who asks is not known yet (rmw_fastrtps, issue 842) [s]."""
REPORT_S: Final = 1.5
"""For reports from before, and the one that follows [s]."""


def hypocentre_of(text: str) -> list[float]:
    """Return latitude, longitude [deg] and depth [km] of a text.

    Raises
    ------
    InputError
        They are not three numbers.

    Examples
    --------
    >>> hypocentre_of("38.297, 142.373, 29")
    [38.297, 142.373, 29.0]
    """
    try:
        latitude, longitude, depth = (float(word) for word in text.replace(",", " ").split())
    except ValueError:
        hint = "'latitude longitude depth' [deg deg km], as '38.297 142.373 29'"
        raise InputError("hypocentre", f"is {text!r}", hint) from None
    return [latitude, longitude, depth]


@dataclass
class _Heard:
    """Reports of events; those known before come at once, for they are latched."""

    events: list[SeismicEvent] = field(default_factory=list)

    def take(self, event: SeismicEvent, _utc_ns: int) -> None:
        self.events.append(event)


def tell(
    hypocentre: list[float], station: str = "", environment: Mapping[str, str] | None = None
) -> SeismicEvent | None:
    """Give a running station a hypocentre; return the newest report of an event after that.

    Parameters
    ----------
    hypocentre : list of float
        Latitude, longitude [deg], depth [km]; empty: take it back.
    station : str
        Its namespace.
    environment : mapping, optional
        Its ROS_DOMAIN_ID counts; None: the process' own.

    Raises
    ------
    InputError
        There is no such station, or it does not take it.
    """
    choose_reach(os.environ)
    number = (os.environ if environment is None else environment).get("ROS_DOMAIN_ID")
    context, heard = Context(), _Heard()
    rclpy.init(context=context, domain_id=int(number) if number else None)
    name = f"hypocentre_{os.getpid()}"
    node = Node(
        name, context=context, namespace=station, start_parameter_services=False,
        enable_rosout=False,
    )  # fmt: skip
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)

    def until(condition: Callable[[], bool], seconds: float) -> bool:
        deadline = time.monotonic() + seconds
        while not condition() and time.monotonic() < deadline:
            executor.spin_once(timeout_sec=0.05)
        return condition()

    try:
        subscribe(node, codecs.SEISMIC_EVENT, "seismo/event", heard.take, qos.LATCHED)
        _set(node, until, hypocentre or [float("nan")], station)
        until(lambda: False, REPORT_S)  # of older events and the new one, the new one comes last
        return heard.events[-1] if heard.events else None
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)


def _set(
    node: Node,
    until: Callable[[Callable[[], bool], float], bool],
    value: list[float],
    station: str,
) -> None:
    where = f"station {station}" if station else "station"
    client = AsyncParameterClient(node, NODE)
    if not until(client.services_are_ready, WAIT_S):
        hint = "--station NAME, ROS_DOMAIN_ID; events need a station with an IMU"
        raise InputError(where, f"no node {NODE} answers", hint)
    parameter = Parameter("hypocentre", Parameter.Type.DOUBLE_ARRAY, value)
    futures: list[Any] = []

    def answered() -> bool:
        return any(future.done() for future in futures)

    for _ in range(round(WAIT_S / ASK_AGAIN_S)):
        futures.append(client.set_parameters([parameter]))
        if until(answered, ASK_AGAIN_S):
            break
    else:
        raise InputError(where, f"node {NODE} does not answer")
    answer = next(future.result() for future in futures if future.done())
    (result,) = answer.results
    if not result.successful:
        raise InputError(where, result.reason)
