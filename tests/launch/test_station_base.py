"""One station is another's base: its own topics in the same ROS domain, no RTCM between."""

import threading
import time
from dataclasses import replace

import graph_runs
import numpy as np
import pytest
import rclpy
from domain_coordinator import domain_id
from graph_runs import RATE
from rclpy.context import Context
from rclpy.node import Node

from deepseis_bringup.base import with_base
from deepseis_bringup.graph import GraphConfig
from deepseis_bringup.inertial import assistance
from deepseis_bringup.offline import OfflineChain
from deepseis_bringup.simulation.simulate import simulate
from deepseis_core.gps_time import GpsTime
from deepseis_core.ros import codecs, qos
from deepseis_core.types import PreciseStatus
from deepseis_frontend.base_events import BaseReference
from deepseis_frontend.nodes.base_bag import BaseBag
from deepseis_msgs.msg import Observations, Station
from deepseis_sim.base_station import BaseConfig
from deepseis_sim.scenario import load_scenario
from deepseis_sim.sky import SkyConfig

pytestmark = [pytest.mark.launch, pytest.mark.slow, pytest.mark.timeout(400)]

SECONDS = 13.0


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    still = load_scenario("static", short=True)
    small = replace(
        still, duration=SECONDS, base=BaseConfig(rate_hz=10), sky=SkyConfig(satellites=10)
    )
    folder = tmp_path_factory.mktemp("scene") / "in"
    simulate(small, folder, progress=False)
    return folder / "bag"


class Other(threading.Thread):
    """Another station: says who it is at once, and its epochs once somebody listens to them."""

    def __init__(self, number, place, epochs):
        super().__init__(daemon=True)
        self.place, self.epochs, self.listened = place, epochs, float("nan")
        self.context = Context()
        rclpy.init(context=self.context, domain_id=number)
        self.node = Node("pvt", namespace="KOBE", context=self.context)

    def run(self):
        node = self.node
        start_ns = GpsTime(self.epochs[0].week, self.epochs[0].tow_ns).to_utc_ns()
        station = node.create_publisher(Station, "station", qos.LATCHED)
        given = BaseReference(start_ns, self.place, "KOBE").station()
        station.publish(codecs.STATION.encode(given, start_ns))
        observations = node.create_publisher(Observations, "gnss/observations", qos.STREAM)
        heard, deadline = time.monotonic(), time.monotonic() + 200.0
        while not observations.get_subscription_count() and time.monotonic() < deadline:
            heard = heard if station.get_subscription_count() else time.monotonic()
            time.sleep(0.05)
        self.listened = time.monotonic() - heard
        for epoch in self.epochs:
            utc_ns = GpsTime(epoch.week, epoch.tow_ns).to_utc_ns()
            observations.publish(codecs.OBSERVATIONS.encode(epoch, utc_ns))
            time.sleep(0.002)
        time.sleep(1.0)


def test_its_epochs_fix_our_ambiguities_as_the_bag_s_base_does(bag, tmp_path):
    known = assistance(bag)
    known["pvt"] |= {"still_until_s": SECONDS - 0.1}
    parameters = {kind: known[kind] for kind in ("pvt", "acquisition")}
    source = {"file": str(bag)}
    config = with_base(GraphConfig(source=source, sample_rate_hz=RATE, parameters=parameters))
    file = [o.value for o in OfflineChain(config).run() if o.topic == "gnss/rtk"]
    epochs = list(BaseBag(bag).epochs())
    # Its samples are counted from another beginning.
    foreign = [replace(o, sample_index=o.sample_index + 10**7) for o in epochs]
    place = np.array(config.parameters["pvt"]["base_position_ecef"])
    satellites = tuple(sorted({name for o in epochs for name in o.satellites}))
    with domain_id() as number, pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(number))
        other = Other(number, place, foreign)
        other.start()
        run = graph_runs.run(
            bag,
            tmp_path / "run",
            satellites,
            base_from="station://KOBE",
            record_if=False,
            timeout=250.0,
            parameters={**parameters, "base_source": {"base_stale_s": 30.0}},
        )
        other.join(60.0)
        rclpy.shutdown(context=other.context)
    payloads = run.payloads()["/gnss/rtk"]
    got = [codecs.PRECISE_POSITION.decode(data)[0] for data in payloads]
    assert len(got) == len(file)
    assert [v.status for v in got] == [v.status for v in file]
    fixed = [k for k, v in enumerate(file) if v.status == PreciseStatus.FIX]
    assert len(fixed) > 50
    apart = [got[k].displacement_enu - file[k].displacement_enu for k in fixed]
    # The same observations; the antenna's place went through the station's monument.
    assert np.abs(apart).max() < 1e-6
    # Its own members had the time to find each other before we listened.
    assert other.listened > 4.5
    *_, (_, text, counts) = run.statuses()["base_source"]
    assert "station://KOBE: listening" in text
    assert int(counts["link_epochs"]) == len(epochs)
