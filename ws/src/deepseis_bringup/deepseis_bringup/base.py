"""What a graph has to know of the base station in a recording."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np

from deepseis_bringup.graph import GraphConfig
from deepseis_core.errors import InputError
from deepseis_core.mcap_scan import McapScan
from deepseis_frontend.if_bag import bag_files
from deepseis_frontend.imu_open import is_bag
from deepseis_frontend.nodes.base_bag import TOPIC

LOOKED_AT = 4000
"""Messages at the beginning of a bag."""
HEADER_LINES = 200


def has_base(path: Path) -> bool:
    """Tell whether a bag begins with observations of a base among its messages."""
    if not is_bag(path):
        return False
    first = McapScan(bag_files(path)[0], tolerant=True).messages()
    return any(("/" + m.channel.topic).endswith("/" + TOPIC) for m in islice(first, LOOKED_AT))


def base_position(bag: Path) -> list[float]:
    """Return the base's antenna [m ECEF] by its RINEX file (``BASE*.rnx``) beside a bag.

    Empty if there is no such file.

    Raises
    ------
    InputError
        The file does not say where the base is.
    """
    files = sorted(bag.resolve().parent.glob("BASE*.rnx"))
    return rinex_position(files[0]) if files else []


def rinex_position(path: Path) -> list[float]:
    """Return the approximate position in a RINEX observation file's header [m ECEF].

    Raises
    ------
    InputError
        There is none.
    """
    with path.open(encoding="ascii", errors="replace") as lines:
        for line in islice(lines, HEADER_LINES):
            if line[60:].strip() == "APPROX POSITION XYZ":
                position = [float(part) for part in line[:60].split()]
                if len(position) == 3 and np.linalg.norm(position) > 1e6:
                    return position
    raise InputError(path, "does not say where its antenna is", "APPROX POSITION XYZ")


def with_base(config: GraphConfig) -> GraphConfig:
    """Return a graph that solves against the base in its source's bag, too.

    Raises
    ------
    InputError
        There is no base, or its place is not known.
    """
    bag = Path(config.source["file"])
    place = base_position(bag) if has_base(bag) else []
    if not place:
        raise InputError(bag, "has no base station", "with its BASE*.rnx beside the bag")
    pvt = {**config.parameters.get("pvt", {}), "base_position_ecef": place}
    return replace(config, base=True, parameters={**config.parameters, "pvt": pvt})
