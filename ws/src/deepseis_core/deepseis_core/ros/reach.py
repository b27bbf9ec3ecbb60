"""How far DDS reaches: this machine, unless the environment asks for the network.

``ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST`` alone stops others from being found, but Fast DDS still
listens on every interface and takes what is sent to it there. So it is not left to the rmw.
"""

from __future__ import annotations

from collections.abc import MutableMapping
from pathlib import Path
from typing import Final

RANGE: Final = "ROS_AUTOMATIC_DISCOVERY_RANGE"
PROFILE: Final = "FASTRTPS_DEFAULT_PROFILES_FILE"
NETWORK: Final = Path(__file__).with_name("fastdds.xml")
LOCAL: Final = Path(__file__).with_name("fastdds_local.xml")


def choose_reach(environment: MutableMapping[str, str]) -> None:
    """Name DDS' profile in the environment; one that is named there goes first.

    Parameters
    ----------
    environment : mutable mapping
        Of the process. LOCALHOST, or no range: sockets on 127.0.0.1 only. Any other range: that.

    Examples
    --------
    >>> environment = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    >>> choose_reach(environment)
    >>> Path(environment[PROFILE]).name, environment[RANGE]
    ('fastdds_local.xml', 'SYSTEM_DEFAULT')
    """
    if environment.get(PROFILE):
        return
    if (environment.get(RANGE) or "LOCALHOST") == "LOCALHOST":
        environment[PROFILE] = str(LOCAL)
        environment[RANGE] = "SYSTEM_DEFAULT"  # the rmw would add a transport of its own
        return
    environment[PROFILE] = str(NETWORK)
