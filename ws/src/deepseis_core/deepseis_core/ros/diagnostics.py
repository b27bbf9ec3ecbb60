"""Diagnostics with levels that mean something, stamped by validity time.

``/diagnostics`` is one topic for all stations of a ROS domain, as everywhere in ROS. A status says
whose it is: ``deepseis: STATION/node``, of a station without a name ``deepseis: node``.
"""

from __future__ import annotations

from collections.abc import Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from deepseis_core.ros.cdr import encode_message
from deepseis_core.ros.convert import stamp_from_ns
from deepseis_core.status_names import OURS, name_of

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
_process = {"namespace": ""}


def of_station(namespace: str) -> None:
    """Say that the nodes of this process are those of a station: statuses get its name."""
    _process["namespace"] = namespace


def array(
    name: str,
    level: bytes,
    text: str,
    values: Mapping[str, object],
    utc_ns: int,
    namespace: str | None = None,
) -> DiagnosticArray:
    """One status as a message: OK works as meant, WARN data were lost, ERROR no output."""
    who = name_of(name, _process["namespace"] if namespace is None else namespace)
    status = DiagnosticStatus(level=level, name=f"{OURS}{who}", message=text)
    status.hardware_id = who
    status.values = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
    msg = DiagnosticArray(status=[status])
    msg.header.stamp = stamp_from_ns(utc_ns)
    return msg


def encoded(
    name: str,
    level: bytes,
    text: str,
    values: Mapping[str, object],
    utc_ns: int,
    namespace: str | None = None,
) -> bytes:
    """One status, serialised (`deepseis_core.ros.cdr`: the same bytes every time)."""
    return encode_message(array(name, level, text, values, utc_ns, namespace))
