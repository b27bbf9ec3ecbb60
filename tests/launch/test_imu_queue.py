"""IMU samples of the fastest IMU wait in the queue as long as lockstep's source may be ahead."""

import time

import numpy as np
import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import Imu

from deepseis_bringup.graph import topic_type
from deepseis_bringup.supervisor import own_domain
from deepseis_core.imu_message import encode_imu
from deepseis_core.ros import qos
from deepseis_core.types import ImuSample

pytestmark = [pytest.mark.launch, pytest.mark.timeout(60)]

RATE_HZ, WINDOW_S = 2000.0, 32 * 0.02
"""The highest rate that the nodes' settings allow; the source's credit window."""


def test_a_reader_that_is_busy_for_a_whole_window_loses_none():
    count, got = round(1.2 * RATE_HZ * WINDOW_S), []
    assert qos.BY_NAME[topic_type("imu/data_raw")[1]] is qos.IMU
    with own_domain() as environment:
        context = Context()
        number = environment.get("ROS_DOMAIN_ID")
        rclpy.init(context=context, domain_id=int(number) if number else None)
        writer, reader = (Node(name, context=context) for name in ("writer", "reader"))
        publisher = writer.create_publisher(Imu, "imu/data_raw", qos.IMU)
        reader.create_subscription(Imu, "imu/data_raw", got.append, qos.IMU, raw=True)
        while not publisher.get_subscription_count():
            time.sleep(0.01)
        sent = []
        for k in range(count):
            sample = ImuSample(k, np.full(3, k), np.zeros(3), 0.0, 0.0)
            sent.append(encode_imu(sample, round(k * 1e9 / RATE_HZ)))
            publisher.publish(sent[-1])
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(reader)
        begin = time.monotonic()
        while len(got) < count and time.monotonic() < begin + 30.0:
            executor.spin_once(timeout_sec=1.0)
        writer.destroy_node()
        reader.destroy_node()
        rclpy.shutdown(context=context)
    assert got == sent
