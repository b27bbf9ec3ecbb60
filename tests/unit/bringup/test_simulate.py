import json
from dataclasses import replace

import numpy as np
import pytest

from deepseis_bringup import simulate
from deepseis_core.errors import InputError
from deepseis_core.mcap_scan import McapScan
from deepseis_frontend.if_bag import IfBag
from deepseis_frontend.if_file import IfFile
from deepseis_sim.still_recording import StillConfig

CONFIG = StillConfig(duration=0.3, seed=5)


def payloads(folder):
    return [bytes(m.data) for m in McapScan(folder / "bag" / "bag_0.mcap").messages()]


def test_the_bag_holds_the_samples_of_the_raw_file(tmp_path):
    simulate.still(CONFIG, tmp_path / "a", keep_raw=True)
    blocks = list(IfBag(tmp_path / "a" / "bag").blocks())
    raw = list(IfFile(tmp_path / "a" / "if.bin").blocks())
    assert len(blocks) == len(raw) == 15
    for block, other in zip(blocks, raw, strict=True):
        assert block.sample_index == other.sample_index
        np.testing.assert_array_equal(block.data, other.data)


def test_the_same_seed_gives_the_same_bytes_and_another_does_not(tmp_path):
    first = simulate.still(CONFIG, tmp_path / "a")
    second = simulate.still(CONFIG, tmp_path / "b")
    other = simulate.still(replace(CONFIG, seed=6), tmp_path / "c")
    assert first == second
    assert payloads(tmp_path / "a") == payloads(tmp_path / "b")
    assert first["if_sha256"] != other["if_sha256"]


def test_the_folder_holds_what_is_promised(tmp_path):
    summary = simulate.still(CONFIG, tmp_path / "a")
    names = {path.name for path in (tmp_path / "a").iterdir()}
    assert names == {"bag", "truth.npz", "nav.rnx", "summary.json"}
    assert json.loads((tmp_path / "a" / "summary.json").read_text()) == summary
    assert (summary["seed"], summary["duration_s"], summary["if_format"]) == (5, 0.3, "iq2")
    assert len(summary["satellites"]) >= 5


@pytest.mark.parametrize("existed", [False, True])
def test_bad_settings_leave_nothing_behind(tmp_path, existed):
    folder = tmp_path / "a"
    if existed:
        folder.mkdir()
    with pytest.raises(InputError, match="iq9"):
        simulate.still(replace(CONFIG, if_format="iq9"), folder)
    assert folder.exists() == existed
    assert not existed or not list(folder.iterdir())
