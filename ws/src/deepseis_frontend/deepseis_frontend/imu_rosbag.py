"""IMU samples out of a bag that others recorded: ROS 1 ``.bag``, ROS 2 in SQLite or MCAP.

A YAML file beside the bag, ``<bag>.yaml``, may say what the bag does not; all of it is optional::

    topic: /imu/data                       # if there are several of sensor_msgs/Imu
    time: {offset: 0.0, stamp: header}     # header, or log: when it was written down
    axes: [x, y, z]                        # forward, left, up in terms of the message's axes
    stamp: end                             # of its interval, where a sample is stamped
    installation: {grade: mti-g, ...}      # as of a text of columns (`deepseis_frontend.imu_file`)

Stamps are UTC, and become samples of the IF by the recording's own ``start_utc``: ``deepseis
align`` finds what that is off. Messages have SI units (REP-145), gravity in the specific force.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from deepseis_core.config import setting
from deepseis_core.errors import InputError
from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import ImuSample
from deepseis_core.yaml_config import fill, read_yaml
from deepseis_frontend.imu_file import (
    LOOKED_AT,
    STAMPS,
    Installation,
    axes_matrix,
    require_gravity,
    told_rate,
)

TYPE: Final = "sensor_msgs/msg/Imu"


@dataclass(frozen=True)
class BagTime:
    """When a sample is."""

    stamp: str = setting("header", "which of a message's times [-]", choices=("header", "log"))
    offset: float = setting(0.0, "to be added to all times, as `align` finds it [s]")


@dataclass(frozen=True)
class ImuBagFormat:
    """What a bag does not say itself; the module's text explains it."""

    topic: str = setting("", "of the IMU; empty: the only one of its type [-]")
    time: BagTime = setting(BagTime(), "when a sample is")
    axes: tuple[str, str, str] = setting(("x", "y", "z"), "forward, left, up; such as -y [-]")
    stamp: str = setting("end", "of its interval, where it is stamped [-]", choices=tuple(STAMPS))
    installation: Installation | None = setting(None, "how the IMU stands at its station")


class ImuRosbag:
    """The IMU of a bag of any kind.

    Parameters
    ----------
    path : path
        A ``.bag``, ``.db3`` or ``.mcap`` file, or the folder of a ROS 2 bag.
    clock : SampleClock
        Of the IF samples.

    Attributes
    ----------
    rate_hz : float
        Samples a second, as the times tell.

    Raises
    ------
    InputError
        The bag cannot be read, or has no IMU, or several.
    """

    def __init__(self, path: str | Path, clock: SampleClock) -> None:
        self.path, self.clock = Path(path), clock
        beside = described_by(self.path)
        self.format = fill(ImuBagFormat, read_yaml(beside)) if beside.is_file() else ImuBagFormat()
        self._turn = axes_matrix(beside, self.format.axes)
        times = [t for t, _ in islice(self._messages(), LOOKED_AT)]
        if len(times) < 2:
            raise InputError(self.path, "holds less than two IMU samples")
        self.dt_ns = float(np.median(np.diff(times)))
        if not self.dt_ns > 0.0:
            raise InputError(self.path, "its IMU samples have no times that grow")
        self.rate_hz = told_rate(1e-9 * self.dt_ns)
        self._require_gravity()

    def samples(self, since: int = 0) -> Iterator[ImuSample]:
        """Yield the samples from a sample of the IF on.

        Raises
        ------
        InputError
            The samples go back in time, or hold what is no number.
        """
        shift = round(STAMPS[self.format.stamp] * self.dt_ns + self.format.time.offset * 1e9)
        last = -1
        for time_ns, message in self._messages():
            sample = self.clock.sample_at(time_ns + shift)
            if sample < since:
                continue
            if sample <= last:
                reason = f"IMU sample at {sample} comes after that at {last}"
                raise InputError(self.path, reason, "time: {stamp: log} takes the other stamps")
            last = sample
            rate, force = _vector(message.angular_velocity), _vector(message.linear_acceleration)
            if not (np.isfinite(rate).all() and np.isfinite(force).all()):
                raise InputError(self.path, f"the IMU sample at {sample} is not finite")
            yield ImuSample(sample, self._turn @ rate, self._turn @ force, 0.0, 0.0)

    def _require_gravity(self) -> None:
        found = islice(self._messages(), LOOKED_AT)
        norms = [float(np.linalg.norm(_vector(m.linear_acceleration))) for _, m in found]
        require_gravity(self.path, norms, "is gravity taken off, or the unit g?")

    def _messages(self) -> Iterator[tuple[int, Any]]:
        """Yield UTC [ns] and message."""
        store = get_typestore(Stores.ROS2_JAZZY)
        try:
            with AnyReader([_for_rosbags(self.path)], default_typestore=store) as reader:
                connection = self._chosen(reader)
                by_header = self.format.time.stamp == "header"
                for _, log_ns, raw in reader.messages(connections=[connection]):
                    message: Any = reader.deserialize(raw, connection.msgtype)
                    stamp = message.header.stamp
                    header_ns = int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
                    yield (header_ns if by_header else int(log_ns)), message
        except InputError:
            raise
        except Exception as error:  # readers of three formats, whose damage shows in any way
            reason = f"cannot be read as a bag: {str(error) or type(error).__name__}"
            raise InputError(self.path, reason) from None

    def _chosen(self, reader: AnyReader) -> Any:
        known = [item for item in reader.connections if item.msgtype == TYPE]
        wanted = self.format.topic.strip("/")
        if wanted:
            known = [item for item in known if item.topic.strip("/") == wanted]
        topics = sorted({item.topic for item in known})
        if not topics:
            there = ", ".join(sorted({item.topic for item in reader.connections})) or "nothing"
            raise InputError(self.path, f"holds no {TYPE}", f"it holds {there}")
        if len(topics) > 1:
            hint = f"topic: ... in {described_by(self.path).name}"
            raise InputError(self.path, f"holds several IMUs: {', '.join(topics)}", hint)
        return known[0]


def described_by(path: Path) -> Path:
    """Return the place of a bag's description.

    Examples
    --------
    >>> described_by(Path("a/drive.bag")).as_posix()
    'a/drive.bag.yaml'
    """
    return path.with_name(path.name + ".yaml")


def is_rosbag(path: Path) -> bool:
    """Tell whether a path names a bag that `ImuRosbag` is for: not one of this station."""
    if path.suffix in (".bag", ".db3"):
        return True
    if path.is_dir() and any(path.glob("*.db3")):
        return True
    is_mcap = path.suffix == ".mcap" or (path.is_dir() and any(path.glob("*.mcap")))
    return is_mcap and described_by(path).is_file()


def _for_rosbags(path: Path) -> Path:
    """Return what the reader opens: of ROS 2 a folder, of ROS 1 a file."""
    if path.suffix in (".db3", ".mcap") and path.is_file():
        if not (path.parent / "metadata.yaml").is_file():
            raise InputError(path, "has no metadata.yaml beside it", "name the bag's folder")
        return path.parent
    return path


def _vector(value: Any) -> Any:
    return np.array([value.x, value.y, value.z])
