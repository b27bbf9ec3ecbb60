"""A hypocentre told to a running station: its event is reported anew, with a magnitude."""

import os
import subprocess
import time

import numpy as np
import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node

from deepseis_bringup import hypocentre
from deepseis_bringup.executables import executable
from deepseis_bringup.hypocentre import tell
from deepseis_bringup.supervisor import own_domain
from deepseis_core.errors import InputError
from deepseis_core.gps_time import GpsTime
from deepseis_core.ros import codecs, qos
from deepseis_core.types import Displacement
from deepseis_ins import pgd_magnitude as pgd
from deepseis_msgs.msg import Displacement as DisplacementMessage

pytestmark = [pytest.mark.launch, pytest.mark.timeout(60)]

STATION, BELOW = [-3957200.0, 3310200.0, 3737700.0], [35.0, 140.0, 30.0]
RATE, TIME = 200.0, GpsTime(2000, 0)


@pytest.fixture
def station():
    """The node of station KOBE in a domain of its own; yields the domain's environment."""
    words = ["--ros-args", "-r", "__ns:=/KOBE", "-p", f"monument_ecef:={STATION}"]
    with own_domain() as environment:
        process = subprocess.Popen(
            [str(executable("deepseis_ins", "seismic_event")), *words],
            env={**os.environ, **environment},
        )
        try:
            yield environment
        finally:
            process.terminate()
            process.wait(20)


def shake(environment):
    """Publish 12 s of rest and 3 s of a motion of 10 cm, once somebody listens."""
    context = Context()
    rclpy.init(context=context, domain_id=int(environment["ROS_DOMAIN_ID"]))
    node = Node("bench", context=context, namespace="KOBE", start_parameter_services=False)
    publisher = node.create_publisher(DisplacementMessage, "seismo/displacement", qos.STREAM)
    try:
        deadline = time.monotonic() + 20.0
        while not publisher.get_subscription_count():
            assert time.monotonic() < deadline
            time.sleep(0.02)
        for second in range(15):
            t = second + np.arange(200) / RATE
            d = np.zeros((200, 3))
            d[:, 0] = np.where(t > 12.0, 0.05 * (1.0 - np.cos(np.pi * (t - 12.0))), 0.0)
            a = np.random.default_rng(second).normal(0.0, 3e-3, (200, 3))
            a[:, 0] += np.where(t > 12.0, 0.05 * np.pi**2 * np.cos(np.pi * (t - 12.0)), 0.0)
            sd = np.full((200, 3), 1e-3, np.float32)
            tow_ns = np.round(t * 1e9).astype(np.int64)
            motion = Displacement(
                2, False, 20_000 * second, 1.0 / RATE, tow_ns, TIME.week, d, 0.0 * d, a, sd, sd, sd
            )
            publisher.publish(codecs.DISPLACEMENT.encode(motion, TIME.to_utc_ns(), "map"))
        publisher.wait_for_all_acked()
        time.sleep(0.5)
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)


def test_an_event_in_progress_gets_its_magnitude(station, monkeypatch):
    monkeypatch.setattr(hypocentre, "REPORT_S", 0.2)  # there is nothing to report yet
    with pytest.raises(InputError, match="station KOBE: hypocentre"):
        tell([135.0, 140.0, 30.0], "KOBE", station)
    assert tell(BELOW, "KOBE", station) is None
    assert tell([], "KOBE", station) is None
    monkeypatch.undo()
    shake(station)
    event = tell(BELOW, "KOBE", station)
    assert event is not None
    assert event.event_id.startswith("KOBE-")
    assert event.peak_displacement == pytest.approx(0.1, rel=0.01)
    distance = pgd.hypocentral_distance(np.array(STATION), BELOW)
    assert event.hypocentral_distance == pytest.approx(distance)
    assert event.magnitude == pytest.approx(pgd.magnitude(0.1, distance), abs=0.01)
    taken_back = tell([], "KOBE", station)
    assert np.isnan(taken_back.magnitude)


def test_a_station_that_is_not_there_is_named(station, monkeypatch):
    monkeypatch.setattr(hypocentre, "WAIT_S", 0.5)
    with pytest.raises(InputError, match="station OSAKA: no node seismic_event answers"):
        tell(BELOW, "OSAKA", station)
