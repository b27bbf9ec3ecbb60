"""Whose a status of ``/diagnostics`` is: one topic for all stations of a ROS domain."""

from __future__ import annotations

from typing import Any, Final

OURS: Final = "deepseis: "
"""How the names of our statuses begin; then ``STATION/node``, or ``node`` of a nameless one."""


def name_of(node: str, namespace: str) -> str:
    """Return what a node's statuses are called.

    Examples
    --------
    >>> name_of("pvt", "/KOBE"), name_of("pvt", "/")
    ('KOBE/pvt', 'pvt')
    """
    station = namespace.strip("/")
    return f"{station}/{node}" if station else node


def node_of(status: Any) -> str:
    """Return who says a status, without the station's name; of others' statuses what they give.

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> node_of(SimpleNamespace(name="deepseis: KOBE/pvt", hardware_id="KOBE/pvt"))
    'pvt'
    >>> node_of(SimpleNamespace(name="lidar", hardware_id="/dev/ttyUSB0"))
    '/dev/ttyUSB0'
    """
    who = str(status.hardware_id or status.name)
    return who.rpartition("/")[2] if status.name.startswith(OURS) else who


def is_of(name: str, namespace: str) -> bool:
    """Tell by its name whether a status is not that of another station.

    Examples
    --------
    >>> is_of("deepseis: KOBE/pvt", "/KOBE"), is_of("deepseis: pvt", "/KOBE"), is_of("lidar", "/")
    (True, False, True)
    """
    station = name.removeprefix(OURS).rpartition("/")[0]
    return not name.startswith(OURS) or station == namespace.strip("/")
