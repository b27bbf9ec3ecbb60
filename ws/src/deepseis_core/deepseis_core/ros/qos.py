"""The qualities of service; both ends of every topic import them from here."""

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

_RELIABLE, _LATCHED = ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL

STREAM = QoSProfile(depth=250, reliability=_RELIABLE)
"""IF, IMU, aiding, epochs, observations: a gap is a hole in the record."""

IMU = QoSProfile(depth=2000, reliability=_RELIABLE)
"""IMU samples: a second of the fastest; a lockstep source is less ahead of its readers."""

LATEST = QoSProfile(depth=1, reliability=_RELIABLE)
"""Only the newest matters."""

LATCHED = QoSProfile(depth=100, reliability=_RELIABLE, durability=_LATCHED)
"""Ephemerides, acquisition results, station, flow: late joiners get them too."""

MONITOR = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Plots; may be lost."""

BY_NAME = {
    "stream": STREAM,
    "imu": IMU,
    "latest": LATEST,
    "latched": LATCHED,
    "monitor": MONITOR,
}

STREAM_LATCHED = QoSProfile(depth=1, reliability=_RELIABLE, durability=_LATCHED)
"""Watermarks: the newest replaces the older ones, and late joiners get it."""
