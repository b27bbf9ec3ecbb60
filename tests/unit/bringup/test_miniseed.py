"""miniSEED, SDS, StationXML, QuakeML: read back by ObsPy; leap seconds by hand."""

import io
import struct
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from deepseis_bringup.export import fdsn_channels, quakeml, sds, stationxml
from deepseis_bringup.export.decimation import Decimator
from deepseis_bringup.export.miniseed import RECORD_BYTES, counts_of, day_records, sample_times
from deepseis_bringup.export.quiet_obspy import obspy_modules
from deepseis_bringup.export.sample_runs import Run, RunCutter, exact_pieces
from deepseis_bringup.export.utc_pieces import UtcMoment
from deepseis_core.errors import InputError
from deepseis_core.gps_time import GpsTime
from deepseis_core.types import DisplacementSource, Station

PLACE = fdsn_channels.Place("XX", "DSEI", 35.0, 139.0, 40.0)
START = GpsTime.from_utc_calendar(2022, 1, 1, 2, 0, 123_456_000).total_ns


def channel(rate_hz=200.0, quantity="displacement", component=0):
    found = fdsn_channels.displacement_channels(DisplacementSource.FUSED, False, rate_hz)
    return found[quantity][component]


def quake(count, rate_hz, columns=1):
    """Return metres of something that shakes, and times."""
    t = np.arange(count) / rate_hz
    rng = np.random.default_rng(3)
    wave = 0.8 * np.sin(2 * np.pi * 1.3 * t) * np.exp(-((t - 3) ** 2))
    return np.stack([wave + 1e-4 * rng.standard_normal(count) for _ in range(columns)], axis=1)


def read(data):
    return obspy_modules().read(io.BytesIO(data))


def joined(run, code):
    return b"".join(data for _, data in day_records(run, 0, code, PLACE))


def test_obspy_reads_back_values_times_and_ids():
    run = Run(sample_times(START, 4000, 200.0), quake(4000, 200.0), 200.0)
    data = joined(run, channel())
    assert len(data) % RECORD_BYTES == 0
    (trace,) = read(data)
    assert trace.id == "XX.DSEI.30.HXE"
    assert trace.stats.mseed.encoding == "STEIM2"
    assert trace.stats.sampling_rate == 200.0
    assert trace.stats.starttime.ns == 1_641_002_400_123_456_000
    assert trace.stats.npts == 4000
    # Half a count of a micrometre.
    assert_allclose(trace.data / 1e6, run.values[:, 0], rtol=0, atol=0.5e-6 * (1 + 1e-9))


def test_every_record_starts_when_its_first_sample_was_taken():
    # A clock 20 ppm fast: after a minute a nominal count would be 1.2 ms off.
    times = sample_times(START, 12_000, 200.0 * (1 + 20e-6))
    run = Run(times, quake(12_000, 200.0), 200.0)
    data = joined(run, channel())
    at = 0
    obspy = obspy_modules()
    for k in range(0, len(data), RECORD_BYTES):
        info = obspy.io.mseed.util.get_record_information(io.BytesIO(data[k : k + RECORD_BYTES]))
        true = UtcMoment.of_gps_ns(int(times[at])).unix_ns
        # STRAY of an interval (5 us), and half a microsecond of rounding.
        assert abs(info["starttime"].ns - true) <= 5_500
        at += info["npts"]
    assert at == 12_000


def test_a_gap_stays_a_gap_and_nan_is_one():
    times, values = sample_times(START, 1000, 200.0), quake(1000, 200.0)
    values[700:710] = np.nan
    keep = np.r_[0:300, 340:1000]
    cutter = RunCutter(200.0)
    runs = cutter.push(times[keep], values[keep])
    assert [len(run.gps_ns) for run in runs] == [300, 360, 290]
    assert not any(run.continues for run in runs)
    assert (cutter.count.gaps, cutter.count.missing) == (2, 50)
    stream = read(b"".join(joined(run, channel()) for run in runs))
    gaps = stream.get_gaps()
    assert [gap[7] for gap in gaps] == [40, 10]
    assert sum(len(trace) for trace in stream) == 950


