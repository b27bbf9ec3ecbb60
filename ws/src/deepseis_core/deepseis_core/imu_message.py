"""IMU samples as ``sensor_msgs/Imu``, straight to and from its bytes; without ROS."""

from __future__ import annotations

import struct

import numpy as np

from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import FloatArray, ImuSample

TYPE = "sensor_msgs/msg/Imu"
FRAME = "imu_link"

_ABSENT = -1.0
_TEXT = FRAME.encode() + b"\0"
_HEAD = struct.Struct(f"<4siII{len(_TEXT)}s")
_PAD = bytes((4 - _HEAD.size) % 8)
_BEGIN = _HEAD.size + len(_PAD)
_VALUES = 37
_DIAGONAL = np.eye(3).ravel()


def encode_imu(sample: ImuSample, utc_ns: int) -> bytes:
    """Serialise a sample as ``sensor_msgs/Imu``, stamped with the end of its interval.

    The orientation is not measured (REP-145: first covariance -1).
    """
    seconds, nanoseconds = divmod(utc_ns, 1_000_000_000)
    body = np.zeros(_VALUES)
    body[3] = 1.0  # orientation: the identity
    body[4] = _ABSENT
    body[13:16], body[16:25] = (
        sample.angular_velocity,
        _covariance(sample.angular_velocity_variance),
    )
    body[25:28], body[28:37] = (
        sample.linear_acceleration,
        _covariance(sample.linear_acceleration_variance),
    )
    head = _HEAD.pack(b"\0\1\0\0", seconds, nanoseconds, len(_TEXT), _TEXT)
    return head + _PAD + body.tobytes()


def _covariance(variance: float) -> FloatArray:
    if variance == _ABSENT:
        return np.array([_ABSENT] + [0.0] * 8)
    return variance * _DIAGONAL


def decode_imu(data: bytes | memoryview, clock: SampleClock) -> tuple[ImuSample, int]:
    """Read a ``sensor_msgs/Imu`` of any frame, and its stamp [ns UTC].

    Raises
    ------
    ValueError
        The bytes are not such a message.
    """
    try:
        seconds, nanoseconds, size = struct.unpack_from("<iII", data, 4)
    except struct.error as error:
        raise ValueError(f"not an Imu: {error}") from None
    begin = 16 + size
    begin += (4 - begin) % 8
    if len(data) < begin + 8 * _VALUES:
        raise ValueError(f"not an Imu: {len(data)} bytes")
    body = np.frombuffer(data[begin : begin + 8 * _VALUES])
    utc_ns = seconds * 1_000_000_000 + nanoseconds
    sample = ImuSample(
        clock.sample_at(utc_ns), body[13:16], body[25:28], float(body[16]), float(body[28])
    )
    return sample, utc_ns
