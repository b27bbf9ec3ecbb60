"""An event on its topic becomes an alert, and how that went is on /diagnostics."""

import json
import sys
import time

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from domain_coordinator import domain_id

from deepseis_bringup.alert import AlertConfig, Alerts
from deepseis_bringup.station import StationWatch
from deepseis_core.ros import qos
from deepseis_core.ros.convert import stamp_from_ns
from deepseis_msgs.msg import SeismicEvent

pytestmark = [pytest.mark.launch, pytest.mark.timeout(60)]


def delivered(said):
    """How many events the station says it has told."""
    mine = [status for status in said if status.hardware_id == "kobe/alert"]
    values = {pair.key: pair.value for status in mine[-1:] for pair in status.values}
    return int(values.get("delivered", 0))


def test_an_event_on_its_topic_is_told(monkeypatch, tmp_path):
    out = tmp_path / "told"
    code = "import sys; open(sys.argv[1], 'ab').write(sys.stdin.buffer.read())"
    config = AlertConfig(command=(sys.executable, "-I", "-S", "-c", code, str(out)))
    with domain_id() as number:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(number))
        context = rclpy.Context()
        rclpy.init(context=context, domain_id=number)
        try:
            node = rclpy.create_node("fault", context=context, namespace="kobe")
            events = node.create_publisher(SeismicEvent, "seismo/event", qos.LATCHED)
            said = []
            node.create_subscription(
                DiagnosticArray, "/diagnostics", lambda m: said.extend(m.status), qos.STREAM
            )
            executor = rclpy.executors.SingleThreadedExecutor(context=context)
            executor.add_node(node)
            with (
                StationWatch("kobe", lambda _text: None) as watch,
                Alerts(config, "kobe") as alerts,
            ):
                watch.tell_of_events(alerts)
                event = SeismicEvent(event_id="kobe-1", peak_acceleration=2.5)
                event.onset = stamp_from_ns(1_700_000_000_000_000_001)
                events.publish(event)
                deadline = time.monotonic() + 40.0
                while not delivered(said):
                    assert time.monotonic() < deadline, said[-1:]
                    watch.poll()
                    executor.spin_once(timeout_sec=0.05)
        finally:
            rclpy.shutdown(context=context)
    [told] = [json.loads(line) for line in out.read_text().splitlines()]
    assert told["station"] == "kobe"
    assert told["onset_utc_ns"] == 1_700_000_000_000_000_001
    assert told["peak_acceleration"] == 2.5
