"""Bags with an IMU as others record them: ROS 1, ROS 2 in SQLite and MCAP."""

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from deepseis_core.sample_clock import SampleClock

CLOCK = SampleClock(1_700_000_000_000_000_000, 4e6)
STEP_NS = 10_000_000
COUNT = 50


def forces():
    return 9.8 * np.array([0.0, 0.0, 1.0]) + 0.01 * np.arange(COUNT)[:, None]


def imu_message(store, stamp_ns, force, first):
    types = store.types
    vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    time = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 1_000_000_000))
    header = types["std_msgs/msg/Header"](*first, stamp=time, frame_id="imu")
    nothing = np.zeros(9)
    return types["sensor_msgs/msg/Imu"](
        header, quaternion(0.0, 0.0, 0.0, 1.0), nothing, vector(0.1, 0.2, 0.3), nothing,
        vector(*map(float, force)), nothing,
    )  # fmt: skip


def write(kind, folder, topics=("/imu/data",), late_ns=0):
    """Write a bag; stamps in headers, logged ``late_ns`` after."""
    is_ros1 = kind == "bag"
    store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    path = folder / ("a.bag" if is_ros1 else "a")
    if is_ros1:
        writer = Writer1(path)
    else:
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        writer = Writer2(path, version=9, storage_plugin=plugin)
    with writer:
        known = [writer.add_connection(t, "sensor_msgs/msg/Imu", typestore=store) for t in topics]
        for k, force in enumerate(forces()):
            stamp = CLOCK.start_utc_ns + (k + 1) * STEP_NS
            message = imu_message(store, stamp, force, (k,) if is_ros1 else ())
            serialise = store.serialize_ros1 if is_ros1 else store.serialize_cdr
            raw = serialise(message, "sensor_msgs/msg/Imu")
            for connection in known:
                writer.write(connection, stamp + late_ns, raw)
    return path
