"""What a run said, in columns, from a graph's recording or from the chain in one process."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from deepseis_core.mcap_scan import McapScan
from deepseis_core.ros import codecs
from deepseis_core.status_names import node_of
from deepseis_core.types import (
    Aiding,
    Displacement,
    DisplacementSource,
    FloatArray,
    Observations,
    PrecisePosition,
    PreciseStatus,
    Pvt,
    PvtStatus,
    TrackingEpochs,
    TrackingFlag,
)
from deepseis_frontend.if_bag import bag_files

DECODERS: Final[Mapping[str, Callable[[bytes], tuple[Any, int]]]] = {
    "gnss/observations": codecs.OBSERVATIONS.decode,
    "gnss/pvt": codecs.PVT.decode,
    "gnss/precise": codecs.PRECISE_POSITION.decode,
    "gnss/rtk": codecs.PRECISE_POSITION.decode,
    "aiding/doppler": codecs.DOPPLER_AIDING.decode,
    "seismo/displacement": codecs.DISPLACEMENT.decode,
}


LOCK: Final = "lock of "
"""A satellite's name follows."""

Timeline = tuple[FloatArray, NDArray[np.bool_]]
"""Times [s] in order, and whether there was something good, (m,) each."""


@dataclass(frozen=True)
class Said:
    """One status of a node: when [s], who, level (1 warning, 2 error), text."""

    time: float
    node: str
    level: int
    text: str


