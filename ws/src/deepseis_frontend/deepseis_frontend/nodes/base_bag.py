"""A base station's observations out of a recorded bag (MCAP), on the clock of the IF samples."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

from deepseis_core.errors import InputError
from deepseis_core.interface import RECORD, require_interface
from deepseis_core.mcap_scan import Channel, McapScan
from deepseis_core.types import Observations
from deepseis_frontend.if_bag import bag_files

TOPIC: Final = "base/observations"
TYPE: Final = "deepseis_msgs/msg/Observations"


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

    def epochs(self) -> Iterator[Observations]:
        """Yield the base's epochs as recorded; none if there is no base in the bag.

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
                    epoch: Observations = codecs.OBSERVATIONS.decode(bytes(message.data))[0]
                except CdrError as error:
                    reason = f"holds an unreadable message on {message.channel.topic}: {error}"
                    raise InputError(file, reason) from None
                if epoch.sample_index <= last:
                    reason = f"base epoch at {epoch.sample_index} comes after that at {last}"
                    raise InputError(file, reason, "the bag holds two bases, or two runs")
                last = epoch.sample_index
                yield epoch

    def _is_wanted(self, channel: Channel) -> bool:
        wanted = ("/" + channel.topic).endswith("/" + TOPIC)
        if wanted and (channel.type_name != TYPE or channel.encoding != "cdr"):
            reason = f"{channel.topic} is {channel.type_name} in {channel.encoding}"
            raise InputError(self.path, reason, f"not {TYPE}")
        return wanted
