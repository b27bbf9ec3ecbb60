"""RINEX by the hour, versions 3.05 and 4.02, read by RTKLIB and georinex."""

import errno
import os
from dataclasses import replace

import georinex
import numpy as np
import pyrtklib as rtk
import pytest
from unit.pvt.test_pvt_engine import engine, run
from unit.pvt.tracked_signals import WEEK, ephemeris

from deepseis_core.errors import DiskError, InputError
from deepseis_core.gps_time import GpsTime
from deepseis_core.rinex_nav import format_record, read_rinex_nav
from deepseis_core.rinex_nav4 import format_rinex_nav4
from deepseis_pvt import rinex_hours
from deepseis_pvt.products import RinexProducts
from deepseis_pvt.rinex_hours import RinexHours
from deepseis_pvt.rinex_obs import RinexObsWriter, RinexStation

HOUR = 526 * 10**12 - 400 * 10**9  # 525600 s of week: 02:00:00 GPS time
ALPHA, BETA = (1.1e-8, 7.4e-9, -6e-8, -6e-8), (9.0e4, 0.0, -2.0e5, -6.5e4)


@pytest.fixture
def first(still):
    return run(engine(), still)[0][0]


def sent(prn, tow):
    return replace(ephemeris(prn), transmit_tow=tow, iono_alpha=ALPHA, iono_beta=BETA)


def write_across_the_hour(first, folder, rate, version):
    """Write 0.4 s before and after 02:00:00, and an ephemeris of each hour."""
    hours = RinexHours(folder, RinexStation(name="DSEI00JPN"), version)
    step = 10**9 // rate
    for k in range(-4 * rate // 10, 4 * rate // 10):
        hours.write(replace(first, week=WEEK, tow_ns=HOUR + k * step, interval=1 / rate))
    for prn, tow in ((5, 525_598.0), (7, 525_606.0)):
        hours.add(sent(prn, tow))
    return hours.close()


@pytest.mark.parametrize("version", ["3.05", "4.02"])
@pytest.mark.parametrize(("rate", "code"), [(50, "50Z"), (100, "01C")])
def test_a_new_file_begins_with_the_hour(first, tmp_path, rate, code, version):
    paths = write_across_the_hour(first, tmp_path, rate, version)
    assert [path.name for path in paths] == [
        f"DSEI00JPN_R_20220010159_01M_{code}_GO.rnx",
        f"DSEI00JPN_R_20220010200_01M_{code}_GO.rnx",
        "DSEI00JPN_R_20220010100_01H_GN.rnx",
        "DSEI00JPN_R_20220010200_01H_GN.rnx",
    ]
    assert not list(tmp_path.glob("*.part"))
    count, satellites = 4 * rate // 10, len(first.satellites)
    for path in paths[:2]:
        obs = rtk.obs_t()
        assert rtk.readrnx(str(path), 1, "", obs, rtk.nav_t(), rtk.sta_t()) == 1
        assert obs.n == count * satellites
        assert path.read_text()[5:9] == version
    begin = next(line for line in paths[1].read_text().splitlines() if line.startswith(">"))
    assert begin.startswith("> 2022 01 01 02 00  0.0000000")


def test_georinex_reads_both_hours(first, tmp_path):
    paths = write_across_the_hour(first, tmp_path, 50, "3.05")
    for path, start in zip(
        paths[:2], ("2022-01-01T01:59:59.6", "2022-01-01T02:00:00"), strict=True
    ):
        data = georinex.load(path, use="G")
        assert data.sizes["time"] == 20
        assert abs(data.time.values[0] - np.datetime64(start)) <= np.timedelta64(1, "us")


def test_version_4_leaves_out_what_it_no_longer_knows(first, tmp_path):
    three, four = (tmp_path / "3", tmp_path / "4")
    texts = []
    for folder, version in ((three, "3.05"), (four, "4.02")):
        folder.mkdir()
        texts.append(write_across_the_hour(first, folder, 50, version)[0].read_text().splitlines())
    labels = [{line[60:].strip() for line in text if text.index(line) < 20} for text in texts]
    assert labels[0] - labels[1] == {"SYS / PHASE SHIFT"}
    bodies = [text[text.index(f"{'':60}END OF HEADER") :] for text in texts]
    assert bodies[0] == bodies[1]


def test_navigation_files_hold_what_was_sent_in_their_hour(first, tmp_path):
    for version in ("3.05", "4.02"):
        folder = tmp_path / version
        folder.mkdir()
        paths = write_across_the_hour(first, folder, 50, version)[2:]
        found = [read_rinex_nav(path) for path in paths]
        assert [[e.satellite for e in file.ephemerides] for file in found] == [["G05"], ["G07"]]
        for file in found:
            assert file.version == float(version)
            assert file.leap_seconds == 18
            assert (file.iono_alpha, file.iono_beta) == (ALPHA, BETA)
        (item,) = found[1].ephemerides  # to the 13 digits that files have
        assert format_record(item) == format_record(sent(7, 525_606.0))


def test_version_4_records_stand_in_the_columns_of_the_standard():
    lines = format_rinex_nav4(
        [sent(7, 525_606.0)], leap_seconds=18, date="20220101 020000 UTC"
    ).splitlines()
    assert lines[0][:9] == "     4.02"
    assert (lines[0][20], lines[0][40]) == ("N", "G")
    body = lines[lines.index(f"{'':60}END OF HEADER") + 1 :]
    assert body[0] == "> EPH G07 LNAV"
    assert body[1][:23] == "G07 2022 01 01 02 00 00"
    assert body[9] == "> ION G07 LNAV"
    assert (
        body[10]
        == "    2022 01 01 02 00 06 1.100000000000E-08 7.400000000000E-09-6.000000000000E-08"
    )
    assert body[11].startswith("    -6.000000000000E-08 9.000000000000E+04 0.000000000000E+00")
    assert body[12] == "    -6.500000000000E+04 0.000000000000E+00"
    assert len(body) == 13


def test_another_version_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"RINEX version 2\.11: is not written"):
        RinexObsWriter(tmp_path, version="2.11")


