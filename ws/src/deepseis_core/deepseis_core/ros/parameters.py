"""Settings dataclasses as ROS parameters: declared once, described, checked.

They are read-only, but for the few of `setting(live=True)`, whose node takes new values.
"""

from __future__ import annotations

from dataclasses import fields
from difflib import get_close_matches
from typing import Any, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node

from deepseis_core.config import check
from deepseis_core.errors import InputError

Config = TypeVar("Config")


_EMPTY_TEXTS, _EMPTY_NUMBERS = [""], [float("nan")]


def _descriptor(item: Any) -> ParameterDescriptor:
    described = ParameterDescriptor(
        description=item.metadata.get("description", ""),
        read_only=not item.metadata.get("live", False),
    )
    if item.metadata.get("choices"):
        described.additional_constraints = "one of " + ", ".join(item.metadata["choices"])
    low, high = item.metadata.get("low"), item.metadata.get("high")
    if low is not None and high is not None:
        if item.type in ("float", float):
            limits = FloatingPointRange(from_value=float(low), to_value=float(high))
            described.floating_point_range = [limits]
        elif item.type in ("int", int):
            described.integer_range = [IntegerRange(from_value=int(low), to_value=int(high))]
    return described


def declare(node: Node, config_type: type[Config]) -> Config:
    """Declare every field of a settings dataclass and return it filled.

    Raises
    ------
    InputError
        A value has the wrong type or is out of range.
    """
    default = config_type()
    values = {}
    for item in fields(config_type):  # type: ignore[arg-type]
        initial = getattr(default, item.name)
        try:
            if isinstance(initial, (list, tuple)) and not initial:
                initial = _EMPTY_NUMBERS if item.type == "list[float]" else _EMPTY_TEXTS
            parameter = node.declare_parameter(item.name, initial, _descriptor(item))
        except (InvalidParameterTypeException, InvalidParameterValueException) as error:
            raise InputError(f"parameter {item.name} of {node.get_name()}", str(error)) from None
        values[item.name] = plain(parameter.value)
    try:
        config = config_type(**values)
        check(config)
    except (TypeError, ValueError) as error:
        raise InputError(f"parameters of {node.get_name()}", str(error)) from None
    return config


def plain(value: Any) -> Any:
    """Return a parameter's value; lists without the blank or NaN that stands for an empty one.

    ROS cannot tell the type of an empty list.
    """
    if isinstance(value, list) or (hasattr(value, "tolist") and not isinstance(value, str)):
        return [entry for entry in list(value) if entry != "" and entry == entry]
    return value


def reject_unknown(node: Node) -> None:
    """Complain about parameters that were given but that nobody declared.

    Raises
    ------
    InputError
        Names them, and what may have been meant.
    """
    known = set(node.get_parameters_by_prefix("")) | set(node._parameters)
    given = set(node._parameter_overrides)
    unknown = sorted(name for name in given - known if not name.startswith("qos_overrides."))
    if unknown:
        what, names = f"node {node.get_name()}", sorted(known - {"use_sim_time"})
        meant = {near for name in unknown for near in get_close_matches(name, names, 2)}
        hint = (
            f"did you mean {', '.join(sorted(meant))}?" if meant else f"known: {', '.join(names)}"
        )
        raise InputError(what, f"unknown parameter {', '.join(unknown)}", hint)
