"""A bag written by hand, converted, and read back by ObsPy, georinex, RTKLIB and csv."""

import csv
import errno
import struct
from itertools import groupby

import numpy as np
import pynmeagps
import pytest
from mcap.reader import make_reader
from numpy.testing import assert_allclose
from typer.testing import CliRunner
from unit.bringup.test_rtcm import kinds, messages
from unit.pvt.rtklib_reference import exact_time

from deepseis_bringup.bags.mcap_recording import BagWriter
from deepseis_bringup.bags.ros_definitions import TopicQos
from deepseis_bringup.cli import app
from deepseis_bringup.export import convert
from deepseis_bringup.export.convert_survey import ConvertOptions, survey
from deepseis_bringup.export.quiet_obspy import obspy_modules
from deepseis_bringup.graph import TYPES
from deepseis_core.constants import L1_WAVELENGTH, SPEED_OF_LIGHT
from deepseis_core.errors import InputError
from deepseis_core.gps_time import GpsTime
from deepseis_core.imu_message import encode_imu
from deepseis_core.rinex_nav import read_rinex_nav
from deepseis_core.ros import codecs
from deepseis_core.ros.cdr import encode_message
from deepseis_core.ros.convert import stamp_from_ns
from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import (
    Displacement,
    DisplacementSource,
    Ephemeris,
    ImuSample,
    MotionState,
    Observations,
    PrecisePosition,
    PreciseStatus,
    Pvt,
    PvtStatus,
    Station,
)
from deepseis_frontend.imu_open import open_imu
from deepseis_msgs import msg

TYPE_OF = {topic: name for topic, (name, _) in TYPES.items()} | {
    "seismo/displacement": "deepseis_msgs/msg/Displacement",
    "seismo/event": "deepseis_msgs/msg/SeismicEvent",
}
START = GpsTime.from_utc_calendar(2022, 1, 1, 1, 59, 50 * 10**9)
RATE = 4e6
BIAS_NS = 123_456  # receiver ahead of GPS time
COARSE_LATE_NS = 250_000_000  # the coarse clock: behind the receiver's by a quarter second
MONUMENT = np.array([-3959783.0, 3352586.0, 3697489.0])
HALF = np.radians(15.0)


def motion(times_ns, frequency=0.9):
    """Return displacement, velocity, acceleration (n, 3) at GPS times [ns]."""
    t = (np.asarray(times_ns) - START.total_ns) * 1e-9
    w = 2 * np.pi * frequency
    size = np.array([0.5, 0.25, 0.1])
    return (
        np.sin(w * t)[:, None] * size,
        w * np.cos(w * t)[:, None] * size,
        -w * w * np.sin(w * t)[:, None] * size,
    )