def test_any_chunking_gives_the_same_runs():
    times, values = sample_times(START, 1000, 100.0), quake(1000, 100.0)
    keep = np.delete(np.arange(1000), np.r_[400:420, 555])
    whole = RunCutter(100.0).push(times[keep], values[keep])
    cutter, parts = RunCutter(100.0), []
    for k in range(0, len(keep), 7):
        parts += cutter.push(times[keep[k : k + 7]], values[keep[k : k + 7]])
    lengths = []
    for run in parts:
        lengths = (
            [*lengths[:-1], lengths[-1] + len(run.gps_ns)]
            if run.continues
            else [
                *lengths,
                len(run.gps_ns),
            ]
        )
    assert lengths == [len(run.gps_ns) for run in whole]
    assert cutter.count.missing == 21


def test_samples_that_come_again_are_counted_and_dropped():
    times, values = sample_times(START, 100, 100.0), quake(100, 100.0)
    cutter = RunCutter(100.0)
    cutter.push(times, values)
    (run,) = cutter.push(np.r_[times[90:], times[-1] + 10_000_000], np.r_[values[90:], values[:1]])
    assert len(run.gps_ns) == 1
    assert run.continues
    assert cutter.count.repeated == 10


def test_a_clock_that_is_set_starts_a_new_piece_and_no_gap():
    times = sample_times(START, 400, 200.0)
    times[200:] += 1_000_000  # a whole millisecond
    (run,) = RunCutter(200.0).push(times, quake(400, 200.0))
    assert list(exact_pieces(run)) == [slice(0, 200), slice(200, 400)]


LEAP_DAY = GpsTime.from_utc_calendar(2016, 12, 31, 23, 59, 50 * 10**9).total_ns


def headers(data):
    """Return year, day, hour, minute, second, fraction [1e-4 s], flags of each record."""
    return [
        (*struct.unpack_from(">HHBBBxH", data, at + 20), data[at + 36])
        for at in range(0, len(data), RECORD_BYTES)
    ]


def test_leap_second_2016_has_second_60_its_flag_and_its_day():
    # 50 Hz from 23:59:50 for 21 s of GPS time: 10 s + the leap second + 10 s.
    times = sample_times(LEAP_DAY, 21 * 50, 50.0)
    run = Run(times, quake(21 * 50, 50.0), 50.0)
    days = list(day_records(run, 0, channel(50.0), PLACE))
    first, leap, after = days
    midnight = 1_483_228_800 * 10**9
    assert [day for day, _ in days] == [midnight - 86_400 * 10**9] * 2 + [midnight]
    assert headers(first[1])[0] == (2016, 366, 23, 59, 50, 0, 0)
    assert set(headers(leap[1])) == {(2016, 366, 23, 59, 60, 0, 0x10)}
    assert headers(after[1])[0] == (2017, 1, 0, 0, 0, 0, 0)
    assert [read(data)[0].stats.npts for _, data in (first, after)] == [500, 500]
    # libmseed knows the second 60: three pieces follow one another without gap or overlap.
    (trace,) = read(b"".join(data for _, data in days))
    assert_allclose(trace.data / 1e6, run.values[:, 0], rtol=0, atol=0.51e-6)


def test_without_a_leap_second_midnight_only_changes_the_file():
    start = GpsTime.from_utc_calendar(2021, 12, 31, 23, 59, 59 * 10**9).total_ns
    run = Run(sample_times(start, 100, 50.0), quake(100, 50.0), 50.0)
    days = list(day_records(run, 0, channel(50.0), PLACE))
    assert [headers(data)[0][:6] for _, data in days] == [
        (2021, 365, 23, 59, 59, 0),
        (2022, 1, 0, 0, 0, 0),
    ]


@pytest.mark.parametrize(
    ("utc", "text"),
    [
        ((2016, 12, 31, 23, 59, 59_999_999_000), "2016-12-31T23:59:59.999999Z"),
        ((2016, 12, 31, 23, 59, 60_000_000_000), "2016-12-31T23:59:60.000000Z"),
        ((2016, 12, 31, 23, 59, 60_999_999_000), "2016-12-31T23:59:60.999999Z"),
        ((2017, 1, 1, 0, 0, 0), "2017-01-01T00:00:00.000000Z"),
        ((2012, 6, 30, 23, 59, 60_500_000_000), "2012-06-30T23:59:60.500000Z"),
    ],
)
def test_utc_text_around_leap_seconds(utc, text):
    assert UtcMoment.of_gps_ns(GpsTime.from_utc_calendar(*utc).total_ns).iso() == text


