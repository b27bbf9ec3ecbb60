"""A recorded run as columns: what the report, the summary and a notebook start from.

Memory: about 0.1 MB for every second of twelve satellites at 50 Hz; IF samples are not kept.
"""

from __future__ import annotations

import dataclasses
import json
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from deepseis_bringup.report.run_columns import ColumnBuilder, Columns
from deepseis_core.errors import InputError
from deepseis_core.mcap_scan import Channel, McapScan, Message
from deepseis_core.status_names import node_of
from deepseis_core.types import Ephemeris
from deepseis_frontend.if_bag import TYPE_NAME as IF_TYPE
from deepseis_frontend.if_bag import bag_files, decode_if_block

EPOCHS_TYPE: Final = "deepseis_msgs/msg/TrackingEpochs"
DIAGNOSTICS_TYPE: Final = "diagnostic_msgs/msg/DiagnosticArray"
EPHEMERIS_TYPE: Final = "deepseis_msgs/msg/Ephemeris"

EPOCHS_SCALARS: Final = ("block_sample_index", "valid_through", "ephemeris_count", "mode")
EPOCHS_JOINED: Final = (
    "sample_index",
    "sample_count",
    "carrier_phase_cycles",
    "carrier_doppler_hz",
    "carrier_doppler_rate",
    "carrier_doppler_accel",
    *("early_i", "early_q", "prompt_i", "prompt_q", "late_i", "late_q"),
    "carrier_error_cycles",
    "code_error_chips",
    "cn0_dbhz",
    "phase_lock_indicator",
    "aid_doppler_hz",
    "flags",
)
TOPICS: Final[Mapping[str, tuple[str, tuple[str, ...], tuple[str, ...], tuple[str, ...]]]] = {
    "gnss/observations": (
        "deepseis_msgs/msg/Observations",
        ("sample_index", "sample_fraction", "week", "tow_ns", "interval"),
        (),
        (
            "satellites",
            "pseudorange",
            "carrier_phase_cycles",
            "carrier_doppler_hz",
            "cn0_dbhz",
            "lli",
            "flags",
        ),
    ),
    "gnss/pvt": (
        "deepseis_msgs/msg/Pvt",
        (
            *("sample_index", "week", "tow_ns", "status", "clock_bias", "clock_drift"),
            *("gdop", "pdop", "hdop", "vdop"),
        ),
        (
            "position_ecef",
            "velocity_ecef",
            "position_covariance_ecef",
            "velocity_covariance_ecef",
        ),
        ("satellites", "pseudorange_residual", "range_rate_residual", "elevation", "azimuth"),
    ),
    "acquisition/result": (
        "deepseis_msgs/msg/AcquisitionResult",
        (
            *("satellite", "detected", "sample_index", "effective_sample_index"),
            *("carrier_doppler_hz", "code_phase_chips", "statistic", "threshold", "cn0_dbhz"),
            "false_alarm_probability",
        ),
        (),
        (),
    ),
    **{
        topic: (
            "deepseis_msgs/msg/PrecisePosition",
            ("sample_index", "status"),
            ("displacement_enu", "covariance_enu"),
            (),
        )
        for topic in ("gnss/precise", "gnss/rtk")
    },
    "seismo/displacement": (
        "deepseis_msgs/msg/Displacement",
        ("source", "smoothed"),
        (),
        # Three values of the others belong to each epoch.
        ("tow_ns", "displacement", "velocity", "acceleration", "displacement_sd", "velocity_sd"),
    ),
    "seismo/event": (
        "deepseis_msgs/msg/SeismicEvent",
        (
            *("event_id", "onset", "ended", "onset_ratio", "peak_displacement", "peak_velocity"),
            *("peak_acceleration", "hypocentral_distance", "magnitude", "magnitude_sd"),
        ),
        (),
        (),
    ),
}
"""Topics read into columns: type, scalar, vector and joined fields."""


@dataclass(frozen=True)
class Status:
    """One status of one node out of ``/diagnostics``."""

    stamp_ns: int
    node: str
    level: int
    message: str
    values: Mapping[str, str]


