"""`deepseis rtk`: as many epochs fixed as rnx2rtkp fixes, and files that say the same."""

import csv
import json
from datetime import datetime

import numpy as np
import pytest
from graph_runs import command
from numpy.testing import assert_allclose
from unit.pvt.test_rtk import postpos

from deepseis_bringup.survey.rtk_files import RtkTable, calendar, solve, write_csv, write_pos
from deepseis_bringup.survey.rtk_page import page
from deepseis_core.errors import InputError
from deepseis_core.gps_time import GpsTime
from deepseis_pvt.rtk import GEODETIC

FORM = "%Y/%m/%d %H:%M:%S.%f"
PAIRS = {
    "rtklib_geonet_3km_30s": (
        *("07590920.05o", "30400920.05o", ["07590920.05n", "30400920.05n"]),
        115,
    ),
    "cssrlib_5km_1hz": ("SEPT265G.21O", "3034265G.21O", ["SEPT2650.21P"], 131),
}
"""Rover, base, orbits, and what rnx2rtkp fixes by its defaults."""


def files_of(shared_data, pair):
    rover, base, navigation, fixed = PAIRS[pair]
    home = shared_data / "rinex" / pair
    return home / rover, home / base, [home / name for name in navigation], fixed


@pytest.mark.parametrize("pair", PAIRS)
def test_files_hold_the_solution_that_rnx2rtkp_gives(shared_data, tmp_path, pair):
    *files, fixed = files_of(shared_data, pair)
    table = solve(*files, GEODETIC)
    write_csv(table, tmp_path / "solution.csv")
    write_pos(table, tmp_path / "solution.pos", ["test"])
    header = next(x for x in files[1].read_text().splitlines() if "APPROX POSITION XYZ" in x)
    theirs = postpos(*files, [float(x) for x in header[:60].split()], tmp_path / "theirs.pos")
    theirs = theirs[theirs[:, 3] <= 2]
    assert table.figures()["fixed"] == np.count_nonzero(theirs[:, 3] == 1)
    # With single points for the base's place, rnx2rtkp's default, a few ratios near 3 turn.
    assert abs(table.figures()["fixed"] - fixed) <= (0 if fixed == 115 else 5)
    rows = [x.split() for x in (tmp_path / "solution.pos").read_text().splitlines() if x[0] != "%"]
    ours = np.array([[float(x) for x in row[2:6]] for row in rows])
    assert_allclose(ours[:, :3], theirs[:, :3], rtol=0, atol=2e-4)
    assert ours[:, 3].tolist() == theirs[:, 3].tolist()
    reference = [
        x.split() for x in (tmp_path / "theirs.pos").read_text().splitlines() if x[0] != "%"
    ]
    reference = [row for row in reference if int(row[5]) <= 2]
    # Ours are the receiver's times of the epochs; RTKLIB takes the clock's error off, 5 ms here.
    stamps = [
        [datetime.strptime(" ".join(r[:2]), FORM) for r in part] for part in (rows, reference)
    ]
    apart = [abs((a - b).total_seconds()) for a, b in zip(*stamps, strict=True)]
    assert max(apart) < 6e-3
    # Satellites, sigmas and their signs, age, ratio.
    numbers = np.array([[float(x) for x in row[6:]] for row in rows])
    expected = np.array([[float(x) for x in row[6:]] for row in reference])
    assert_allclose(numbers[:, 1:], expected[:, 1:], rtol=2e-3, atol=0.06)
    with (tmp_path / "solution.csv").open() as file:
        read = list(csv.DictReader(file))
    assert len(read) == len(table.times)
    assert sum(row["status"] == "fix" for row in read) == table.figures()["fixed"]
    solved = [row for row in read if row["status"] in ("fix", "float")]
    assert_allclose([float(row["y_m"]) for row in solved], ours[:, 1], rtol=0, atol=1e-4)
    assert {row["x_m"] for row in read if row["status"] == "none"} <= {""}


def test_the_command_leaves_page_and_figures(shared_data, tmp_path):
    rover, base, navigation, fixed = files_of(shared_data, "rtklib_geonet_3km_30s")
    result = command("rtk", rover, base, *navigation, "-o", tmp_path / "run")
    assert result.returncode == 0, result.stderr
    assert f"{fixed} of 120 epochs fixed" in result.stdout
    names = {path.name for path in (tmp_path / "run").iterdir()}
    assert names == {"solution.csv", "solution.pos", "rtk.html", "summary.json"}
    assert json.loads((tmp_path / "run/summary.json").read_text())["fixed"] == fixed
    wrong = command("rtk", rover, base, rover, "-o", tmp_path / "wrong")
    assert wrong.returncode == 2
    assert len(wrong.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "wrong").exists()


def made(status):
    n = len(status)
    position = np.tile([4075580.0, 931854.0, 4801568.0], (n, 1))
    nothing = np.array(status) == 0
    position[nothing] = np.nan
    return RtkTable(
        [GpsTime(2190, (525_600 + k) * 10**9) for k in range(n)],
        np.array(status),
        position,
        np.tile(np.eye(3) * 1e-4, (n, 1, 1)),
        np.zeros((n, 3)) + np.where(nothing, np.nan, 0.0)[:, None],
        np.full((n, 3), 0.01),
        np.full(n, 5.0),
        np.full(n, 0.2),
        np.full(n, 8),
    )


@pytest.mark.parametrize("status", [[4, 4, 3, 0], [3, 3], [4]])
def test_the_page_bears_every_mix_of_states(status, tmp_path):
    table = made(status)
    text = page(table, {"rover": "<rover>", "base": "base"}, 3.0)
    assert "&lt;rover&gt; against base" in text
    assert f"fixed ({status.count(4)})" in text
    assert "NaN" not in text.split('id="figures">')[1].split("</script>")[0]
    write_csv(table, tmp_path / "x.csv")
    assert len((tmp_path / "x.csv").read_text().splitlines()) == len(status) + 1


def test_no_solution_at_all_is_said(shared_data):
    rover, base, _, _ = files_of(shared_data, "rtklib_geonet_3km_30s")
    other = shared_data / "rinex/cssrlib_5km_1hz/SEPT2650.21P"
    with pytest.raises(InputError, match="no epoch with a solution"):
        solve(rover, base, [other], GEODETIC)


def test_times_are_rounded_to_milliseconds_without_a_minute_of_sixty():
    assert calendar(GpsTime(2190, 525_659_999_600_000)) == "2022/01/01 02:01:00.000"