def test_a_whole_hour_is_called_one(first, tmp_path):
    hours = RinexHours(tmp_path, RinexStation(name="DSEI00JPN"))
    for second in (*range(0, 3600, 60), 3599):
        hours.write(replace(first, week=WEEK, tow_ns=HOUR + second * 10**9, interval=1.0))
    (path,) = hours.close()
    assert path.name == "DSEI00JPN_R_20220010200_01H_01S_GO.rnx"
    assert GpsTime(WEEK, HOUR).to_calendar()[:5] == (2022, 1, 1, 2, 0)


def test_a_stations_products_begin_a_new_file_with_the_hour(first, tmp_path):
    products = RinexProducts(tmp_path, RinexStation(name="DSEI00JPN"))
    for k in range(-20, 20):
        products.write(replace(first, week=WEEK, tow_ns=HOUR + k * 20_000_000), None)
    products.add(sent(7, 525_606.0))
    assert [path.name for path in products.close()] == [
        "DSEI00JPN_R_20220010159_01M_50Z_GO.rnx",
        "DSEI00JPN_R_20220010200_01M_50Z_GO.rnx",
        "DSEI00JPN_R_20220010159_01M_GN.rnx",
    ]


class FullDisk:
    """A raw file that takes half of what it is given, then nothing, while the disk is full."""

    def __init__(self, file, full):
        self.file, self.full = file, full

    def write(self, data):
        if not self.full[0]:
            return self.file.write(data)
        if self.full[0] == "now":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self.full[0] = "now"
        return self.file.write(data[: len(data) // 2])

    def __getattr__(self, name):
        return getattr(self.file, name)


def write_on_a_full_disk(products, first):
    """Write 400 epochs at 50 Hz; the disk is full from the 100th to the 250th."""
    full = [""]
    for k in range(400):
        if k == 60:
            writer = products.observations._writer
            writer._file = FullDisk(writer._file, full)
        full[0] = (full[0] or "soon") if 100 <= k < 250 else ""
        products.write(replace(first, week=WEEK, tow_ns=HOUR + k * 20_000_000), None)


@pytest.fixture
def patient(tmp_path):
    return RinexProducts(tmp_path, RinexStation(name="DSEI00JPN"), patient=True)


def epochs_in(path):
    return [line[2:30] for line in path.read_text().splitlines() if line.startswith("> ")]


def test_a_disk_that_is_full_for_seconds_costs_no_epoch(first, patient):
    write_on_a_full_disk(patient, first)
    (path,) = patient.close()
    found = epochs_in(path)
    assert len(found) == len(set(found)) == 400
    assert found == sorted(found)
    assert patient.lost == 0


def test_a_disk_that_stays_full_costs_epochs_that_are_counted(first, patient, monkeypatch):
    monkeypatch.setattr(rinex_hours, "MOST_WAITING", 15_000)
    write_on_a_full_disk(patient, first)
    (path,) = patient.close()
    found = epochs_in(path)
    assert 0 < patient.lost <= 150
    assert len(found) == 400 - patient.lost
    assert found == sorted(found)


def test_in_lockstep_a_full_disk_is_an_error_and_whole_epochs_stay(first, tmp_path):
    products = RinexProducts(tmp_path, RinexStation(name="DSEI00JPN"))
    with pytest.raises(DiskError, match="RINEX cannot be written: No space left on device"):
        write_on_a_full_disk(products, first)
    products.observations._writer._file.close()
    (path,) = tmp_path.glob("*.part")
    assert path.read_text().endswith("\n")
    assert len(epochs_in(path)) == 51  # through the last whole second