def displacement(first, count, rate, source=DisplacementSource.FUSED):
    """Return a batch whose receiver times are on the grid of the rate, ``first`` samples in."""
    receiver = START.total_ns + (first + np.arange(count)) * (10**9 // rate)
    d, v, a = motion(receiver - BIAS_NS)
    start = GpsTime(0, int(receiver[0]))
    if source == DisplacementSource.GNSS:
        a = np.full_like(a, np.nan)
    sd = np.full((count, 3), 0.003, np.float32)
    tow = start.tow_ns + receiver - receiver[0]
    return Displacement(source, False, 0, 1 / rate, tow, start.week, d, v, a, sd, sd, sd)


class Writer:
    def __init__(self, folder, space="/DSEI"):
        # Many chunks, however fast the machine writes: a cut or damaged one is lost whole.
        self.bag = BagWriter(folder, flush_interval=0.02)
        self.space, self.known = space, set()

    def __call__(self, topic, data, utc_ns):
        name = f"{self.space}/{topic}"
        if name not in self.known:
            self.known.add(name)
            self.bag.add_topic(name, TYPE_OF[topic], TopicQos(depth=10, durability="volatile"))
        self.bag.write(name, TYPE_OF[topic], data, utc_ns, utc_ns)


def station():
    return Station(
        name="dsei",
        network="JP",
        monument_ecef=MONUMENT,
        antenna_lever_arm=np.array([0.1, 0.2, 1.5]),
        imu_to_antenna=np.zeros(3),
        imu_orientation_xyzw=np.array([0.0, 0.0, np.sin(HALF), np.cos(HALF)]),
        imu="SPAN-FSAS",
    )


def observations(time, interval):
    count = 5
    ranges = 2.1e7 + 1e6 * np.arange(count) + (time.tow_ns - START.tow_ns) * 1e-7
    small = np.zeros(count, np.float32)
    return Observations(
        0, 0.0, time.week, time.tow_ns, 0, interval,
        tuple(f"G{k + 3:02d}" for k in range(count)),
        ranges, ranges / L1_WAVELENGTH, np.full(count, -100.0), np.full(count, 45.0, np.float32),
        np.zeros(count, np.uint8), small + 9, small, small, small, small,
        np.zeros(count, np.uint16),
    )  # fmt: skip


def pvt(time, sample):
    return Pvt(
        sample, time.week, time.tow_ns, 0, PvtStatus.SINGLE, MONUMENT, np.zeros(3),
        BIAS_NS * 1e-9 * SPEED_OF_LIGHT, 0.0, np.eye(3).ravel(), np.eye(3).ravel(),
    )  # fmt: skip


def precise(time, moved, status=PreciseStatus.PHASE):
    return PrecisePosition(
        0, time.week, time.tow_ns, 0, "phase", status, moved, 1e-6 * np.eye(3).ravel(), 0.0, 1e-3
    )


def ephemeris(satellite, transmit_tow):
    return Ephemeris(
        satellite, 2190, 525600.0, 525600.0, 1e-5, 1e-12, 0.0, -1e-8, 5153.65, 0.01, 0.96, 1.0,
        0.5, 0.25, 4.5e-9, -8e-9, 1e-10, 1e-6, 8e-6, 220.0, -30.0, 1e-7, -5e-8, 41, 41,
        transmit_tow=transmit_tow, iono_alpha=(1.1e-8, 7.4e-9, -6e-8, -6e-8),
        iono_beta=(9.0e4, 0.0, -2.0e5, -6.5e4),
    )  # fmt: skip


SECONDS = 60
IMU_RATE = 200
GAP = (3000, 3100)  # fused samples that are missing


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """Write a minute of everything, from 02:00:08 GPS time on."""
    folder = tmp_path_factory.mktemp("convert") / "bag"
    write = Writer(folder)
    write.bag.add_metadata("parameters", {"pvt": f'{{"sample_rate_hz": {RATE}}}'})
    utc0 = START.to_utc_ns()
    write("station", codecs.STATION.encode(station(), utc0), utc0)
    # Sample 0 was taken at receiver time START; the coarse clock says a quarter second less.
    coarse0 = utc0 - COARSE_LATE_NS
    state = MotionState(0, 0, 1, "", np.zeros(6, np.float32), np.zeros(6, np.float32))
    write("motion/state", codecs.MOTION_STATE.encode(state, coarse0), coarse0)
    for k in range(SECONDS * 10):
        time = START.add_ns(k * 10**8)
        write("gnss/pvt", codecs.PVT.encode(pvt(time, k * 400_000), time.to_utc_ns()), coarse0)
    for k in range(0, SECONDS * 200, 20):
        if not GAP[0] <= k < GAP[1]:
            value = displacement(k, 20, 200)
            write("seismo/displacement", codecs.DISPLACEMENT.encode(value, utc0), utc0)
    for k in range(0, SECONDS * 50, 10):
        value = displacement(k, 10, 50, DisplacementSource.GNSS)
        write("seismo/displacement", codecs.DISPLACEMENT.encode(value, utc0), utc0)
    for k in range(1, SECONDS * IMU_RATE + 1):
        end = k * 10**9 // IMU_RATE
        middle = START.total_ns - BIAS_NS + end - 5 * 10**8 // IMU_RATE
        value = motion([middle])[2][0]
        sample = ImuSample(0, value * 0.01, value + np.array([0, 0, 9.8]), 1e-9, 1e-6)
        write("imu/data_raw", encode_imu(sample, coarse0 + end), coarse0 + end)
    for k in range(SECONDS * 50):
        time = START.add_ns(k * 20_000_000)
        value = observations(time, 0.02)
        write("gnss/observations", codecs.OBSERVATIONS.encode(value, time.to_utc_ns()), utc0)
    for satellite, tow in (("G03", START.tow_s() - 6.0), ("G04", START.tow_s() + 30.0)):
        value = ephemeris(satellite, round(tow))
        write("gnss/ephemeris", codecs.EPHEMERIS.encode(value, utc0), utc0)
    event = msg.SeismicEvent(
        event_id="DSEI-1", ended=True, onset_ratio=6.0, peak_displacement=0.5,
        peak_velocity=3.0, peak_acceleration=17.0, hypocentral_distance=float("nan"),
        magnitude=float("nan"), magnitude_sd=float("nan"),
    )  # fmt: skip
    event.header.stamp = stamp_from_ns(utc0 + 10**10)
    event.onset = stamp_from_ns(utc0)
    write("seismo/event", encode_message(event), utc0 + 10**10)
    write.bag.close()
    return folder


@pytest.fixture(scope="module")
def archive(bag, tmp_path_factory):
    folder = tmp_path_factory.mktemp("archive")
    said = []
    options = ConvertOptions(alias=True)
    written = convert.convert(bag, "miniseed", folder, options, said.append)
    assert all(path.is_file() for path in written)
    return folder, said


def stream_of(archive, location, channel):
    folder, _ = archive
    return obspy_modules().read(str(folder / f"2022/JP/DSEI/{channel}.D/*.{location}.*"))


def times_of(trace):
    return GpsTime.from_utc_ns(trace.stats.starttime.ns).total_ns + np.rint(
        np.arange(trace.stats.npts) * 1e9 / trace.stats.sampling_rate
    ).astype(np.int64)


@pytest.mark.parametrize(
    ("location", "channel", "quantity", "scale"),
    [
        ("30", "HXE", 0, 1e6),
        ("31", "HXN", 1, 1e6),
        ("30", "HNZ", 2, 1e6),
        ("10", "BXE", 0, 1e6),
        ("11", "BXZ", 1, 1e6),
    ],
)
def test_samples_carry_true_time_and_value(archive, location, channel, quantity, scale):
    stream = stream_of(archive, location, channel)
    count = 0
    for trace in stream:
        # True time: 5 us of `STRAY` (20 us at 50 Hz) times the wave's slope of its derivative.
        expected = motion(times_of(trace))[quantity][:, "ENZ".index(channel[2])]
        slope = (2 * np.pi * 0.9) ** (quantity + 1) * 0.5
        allowed = 1e-6 * slope + 0.5 / scale
        assert_allclose(trace.data / scale, expected, rtol=0, atol=allowed)
        count += trace.stats.npts
    rate = stream[0].stats.sampling_rate
    assert count == SECONDS * rate - (100 if location[0] == "3" else 0)


def test_a_station_without_a_fusion_has_its_phases_displacement(tmp_path):
    """Also while there are none: 2 s are a gap. Without its first epochs nothing is lost."""
    write, utc0 = Writer(tmp_path / "bag"), START.to_utc_ns()
    write("station", codecs.STATION.encode(station(), utc0), utc0)
    for k in range(100):
        time = START.add_ns(k * 10**8)
        write("gnss/pvt", codecs.PVT.encode(pvt(time, k * 400_000), time.to_utc_ns()), utc0)
    for k in range(500):
        time = START.add_ns(k * 20_000_000)
        moved = motion([time.total_ns - BIAS_NS])[0][0]
        status = PreciseStatus.NONE if 200 <= k < 300 else PreciseStatus.PHASE
        data = codecs.PRECISE_POSITION.encode(precise(time, moved, status), time.to_utc_ns())
        write("gnss/precise", data, utc0)
    write.bag.close()
    said = []
    convert.convert(tmp_path / "bag", "miniseed", tmp_path / "out", ConvertOptions(), said.append)
    assert "1 gaps, 100 samples missing" in " ".join(said)
    for letter, column in zip("ENZ", range(3), strict=True):
        stream = stream_of((tmp_path / "out", said), "10", f"BX{letter}")
        assert [trace.stats.npts for trace in stream] == [200, 200]
        for trace in stream:
            expected = motion(times_of(trace))[0][:, column]
            assert_allclose(trace.data / 1e6, expected, rtol=0, atol=4e-6)
    assert not list((tmp_path / "out").rglob("*.11.*"))  # phases alone know no velocity


def test_the_gap_is_a_gap_of_its_own_length(archive):
    stream = stream_of(archive, "30", "HXE")
    ((*_, length, samples),) = stream.get_gaps()
    assert samples == GAP[1] - GAP[0]
    assert length == pytest.approx(0.5, abs=1e-6)
    assert "3 gaps, 300 samples missing, 0 came again" in archive[1]


@pytest.mark.parametrize(("channel", "rate"), [("BXE", 50.0), ("LXE", 1.0)])
def test_lower_rates_of_the_fused_motion_have_its_times_and_values(archive, channel, rate):
    stream = stream_of(archive, "30", channel)
    assert {trace.stats.sampling_rate for trace in stream} == {rate}
    native = {}
    for trace in stream_of(archive, "30", "HXE"):
        native |= dict(zip((times_of(trace) + 500) // 1000, trace.data, strict=True))
    for trace in stream:
        times = (times_of(trace) + 500) // 1000
        assert set(times.tolist()) <= native.keys()
        if rate == 50.0:  # 0.9 Hz is within the pass band
            expected = [native[t] for t in times.tolist()]
            assert_allclose(trace.data, expected, rtol=0, atol=0.5e6 * 1e-4 + 1)
        else:  # above its Nyquist frequency: nothing folds back
            assert np.abs(trace.data).max() < 0.5e6 * 1e-4 + 1
    assert len(stream) == 2 if rate == 50.0 else len(stream) >= 1


def test_alias_holds_the_same_records_under_source_y(archive):
    (x,), (y,) = stream_of(archive, "10", "LXE"), stream_of(archive, "10", "LYE")
    assert np.array_equal(x.data, y.data)
    assert x.stats.starttime == y.stats.starttime


def test_acceleration_of_gnss_alone_is_not_there(archive):
    folder, _ = archive
    assert not list(folder.glob("2022/JP/DSEI/*/*.12.*"))


def test_imu_is_at_the_middle_of_its_intervals_in_true_time(archive):
    # The coarse clock was a quarter second late, the receiver's 123 us early: both are undone.
    (trace,) = stream_of(archive, "00", "HN1")
    start = START.total_ns - BIAS_NS + 5 * 10**8 // IMU_RATE
    assert abs(times_of(trace)[0] - start) <= 500
    expected = motion(times_of(trace))[2][:, 0]
    assert_allclose(trace.data / 1e6, expected, rtol=0, atol=1e-4)
    (spin,) = stream_of(archive, "00", "HJ1")
    assert_allclose(spin.data / 1e8, expected * 0.01, rtol=0, atol=1e-6)


def test_stationxml_names_every_channel_of_the_archive(archive):
    folder, _ = archive
    inventory = obspy_modules().read_inventory(str(folder / "JP.DSEI.xml"))
    described = {(c.location_code, c.code) for c in inventory[0][0].channels}
    found = {tuple(path.name.split(".")[2:4]) for path in folder.glob("2022/*/*/*/*")}
    assert described == found
    codes = {c.code: c for c in inventory[0][0].channels if c.location_code == "00"}
    assert (codes["HN1"].azimuth, codes["HN2"].azimuth) == (60.0, 330.0)
    assert inventory[0][0].latitude == pytest.approx(35.66, abs=0.1)


def test_quakeml_beside_it(archive):
    (event,) = obspy_modules().read_events(str(archive[0] / "events.xml"))
    assert event.picks[0].time.ns == START.to_utc_ns()
    assert [a.generic_amplitude for a in event.amplitudes] == [0.5, 3.0, 17.0]


@pytest.mark.parametrize("version", ["3.05", "4.02"])
def test_hourly_rinex_through_rtklib(bag, tmp_path, version):
    import pyrtklib as rtk

    options = ConvertOptions(rinex_version=version, rinex_name="DSEI00JPN")
    written = convert.convert(bag, "rinex", tmp_path, options, print)
    assert [path.name for path in written] == [
        "DSEI00JPN_R_20220010200_01M_50Z_GO.rnx",
        "DSEI00JPN_R_20220010200_01H_GN.rnx",
    ]
    obs, nav, sta = rtk.obs_t(), rtk.nav_t(), rtk.sta_t()
    assert rtk.readrnx(str(written[0]), 1, "", obs, nav, sta) == 1
    times = [t for t, _ in groupby(range(obs.n), key=lambda i: exact_time(obs.data[i]))]
    expected = [
        (315_964_800 * 10**9 + START.add_ns(k * 20_000_000).total_ns) // 100
        for k in range(SECONDS * 50)
    ]
    assert times == expected
    assert_allclose([sta.pos[k] for k in range(3)], MONUMENT, atol=1e-4)
    found = read_rinex_nav(written[1])
    assert [e.satellite for e in found.ephemerides] == ["G03", "G04"]
    assert found.ephemerides[1] == ephemeris("G04", found.ephemerides[1].transmit_tow)
    assert found.leap_seconds == 18
    assert written[0].read_text()[:20].split() == [version]


def test_a_bag_becomes_a_file_of_either(bag, tmp_path):
    for to, more in (("rtcm", ["--rtcm-rate", "10"]), ("nmea", [])):
        done = CliRunner().invoke(app, ["convert", str(bag), "--to", to, *more, "-o",
                                        str(tmp_path / to)])  # fmt: skip
        assert done.exit_code == 0, done.stderr
    data = (tmp_path / "rtcm" / "observations.rtcm3").read_bytes()
    numbers = kinds(data)
    assert (numbers.count(1077), numbers.count(1006)) == (600, 7)
    assert {m.DF009 for m in messages(data) if m.identity == "1019"} == {3, 4}
    text = (tmp_path / "nmea" / "positions.nmea").read_text()
    places = [pynmeagps.NMEAReader.parse(line) for line in text.splitlines()]
    assert len(places) == 600
    assert {(p.msgID, p.quality) for p in places} == {("GGA", 1)}


def test_a_disk_that_takes_no_more_is_said_in_a_line_and_leaves_nothing(
    bag, tmp_path, monkeypatch
):
    def full(*_values):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("deepseis_bringup.export.convert_rtcm.RtcmStream.take_observations", full)
    folder = tmp_path / "out"
    done = CliRunner().invoke(app, ["convert", str(bag), "--to", "rtcm", "-o", str(folder)])
    assert done.exit_code == 1
    assert done.stderr.splitlines() == [f"deepseis: {folder}: No space left on device"]
    assert not folder.exists()


def table(path):
    with path.open() as file:
        return list(csv.DictReader(file))


def test_csv_has_exact_times_and_all_rows(bag, tmp_path):
    written = convert.convert(bag, "csv", tmp_path, ConvertOptions(), print)
    names = {path.stem for path in written}
    assert names == {"displacement_fused", "displacement_gnss", "imu", "observations",
                     "positions", "events", "ephemerides"}  # fmt: skip
    rows = table(tmp_path / "displacement_fused.csv")
    assert len(rows) == SECONDS * 200 - 100
    assert rows[0]["utc"] == "2022-01-01T01:59:49.999876544Z"
    assert int(rows[0]["tow_ns"]) == START.tow_ns - BIAS_NS
    assert float(rows[0]["displacement_sd_up_m"]) == pytest.approx(0.003)
    imu = table(tmp_path / "imu.csv")
    assert len(imu) == SECONDS * IMU_RATE
    event = table(tmp_path / "events.csv")[0]
    assert (event["event_id"], event["onset_utc"]) == ("DSEI-1", "2022-01-01T01:59:50.000000Z")


def test_the_command_leaves_an_archive_and_names_it(bag, tmp_path):
    folder = tmp_path / "out"
    result = CliRunner().invoke(app, ["convert", str(bag), "--to", "miniseed", "-o", str(folder)])
    assert result.exit_code == 0, result.output
    assert result.stdout.splitlines()[-1] == str(folder)
    assert (folder / "2022/JP/DSEI/HXE.D/JP.DSEI.30.HXE.D.2022.001").is_file()


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--to", "sac"], "--to sac: is not a format"),
        (["--to", "rinex", "--rinex-version", "2.11"], "RINEX version 2.11: is not written"),
        (["--to", "rinex", "--rinex-name", "DSEI"], "is not nine letters"),
        (["--to", "miniseed", "--station", "dsei-1"], "station code 'dsei-1'"),
    ],
)
def test_bad_input_is_one_line(bag, tmp_path, arguments, text):
    folder = tmp_path / "out"
    result = CliRunner().invoke(app, ["convert", str(bag), *arguments, "-o", str(folder)])
    assert result.exit_code == 2
    assert text in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1
    assert not folder.exists()


def test_a_bag_without_motion_says_so(tmp_path):
    write = Writer(tmp_path / "bag")
    write("station", codecs.STATION.encode(station(), 10**18), 10**18)
    write.bag.close()
    (tmp_path / "out").mkdir()
    with pytest.raises(InputError, match="holds nothing for miniseed"):
        convert.convert(tmp_path / "bag", "miniseed", tmp_path / "out", ConvertOptions(), print)


@pytest.mark.parametrize("part", [0.4, 0.97])
def test_a_bag_that_was_cut_short_is_converted_as_far_as_it_goes(bag, tmp_path, part):
    (whole,) = bag.glob("*.mcap")
    cut, out, said = tmp_path / "cut.mcap", tmp_path / "out", []
    cut.write_bytes(whole.read_bytes()[: round(part * whole.stat().st_size)])
    out.mkdir()
    written = convert.convert(cut, "miniseed", out, ConvertOptions(), said.append)
    assert all(path.stat().st_size for path in written)
    assert any("cut short or damaged" in text for text in said)


def test_a_bag_that_was_cut_before_its_first_epoch_says_so(bag, tmp_path):
    (whole,) = bag.glob("*.mcap")
    cut, out = tmp_path / "cut.mcap", tmp_path / "out"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 50])
    out.mkdir()
    with pytest.raises(InputError, match="holds nothing for rinex"):
        convert.convert(cut, "rinex", out, ConvertOptions(), print)


