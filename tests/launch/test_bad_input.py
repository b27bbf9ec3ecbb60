"""Bad input through the real command: one clear line, exit status 2, nothing left behind."""

import shutil

import numpy as np
import pytest
from graph_runs import command

pytestmark = [pytest.mark.launch, pytest.mark.timeout(60)]


@pytest.fixture(scope="module")
def place(tmp_path_factory, recording, recorded):
    """A folder with bad input of every kind."""
    place = tmp_path_factory.mktemp("bad")
    with recording.if_path.open("rb") as samples:
        (place / "short.bin").write_bytes(samples.read(4_000_013))
    shutil.copy(recording.descriptor_path, place / "short.bin.yaml")
    (place / "noise.bin").write_bytes(np.random.default_rng(1).bytes(4_000_000))
    (place / "empty.bin").touch()
    (place / "not_a_bag.mcap").write_bytes(b"no bag at all " * 100)
    (place / "folder").mkdir()
    (place / "full").mkdir()
    (place / "full" / "notes.txt").write_text("mine")
    (path,) = recorded.bag.glob("*.mcap")
    data = bytearray(path.read_bytes()[:12_000_000])
    data[3_000_000:3_001_000] = bytes(1000)
    (place / "corrupt.mcap").write_bytes(data)
    return place


def fails_in_one_line(result, *words):
    assert result.returncode == 2, result.stderr
    lines = result.stderr.strip().splitlines()
    assert len(lines) == 1, result.stderr
    assert result.stdout == ""
    for word in words:
        assert str(word) in lines[0]


PROCESS = {
    "a missing file": (["missing.bin"], ["missing.bin", "does not exist"]),
    "an empty file": (["empty.bin"], ["empty.bin", "is empty"]),
    "a folder": (["folder"], ["folder", "is a directory"]),
    "no format": (["noise.bin"], ["noise.bin", "format is not known"]),
    "an unknown format": (["noise.bin", "--format", "iq9", "--rate", "4e6"], ["iq9"]),
    "a wrong format": (["short.bin", "--format", "iq8", "--rate", "4e6"], ["short.bin", "iq8"]),
    "no time": (["short.bin", "--start-utc", "noon"], ["noon", "ISO 8601"]),
    "a missing nav file": (["short.bin", "--nav", "missing.rnx"], ["missing.rnx", "No such file"]),
    "a nav file that is none": (["short.bin", "--nav", "short.bin.yaml"], ["not a RINEX file"]),
}


@pytest.mark.parametrize("case", PROCESS)
def test_process_refuses(case, place, tmp_path):
    (file, *options), words = PROCESS[case]
    options = [place / o if o.endswith((".rnx", ".yaml")) else o for o in options]
    result = command("process", place / file, *options, "-o", tmp_path / "run")
    fails_in_one_line(result, *words)
    assert not (tmp_path / "run").exists()


REPLAY = {
    "a missing bag": ("missing.mcap", ["missing.mcap", "No such file"]),
    "what is no bag": ("not_a_bag.mcap", ["not_a_bag.mcap", "is not an MCAP file"]),
    "a folder without a bag": ("folder", ["folder", "holds no bag"]),
    "a corrupt bag": ("corrupt.mcap", ["corrupt.mcap", "damaged at byte", "deepseis recover"]),
}


@pytest.mark.parametrize("case", REPLAY)
def test_replay_refuses(case, place, tmp_path):
    file, words = REPLAY[case]
    fails_in_one_line(command("replay", place / file, "-o", tmp_path / "run"), *words)
    assert not (tmp_path / "run").exists()


def test_replay_refuses_a_bag_without_samples(recorded, tmp_path):
    from deepseis_bringup.bags.mcap_recording import BagWriter

    with BagWriter(tmp_path / "bag") as writer:
        data = recorded.payloads()["/gnss/pvt"][0]
        writer.write("/gnss/pvt", "deepseis_msgs/msg/Pvt", data, 0, 0)
    result = command("replay", tmp_path / "bag", "-o", tmp_path / "run")
    fails_in_one_line(result, tmp_path / "bag", "holds no IF samples")
    assert not (tmp_path / "run").exists()


def test_process_refuses_a_part_of_a_bag(recorded, tmp_path):
    result = command("process", recorded.bag, "--length", 2, "-o", tmp_path / "run")
    fails_in_one_line(result, recorded.bag, "played whole")
    assert not (tmp_path / "run").exists()


def test_a_folder_with_something_in_it_is_not_touched(place):
    result = command("process", place / "short.bin", "-o", place / "full")
    fails_in_one_line(result, "full", "exists and is not empty")
    assert [path.name for path in (place / "full").iterdir()] == ["notes.txt"]


NODES = {
    "an unknown parameter": ("pvt pvt", "nonsense:=1", ["pvt", "unknown parameter nonsense"]),
    "a number out of range": ("pvt pvt", "pvt_rate_hz:=1000", ["pvt_rate_hz", "1", "50"]),
    "a wrong type": ("pvt pvt", "pvt_rate_hz:=often", ["pvt_rate_hz", "INTEGER"]),
    "an unknown choice": ("pvt pvt", "mode:=fast", ["mode", "fast", "lockstep, realtime"]),
    "a missing nav file": ("pvt pvt", "nav_file:=/missing.rnx", ["/missing.rnx", "No such file"]),
    "an unknown satellite": ("tracking tracker", "satellite:=G99", ["G99", "G01 to G32"]),
    "no loop": ("tracking tracker", "pll_bandwidth_hz:=500.0", ["pll_bandwidth_hz", "50"]),
    "no file": ("frontend if_source", "start_s:=0.0", ["file", "names no file"]),
    "no folder": ("bringup recorder", "compression:=none", ["directory", "is empty"]),
}


@pytest.mark.parametrize("case", NODES)
def test_a_node_refuses(case):
    names, assignment, words = NODES[case]
    package, node = names.split()
    arguments = ("--ros-args", "-p", assignment)
    fails_in_one_line(command("run", f"deepseis_{package}", node, *arguments), *words)


def test_a_node_or_package_that_does_not_exist_is_named():
    fails_in_one_line(command("run", "deepseis_pvt", "nobody"), "nobody", "there are: pvt")
    fails_in_one_line(command("run", "nobody", "pvt"), "nobody", "deepseis_pvt")


def test_a_truncated_file_runs_to_its_end_and_says_so(place, tmp_path):
    result = command("process", place / "short.bin", "-o", tmp_path / "run")
    assert result.returncode == 0, result.stderr
    (line,) = [line for line in result.stderr.splitlines() if "short.bin" in line]
    # 4000013 bytes at two samples each; 80000 samples a block.
    assert "the last block holds 26 of 80000 samples" in line
    assert result.stdout.splitlines()[-1] == str(tmp_path / "run")
    assert (tmp_path / "run" / "summary.json").exists()
