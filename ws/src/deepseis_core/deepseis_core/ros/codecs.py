"""Our values on topics: one codec each, and how nodes subscribe and publish with it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.node import Node

from deepseis_core import types
from deepseis_core.ros.cdr import Codec
from deepseis_core.ros.convert import stamp_from_ns
from deepseis_msgs import msg

IF_BLOCK = Codec(types.IfBlock, msg.IfBlock)
ACQUISITION_RESULT = Codec(types.AcquisitionResult, msg.AcquisitionResult)
TRACKING_EPOCHS = Codec(types.TrackingEpochs, msg.TrackingEpochs)
EPHEMERIS = Codec(types.Ephemeris, msg.Ephemeris)
OBSERVATIONS = Codec(types.Observations, msg.Observations)
PVT = Codec(types.Pvt, msg.Pvt)
PRECISE_POSITION = Codec(types.PrecisePosition, msg.PrecisePosition)
DISPLACEMENT = Codec(types.Displacement, msg.Displacement)
SEISMIC_EVENT = Codec(types.SeismicEvent, msg.SeismicEvent)
DOPPLER_AIDING = Codec(types.Aiding, msg.DopplerAiding)
STATION = Codec(types.Station, msg.Station)
LDV_VELOCITY = Codec(types.LdvVelocity, msg.LdvVelocity)
TRUTH = Codec(types.Truth, msg.Truth)
MOTION_STATE = Codec(types.MotionState, msg.MotionState)
INS_SOLUTION = Codec(types.InsSolution, msg.InsSolution)


def acquisition_request(satellite: str, sample_index: int, utc_ns: int) -> msg.AcquisitionRequest:
    """Return the request of a channel that became idle."""
    request = msg.AcquisitionRequest(satellite=satellite, sample_index=sample_index)
    request.header.stamp = stamp_from_ns(utc_ns)
    return request


def subscribe(
    node: Node, codec: Codec[Any], topic: str, callback: Callable[[Any, int], None], profile: Any
) -> Any:
    """Subscribe to a topic's bytes; ``callback(value, utc_ns)`` gets what they say."""

    def on_bytes(data: bytes) -> None:
        callback(*codec.decode(data))

    return node.create_subscription(codec.msg_type, topic, on_bytes, profile, raw=True)
