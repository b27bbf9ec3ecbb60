"""One door to every kind of base: bag, RINEX, RTCM 3 from a file or live."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

from deepseis_core.errors import InputError
from deepseis_core.rtcm_frame import PREAMBLE
from deepseis_core.sample_clock import SampleClock
from deepseis_frontend.base_events import BaseEvent
from deepseis_frontend.base_rtklib import rinex_events, rtcm_events
from deepseis_frontend.imu_open import is_bag
from deepseis_frontend.nodes.base_bag import BaseBag

_LOOKED_AT: Final = 4096
"""Bytes at the beginning of a file that tell RINEX from RTCM."""


def base_events(path: str | Path, clock: SampleClock) -> Iterator[BaseEvent]:
    """Return the events of a recorded base: a bag, RINEX observations or RTCM 3.

    Raises
    ------
    InputError
        There is no such file, or it is none of these.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(path, "does not exist")
    if path.is_dir() or is_bag(path):
        return BaseBag(path).events()
    with path.open("rb") as file:
        head = file.read(_LOOKED_AT)
    if b"RINEX VERSION / TYPE" in head[:200]:
        return rinex_events(path, clock)
    if PREAMBLE in head:
        return rtcm_events(path, clock)
    raise InputError(path, "holds no base", "a bag, RINEX observations, or RTCM 3")
