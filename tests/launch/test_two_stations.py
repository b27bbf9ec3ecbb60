"""Two stations in one ROS domain, told apart by their names: each gives its own bytes."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest
from domain_coordinator import domain_id
from graph_runs import decode

from deepseis_bringup.accept.scene import Scene, aided
from deepseis_bringup.graph_payloads import run_graph
from deepseis_sim import scenario as scenarios
from deepseis_sim.motions import Circle
from deepseis_sim.sky import SkyConfig

pytestmark = [pytest.mark.launch, pytest.mark.slow, pytest.mark.timeout(600)]

ONSETS = {"KOBE": 6.5, "MIYAGI": 9.0}
LENGTH = 14.0


@pytest.fixture(scope="module")
def configs(tmp_path_factory):
    """The whole graph, INS aiding the loops, on two recordings of different shaking and noise."""
    found = {}
    for seed, (name, onset) in enumerate(ONSETS.items(), 1):
        motion = Circle(radius=0.03, frequency_hz=2.0, start=onset, duration=4.0, ramp=0.5)
        base = scenarios.load_scenario("sine-2hz", short=True)
        sky = SkyConfig(satellites=8 + seed)
        small = replace(base, duration=LENGTH, motion=(motion,), sky=sky, base=None, seed=seed)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(
                "deepseis_bringup.accept.scene.load_scenario", lambda *_, s=small, **__: s
            )
            scene = Scene("sine-2hz", tmp_path_factory.mktemp(name), short=True)
        found[name] = scene.config(aided(8.0))
    return found


@pytest.fixture(scope="module")
def alone(configs, tmp_path_factory):
    folder = tmp_path_factory.mktemp("alone")
    return {
        name: run_graph(config, folder / name, namespace=name) for name, config in configs.items()
    }


@pytest.fixture(scope="module")
def together(configs, tmp_path_factory):
    folder = tmp_path_factory.mktemp("together")
    with domain_id() as number, pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(number))
        with ThreadPoolExecutor(2) as pool:
            runs = {
                name: pool.submit(run_graph, config, folder / name, namespace=name)
                for name, config in configs.items()
            }
            return {name: run.result() for name, run in runs.items()}


@pytest.mark.parametrize("name", ONSETS)
def test_a_station_gives_the_bytes_that_it_gives_alone(alone, together, name):
    assert alone[name].keys() == together[name].keys()
    differing = [topic for topic, sent in alone[name].items() if together[name][topic] != sent]
    assert differing == []
    # A run that did something: satellites, aiding, ground motion.
    for topic, least in (("gnss/pvt", 50), ("aiding/doppler", 300), ("seismo/displacement", 300)):
        assert len(alone[name][f"{name}/{topic}"]) > least, topic


@pytest.mark.parametrize("name", ONSETS)
def test_nothing_of_the_other_station_is_recorded(together, name):
    topics = together[name].keys() - {"diagnostics"}
    assert {topic.partition("/")[0] for topic in topics} == {name}
    statuses = [
        status
        for data in together[name]["diagnostics"]
        for status in decode("diagnostic_msgs/msg/DiagnosticArray", data).status
    ]
    assert {status.hardware_id.partition("/")[0] for status in statuses} == {name}
    assert {f"{name}/{node}" for node in ("fusion", "pvt", "trackers")} <= {
        status.hardware_id for status in statuses
    }


def test_the_stations_are_not_the_same(together):
    one, other = [data[f"{name}/gnss/pvt"][-1] for name, data in together.items()]
    assert one != other
