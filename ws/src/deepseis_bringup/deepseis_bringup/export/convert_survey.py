"""What must be known before a bag is converted: its station, positions and clocks."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deepseis_bringup.export.convert_bag import ConvertBag
from deepseis_bringup.export.true_time import TimeFinder, TrueTime
from deepseis_core.types import Pvt, PvtStatus, Station
from deepseis_pvt.rinex_obs import VERSIONS

Say = Callable[[str], None]


@dataclass(frozen=True)
class ConvertOptions:
    """What the user may choose; empty: what the bag says."""

    network: str = ""
    station: str = ""
    rinex_version: str = VERSIONS[0]
    rinex_name: str = ""
    alias: bool = False
    rtcm_rate_hz: float = 1.0


@dataclass(frozen=True)
class Survey:
    """What must be known of a bag before it is converted."""

    bag: ConvertBag
    time: TrueTime
    station: Station | None
    first_position: np.ndarray | None
    newest_utc_ns: int


def survey(path: Path) -> Survey:
    """Read a bag's station, positions and clocks."""
    bag = ConvertBag(path)
    station, position, newest = None, None, 0
    positions: list[Pvt] = []
    stamp: tuple[int, int] | None = None
    for topic, value, utc_ns in bag.values(("station", "gnss/pvt", "motion/state")):
        newest = max(newest, utc_ns)
        if topic == "station":
            station = value
        elif topic == "gnss/pvt":
            positions.append(value)
            if position is None and value.status != PvtStatus.NONE:
                position = value.position_ecef
        elif stamp is None:
            stamp = value.sample_index, utc_ns
    finder = TimeFinder(sample_rate_of(bag.metadata))
    if stamp is not None:
        finder.take_stamp(*stamp)
    for pvt in positions:
        finder.take_pvt(pvt)
    return Survey(bag, finder.finish(), station, position, newest)


def sample_rate_of(metadata: dict[str, dict[str, str]]) -> float | None:
    """Return the rate of IF samples [Hz] that a bag's records name; None if they do not."""
    for node in ("pvt", "fusion", "motion_state"):
        try:
            return float(json.loads(metadata["parameters"][node])["sample_rate_hz"])
        except (KeyError, ValueError, TypeError):
            continue
    return None
