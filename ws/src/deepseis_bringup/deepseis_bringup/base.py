"""What a graph has to know of the base station in a recording."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from deepseis_bringup.graph import GraphConfig
from deepseis_core.errors import InputError
from deepseis_core.sample_clock import SampleClock
from deepseis_frontend.bag_topic import is_on
from deepseis_frontend.if_bag import first_messages
from deepseis_frontend.if_stream import IfSource
from deepseis_frontend.imu_open import is_bag
from deepseis_frontend.nodes.base_bag import REFERENCE_TOPIC, TOPIC
from deepseis_frontend.nodes.base_open import base_events
from deepseis_frontend.ntrip import address_of, is_address

LOOKED_AT = 4000
"""Messages at the beginning of a bag."""
HEADER_LINES = 200


def has_base(path: Path) -> bool:
    """Tell whether a bag begins with observations of a base among its messages."""
    return _begins_with(path, TOPIC)


def knows_its_base(path: Path) -> bool:
    """Tell whether a bag begins with the place of a base among its messages."""
    return _begins_with(path, REFERENCE_TOPIC)


def _begins_with(path: Path, topic: str) -> bool:
    if not is_bag(path):
        return False
    return any(is_on(m.channel, topic) for m in first_messages(path, LOOKED_AT))


def base_parameters(given: str, source: IfSource, start_utc_ns: int) -> dict[str, Any]:
    """Return parameters of ``base_source`` for a base that is not in the source's bag.

    Parameters
    ----------
    given : str
        A file, or an address.
    source : IfSource
        The IF samples.
    start_utc_ns : int
        UTC of sample 0; its epochs are put among the samples by it [ns since 1970].

    Raises
    ------
    InputError
        There is no such file, it holds no base, the address is none, or the time is not known.
    """
    if is_address(given):
        address_of(given)
    else:
        base_events(given, SampleClock(start_utc_ns, source.sample_rate_hz))
    if not start_utc_ns:
        hint = "--start-utc, or start_utc of the source"
        raise InputError(given, "cannot be played: the time of the samples is not known", hint)
    return {"sample_rate_hz": source.sample_rate_hz, "start_utc_ns": start_utc_ns}


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
    try:
        with path.open(encoding="ascii", errors="replace") as lines:
            for line in islice(lines, HEADER_LINES):
                if line[60:].strip() == "APPROX POSITION XYZ":
                    position = [float(part) for part in line[:60].split()]
                    if len(position) == 3 and 1e6 < np.linalg.norm(position) < 1e8:
                        return position
    except OSError as error:
        raise InputError(path, error.strerror or str(error)) from None
    except ValueError:
        raise InputError(path, "has an APPROX POSITION XYZ that is no position") from None
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