@pytest.mark.parametrize("at", [0.3, 0.6])
def test_damage_within_a_bag_is_a_gap_and_is_said(bag, tmp_path, at):
    (whole,) = bag.glob("*.mcap")
    data = bytearray(whole.read_bytes())
    with whole.open("rb") as file:
        chunks = make_reader(file).get_summary().chunk_indexes
    chunk = chunks[int(at * len(chunks))]
    middle = chunk.chunk_start_offset + chunk.chunk_length // 2
    data[middle : middle + 50] = bytes(50)
    bad, out, said = tmp_path / "bad.mcap", tmp_path / "out", []
    bad.write_bytes(data)
    out.mkdir()
    assert convert.convert(bad, "miniseed", out, ConvertOptions(), said.append)
    assert any("cut short or damaged" in text for text in said)


def test_two_stations_in_a_bag_are_refused(tmp_path):
    write = Writer(tmp_path / "bag")
    data = codecs.STATION.encode(station(), 10**18)
    write("station", data, 10**18)
    write.space = "/DSEJ"
    write("station", data, 10**18)
    write.bag.close()
    with pytest.raises(InputError, match="one station at a time"):
        survey(tmp_path / "bag")


def test_a_message_that_cannot_be_read_is_named(tmp_path):
    write = Writer(tmp_path / "bag")
    write("station", b"\0\1\0\0" + struct.pack("<iI", 1, 2) + b"\xff" * 8, 10**18)
    write.bag.close()
    with pytest.raises(InputError, match="unreadable message on /DSEI/station"):
        survey(tmp_path / "bag")


