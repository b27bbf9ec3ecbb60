"""Loops aided by the tight filter over DDS, ranges alone: the chain's bytes, and no slip."""

from collections import defaultdict
from dataclasses import replace

import numpy as np
import pytest

from deepseis_bringup.accept.loop_measures import Tracks, measure, thermal_deg
from deepseis_bringup.accept.scene import RATE_HZ, Loop, Scene, aided
from deepseis_bringup.graph_payloads import run_graph
from deepseis_bringup.offline import OfflineChain, encode
from deepseis_core.ros import codecs
from deepseis_core.types import InsFilter
from deepseis_sim import scenario as scenarios
from deepseis_sim.motions import Circle
from deepseis_sim.sky import SkyConfig

pytestmark = pytest.mark.launch

ONSET = 11.0


def loop(coupling: str) -> Loop:
    """Return a loop of 8 Hz that is aided by ranges, or positions, of code and Doppler."""
    return replace(aided(8.0), fusion={"coupling": coupling, "precise": False})


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """Five satellites; 12 cm at 2 Hz from the 11th to the 15th second."""
    circle = Circle(radius=0.12, frequency_hz=2.0, start=ONSET, duration=4.0, ramp=0.5)
    base = scenarios.load_scenario("sine-2hz", short=True)
    small = replace(base, duration=15.5, motion=(circle,), sky=SkyConfig(satellites=5))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("deepseis_bringup.accept.scene.load_scenario", lambda *_, **__: small)
        made = Scene("sine-2hz", tmp_path_factory.mktemp("scene"), short=True)
    made.moving, made.still = (ONSET + 0.6, 14.6), (8.6, ONSET - 0.1)
    return made


def chain(scene, coupling):
    """Return values and payloads by topic of the chain in one process."""
    values, payloads = defaultdict(list), defaultdict(list)
    for output in OfflineChain(scene.config(loop(coupling))).run():
        if output.topic != "if/samples":
            values[output.topic].append(output.value)
            payloads[output.topic].append(encode(output))
    return values, payloads


@pytest.fixture(scope="module")
def tight(scene):
    return chain(scene, "tight")


@pytest.fixture(scope="module")
def graph(scene, tmp_path_factory):
    return run_graph(scene.config(loop("tight")), tmp_path_factory.mktemp("graph") / "run")


def true_phase_error(scene, values):
    """Return figures of the loops, moving, against the truth of the carrier."""
    tracks = Tracks()
    for topic, epochs in values.items():
        for item in epochs if topic.startswith("tracking/") else ():
            tracks.add(item)
    return measure(tracks.finish(), scene.truth, RATE_HZ, scene.moving, scene.still)


def test_the_graph_gives_the_bytes_of_the_chain(graph, tight):
    """Another run, in other processes, in another order of arrival: identical on every topic."""
    differing = [topic for topic, sent in tight[1].items() if sorted(graph[topic]) != sorted(sent)]
    assert not differing
    last = codecs.INS_SOLUTION.decode(graph["ins/solution"][-1])[0]
    assert last.filter == InsFilter.TIGHT
    assert np.isfinite(last.clock_bias).all()


def test_the_loops_are_held_as_by_the_loose_filter(scene, tight):
    """No slip through 2 g; phase errors as with positions, and within noise of the thermal."""
    found = true_phase_error(scene, tight[0])
    loose = true_phase_error(scene, chain(scene, "loose")[0])
    assert len(found) == len(loose) == 5
    assert all(item.locked == 1.0 and not item.slips for item in found)

    def ratio(figures):
        ratios = [item.own_rms / thermal_deg(8.0, item.cn0_dbhz) for item in figures]
        return float(np.sqrt(np.mean(np.square(ratios))))

    # About 48 independent errors each in 3 s at 16 Hz: one sigma of the pooled RMS is 4.6 %.
    assert ratio(found) < 1.15
    # The same noise in both: what differs is the aiding's error, 0.1 deg of 1 deg.
    assert abs(ratio(found) - ratio(loose)) < 0.03
