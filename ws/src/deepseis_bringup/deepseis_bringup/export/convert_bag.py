"""What a recorded bag holds for other formats: values by topic, in the order of the file."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from deepseis_bringup.export.quakeml import StationEvent
from deepseis_core.errors import InputError
from deepseis_core.imu_message import decode_imu
from deepseis_core.interface import RECORD, require_interface
from deepseis_core.mcap_scan import Channel, McapScan
from deepseis_core.ros import codecs
from deepseis_core.ros.cdr import Codec
from deepseis_core.ros.convert import ns_from_stamp
from deepseis_core.sample_clock import SampleClock
from deepseis_frontend.if_bag import bag_files
from deepseis_msgs import msg

_BY_STAMP = SampleClock(0, 1e9)
"""Counts nanoseconds: the IMU is read by its stamps."""


@dataclass(frozen=True)
class _EventMessage:
    event_id: str
    onset: Any
    ended: bool
    onset_ratio: float
    peak_displacement: float
    peak_velocity: float
    peak_acceleration: float
    hypocentral_distance: float
    magnitude: float
    magnitude_sd: float


_EVENT = Codec(_EventMessage, msg.SeismicEvent)


def _decode_event(data: bytes) -> tuple[StationEvent, int]:
    message, utc_ns = _EVENT.decode(data)
    values = {**vars(message)}
    onset = ns_from_stamp(values.pop("onset"))
    return StationEvent(utc_ns=utc_ns, onset_utc_ns=onset, **values), utc_ns


def _decode_imu(data: bytes) -> tuple[Any, int]:
    return decode_imu(data, _BY_STAMP)


Decode = Callable[[bytes], tuple[Any, int]]

TOPICS: Final[Mapping[str, tuple[str, Decode]]] = {
    "station": ("deepseis_msgs/msg/Station", codecs.STATION.decode),
    "seismo/displacement": ("deepseis_msgs/msg/Displacement", codecs.DISPLACEMENT.decode),
    "seismo/event": ("deepseis_msgs/msg/SeismicEvent", _decode_event),
    "imu/data_raw": ("sensor_msgs/msg/Imu", _decode_imu),
    "gnss/observations": ("deepseis_msgs/msg/Observations", codecs.OBSERVATIONS.decode),
    "gnss/ephemeris": ("deepseis_msgs/msg/Ephemeris", codecs.EPHEMERIS.decode),
    "gnss/pvt": ("deepseis_msgs/msg/Pvt", codecs.PVT.decode),
    "gnss/rtk": ("deepseis_msgs/msg/PrecisePosition", codecs.PRECISE_POSITION.decode),
    "gnss/precise": ("deepseis_msgs/msg/PrecisePosition", codecs.PRECISE_POSITION.decode),
    "motion/state": ("deepseis_msgs/msg/MotionState", codecs.MOTION_STATE.decode),
}
"""Type and reader of each topic, below the station's namespace."""


class ConvertBag:
    """A bag of one station, whole, cut short or damaged.

    Parameters
    ----------
    path : path
        Folder or MCAP file.

    Raises
    ------
    InputError
        There is no bag, it is of another interface version, or, while it is read, a message
        cannot be read or another station appears.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.files = path, bag_files(path)
        self.metadata: dict[str, dict[str, str]] = {}
        self.is_whole = True
        self._namespace: dict[str, str] = {}

    def values(self, topics: Iterable[str]) -> Iterator[tuple[str, Any, int]]:
        """Yield topic, value and the stamp of its header [ns UTC] of the topics named."""
        wanted = set(topics)
        for file in self.files:
            scan = McapScan(file, tolerant=True)
            checked = False
            for message in scan.messages(lambda channel: self._topic_of(channel) in wanted):
                if not checked and RECORD in scan.metadata:
                    require_interface(file, scan.metadata)
                    checked = True
                topic = self._topic_of(message.channel)
                try:
                    value, utc_ns = TOPICS[topic][1](bytes(message.data))
                except ValueError as error:
                    raise InputError(
                        file, f"holds an unreadable message on {message.channel.topic}: {error}"
                    ) from None
                yield topic, value, utc_ns
            self.metadata |= scan.metadata
            self.is_whole &= scan.cut_at is None and not scan.damaged_chunks

    def _topic_of(self, channel: Channel) -> str:
        """Return the topic without the namespace; empty if it is none of ours."""
        for topic, (type_name, _) in TOPICS.items():
            full = "/" + channel.topic.lstrip("/")
            if full.endswith("/" + topic) and channel.type_name == type_name:
                space = full[: -len(topic) - 1]
                known = self._namespace.setdefault(topic, space)
                if known != space:
                    reason = f"holds {known}/{topic} and {space}/{topic}"
                    raise InputError(self.path, reason, "one station at a time")
                return topic
        return ""
