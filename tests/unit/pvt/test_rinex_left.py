"""What a killed process leaves of its RINEX file is gone on with, or finished."""

from dataclasses import replace

import georinex
import pytest
from unit.pvt.test_pvt_engine import engine, run
from unit.pvt.tracked_signals import WEEK

from deepseis_pvt.rinex_hours import RinexHours
from deepseis_pvt.rinex_left import LeftFile, finish_left, left_files
from deepseis_pvt.rinex_obs import RinexStation

HOUR_NS = 526 * 10**12 - 400 * 10**9  # 02:00:00 GPS time
STATION = RinexStation(name="DSEI00JPN", position_ecef=(-3.9e6, 3.3e6, 3.7e6))


@pytest.fixture(scope="module")
def first(still):
    return run(engine(), still)[0][0]


def write(first, folder, begin, end, *, rate=50, version="3.05"):
    """Write from ``begin`` to ``end`` [s after 02:00:00]."""
    hours = RinexHours(folder, STATION, version)
    for k in range(round(begin * rate), round(end * rate)):
        tow_ns = HOUR_NS + k * (10**9 // rate)
        hours.write(replace(first, week=WEEK, tow_ns=tow_ns, interval=1 / rate))
    return hours


def killed(first, folder, begin, end, cut=0, **how):
    """Leave what a killed process leaves, cut short by some bytes; what waits is lost."""
    hours = write(first, folder, begin, end, **how)
    (path,) = folder.glob("*.part")
    with path.open("r+b") as file:
        file.truncate(path.stat().st_size - cut)
    hours._writer._file.close()
    return path


def times(path):
    return georinex.load(path)["time"].values


@pytest.mark.parametrize("cut", [0, 1, 100, 700])
def test_the_next_process_goes_on_with_the_file(first, tmp_path, cut):
    killed(first, tmp_path, 10, 13, cut)
    (path,) = write(first, tmp_path, 14, 16).close()
    assert path.name == "DSEI00JPN_R_20220010200_01M_50Z_GO.rnx"
    assert not list(tmp_path.glob("*.part"))
    found = times(path)
    lost = {0: 0, 1: 1, 100: 1, 700: 2}[cut]
    # 12.00 s closes the second before it: of the last one nothing had been handed over.
    assert len(found) == 101 - lost + 100
    assert str(found[-1]).endswith("02:00:15.980000")
    assert (found[1:] > found[:-1]).all()


def test_another_hour_or_kind_is_finished_and_a_new_file_begun(first, tmp_path):
    killed(first, tmp_path, -600, -598)
    killed(first, tmp_path, 0, 2, version="4.02")
    paths = write(first, tmp_path, 61, 63).close()
    assert sorted(path.name for path in tmp_path.glob("*GO.rnx")) == [
        f"DSEI00JPN_R_20220010{at}_01M_50Z_GO.rnx" for at in ("150", "200", "201")
    ]
    assert paths[0].name == "DSEI00JPN_R_20220010201_01M_50Z_GO.rnx"
    assert not list(tmp_path.glob("*.part"))


def test_what_is_still_being_written_is_left_alone(first, tmp_path):
    living = write(first, tmp_path, 10, 12)
    assert list(left_files(tmp_path, STATION.name)) == []
    assert finish_left(tmp_path) == []
    assert living.close()[0].exists()


def test_time_that_runs_back_begins_a_new_file(first, tmp_path):
    path = killed(first, tmp_path, 70, 73)
    left = LeftFile.read(path)
    assert (left.version, left.interval) == ("3.05", 0.02)
    write(first, tmp_path, 5, 7).close()
    names = sorted(path.name for path in tmp_path.glob("*GO.rnx"))
    assert [name.split("_")[2] for name in names] == ["20220010200", "20220010201"]


def test_recover_gives_the_name(first, tmp_path):
    killed(first, tmp_path, 10, 13, 50)
    (path,) = finish_left(tmp_path)
    assert len(times(path)) == 100
    assert finish_left(tmp_path) == []


@pytest.mark.parametrize("content", [b"", b"nothing", b"x" * 70_000, b"END OF HEADER\n> 2022 1"])
def test_files_without_an_epoch_go(first, tmp_path, content):
    (tmp_path / "DSEI00JPN_1.rnx.part").write_bytes(content)
    assert finish_left(tmp_path) == []
    assert not list(tmp_path.iterdir())


def test_a_file_with_a_damaged_header_stays_as_it_is(first, tmp_path):
    path = killed(first, tmp_path, 10, 13)
    damaged = path.read_bytes().replace(b"END OF HEADER", b"END OF HEADEX")
    path.write_bytes(damaged)
    assert finish_left(tmp_path) == []
    assert path.read_bytes() == damaged