@dataclass
class RunData:
    """A run; arrays as in `Columns`, times by sample index."""

    folder: Path
    tracking: dict[str, Columns] = field(default_factory=dict)
    observations: Columns = field(default_factory=Columns)
    pvt: Columns = field(default_factory=Columns)
    acquisition: Columns = field(default_factory=Columns)
    motion: Mapping[str, Columns] = field(default_factory=dict)
    ephemerides: list[Ephemeris] = field(default_factory=list)
    diagnostics: list[Status] = field(default_factory=list)
    if_blocks: NDArray[np.int64] = field(default_factory=lambda: np.zeros((0, 2), np.int64))
    messages: dict[str, int] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    if_format: str = ""
    intermediate_frequency_hz: float = float("nan")
    sample_rate_hz: float = float("nan")
    start_sample: int = 0
    end_sample: int = 0
    start_utc_ns: int = 0
    is_whole: bool = True

    @property
    def satellites(self) -> list[str]:
        """Satellites with at least one integration, sorted."""
        return sorted(s for s, c in self.tracking.items() if c["sample_index"].size)

    @property
    def duration(self) -> float:
        """Length of the run [s]."""
        return float(self.seconds(self.end_sample))

    def seconds(self, sample_index: Any) -> NDArray[np.float64]:
        """Time since the first sample of the run [s]."""
        since = np.asarray(sample_index, np.int64) - self.start_sample
        return np.asarray(since / self.sample_rate_hz)

    def seconds_of_utc(self, stamp_ns: int) -> float:
        """Time of a message's stamp since the first sample [s]."""
        return (stamp_ns - self.start_utc_ns) / 1e9

    @classmethod
    def read(cls, run_folder: str | Path) -> RunData:
        """Read the bag of a run: the folder of the run, of the bag, or an MCAP file.

        A bag that was cut short or damaged is read as far as it makes sense (``is_whole``).

        Raises
        ------
        InputError
            Where there is no bag, or nothing in it.
        """
        folder = Path(run_folder)
        bag = folder / "bag" if (folder / "bag").is_dir() else folder
        reader = _Reader(cls(folder))
        for file in bag_files(bag):
            reader.read(file)
        return reader.finish(bag)