@dataclass
class RunRecord:
    """What a run said; times in seconds of the recording.

    Parameters
    ----------
    rate_hz : float
        Of the IF samples.
    start_tow_ns : int
        GPS time of week of sample 0.
    """

    rate_hz: float
    start_tow_ns: int
    observations: list[Observations] = field(default_factory=list)
    aiding: list[tuple[float, bool]] = field(default_factory=list)
    pvt: list[tuple[float, bool]] = field(default_factory=list)
    precise: list[tuple[float, bool, FloatArray]] = field(default_factory=list)
    phases: list[tuple[float, bool]] = field(default_factory=list)
    rtk: list[tuple[float, bool, FloatArray]] = field(default_factory=list)
    fused: list[Displacement] = field(default_factory=list)
    flags: dict[str, list[tuple[float, int]]] = field(default_factory=dict)
    said: list[Said] = field(default_factory=list)

    def take(self, topic: str, value: Any) -> None:
        """Take one value of a topic; others than those of interest are left aside."""
        if topic == "gnss/observations":
            self.observations.append(value)
        elif topic == "aiding/doppler":
            self._take_aiding(value)
        elif topic == "gnss/pvt":
            self._take_pvt(value)
        elif topic in ("gnss/precise", "gnss/rtk"):
            self._take_precise(topic, value)
        elif topic == "seismo/displacement" and value.source == DisplacementSource.FUSED:
            if not value.smoothed:
                self.fused.append(value)
        elif topic.startswith("tracking/"):
            self._take_epochs(value)

    def take_all(self, payloads: Mapping[str, Iterable[bytes]], start_utc_ns: int) -> None:
        """Take what a graph recorded, by topic without the leading slash."""
        for topic, messages in payloads.items():
            for data in messages:
                self.take_bytes(topic, data, start_utc_ns)

    def read(self, bag: Path, start_utc_ns: int) -> None:
        """Take what a bag holds, message by message."""
        for file in bag_files(bag):
            for message in McapScan(file, tolerant=True).messages():
                topic = message.channel.topic.lstrip("/")
                self.take_bytes(topic, bytes(message.data), start_utc_ns)

    def take_bytes(self, topic: str, data: bytes, start_utc_ns: int) -> None:
        """Take a message of a topic without the leading slash."""
        if topic == "diagnostics":
            self.said += statuses((data,), start_utc_ns)
        elif topic.startswith("tracking/"):
            self.take(topic, codecs.TRACKING_EPOCHS.decode(data)[0])
        elif topic in DECODERS:
            self.take(topic, DECODERS[topic](data)[0])

    def _take_aiding(self, value: Aiding) -> None:
        self.aiding.append((value.valid_from / self.rate_hz, value.valid))

    def _take_pvt(self, value: Pvt) -> None:
        self.pvt.append((value.sample_index / self.rate_hz, value.status != PvtStatus.NONE))

    def _take_precise(self, topic: str, value: PrecisePosition) -> None:
        least = PreciseStatus.PHASE if topic == "gnss/precise" else PreciseStatus.FIX
        stream = self.precise if topic == "gnss/precise" else self.rtk
        time = (value.tow_ns - self.start_tow_ns) * 1e-9
        stream.append((time, value.status >= least, np.asarray(value.displacement_enu)))
        if topic == "gnss/precise":  # from a place not known too: the fusion knows it
            self.phases.append((time, value.status >= least or value.datum > 0))

    def _take_epochs(self, value: TrackingEpochs) -> None:
        rows = self.flags.setdefault(value.satellite, [])
        times = np.asarray(value.sample_index) / self.rate_hz
        rows += zip(times.tolist(), np.asarray(value.flags).tolist(), strict=True)

    # What came out

    def observed(self) -> dict[str, tuple[FloatArray, FloatArray, FloatArray]]:
        """Return times [s], carrier phases [cycles] and LLI of every satellite."""
        found: dict[str, list[tuple[float, float, float]]] = {}
        for epoch in self.observations:
            time = (epoch.sample_index + epoch.sample_fraction) / self.rate_hz
            rows = zip(epoch.satellites, epoch.carrier_phase_cycles, epoch.lli, strict=True)
            for name, phase, lli in rows:
                found.setdefault(name, []).append((time, float(phase), float(lli)))
        columns = {name: np.array(rows).T for name, rows in sorted(found.items())}
        return {name: (rows[0], rows[1], rows[2]) for name, rows in columns.items()}

    def timelines(self) -> dict[str, Timeline]:
        """Return when [s] each kind of output was due, and whether it was there."""
        t, _, _ = self.displacement()
        found = {
            "aiding": _timeline(self.aiding),
            "position": _timeline(self.pvt),
            "phase displacement": _timeline(self.phases),
            "fused displacement": (t, np.ones(t.size, np.bool_)),
        }
        for name, rows in sorted(self.flags.items()):
            mask = int(TrackingFlag.PHASE_LOCK)
            found[LOCK + name] = _timeline([(at, bool(flags & mask)) for at, flags in rows])
        return found

    def displacement(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return times, fused displacement (m, 3) and its sigmas (m, 3) [s, m, m]."""
        if not self.fused:
            return np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3))
        times = np.concatenate([item.tow_ns for item in self.fused])
        moved = np.concatenate([np.reshape(item.displacement, (-1, 3)) for item in self.fused])
        sd = np.concatenate([np.reshape(item.displacement_sd, (-1, 3)) for item in self.fused])
        return (times - self.start_tow_ns) * 1e-9, moved, sd


def _timeline(rows: Sequence[tuple[float, bool]]) -> Timeline:
    return np.array([at for at, _ in rows]), np.array([good for _, good in rows], np.bool_)


def positions(
    stream: Sequence[tuple[float, bool, FloatArray]],
) -> tuple[FloatArray, FloatArray]:
    """Return times [s] and displacements (m, 3) [m] of the epochs that have one."""
    there = [(time, moved) for time, good, moved in stream if good]
    times = np.array([time for time, _ in there])
    return times, np.array([moved for _, moved in there]).reshape(-1, 3)


def statuses(messages: Iterable[bytes], start_utc_ns: int) -> list[Said]:
    """Return what ``/diagnostics`` held, with times since the start of the recording."""
    from diagnostic_msgs.msg import DiagnosticArray
    from rclpy.serialization import deserialize_message

    found = []
    for data in messages:
        array = deserialize_message(data, DiagnosticArray)
        stamp = array.header.stamp.sec * 10**9 + array.header.stamp.nanosec
        for item in array.status:
            name = node_of(item)
            level = bytes(item.level)[0]
            found.append(Said((stamp - start_utc_ns) * 1e-9, name, level, item.message))
    return found
