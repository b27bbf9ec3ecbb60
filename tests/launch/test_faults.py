"""Faults of the inputs over DDS: the bytes of one process, said, and nothing old taken for new.

What they cost is measured by `./deepseis accept faults`; goals that are missed stand there.
"""

from dataclasses import replace

import pytest

from deepseis_bringup.accept.scene import RATE_HZ, Scene, aided
from deepseis_bringup.faults.faulty_bag import faulty_bag
from deepseis_bringup.faults.measures import complaints
from deepseis_bringup.faults.record import RunRecord
from deepseis_bringup.graph_payloads import run_graph
from deepseis_bringup.offline import OfflineChain, encode
from deepseis_core.ros import codecs
from deepseis_core.types import Lli, PvtStatus
from deepseis_sim import scenario as scenarios
from deepseis_sim.faults import Fault
from deepseis_sim.motions import Circle
from deepseis_sim.sky import SkyConfig

pytestmark = [pytest.mark.launch, pytest.mark.slow, pytest.mark.timeout(900)]

LENGTH, ONSET = 24.0, 6.5
RANGE_G = 1.05
"""Cuts the peaks of the circle's 1.13 g off, and nothing of gravity."""
GAP = Fault("imu-gap", 9.0, 1.0)
CLIP = Fault("imu-clip", 12.0, 2.0, RANGE_G * 9.80665)
DARK = Fault("no-signal", 17.0, 3.0)
HELD_S = 1.5
"""A signal is given up 1 s after it is too weak, and the mean power has to fall first."""
SAME = ("gnss/observations", "gnss/pvt", "aiding/doppler", "seismo/displacement")


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """Nine satellites, so a fix after 1.4 s; at 2 Hz 3 cm, 0.5 g, and from 11.5 s 7 cm, 1.13 g."""
    weak = Circle(radius=0.03, frequency_hz=2.0, start=ONSET, duration=5.0, ramp=0.5)
    strong = Circle(radius=0.07, frequency_hz=2.0, start=11.5, duration=LENGTH, ramp=0.5)
    base = scenarios.load_scenario("sine-2hz", short=True)
    small = replace(
        base, duration=LENGTH, motion=(weak, strong), sky=SkyConfig(satellites=9), base=None
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("deepseis_bringup.accept.scene.load_scenario", lambda *_, **__: small)
        return Scene("sine-2hz", tmp_path_factory.mktemp("scene"), short=True)


@pytest.fixture(scope="module")
def config(scene, tmp_path_factory):
    folder = tmp_path_factory.mktemp("spoilt")
    faulty_bag(scene.bag, folder, [GAP, CLIP, DARK])
    known = scene.config(
        replace(aided(8.0), fusion={"imu_grade": f"span-fsas accel_range_g={RANGE_G}"})
    )
    return replace(known, source={"file": str(folder / "bag")})


@pytest.fixture(scope="module")
def payloads(config, tmp_path_factory):
    return run_graph(config, tmp_path_factory.mktemp("run") / "graph")


@pytest.fixture(scope="module")
def record(scene, payloads):
    start = scene.scenario.start.time
    found = RunRecord(RATE_HZ, start.tow_ns)
    found.take_all(payloads, start.to_utc_ns())
    return found


def differing(config, payloads):
    """Return the topics on which the chain in one process gives other bytes."""
    found = {topic: [] for topic in SAME}
    for output in OfflineChain(config).run():
        if output.topic in found:
            found[output.topic].append(encode(output))
    return [topic for topic in SAME if found[topic] != payloads[topic]]


def test_the_chain_in_one_process_gives_the_same_bytes(config, payloads):
    assert differing(config, payloads) == []


@pytest.mark.parametrize(
    ("fault", "who", "what"), [(GAP, "fusion", "IMU"), (DARK, "pvt", "no position")]
)
def test_it_is_said(record, fault, who, what):
    said = complaints(record.said, fault.start, fault.end + 1.5)
    assert any(what in item.text for item in said if item.node.startswith(who)), said


def test_nothing_is_observed_without_a_signal_and_marked_after_it(payloads):
    first, inside = {}, 0
    for data in payloads["gnss/observations"]:
        epoch = codecs.OBSERVATIONS.decode(data)[0]
        t = epoch.sample_index / RATE_HZ
        inside += (DARK.start + HELD_S < t < DARK.end) * len(epoch.satellites)
        if t > DARK.end:
            for name, lli in zip(epoch.satellites, epoch.lli, strict=True):
                first.setdefault(name, lli)
    assert inside == 0
    assert len(first) == 9
    assert all(lli & Lli.SLIP for lli in first.values())


def test_positions_are_none_without_a_signal_not_old_ones(payloads):
    for data in payloads["gnss/pvt"]:
        value = codecs.PVT.decode(data)[0]
        if DARK.start + HELD_S < value.sample_index / RATE_HZ < DARK.end:
            assert value.status == PvtStatus.NONE


def test_missing_samples_under_aiding_stop_nothing(scene, tmp_path):
    """The block after a gap waits for no aiding: the fusion waits for observations behind it."""
    faulty_bag(scene.bag, tmp_path / "spoilt", [Fault("if-gap", 15.0, 0.42)])
    config = replace(scene.config(aided(8.0)), source={"file": str(tmp_path / "spoilt" / "bag")})
    payloads = run_graph(config, tmp_path / "graph")
    assert differing(config, payloads) == []
    last = codecs.DOPPLER_AIDING.decode(payloads["aiding/doppler"][-1])[0]
    assert last.valid_through >= (LENGTH - 1.0) * RATE_HZ
