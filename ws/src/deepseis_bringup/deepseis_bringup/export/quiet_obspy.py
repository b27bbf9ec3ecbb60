"""ObsPy without the warnings that its import gives: it takes a second, so only who needs it."""

from __future__ import annotations

import warnings
from functools import cache
from importlib import import_module
from typing import Any


@cache
def obspy_modules() -> Any:
    """Return the package, with ``core.event``, ``core.inventory`` and ``io.mseed`` imported."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name in ("core.event", "core.inventory", "io.mseed.core"):
            import_module(f"obspy.{name}")
        return import_module("obspy")
