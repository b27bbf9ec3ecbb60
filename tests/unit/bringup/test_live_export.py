"""The live archive: packets, true time, what a kill costs."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from unit.bringup.test_convert import (
    BIAS_NS,
    COARSE_LATE_NS,
    IMU_RATE,
    RATE,
    START,
    displacement,
    motion,
    pvt,
    station,
)

from deepseis_bringup.export.live_export import LiveConfig, LiveExport
from deepseis_bringup.export.quiet_obspy import obspy_modules
from deepseis_bringup.export.sds import SdsArchive
from deepseis_core.errors import InputError
from deepseis_core.ros import codecs
from deepseis_core.types import ImuSample

TESTS = Path(__file__).resolve().parents[2]


def feed(live, first_s, last_s, after=lambda _second: None):
    """Give a station's values in order, as they would come."""
    coarse0 = START.to_utc_ns() - COARSE_LATE_NS
    for k in range(round(first_s * 50), round(last_s * 50)):
        if k % 5 == 0:
            live.take_pvt(pvt(START.add_ns(k * 20_000_000), k * 80_000))
        for i in range(4 * k + 1, 4 * k + 5):
            end = i * 10**9 // IMU_RATE
            middle = START.total_ns - BIAS_NS + end - 5 * 10**8 // IMU_RATE
            value = motion([middle])[2][0]
            sample = ImuSample(0, value * 0.01, value, 1e-9, 1e-6)
            live.take_imu(sample, coarse0 + end)
        data = codecs.DISPLACEMENT.encode(displacement(4 * k, 4, 200), 0)
        live.take_displacement(codecs.DISPLACEMENT.decode(data)[0])  # flat, as off a topic
        after((k + 1) / 50)


def started(sink, **settings):
    live = LiveExport(LiveConfig(**settings), RATE, sink)
    live.take_station(station())
    live.take_stamp(0, START.to_utc_ns() - COARSE_LATE_NS)
    return live


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("live")
    sds = SdsArchive(folder)
    live = started(sds.append)
    feed(live, 0.0, 6.0)
    live.close()
    live.describe(folder)
    return folder, live


def read(folder, pattern):
    return obspy_modules().read(str(folder / "2022/JP/DSEI" / pattern))


@pytest.mark.parametrize(
    ("pattern", "quantity", "column"),
    [("HXE.D/*.30.*", 0, 0), ("HXZ.D/*.31.*", 1, 2), ("HN1.D/*.00.*", 2, 0)],
)
def test_what_is_written_is_the_motion_in_true_time(archive, pattern, quantity, column):
    (trace,) = read(archive[0], pattern)
    assert trace.stats.npts == 1200
    start = trace.stats.starttime.ns - START.to_utc_ns() + START.total_ns
    half = 5 * 10**8 // IMU_RATE if quantity == 2 else 0
    assert abs(start - (START.total_ns - BIAS_NS + half)) <= 500
    times = start + np.arange(1200) * 5_000_000
    assert_allclose(trace.data / 1e6, motion(times)[quantity][:, column], rtol=0, atol=1e-4)


def test_stationxml_is_open_at_its_end_and_written_once(archive):
    folder, live = archive
    inventory = obspy_modules().read_inventory(str(folder / "JP.DSEI.xml"))
    assert len(inventory[0][0].channels) == 15
    assert {channel.end_date for channel in inventory[0][0].channels} == {None}
    assert live.describe(folder) is None
    good, errors = obspy_modules().io.stationxml.core.validate_stationxml(
        str(folder / "JP.DSEI.xml")
    )
    assert good, errors


def test_packets_are_half_a_second_of_whole_records():
    sizes = []
    live = started(lambda name, data: sizes.append((name.parts[3], len(data))))
    spans = []
    feed(live, 0.0, 3.0, lambda second: spans.append((second, len(sizes))))
    assert all(size % 512 == 0 for _, size in sizes)
    # After any moment, no more than half a second of displacement is not yet given out.
    given = [count for _, count in spans]
    assert given[24] > 0
    assert sum(name == "HXE.D" for name, _ in sizes) >= 6


def test_without_a_station_or_a_clock_nothing_is_given_out_and_it_is_counted():
    given = []
    live = LiveExport(LiveConfig(), RATE, lambda *packet: given.append(packet))
    live.take_displacement(displacement(0, 20, 200))
    live.take_station(station())
    live.take_imu(ImuSample(0, np.zeros(3), np.zeros(3), 1e-9, 1e-6), START.to_utc_ns())
    live.close()
    assert not given
    assert live.held == 21


def write_until_killed(folder):
    """Write for ever, say each second of data that is complete (run in a process of its own)."""
    sds = SdsArchive(Path(folder))
    live = started(sds.append)

    def say(second):
        if second == int(second):
            print(int(second), flush=True)

    feed(live, 0.0, 3600.0, say)


def test_kill_9_costs_less_than_a_second(tmp_path):
    code = (
        f"import sys; sys.path.insert(0, {str(TESTS)!r})\n"
        "from unit.bringup.test_live_export import write_until_killed\n"
        f"write_until_killed({str(tmp_path)!r})"
    )
    with subprocess.Popen(
        [sys.executable, "-W", "ignore", "-c", code], stdout=subprocess.PIPE, text=True
    ) as process:
        said = 0
        for line in process.stdout:
            said = int(line)
            if said == 5:
                break
        os.kill(process.pid, signal.SIGKILL)
        rest = process.stdout.read().split()
    said = int(rest[-1]) if rest else said
    files = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert len(files) == 15
    assert all(path.stat().st_size % 512 == 0 for path in files)
    for path in files:
        (trace,) = obspy_modules().read(str(path))
        assert trace.stats.npts > 200 * (said - 1)


def test_a_bad_code_is_named():
    with pytest.raises(InputError, match="station code 'TOOLONG'"):
        started(print, station_code="TOOLONG")