def test_obspy_finds_the_archive_by_its_layout(tmp_path):
    from obspy.clients.filesystem.sds import Client

    archive = sds.SdsArchive(tmp_path, PLACE)
    start = GpsTime.from_utc_calendar(2021, 12, 31, 23, 59, 55 * 10**9).total_ns
    run = Run(sample_times(start, 2000, 200.0), quake(2000, 200.0, 3), 200.0)
    codes = tuple(channel(component=k) for k in range(3))
    for k in range(0, 2000, 500):
        part = Run(run.gps_ns[k : k + 500], run.values[k : k + 500], 200.0, k > 0)
        archive.write(part, codes)
    names = sorted(str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*") if p.is_file())
    assert names[0] == "2021/XX/DSEI/HXE.D/XX.DSEI.30.HXE.D.2021.365"
    assert len(names) == 6
    utc = obspy_modules().UTCDateTime
    client = Client(str(tmp_path))
    found = client.get_waveforms("XX", "DSEI", "30", "HX?", utc(2021, 12, 31), utc(2022, 1, 2))
    found.merge()
    assert sorted(trace.id[-3:] for trace in found) == ["HXE", "HXN", "HXZ"]
    for k, trace in enumerate(sorted(found, key=lambda t: t.id)):
        assert trace.stats.npts == 2000
        assert_allclose(trace.data / 1e6, run.values[:, k], rtol=0, atol=0.51e-6)


def test_what_a_killed_writer_left_of_a_record_is_cut_off(tmp_path):
    run = Run(sample_times(START, 400, 200.0), quake(400, 200.0), 200.0)
    first = sds.SdsArchive(tmp_path, PLACE)
    first.write(run, (channel(),))
    (path,) = first.paths
    with path.open("ab") as file:
        file.write(path.read_bytes()[:300])
    later = Run(run.gps_ns + 2_000_000_000, run.values, 200.0)
    sds.SdsArchive(tmp_path, PLACE).write(later, (channel(),))
    (trace,) = obspy_modules().read(str(path))
    assert trace.stats.npts == 800


def test_a_step_that_steim_cannot_say_is_refused():
    with pytest.raises(InputError, match="HXE 30: changes by more than"):
        counts_of(np.array([0.0, 600.0]), channel())


@pytest.mark.parametrize(("rate", "band"), [(200.0, "H"), (100.0, "H"), (50.0, "B"), (1.0, "L")])
def test_codes_follow_fdsn(rate, band):
    assert channel(rate).code == band + "XE"
    assert channel(rate, "acceleration").code == band + "NE"
    assert channel(rate, "velocity").location == "31"
    gnss = fdsn_channels.displacement_channels(DisplacementSource.GNSS, False, rate)
    assert [gnss[q][0].location for q in gnss] == ["10", "11", "12"]
    assert gnss["acceleration"][2].code == band + "XZ"
    ids = set()
    for source in DisplacementSource:
        for smoothed in (False, True):
            found = fdsn_channels.displacement_channels(source, smoothed, rate)
            ids |= {(c.location, c.code) for triple in found.values() for c in triple}
    assert len(ids) == 6 * 9


def station(xyzw=(0.0, 0.0, 0.0, 1.0)):
    return Station(
        name="DSEI",
        network="XX",
        monument_ecef=np.array([-3959783.0, 3352586.0, 3697489.0]),
        antenna_lever_arm=np.zeros(3),
        imu_to_antenna=np.zeros(3),
        imu_orientation_xyzw=np.array(xyzw),
        receiver="DeepSeis",
        antenna="UNKNOWN",
        imu="SPAN-FSAS",
        imu_serial="17",
    )


def test_axes_of_the_imu_follow_its_orientation():
    # Turned by 30 degrees counterclockwise: forward heads north of east, azimuth 60.
    half = np.radians(15.0)
    turned = station((0.0, 0.0, np.sin(half), np.cos(half)))
    codes = fdsn_channels.imu_channels(turned, 200.0)["rotation"]
    assert [c.code for c in codes] == ["HJ1", "HJ2", "HJZ"]
    assert [c.azimuth_deg for c in codes[:2]] == [60.0, 330.0]
    assert codes[2].dip_deg == -90.0
    level = fdsn_channels.imu_channels(station(), 200.0)["acceleration"]
    assert [c.code for c in level] == ["HNE", "HNN", "HNZ"]
    upside_down = station((1.0, 0.0, 0.0, 0.0))
    codes = fdsn_channels.imu_channels(upside_down, 200.0)["acceleration"]
    assert [(c.code, c.dip_deg) for c in codes][2] == ("HN3", 90.0)


def test_stationxml_is_valid_and_its_response_is_that_of_the_data(tmp_path):
    decimator = Decimator(200.0, 1.0, 0.6)
    native = channel()
    slow = replace(native, band="L", rate_hz=1.0)
    spin = fdsn_channels.imu_channels(station(), 200.0)["rotation"][0]
    epochs = [
        stationxml.ChannelEpoch(native, START, START + 10**10),
        stationxml.ChannelEpoch(slow, START, START + 10**10, decimator.stages),
        stationxml.ChannelEpoch(spin, START, START + 10**10),
    ]
    path = tmp_path / "station.xml"
    stationxml.write_stationxml(path, PLACE, epochs, station())
    inventory = obspy_modules().read_inventory(str(path))
    obspy = obspy_modules()
    time = obspy.UTCDateTime(2022, 1, 1, 2, 0, 5)
    fast = inventory.get_response("XX.DSEI.30.HXE", time)
    at = np.array([0.05, 0.2, 0.3])
    assert_allclose(fast.get_evalresp_response_for_frequencies(at, output="DISP"), 1e6, rtol=1e-12)
    low = inventory.get_response("XX.DSEI.30.LXE", time)
    response = low.get_evalresp_response_for_frequencies(at, output="DISP")
    assert_allclose(response, 1e6, rtol=1e-4)  # flat, and without delay
    spinning = inventory.get_response("XX.DSEI.00.HJE", time)
    assert spinning.instrument_sensitivity.value == 1e8
    channel_info = inventory.get_channel_metadata("XX.DSEI.30.HXE", time)
    assert (channel_info["azimuth"], channel_info["dip"]) == (90.0, 0.0)


def test_obspy_removes_the_response_to_metres(tmp_path):
    run = Run(sample_times(START, 2000, 200.0), quake(2000, 200.0), 200.0)
    stream = read(joined(run, channel()))
    inventory = stationxml.build_inventory(
        PLACE, [stationxml.ChannelEpoch(channel(), START, START + 10**10)]
    )
    stream.remove_sensitivity(inventory)
    assert_allclose(stream[0].data, run.values[:, 0], rtol=0, atol=0.51e-6)


def event(**changes):
    onset = UtcMoment.of_gps_ns(START).unix_ns
    made = quakeml.StationEvent(
        *(onset + 5 * 10**9, "DSEI-20220101T020000", onset, False, 7.5, 0.1, 0.2, 3.0),
        *(float("nan"),) * 3,
    )
    return replace(made, **changes)


def test_quakeml_holds_the_last_report_of_each_event(tmp_path):
    last = event(
        utc_ns=event().utc_ns + 10**10,
        ended=True,
        peak_displacement=0.83,
        magnitude=7.1,
        magnitude_sd=0.3,
        hypocentral_distance=80_000.0,
    )
    path = tmp_path / "events.xml"
    quakeml.write_quakeml(path, PLACE, [event(), last])
    (found,) = obspy_modules().read_events(str(path))
    assert found.picks[0].time.ns == last.onset_utc_ns
    peaks = {a.type: (a.generic_amplitude, a.unit) for a in found.amplitudes}
    assert peaks == {"PGD": (0.83, "m"), "PGV": (0.2, "m/s"), "PGA": (3.0, "m/(s*s)")}
    assert found.preferred_magnitude().mag == 7.1
    assert found.preferred_magnitude().evaluation_status == "final"


def test_codes_that_miniseed_cannot_hold_are_named():
    with pytest.raises(InputError, match="station code 'TOOLONG'"):
        fdsn_channels.Place("XX", "TOOLONG", 0.0, 0.0, 0.0)
