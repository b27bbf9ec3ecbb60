"""Watermarks are said again while nothing is new: who missed the last one gets it."""

import time

import pytest
import rclpy
from domain_coordinator import domain_id
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile

from deepseis_bringup.watch import GraphWatch
from deepseis_core.ros import flow as flow_module
from deepseis_core.ros.flow import Flow, FlowConfig
from deepseis_msgs.msg import Watermark

pytestmark = [pytest.mark.launch, pytest.mark.timeout(60)]


@pytest.fixture
def graph(monkeypatch):
    """A node's flow, what a reader hears of it, and a way to let time pass."""
    monkeypatch.setattr(flow_module, "REPEAT_SECONDS", 0.1)
    heard = []
    with domain_id() as number:
        context = Context()
        rclpy.init(context=context, domain_id=number)
        node, reader = (Node(name, context=context) for name in ("speaker", "reader"))
        executor = SingleThreadedExecutor(context=context)
        for item in (node, reader):
            executor.add_node(item)
        flow = Flow(node, None, "speaker", FlowConfig())
        reader.create_subscription(Watermark, "flow/speaker", heard.append, QoSProfile(depth=100))

        def until(condition):
            deadline = time.monotonic() + 20.0
            while not condition():
                assert time.monotonic() < deadline, "did not happen in time"
                executor.spin_once(timeout_sec=0.05)

        try:
            yield flow, heard, until, number
        finally:
            node.destroy_node()
            reader.destroy_node()
            rclpy.shutdown(context=context)


def test_the_newest_is_repeated_and_nothing_follows_the_end(graph):
    flow, heard, until, _ = graph
    until(lambda: heard)
    flow.send(79_999, 79_999, event_count=4, utc_ns=1)
    before = len(heard)
    until(lambda: len(heard) > before + 4)
    assert {(m.valid_through, m.event_count) for m in heard[before + 1 :]} == {(79_999, 4)}
    flow.send(79_999, 79_999, event_count=4, ephemeris_count=3, precise_count=2, utc_ns=1)
    flow.finish()
    until(lambda: heard[-1].end_of_stream)
    last = heard[-1]
    assert (last.event_count, last.ephemeris_count, last.precise_count) == (4, 3, 2)
    flow.send(159_999, 159_999)
    before = len(heard)
    until(lambda: len(heard) > before + 4)
    assert all(m.end_of_stream and m.valid_through == 79_999 for m in heard[before:])


def at(watch):
    """Return how far the watch has heard the speaker to be."""
    said = watch.said.get("speaker")
    return said.valid_through if said is not None and said.ready else -1


def test_a_repeated_watermark_is_no_progress(graph):
    flow, _, until, number = graph
    with GraphWatch({"ROS_DOMAIN_ID": str(number)}, members=["speaker"]) as watch:
        flow.send(79_999, 79_999, utc_ns=1)
        until(lambda: watch.poll() and at(watch) == 79_999)
        moved = watch.moved_at
        until(lambda: watch.poll() and time.monotonic() > moved + 1.0)
        assert watch.moved_at == moved
        flow.send(159_999, 159_999, utc_ns=2)
        until(lambda: watch.poll() and at(watch) == 159_999)
        assert watch.moved_at > moved
