"""The base in an input bag: found, placed, and refused by name where it does not serve."""

from dataclasses import replace

import numpy as np
import pytest

from deepseis_bringup.base import base_position, has_base, rinex_position, with_base
from deepseis_bringup.graph import GraphConfig, build_graph
from deepseis_bringup.simulation.simulate import simulate
from deepseis_core.errors import InputError
from deepseis_frontend.nodes.base_bag import BaseBag
from deepseis_sim.scenario import load_scenario

STATIC = replace(load_scenario("static", short=True), duration=0.4)


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    folder = tmp_path_factory.mktemp("base") / "with"
    simulate(STATIC, folder, progress=False)
    return folder / "bag"


def test_the_base_of_a_simulated_bag_is_found_and_placed(bag):
    assert has_base(bag)
    epochs = list(BaseBag(bag).epochs())
    assert len(epochs) == 4
    assert len(epochs[0].satellites) >= 8
    config = with_base(GraphConfig(source={"file": str(bag)}, sample_rate_hz=4e6))
    place = config.parameters["pvt"]["base_position_ecef"]
    with np.load(bag.parent / "truth.npz") as truth:
        distance = np.linalg.norm(np.array(place) - truth["origin_ecef"])
    assert 1e3 < distance < 5e3
    specs = {spec.name: spec for spec in build_graph(config)}
    assert "base/observations" in specs["base_source"].publishes
    assert "base/observations" in specs["pvt"].subscribes
    assert "gnss/rtk" in specs["pvt"].publishes
    assert specs["pvt"].parameters["wait_base"]


def test_without_a_base_there_is_no_node_for_it(tmp_path):
    simulate(replace(STATIC, base=None), tmp_path / "without", progress=False)
    bag = tmp_path / "without/bag"
    assert not has_base(bag)
    config = GraphConfig(source={"file": str(bag)}, sample_rate_hz=4e6)
    with pytest.raises(InputError, match="has no base station"):
        with_base(config)
    specs = {spec.name: spec for spec in build_graph(config)}
    assert "base_source" not in specs
    assert "gnss/rtk" not in specs["pvt"].publishes


def test_a_file_without_a_place_is_named(bag, tmp_path):
    source = next(bag.parent.glob("BASE*.rnx"))
    assert rinex_position(source) == base_position(bag)
    lines = [x for x in source.read_text().splitlines() if "APPROX POSITION" not in x]
    (tmp_path / "BASE.rnx").write_text("\n".join(lines))
    with pytest.raises(InputError, match="does not say where its antenna is"):
        rinex_position(tmp_path / "BASE.rnx")
