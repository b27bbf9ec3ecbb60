"""IMU samples out of a recorded bag (MCAP), without ROS, on the clock of the IF samples."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Final

import numpy as np

from deepseis_core.errors import InputError
from deepseis_core.imu_message import TYPE, decode_imu
from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import ImuSample
from deepseis_frontend.bag_topic import bag_values, later
from deepseis_frontend.if_bag import bag_files

TOPIC: Final = "imu/data_raw"
LOOKED_AT: Final = 400
"""Samples from which the rate is told."""


class ImuBag:
    """The IMU of a bag.

    Parameters
    ----------
    path : path
        MCAP file or bag folder.
    clock : SampleClock
        Of the bag's IF samples: stamps become sample indices.

    Attributes
    ----------
    rate_hz : float
        Samples a second, as the stamps tell.

    Raises
    ------
    InputError
        There is no IMU in the bag, or it cannot be read.
    """

    def __init__(self, path: str | Path, clock: SampleClock) -> None:
        self.path, self.clock = Path(path), clock
        self.files = bag_files(path)
        ends = [sample.sample_index for sample in islice(self.samples(), LOOKED_AT)]
        if len(ends) < 2:
            reason = f"holds no IMU samples: none on a topic {TOPIC}"
            raise InputError(self.path, reason, "name the IMU's own log")
        step = float(np.median(np.diff(ends))) / clock.sample_rate_hz
        self.rate_hz = _plain(1.0 / step)

    def samples(self, since: int = 0) -> Iterator[ImuSample]:
        """Yield the samples as recorded.

        Parameters
        ----------
        since : int, optional
            IF sample: those before it are left out, and what was written long before is not read.

        Raises
        ------
        InputError
            Where they go back in time, or the bag is damaged.
        """
        topics = {TOPIC: (TYPE, lambda data: decode_imu(data, self.clock)[0])}
        last, hint = -1, "the bag holds two IMUs, or two runs"
        since_ns = self.clock.utc_ns(since) if since else 0
        for sample in bag_values(self.path, self.files, topics, since_ns):
            last = later(self.path, "IMU sample", sample.sample_index, last, hint)
            if sample.sample_index >= since:
                yield sample


def _plain(rate_hz: float) -> float:
    """Round a rate that stamps tell to 1 ns to the plain number it is.

    Examples
    --------
    >>> _plain(199.9999998)
    200.0
    """
    whole = round(rate_hz, 3)
    return whole if abs(whole - rate_hz) < 1e-5 * rate_hz else rate_hz