class _Reader:
    """Sorts the messages of a bag into columns."""

    def __init__(self, run: RunData) -> None:
        self.run = run
        self.store = get_typestore(Stores.EMPTY)
        self.handlers: dict[tuple[int, str], Callable[[Message], None] | None] = {}
        self.epochs: dict[str, ColumnBuilder] = {}
        self.builders = {
            topic: ColumnBuilder(scalars, vectors, joined)
            for topic, (_, scalars, vectors, joined) in TOPICS.items()
        }
        self.blocks: list[tuple[int, int]] = []

    def read(self, file: Path) -> None:
        """Take all messages of one file."""
        scan = McapScan(file, tolerant=True)
        self.handlers.clear()
        for message in scan.messages():
            channel = message.channel
            key = (channel.id, channel.topic)
            if key not in self.handlers:
                self.handlers[key] = self.handler(channel)
            self.run.messages[channel.topic] = self.run.messages.get(channel.topic, 0) + 1
            handle = self.handlers[key]
            if handle is not None:
                handle(message)
        self.run.metadata |= scan.metadata
        self.run.is_whole &= scan.cut_at is None and not scan.damaged_chunks

    def handler(self, channel: Channel) -> Callable[[Message], None] | None:
        """Choose what is done with the messages of a channel; None: they are counted only."""
        if channel.type_name == IF_TYPE:
            return self.on_if
        if channel.schema_encoding != "ros2msg":
            return None
        by_type = {
            EPOCHS_TYPE: self.on_epochs,
            DIAGNOSTICS_TYPE: self.on_diagnostics,
            EPHEMERIS_TYPE: self.on_ephemeris,
        }
        take: Callable[[Any], None] | None = by_type.get(channel.type_name)
        for topic, (type_name, *_) in TOPICS.items():
            if channel.type_name == type_name and channel.topic.endswith(topic):
                take = self.column_handler(topic)
        if take is None:
            return None
        self.register(channel)
        definition, chosen = self.store.get_msgdef(channel.type_name), take
        decode, kind = definition.deserialize_cdr_le, definition.cls

        def handle(message: Message) -> None:
            try:  # rmw may leave more bytes behind a message than padding: not an error
                decoded, _ = decode(bytes(message.data[4:]), 0, kind, self.store)
            except (struct.error, ValueError):
                self.run.is_whole = False
                return
            chosen(decoded)

        return handle

    def register(self, channel: Channel) -> None:
        """Learn the types in the file's own schema."""
        found = get_types_from_msg(channel.schema.decode(), channel.type_name)
        self.store.register({k: v for k, v in found.items() if k not in self.store.types})

    def column_handler(self, topic: str) -> Callable[[Any], None]:
        """Return what adds a message of a topic to its columns."""
        builder = self.builders[topic]
        return lambda message: builder.add(_stamp(message), message)

    def on_if(self, message: Message) -> None:
        """Keep where a block of samples begins and how long it is."""
        try:
            block = decode_if_block(message.data).block
        except (ValueError, struct.error):
            self.run.is_whole = False
            return
        self.run.if_format = block.format
        self.run.sample_rate_hz = block.sample_rate_hz
        self.run.intermediate_frequency_hz = block.intermediate_frequency_hz
        self.blocks.append((block.sample_index, block.sample_count))

    def on_epochs(self, message: Any) -> None:
        """Take the integrations of one satellite."""
        builder = self.epochs.get(message.satellite)
        if builder is None:
            builder = self.epochs[message.satellite] = ColumnBuilder(
                EPOCHS_SCALARS, (), EPOCHS_JOINED
            )
        builder.add(_stamp(message), message)

    def on_diagnostics(self, message: Any) -> None:
        """Take the states of the nodes."""
        for status in message.status:
            values = {item.key: item.value for item in status.values}
            node = node_of(status)
            self.run.diagnostics.append(
                Status(_stamp(message), node, int(status.level), status.message, values)
            )

    def on_ephemeris(self, message: Any) -> None:
        """Take an ephemeris."""
        values = {f.name: getattr(message, f.name) for f in dataclasses.fields(Ephemeris)}
        values |= {name: tuple(values[name]) for name in ("iono_alpha", "iono_beta")}
        self.run.ephemerides.append(Ephemeris(**values))

    def finish(self, bag: Path) -> RunData:
        """Close the columns and settle the time scale."""
        run = self.run
        run.tracking = {s: self.epochs[s].finish() for s in sorted(self.epochs)}
        columns = {topic: builder.finish() for topic, builder in self.builders.items()}
        run.observations, run.pvt = columns["gnss/observations"], columns["gnss/pvt"]
        run.acquisition = columns["acquisition/result"]
        of_motion = ("gnss/precise", "gnss/rtk", "seismo/displacement", "seismo/event")
        run.motion = {topic: columns[topic] for topic in of_motion if columns[topic].count}
        run.if_blocks = np.array(self.blocks, np.int64).reshape(-1, 2)
        if not run.messages:
            raise InputError(bag, "holds no messages", "is it the bag of a run?")
        if len(self.blocks):
            run.start_sample = int(run.if_blocks[:, 0].min())
            run.end_sample = int(run.if_blocks.sum(axis=1).max())
        if run.tracking:
            self.settle_times()
        return run

    def settle_times(self) -> None:
        """Take rate, span and UTC of the run from its tracking, where IF was not recorded."""
        run = self.run
        first = [c["block_sample_index"].min() for c in run.tracking.values()]
        longest = max(run.tracking.values(), key=lambda c: len(c["stamp_ns"]))
        if not len(self.blocks):
            run.start_sample = int(min(first))
            run.end_sample = int(max(c["valid_through"].max() for c in run.tracking.values())) + 1
        if not np.isfinite(run.sample_rate_hz):
            run.sample_rate_hz = _rate_of_record(run.metadata) or _rate_of_stamps(longest)
        if not np.isfinite(run.sample_rate_hz):
            raise InputError(run.folder, "tells no sampling rate", "was it cut within a block?")
        before = (longest["block_sample_index"][0] - run.start_sample) / run.sample_rate_hz
        run.start_utc_ns = int(longest["stamp_ns"][0]) - round(before * 1e9)


def _stamp(message: Any) -> int:
    return int(message.header.stamp.sec) * 10**9 + int(message.header.stamp.nanosec)


def _rate_of_record(metadata: Mapping[str, Mapping[str, str]]) -> float:
    """Sample rate [Hz] that the run's own record names, or 0."""
    try:
        recorded = json.loads(metadata["parameters"]["pvt"])["sample_rate_hz"]
    except (KeyError, ValueError):
        return 0.0
    return float(recorded)


def _rate_of_stamps(columns: Columns) -> float:
    """Sample rate [Hz] from the coarse clock, which knows it exactly but for its nanoseconds."""
    stamps, samples = columns["stamp_ns"], columns["block_sample_index"]
    span = float(stamps[-1] - stamps[0])
    rate = float(samples[-1] - samples[0]) * 1e9 / span if span else float("nan")
    return float(np.round(rate)) if abs(rate - np.round(rate)) < 1e-8 * rate else rate
