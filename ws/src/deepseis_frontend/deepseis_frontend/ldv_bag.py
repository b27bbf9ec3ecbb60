"""A velocimeter's measurements out of a recorded bag (MCAP), on the clock of the IF samples."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

from deepseis_core.errors import InputError
from deepseis_core.interface import RECORD, require_interface
from deepseis_core.mcap_scan import Channel, McapScan
from deepseis_core.types import LdvVelocity
from deepseis_frontend.if_bag import bag_files

TOPIC: Final = "ldv/velocity"
TYPE: Final = "deepseis_msgs/msg/LdvVelocity"


class LdvBag:
    """The velocimeter of a bag.

    Parameters
    ----------
    path : path
        MCAP file or bag folder.

    Raises
    ------
    InputError
        There is none in the bag, or it cannot be read.
    """

    def __init__(self, path: str | Path) -> None:
        self.path, self.files = Path(path), bag_files(path)
        if next(self.measurements(), None) is None:
            raise InputError(self.path, f"holds no velocimeter: nothing on a topic {TOPIC}")

    def measurements(self) -> Iterator[LdvVelocity]:
        """Yield the measurements as recorded.

        Raises
        ------
        InputError
            Where they go back in time, or the bag is damaged.
        """
        from deepseis_core.ros import codecs
        from deepseis_core.ros.cdr import CdrError

        last = -1
        for file in self.files:
            scan = McapScan(file)
            for message in scan.messages(self._is_wanted):
                if RECORD in scan.metadata:
                    require_interface(file, scan.metadata)
                try:
                    value: LdvVelocity = codecs.LDV_VELOCITY.decode(bytes(message.data))[0]
                except CdrError as error:
                    reason = f"holds an unreadable message on {message.channel.topic}: {error}"
                    raise InputError(file, reason) from None
                if value.sample_index <= last:
                    reason = f"velocity at {value.sample_index} comes after that at {last}"
                    raise InputError(file, reason, "the bag holds two velocimeters, or two runs")
                last = value.sample_index
                yield value

    def _is_wanted(self, channel: Channel) -> bool:
        wanted = ("/" + channel.topic).endswith("/" + TOPIC)
        if wanted and (channel.type_name != TYPE or channel.encoding != "cdr"):
            reason = f"{channel.topic} is {channel.type_name} in {channel.encoding}"
            raise InputError(self.path, reason, f"not {TYPE}")
        return wanted
