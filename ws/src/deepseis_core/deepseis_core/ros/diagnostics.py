"""Diagnostics with levels that mean something, stamped by validity time."""

from __future__ import annotations

from collections.abc import Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from deepseis_core.ros.cdr import encode_message
from deepseis_core.ros.convert import stamp_from_ns

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


def array(
    name: str, level: bytes, text: str, values: Mapping[str, object], utc_ns: int
) -> DiagnosticArray:
    """One status as a message: OK works as meant, WARN data were lost, ERROR no output."""
    status = DiagnosticStatus(level=level, name=f"deepseis: {name}", message=text)
    status.hardware_id = name
    status.values = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
    msg = DiagnosticArray(status=[status])
    msg.header.stamp = stamp_from_ns(utc_ns)
    return msg


def encoded(
    name: str, level: bytes, text: str, values: Mapping[str, object], utc_ns: int
) -> bytes:
    """One status, serialised (`deepseis_core.ros.cdr`: the same bytes every time)."""
    return encode_message(array(name, level, text, values, utc_ns))
