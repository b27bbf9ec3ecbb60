"""One door to every kind of IMU recording."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

from deepseis_core.errors import InputError
from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import ImuSample
from deepseis_frontend.imu_bag import ImuBag
from deepseis_frontend.imu_file import ImuFile
from deepseis_frontend.imu_rosbag import ImuRosbag, is_rosbag


class ImuRecording(Protocol):
    """Samples of an IMU on the clock of IF samples."""

    rate_hz: float

    def samples(self, since: int = 0) -> Iterator[ImuSample]:
        """Yield the samples from an IF sample on, in order."""
        ...


def is_bag(path: Path) -> bool:
    """Tell whether a path names a bag."""
    return path.suffix == ".mcap" or (path.is_dir() and any(path.glob("*.mcap")))


def open_imu(path: str | Path, clock: SampleClock) -> ImuRecording:
    """Open a bag of this station, a bag of others, or a text file of columns.

    Raises
    ------
    InputError
        There is no such file, or no IMU in it.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(path, "does not exist")
    if is_rosbag(path):
        return ImuRosbag(path, clock)
    return ImuBag(path, clock) if is_bag(path) or path.is_dir() else ImuFile(path, clock)
