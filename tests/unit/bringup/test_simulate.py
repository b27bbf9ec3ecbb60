import errno
import json
import resource
from dataclasses import replace

import numpy as np
import pytest

from deepseis_bringup.simulation.simulate import simulate
from deepseis_core.errors import InputError
from deepseis_core.imu_message import decode_imu
from deepseis_core.mcap_scan import McapScan
from deepseis_core.ros import codecs
from deepseis_core.sample_clock import SampleClock
from deepseis_frontend.if_bag import IfBag
from deepseis_frontend.if_file import IfFile
from deepseis_sim.motions import Circle
from deepseis_sim.scenario import ReceiverConfig, load_scenario
from deepseis_sim.truth_file import TruthFile

STATIC = replace(load_scenario("static", short=True), duration=0.3, seed=5)
START_NS = STATIC.start.time.to_utc_ns()


def messages(folder):
    return list(McapScan(folder / "bag" / "bag_0.mcap").messages())


def made(scenario, folder, **options):
    return simulate(scenario, folder, progress=False, **options)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run") / "a"
    return folder, made(STATIC, folder, keep_raw=True)


@pytest.mark.parametrize("packing", ["iq4", "iq8", "sxnsr", "iq2 inverted"])
def test_the_bag_holds_the_samples_of_the_raw_file(tmp_path, packing):
    scenario = replace(STATIC, receiver=ReceiverConfig(if_format=packing))
    made(scenario, tmp_path / "a", keep_raw=True)
    blocks = list(IfBag(tmp_path / "a" / "bag").blocks())
    raw = list(IfFile(tmp_path / "a" / "if.bin").blocks())
    assert len(blocks) == len(raw) == 15
    for block, other in zip(blocks, raw, strict=True):
        assert block.sample_index == other.sample_index
        np.testing.assert_array_equal(block.data, other.data)


def test_the_same_seed_gives_the_same_files_and_another_does_not(run, tmp_path):
    folder, first = run
    second = made(STATIC, tmp_path / "b", keep_raw=True)
    other = made(replace(STATIC, seed=6), tmp_path / "c")
    assert first == second
    for path in folder.rglob("*.*"):
        same = tmp_path / "b" / path.relative_to(folder)
        if path.name not in ("metadata.yaml", "report.html"):
            assert path.read_bytes() == same.read_bytes(), path.name
    assert first["if_sha256"] != other["if_sha256"]


def test_the_folder_holds_what_is_promised(run):
    folder, summary = run
    names = {path.name.split("_")[0] for path in folder.iterdir()}
    promised = {"bag", "truth.npz", "nav.rnx", "summary.json", "report.html", "BASE00XXX"}
    assert names == promised | {"if.bin", "if.bin.yaml"}
    assert json.loads((folder / "summary.json").read_text()) == summary
    assert (summary["seed"], summary["duration_s"]) == (5, 0.3)
    assert len(summary["satellites"]) == 12


def test_messages_lie_in_order_of_validity(run):
    times = [message.log_time_ns for message in messages(run[0])]
    assert times == sorted(times)
    assert times[0] == START_NS


def test_an_imu_message_says_what_it_is(run):
    data = [m for m in messages(run[0]) if m.channel.topic == "/imu/data_raw"]
    sample, stamp = decode_imu(bytes(data[0].data), SampleClock(START_NS, 4e6))
    assert stamp == START_NS + 5_000_000  # the end of the first interval of 5 ms
    assert sample.sample_index == 20_000
    assert sample.linear_acceleration[2] == pytest.approx(9.80, abs=0.1)


def test_the_station_says_where_its_sensors_are(run):
    data = next(m for m in messages(run[0]) if m.channel.topic == "/station")
    station, _ = codecs.STATION.decode(bytes(data.data))
    np.testing.assert_allclose(station.monument_ecef, STATIC.place.ecef, atol=1e-6)
    np.testing.assert_array_equal(station.imu_to_antenna, STATIC.lever_arm)


def test_truth_of_bag_and_file_are_the_same(run):
    folder = run[0]
    batches = [
        codecs.TRUTH.decode(bytes(m.data))[0]
        for m in messages(folder)
        if m.channel.topic == "/truth"
    ]
    with np.load(folder / "truth.npz") as file:
        position = np.concatenate([b.position_ecef for b in batches]).reshape(-1, 3)
        np.testing.assert_array_equal(position, file["antenna_ecef_m"])
        phase = np.concatenate([b.carrier_phase_cycles for b in batches]).reshape(-1, 12)
        np.testing.assert_array_equal(phase, file["carrier_phase_cycles"])
        assert len(file["motion_t_s"]) == 300
        assert len(file["t_s"]) == 30


@pytest.mark.parametrize("existed", [False, True])
def test_bad_settings_leave_nothing_behind(tmp_path, existed):
    folder = tmp_path / "a"
    if existed:
        folder.mkdir()
    scenario = replace(STATIC, motion=(Circle(ramp=90.0, duration=3.0),))
    with pytest.raises(InputError, match="ramp"):
        made(scenario, folder)
    assert folder.exists() == existed
    assert not existed or not list(folder.iterdir())


@pytest.mark.parametrize("existed", [True, False])
def test_a_full_disk_is_told_with_the_folder_and_leaves_nothing_behind(
    tmp_path, monkeypatch, existed
):
    def full(*_given, **_more):
        raise OSError(errno.ENOSPC, "No space left on device")

    folder = tmp_path / "a"
    if existed:
        folder.mkdir()
    monkeypatch.setattr(TruthFile, "append", full)
    with pytest.raises(OSError, match=r"No space left on device: '.*/a'"):
        made(STATIC, folder)
    assert list(tmp_path.rglob("*")) == ([folder] if existed else [])


@pytest.mark.slow
def test_memory_does_not_grow_with_the_length_of_the_run(tmp_path):
    long = replace(STATIC, duration=20.0)
    made(replace(STATIC, duration=10.0), tmp_path / "a")
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for k in range(2):
        made(replace(long, duration=30.0), tmp_path / f"b{k}")
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert grown < 20_000  # [kB]; 30 s of samples are 120 MB, of truth 15 MB
