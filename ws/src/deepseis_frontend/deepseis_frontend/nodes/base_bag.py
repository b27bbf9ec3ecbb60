"""A base station out of a recorded bag (MCAP), on the clock of the IF samples."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from deepseis_core.geodesy import ecef_from_enu
from deepseis_core.types import Observations
from deepseis_frontend.bag_topic import bag_values, later
from deepseis_frontend.base_events import BaseEvent, BaseReference, in_order
from deepseis_frontend.if_bag import bag_files

TOPIC: Final = "base/observations"
TYPE: Final = "deepseis_msgs/msg/Observations"
REFERENCE_TOPIC: Final = "base/reference"
REFERENCE_TYPE: Final = "deepseis_msgs/msg/Station"


class BaseBag:
    """The base station of a bag.

    Parameters
    ----------
    path : path
        MCAP file or bag folder.

    Raises
    ------
    InputError
        It cannot be read.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.files = bag_files(path)

    def events(self) -> Iterator[BaseEvent]:
        """Yield references and epochs as recorded; none if there is no base in the bag.

        Raises
        ------
        InputError
            Where epochs go back in time, or the bag is damaged.
        """
        topics: dict[str, tuple[str, Any]] = {
            TOPIC: (TYPE, _epoch),
            REFERENCE_TOPIC: (REFERENCE_TYPE, _reference),
        }
        last, hint = -1, "the bag holds two bases, or two runs"
        for event in in_order(bag_values(self.path, self.files, topics)):
            if isinstance(event, Observations):
                last = later(self.path, "base epoch", event.sample_index, last, hint)
            yield event

    def epochs(self) -> Iterator[Observations]:
        """Yield the epochs alone."""
        return (event for event in self.events() if isinstance(event, Observations))


def _epoch(data: bytes) -> Observations:
    from deepseis_core.ros import codecs

    return codecs.OBSERVATIONS.decode(data)[0]


def _reference(data: bytes) -> BaseReference:
    from deepseis_core.ros import codecs

    station, utc_ns = codecs.STATION.decode(data)
    place = ecef_from_enu(station.antenna_lever_arm, station.monument_ecef)
    return BaseReference(utc_ns, place, station.name)
