"""How long after its sample an event's peaks are published, in real time over DDS.

    ./deepseis sim quake --short -o /tmp/quake
    ./deepseis python benchmarks/bench_event_latency.py /tmp/quake

An onlooker in the same ROS domain notes when IMU samples arrive, which sets the pace of the clock,
and when motion and events that hold for them do. A peak may come just after a report, so the next
one, `report_s` (0.2 s) later, is the first that has it: that adds to the worst. On a machine that
does other things figures are larger.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path
from struct import unpack_from

import numpy as np
import rclpy
from domain_coordinator import domain_id
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import Imu

from deepseis_core.ros import codecs, qos
from deepseis_core.types import DisplacementSource
from deepseis_msgs.msg import Displacement, SeismicEvent

PROJECT = Path(__file__).resolve().parent.parent
REPORT_S = 0.2


class Onlooker:
    """Notes when what arrives."""

    def __init__(self, node: Node) -> None:
        self.imu: dict[int, float] = {}
        self.found: dict[str, list[tuple[int, float]]] = defaultdict(list)
        node.create_subscription(Imu, "imu/data_raw", self.on_imu, qos.IMU, raw=True)
        for topic, kind in (("seismo/displacement", Displacement), ("seismo/event", SeismicEvent)):
            profile = qos.LATCHED if topic.endswith("event") else qos.STREAM
            node.create_subscription(
                kind, topic, lambda data, t=topic: self.on(t, data), profile, raw=True
            )

    def on_imu(self, data: bytes) -> None:
        """Take a sample; its stamp are the first words after the encapsulation's header."""
        sec, nanosec = unpack_from("<iI", data, 4)
        self.imu[sec * 10**9 + nanosec] = time.monotonic()

    def on(self, topic: str, data: bytes) -> None:
        """Take what holds for samples, by the last of them."""
        now = time.monotonic()
        if topic == "seismo/event":
            self.found[topic].append((codecs.SEISMIC_EVENT.decode(data)[1], now))
            return
        motion, utc_ns = codecs.DISPLACEMENT.decode(data)
        if motion.source != DisplacementSource.FUSED or motion.smoothed:
            return
        last = utc_ns + int(motion.tow_ns[-1] - motion.tow_ns[0])
        self.found[topic].append((last, now))

    def delays(self, topic: str) -> np.ndarray:
        """Return how much later messages came than their last sample was due [s].

        Samples are due at the pace of the clock; the one of the IMU that came soonest sets it.
        """
        pace = min(at - 1e-9 * utc_ns for utc_ns, at in self.imu.items())
        return np.array([at - 1e-9 * utc_ns - pace for utc_ns, at in self.found[topic]])


def main() -> None:
    """Replay a recording at the pace of the clock and print the delays."""
    source = Path(sys.argv[1])
    with domain_id() as number, tempfile.TemporaryDirectory() as folder:
        context = Context()
        rclpy.init(context=context, domain_id=number)
        node = Node("onlooker", context=context)
        onlooker = Onlooker(node)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        command = [str(PROJECT / "deepseis"), "replay", str(source), "--realtime", "--without-if"]
        run = subprocess.Popen(
            [*command, "-o", f"{folder}/run"],
            env={**os.environ, "ROS_DOMAIN_ID": str(number)},
            stdout=subprocess.DEVNULL,
        )
        while run.poll() is None:
            for _ in range(200):
                executor.spin_once(timeout_sec=0.01)
        rclpy.shutdown(context=context)
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")
    for topic in onlooker.found:
        late = 1e3 * onlooker.delays(topic)
        if not len(late):
            print(topic, "nothing")
            continue
        median, most = np.percentile(late, [50, 99])
        print(
            f"{topic}: {len(late)}, median {median:.0f} ms, 99 % {most:.0f}, most {late.max():.0f}"
        )
    print(f"a peak waits for the next report up to {1e3 * REPORT_S:.0f} ms more")


if __name__ == "__main__":
    main()
