"""Input bags: the values of the bench, or of anyone's sensors, written as a recording."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Final

from deepseis_bringup.bags.mcap_recording import BagWriter
from deepseis_bringup.bags.ros_definitions import TopicQos
from deepseis_bringup.graph import TYPES
from deepseis_core.imu_message import encode_imu
from deepseis_core.ros import codecs, qos

ENCODERS: Final[Mapping[str, Callable[[Any, int], bytes]]] = {
    "station": codecs.STATION.encode,
    "if/samples": codecs.IF_BLOCK.encode,
    "imu/data_raw": encode_imu,
    "ldv/velocity": codecs.LDV_VELOCITY.encode,
    "base/observations": codecs.OBSERVATIONS.encode,
    "gnss/ephemeris": codecs.EPHEMERIS.encode,
    "gnss/observations": codecs.OBSERVATIONS.encode,
    "gnss/pvt": codecs.PVT.encode,
    "truth": codecs.TRUTH.encode,
}
"""How the value of a topic becomes its message; also the order of what is valid at one moment."""

ORDER: Final = {topic: number for number, topic in enumerate(ENCODERS)}

FOREVER_S: Final = 1e6
"""Longer than any simulation takes [s]."""


class InputBag:
    """Writes values to a bag that replays as input; a context manager.

    Parameters
    ----------
    folder : path
        The bag's folder, made new.
    start_utc_ns : int
        UTC of sample 0 [ns since 1970].
    records : mapping of mappings, optional
        Metadata records.
    """

    def __init__(
        self,
        folder: Path,
        start_utc_ns: int,
        records: Mapping[str, Mapping[str, Any]] | None = None,
    ) -> None:
        self.start_utc_ns = start_utc_ns
        # Chunks are closed when they are full, never by the clock: same seed, same bytes.
        self.bag = BagWriter(folder, records, flush_interval=FOREVER_S)
        self.counts = dict.fromkeys(ENCODERS, 0)

    def write(self, topic: str, value: Any, offset_ns: int, stamp_ns: int | None = None) -> None:
        """Write a value that is valid ``offset_ns`` after sample 0.

        ``stamp_ns`` is the moment that it is about, if that is another.
        """
        type_name, quality = TYPES[topic]
        if not self.counts[topic]:
            self.bag.add_topic(f"/{topic}", type_name, offered(quality))
        self.counts[topic] += 1
        valid = self.start_utc_ns + offset_ns
        stamp = valid if stamp_ns is None else self.start_utc_ns + stamp_ns
        self.bag.write(f"/{topic}", type_name, ENCODERS[topic](value, stamp), valid, valid)

    def __enter__(self) -> InputBag:
        """Return itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the bag, whatever happened."""
        self.bag.__exit__(kind, error, trace)


def offered(quality: str) -> TopicQos:
    """Return what a publisher of a quality of service (`deepseis_core.ros.qos`) offers."""
    profile = qos.BY_NAME[quality]
    durability = "transient_local" if quality == "latched" else "volatile"
    return TopicQos(depth=profile.depth, durability=durability)
