"""A simulated station's input bag through our receiver; its RINEX through RTKLIB."""

from collections import defaultdict
from dataclasses import replace

import numpy as np
import pytest
from unit.pvt.rtklib_reference import epochs as rtklib_epochs

from deepseis_bringup.graph import GraphConfig
from deepseis_bringup.offline import OfflineChain
from deepseis_bringup.simulation.simulate import simulate
from deepseis_core.geodesy import enu_from_ecef
from deepseis_pvt.rinex_obs import RinexObsWriter
from deepseis_sim.scenario import load_scenario


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Folder, antenna, and the chain's outputs by topic."""
    folder = tmp_path_factory.mktemp("station")
    scenario = replace(load_scenario("static", short=True), duration=30.0, seed=3)
    simulate(scenario, folder / "input", progress=False)
    with np.load(folder / "input" / "truth.npz") as truth:
        antenna, names = truth["antenna_ecef_m"][0], tuple(truth["satellites"].tolist())
    config = GraphConfig(
        source={"file": str(folder / "input" / "bag")}, sample_rate_hz=4e6, satellites=names
    )
    outputs = defaultdict(list)
    for output in OfflineChain(config).run():
        if output.topic != "if/samples":
            outputs[output.topic].append(output.value)
    return folder, antenna, outputs


def test_all_twelve_satellites_are_used(run):
    assert len(run[2]["gnss/pvt"][-1].satellites) == 12


def test_our_position_is_within_two_metres(run):
    position = np.array([pvt.position_ecef for pvt in run[2]["gnss/pvt"]])
    error = enu_from_ecef(position, run[1])
    assert np.linalg.norm(error.mean(axis=0)) < 2.0


def test_rtklib_on_our_rinex_is_within_two_metres(run):
    folder, antenna, outputs = run
    with RinexObsWriter(folder) as writer:
        for epoch in outputs["gnss/observations"]:
            writer.write(epoch)
    solved = rtklib_epochs(writer.path, folder / "input" / "nav.rnx")
    position = np.array([e.position_ecef for e in solved if e.position_ecef is not None])
    assert len(position) == len(outputs["gnss/observations"])
    error = enu_from_ecef(position, antenna)
    assert np.linalg.norm(error.mean(axis=0)) < 2.0