def test_a_clock_set_by_a_millisecond_moves_no_true_time():
    rows = [(k * 10**8, (0.4e6 if k < 50 else -0.6e6), k * 400_000) for k in range(100)]
    # Receiver times jump back by 1 ms at the fiftieth position.
    receiver = np.array([t - (10**6 if k >= 50 else 0) for k, (t, _, _) in enumerate(rows)])
    time = convert.TrueTime(
        receiver, np.array([b for _, b, _ in rows]), np.array([s for *_, s in rows]), None
    )
    true = time.of_receiver(receiver)
    assert set(np.diff(true)) == {10**8}


def test_the_imu_s_table_is_an_input_again(bag, tmp_path):
    convert.convert(bag, "csv", tmp_path, ConvertOptions(), print)
    rows = table(tmp_path / "imu.csv")
    clock = SampleClock(START.to_utc_ns(), 4e6)
    imu = open_imu(tmp_path / "imu.csv", clock)
    samples = list(imu.samples())
    assert imu.rate_hz == IMU_RATE
    times = [int(row["tow_ns"]) - START.tow_ns for row in rows]
    expected = [clock.sample_at(clock.start_utc_ns + t) for t in times]
    assert [s.sample_index for s in samples] == [e for e in expected if e >= 0]
    assert imu.format.installation is not None
