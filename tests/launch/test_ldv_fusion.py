"""A vehicle with a velocimeter over DDS: GNSS is lost on the way, the velocimeter goes on."""

from dataclasses import replace

import numpy as np
import pytest

from deepseis_bringup.accept.scene import RATE_HZ, Loop, Scene
from deepseis_bringup.graph_payloads import run_graph
from deepseis_bringup.offline import OfflineChain, encode
from deepseis_core.ros import codecs
from deepseis_core.types import InsFilter, PvtStatus
from deepseis_sim import scenario as scenarios
from deepseis_sim.sky import Obstruction, SkyConfig

pytestmark = [pytest.mark.launch, pytest.mark.slow]

START, LOST, LAST = 12.0, 26.0, 44.0
LOOP = Loop(
    "aided 8 Hz", "fusion", 8.0, {"aided_order": 2, "aided_bandwidth_hz": 8.0},
    fusion={"coupling": "ldv", "ldv_lever_arm": [0.0, 0.0, -0.6], "precise": False},
)  # fmt: skip


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A mountain road; six satellites, none from 26 s on."""
    settings = [f"motion.0.start={START}", f"duration={LAST}", "signal=true"]
    base = scenarios.load_scenario("gravity-lines", short=True, settings=settings)
    sky = SkyConfig(satellites=6, obstructions=(Obstruction(from_s=LOST, to_s=LAST),))
    small = replace(base, sky=sky)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("deepseis_bringup.accept.scene.load_scenario", lambda *_, **__: small)
        return Scene("gravity-lines", tmp_path_factory.mktemp("scene"), short=True)


@pytest.fixture(scope="module")
def graph(scene, tmp_path_factory):
    return run_graph(scene.config(LOOP), tmp_path_factory.mktemp("graph") / "run")


def test_the_graph_gives_the_bytes_of_the_chain(scene, graph):
    sent = {}
    for output in OfflineChain(scene.config(LOOP)).run():
        if output.topic != "if/samples":
            sent.setdefault(output.topic, []).append(encode(output))
    differing = [topic for topic, found in sent.items() if sorted(graph[topic]) != sorted(found)]
    assert not differing
    assert len(graph["ldv/velocity"]) > 99.0 * LAST


def test_18_s_without_satellites_leave_it_where_the_truth_is(scene, graph):
    solutions = [codecs.INS_SOLUTION.decode(data)[0] for data in graph["ins/solution"]]
    assert {s.filter for s in solutions} == {InsFilter.LDV}
    for data in graph["gnss/pvt"]:
        pvt = codecs.PVT.decode(data)[0]
        assert pvt.status == PvtStatus.NONE or pvt.sample_index < (LOST + 2.0) * RATE_HZ
    sample = np.concatenate([s.sample_index for s in solutions])
    place = np.concatenate([np.reshape(s.position_enu, (-1, 3)) for s in solutions])
    sds = [np.reshape(s.state_sd, (-1, s.state_count)) for s in solutions]
    sd = np.concatenate([part[:, [1, 0, 2]] for part in sds])
    with np.load(scene.truth_file) as truth:
        t, true = truth["motion_t_s"], truth["antenna_ecef_m"]
        bias = np.interp(sample / RATE_HZ, truth["t_s"], truth["clock_bias"])
        true = np.stack([np.interp(sample / RATE_HZ - bias, t, x) for x in true.T], axis=1)
    moved = np.linalg.norm(true - true[0], axis=1)
    assert moved[-1] > 300.0
    # The antenna stands a metre off on a vehicle that turns by 20 deg at most: 0.4 m.
    error = np.linalg.norm(place - place[0], axis=1) - moved
    assert abs(error[-1]) < 0.4 + 4.0 * np.linalg.norm(sd[-1])
    assert np.linalg.norm(sd[-1]) < 3.0
