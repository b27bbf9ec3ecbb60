"""Settings declared once, beside the algorithm that uses them, without ROS."""

from __future__ import annotations

import dataclasses
from typing import Any


def setting(
    default: Any,
    description: str,
    *,
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] = (),
    live: bool = False,
) -> Any:
    """Declare one field of a frozen settings dataclass.

    Parameters
    ----------
    default : Any
        Value used where nothing overrides it; its type is the setting's type.
    description : str
        What it is, with its unit in square brackets.
    low, high : float, optional
        Inclusive limits of a number.
    choices : tuple of str, optional
        The values a text may take.
    live : bool
        The node that declares it takes another value while it runs.
    """
    metadata = {
        "description": description, "low": low, "high": high, "choices": choices, "live": live,
    }  # fmt: skip
    if isinstance(default, list):
        return dataclasses.field(default_factory=lambda: list(default), metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


def check(config: Any) -> None:
    """Raise ``ValueError`` naming the first field of a settings dataclass outside its limits.

    Limits and choices hold for each item of a tuple.
    """
    for item in dataclasses.fields(config):
        whole = getattr(config, item.name)
        low, high = item.metadata.get("low"), item.metadata.get("high")
        choices = item.metadata.get("choices") or ()
        for value in whole if isinstance(whole, tuple) else (whole,):
            if (low is not None and value < low) or (high is not None and value > high):
                raise ValueError(f"{item.name} = {value} is outside [{low}, {high}]")
            if choices and value not in choices:
                raise ValueError(f"{item.name} = {value!r} is not one of {', '.join(choices)}")
