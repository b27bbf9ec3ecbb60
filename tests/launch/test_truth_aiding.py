"""The whole graph over DDS with aiding from the truth: same numbers as in one process."""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from phase_truth import MOVING, NAV, RATE, PhaseErrors, Station, Truth, collect

from deepseis_core.types import Aiding, TrackingEpochs

graph = pytest.importorskip("deepseis_bringup.graph")
supervisor = pytest.importorskip("deepseis_bringup.supervisor")
codecs = pytest.importorskip("deepseis_core.ros.codecs")
reader = pytest.importorskip("mcap.reader")

pytestmark = pytest.mark.launch

LENGTH = 14.0
STILL, MOTION = (4.0, 10.0), (11.0, 13.8)


@pytest.fixture(scope="module")
def folder(shared_data):
    return shared_data / "if_captures" / "independent_sim"


def run_graph(folder: Path, run: Path, satellites: tuple[str, ...], *, one_process: bool) -> None:
    """Play the moving recording through separate processes, recorded to ``run/bag``."""
    source = {
        "file": str(folder / MOVING.samples),
        "format": "independent_sim",
        "sample_rate_hz": RATE,
        "start_utc": "2022-01-01T02:00:12",
        "length_s": LENGTH,
    }
    files = {"truth_file": str(folder / MOVING.truth), "nav_file": str(folder / NAV)}
    config = graph.GraphConfig(
        source=source,
        sample_rate_hz=RATE,
        satellites=satellites,
        one_process=one_process,
        aiding="truth",
        record_dir=str(run / "bag"),
        record_if=False,
        parameters={"truth_aiding": files, "pvt": {"troposphere": False}},
    )
    specs = graph.build_graph(config)
    with (
        supervisor.own_domain() as environment,
        supervisor.running(supervisor.Supervisor(specs, run, environment=environment)) as nodes,
    ):
        nodes.wait(timeout=110)
    assert set(nodes.statuses().values()) == {0}


def recorded(run: Path, topic: str, codec: object) -> Iterator[object]:
    """Yield what was recorded on topics that contain ``topic``."""
    for path in sorted((run / "bag").glob("*.mcap")):
        with path.open("rb") as file:
            for _, channel, message in reader.make_reader(file).iter_messages():
                if topic in channel.topic:
                    yield codec.decode(message.data)[0]  # type: ignore[attr-defined]


@pytest.fixture(scope="module")
def truth(folder):
    return Truth(folder, MOVING)


@pytest.fixture(scope="module")
def run(folder, truth, tmp_path_factory):
    run = tmp_path_factory.mktemp("truth_aiding")
    run_graph(folder, run, truth.satellites, one_process=True)
    return run


def same(one: list[TrackingEpochs], other: list[TrackingEpochs]) -> bool:
    """Whether two satellites' integrations are identical."""
    a, b = collect(one), collect(other)
    columns = ("sample_index", "carrier_phase_cycles", "carrier_doppler_hz", "prompt_i", "flags")
    return a.keys() == b.keys() and all(
        np.array_equal(a[name].column(c), b[name].column(c)) for name in a for c in columns
    )


def test_over_dds_aided_loops_hold_the_motion(run, truth):
    tracks = collect(recorded(run, "tracking/", codecs.TRACKING_EPOCHS))
    for name in truth.satellites:
        assert tracks[name].unlocked_after(2.0) == 0
        assert tracks[name].aided_after(2.0) == 1.0
    errors = PhaseErrors(truth, tracks, STILL[0], MOTION[1])
    assert np.abs(errors.step(STILL, MOTION)).max() < 0.01
    # 2.8 s of 8 Hz noise: an r.m.s. of 45 degrees of freedom scatters by 11 %.
    assert errors.ratio(8.0, *MOTION).max() <= 1.2 + 2 * 0.11
    pooled = np.sqrt(np.mean(errors.ratio(8.0, *MOTION) ** 2))
    assert pooled <= 1.2


def test_over_dds_and_in_one_process_the_numbers_are_identical(run, folder, truth):
    over_dds = list(recorded(run, "tracking/", codecs.TRACKING_EPOCHS))
    station = Station(folder, MOVING, truth.satellites, aided=True)
    assert same(over_dds, list(station.run(length=LENGTH)))


def test_aiding_covers_every_sample_once_and_in_order(run, truth):
    spans: list[Aiding] = list(recorded(run, "aiding/doppler", codecs.DOPPLER_AIDING))
    assert spans[0].valid_from == 0
    assert spans[-1].valid_through == LENGTH * RATE - 1
    joints = [(a.valid_through + 1, b.valid_from) for a, b in pairwise(spans)]
    assert all(end == begin for end, begin in joints)
    assert all(set(truth.satellites) == set(span.satellites) for span in spans)


def test_with_one_process_for_each_satellite_nothing_changes(run, folder, truth, tmp_path):
    satellites = truth.satellites[:3]
    run_graph(folder, tmp_path, satellites, one_process=False)
    alone = list(recorded(tmp_path, "tracking/", codecs.TRACKING_EPOCHS))
    together = list(recorded(run, "tracking/", codecs.TRACKING_EPOCHS))
    assert same(alone, [e for e in together if e.satellite in satellites])
