"""What a bag says of its station."""

from __future__ import annotations

from pathlib import Path

from deepseis_core.errors import InputError
from deepseis_core.mcap_scan import Channel
from deepseis_core.ros import codecs
from deepseis_core.ros.cdr import CdrError
from deepseis_core.types import Station
from deepseis_frontend.if_bag import first_messages

TYPE = "deepseis_msgs/msg/Station"
LOOKED_AT = 2000
"""Messages at the beginning of a bag."""


def read_station(path: str | Path) -> tuple[Station, int] | None:
    """Return the station of a bag and the UTC from which it holds [ns]; None if it has none.

    It is looked for in the first messages only: a station is said at the start.

    Raises
    ------
    InputError
        It is there and cannot be read.
    """
    for message in first_messages(path, LOOKED_AT):
        if _is_station(message.channel):
            try:
                return codecs.STATION.decode(bytes(message.data))
            except CdrError as error:
                raise InputError(path, f"holds an unreadable station: {error}") from None
    return None


def _is_station(channel: Channel) -> bool:
    return ("/" + channel.topic).endswith("/station") and channel.type_name == TYPE
