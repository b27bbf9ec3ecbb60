"""Every node alone: parameters described and read-only, readiness, its end on a signal."""

import os
import signal
import subprocess
import time
from contextlib import contextmanager

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient

from deepseis_bringup.executables import executable
from deepseis_bringup.supervisor import own_domain
from deepseis_core.ros import qos
from deepseis_msgs.msg import Observations, Watermark

pytestmark = [pytest.mark.launch, pytest.mark.timeout(150)]

NODES = {
    "if_source": ("deepseis_frontend", "if_source"),
    "acquisition": ("deepseis_tracking", "acquisition"),
    "trackers": ("deepseis_tracking", "tracker_container"),
    "tracker": ("deepseis_tracking", "tracker"),
    "pvt": ("deepseis_pvt", "pvt"),
    "recorder": ("deepseis_bringup", "recorder"),
}
ASK_AGAIN_S = 3.0
LOST_REPLY = "ignore:failed to send response:RuntimeWarning"  # the server's word on a lost reply
OWN_OF_ROS = {"use_sim_time", "start_type_description_service"}


@contextmanager
def started(environment, parameters):
    """All nodes, each with its parameters; killed at the end if they still run."""
    processes = {}
    try:
        for name, (package, program) in NODES.items():
            given = [f"{k}:={v}" for k, v in parameters.get(name, {}).items()]
            arguments = [word for item in given for word in ("-p", item)]
            processes[name] = subprocess.Popen(
                [str(executable(package, program)), "--ros-args", *arguments],
                env={**os.environ, **environment, "PYTHONWARNINGS": LOST_REPLY},
                stderr=subprocess.PIPE,
                text=True,
            )
        yield processes
    finally:
        for process in processes.values():
            process.kill()
            process.communicate()


@contextmanager
def listener(environment):
    """A node of our own in the same domain, and a function that spins it until something holds."""
    context = Context()
    rclpy.init(context=context, domain_id=int(environment["ROS_DOMAIN_ID"]))
    node = Node("listener", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)

    def until(condition, seconds=40.0):
        deadline = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < deadline, "did not happen in time"
            executor.spin_once(timeout_sec=0.05)

    try:
        yield node, until
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)


def answer(until, ask):
    """A service's reply, asked for again where one was lost.

    A server sends its reply into the void while its writer has not yet discovered who asked,
    although the client calls the service ready by then (rmw_fastrtps, issue 842).
    """
    futures = [ask()]
    asked = time.monotonic()

    def answered():
        nonlocal asked
        if time.monotonic() - asked > ASK_AGAIN_S:
            futures.append(ask())
            asked = time.monotonic()
        return any(future.done() for future in futures)

    until(answered)
    return next(future.result() for future in futures if future.done())


def check_parameters(node, until, name):
    client = AsyncParameterClient(node, name)
    until(client.services_are_ready)
    names = set(answer(until, client.list_parameters).result.names) - OWN_OF_ROS
    names = sorted(n for n in names if not n.startswith("qos_overrides."))
    assert len(names) > 3
    for item in answer(until, lambda: client.describe_parameters(names)).descriptors:
        assert item.description, f"{name}: {item.name} is not described"
        assert item.read_only, f"{name}: {item.name} can be changed"
    realtime = Parameter("mode", Parameter.Type.STRING, "realtime")
    (result,) = answer(until, lambda: client.set_parameters([realtime])).results
    assert not result.successful


def test_nodes_describe_their_parameters_and_end_on_sigint(recording, tmp_path):
    parameters = {
        "if_source": {"file": recording.if_path, "members": "[pvt, nobody]"},
        "pvt": {"expected_subscribers": "[gnss/observations=1]"},
        "recorder": {"directory": tmp_path / "bag"},
    }
    with (
        own_domain() as environment,
        started(environment, parameters) as processes,
        listener(environment) as (node, until),
    ):
        marks = {}
        for name in ("pvt", "if_source"):
            node.create_subscription(
                Watermark,
                f"flow/{name}",
                lambda msg: marks.__setitem__(msg.node, msg),
                qos.STREAM_LATCHED,
            )
        for name in NODES:
            check_parameters(node, until, name)
        # Nobody listens to pvt, so it is not ready, and the source waits for it and for "nobody".
        assert "pvt" not in marks
        assert marks["if_source"].ready
        assert marks["if_source"].valid_through == -1
        node.create_subscription(Observations, "gnss/observations", lambda _msg: None, qos.STREAM)
        until(lambda: "pvt" in marks and marks["pvt"].ready)
        for name, process in processes.items():
            process.send_signal(signal.SIGTERM if name == "tracker" else signal.SIGINT)
        for name, process in processes.items():
            assert process.wait(timeout=15) == 0, name
            assert process.stderr.read() == "", name
