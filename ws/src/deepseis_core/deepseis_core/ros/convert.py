"""Values of `deepseis_core.types` to messages and back, by field name.

Sequences go through the buffer protocol in both directions: the generated setters would look at
every element, so arrays are put into the message's slots directly (rosidl_generator_py copies
any contiguous buffer).
"""

from __future__ import annotations

from dataclasses import fields
from functools import cache
from importlib import import_module
from typing import Any, TypeVar

import numpy as np
from builtin_interfaces.msg import Time

Value = TypeVar("Value")

_DTYPES = {
    "double": np.float64,
    "float": np.float32,
    "int64": np.int64,
    "int32": np.int32,
    "uint32": np.uint32,
    "uint16": np.uint16,
    "uint8": np.uint8,
    "boolean": np.bool_,
}


def stamp_from_ns(utc_ns: int) -> Time:
    """UTC nanoseconds since 1970 as a message stamp."""
    return Time(sec=utc_ns // 1_000_000_000, nanosec=utc_ns % 1_000_000_000)


def ns_from_stamp(stamp: Time) -> int:
    """Stamp as UTC nanoseconds since 1970."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def message_class(type_name: str) -> Any:
    """Message class of a full type name such as ``sensor_msgs/msg/Imu``."""
    package, kind, name = type_name.split("/")
    return getattr(import_module(f"{package}.{kind}"), name)


@cache
def _plan(value_type: type, msg_type: Any) -> tuple[tuple[str, str, Any], ...]:
    """How each field is carried: array with dtype, names, or scalar."""
    plan = []
    annotations = {item.name: str(item.type) for item in fields(value_type)}
    for name, text in msg_type.get_fields_and_field_types().items():
        if name not in annotations:
            continue
        base = text.removeprefix("sequence<").split("[")[0].rstrip(">")
        if base == "string":
            kind = "names" if text.startswith("sequence<") else "text"
            plan.append((name, kind, None))
        elif text.startswith("sequence<") or "[" in text:
            is_tuple = annotations[name].startswith("tuple")
            plan.append((name, "numbers" if is_tuple else "array", _DTYPES[base]))
        else:
            plan.append((name, "float" if base in ("double", "float") else base, None))
    return tuple(plan)


def to_msg(value: Any, msg_type: Any, utc_ns: int) -> Any:
    """Build a message from a value; ``utc_ns`` is the time of validity for its header."""
    msg = msg_type()
    msg.header.stamp = stamp_from_ns(utc_ns)
    for name, kind, dtype in _plan(type(value), msg_type):
        item = getattr(value, name)
        if kind in ("array", "numbers"):
            item = np.ascontiguousarray(item, dtype).reshape(-1)
        elif kind == "names":
            item = list(item)
        elif kind == "float":
            item = float(item)
        elif kind == "boolean":
            item = bool(item)
        elif kind != "text":
            item = int(item)
        setattr(msg, "_" + name, item)
    return msg


def from_msg(msg: Any, value_type: type[Value]) -> Value:
    """Build a value from a message; arrays are views of the message's buffers."""
    values: dict[str, Any] = {}
    for name, kind, dtype in _plan(value_type, type(msg)):
        item = getattr(msg, "_" + name)
        if kind == "array":
            item = np.asarray(item, dtype)
        elif kind == "numbers":
            item = tuple(np.asarray(item, dtype).tolist())
        elif kind == "names":
            item = tuple(item)
        values[name] = item
    return value_type(**values)
