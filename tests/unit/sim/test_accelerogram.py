"""Archives' formats: real files where they are at hand, written ones for the formats' rules."""

import warnings

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from deepseis_core.errors import InputError
from deepseis_sim.accelerogram import read_accelerogram
from deepseis_sim.accelerogram_formats import direction_of

G = 9.80665


def columns(values, width, per_row, decimals):
    """Write numbers as Fortran does; a full column touches the one before."""
    rows = [values[i : i + per_row] for i in range(0, len(values), per_row)]
    return "".join("".join(f"{v:{width}.{decimals}f}" for v in row) + "\n" for row in rows)


def knet_text(direction, counts, extra_header=""):
    return (
        "Origin Time       2011/03/11 14:46:00\nLat.              38.0\n"
        "Long.             142.9\nDepth. (km)       24\nMag.              9.0\n"
        "Station Code      ABC001\nStation Lat.      38.5\nStation Long.     141.25\n"
        "Station Height(m) 40\nRecord Time       2011/03/12 00:00:05\nSampling Freq(Hz) 100Hz\n"
        f"Duration Time(s)  {len(counts) / 100:g}\nDir.              {direction}\n"
        "Scale Factor      2000(gal)/8388608\nMax. Acc. (gal)   1\n"
        f"Last Correction   2011/03/11 14:46:36\nMemo.             {extra_header}\n"
        + columns(np.asarray(counts, float), 9, 8, 0)
    )


def csmip_v1_text(names, values):
    """Pairs of time and g/10, with touching columns where the value is below -10."""
    blocks = []
    for name in names:
        pairs = np.stack((0.01 * np.arange(len(values)), values), axis=1).ravel()
        blocks.append(
            "UNCORRECTED ACCELEROGRAM DATA\nTEST\nRCRD\n"
            "1-S1  TRIGGER TIME: 12/31/99, 16:00:01.5 PST\n"
            "STATION NO. 14403   33.929N, 118.260W     SMA-1  S/N 3492\nPLACE\n"
            f"CHAN  1: {name}\nTEST\nHYPOCENTER\nSENSITIVITY = 1.77 CM/G.\n"
            f"NO. OF POINTS = {len(values):6d}  RECORD LENGTH = 1 SEC\n"
            "UNITS OF UNCOR ACCEL ARE SEC AND G/10.     MAX  =  0 G\nRMS\n"
            + "    0\n" * 7
            + "      .000\n" * 7
            + columns(pairs, 7, 10, 3)
            + "/&  ----------  END OF DATA FOR CHANNEL  1  ----------\n"
        )
    return "".join(blocks)


def cosmos_text(codes, values, unit="cm/sec2(04)"):
    whole, real = np.full(100, -999.0), np.full(100, -999.0)
    whole[[0, 1, 39, 40, 41, 42, 43, 44]] = [1, 1, 2018, 168, 6, 17, 18, 34]
    real[[0, 1, 29, 61]] = [33.5, -115.5, 36.25, 10.0]
    blocks = []
    for code in codes:
        whole[53] = code
        blocks.append(
            "Uncorrected acceleration  (Format v01.20 with 13 text lines)\n"
            + "text\n" * 12
            + " 100 Integer-header values follow on  10 lines, Format= (10I8)\n"
            + columns(whole, 8, 10, 0)
            + " 100 Real-header values follow on  20 lines, Format= (5F15.6)\n"
            + columns(real, 15, 5, 6)
            + '   2 Comment line(s) follow, each starting with a "|":\n| one\n| two\n'
            + f"{len(values):8d} acceleration pts, approx 1 secs, units={unit}, Format=(8f10.5)\n"
            + columns(values, 10, 8, 5)
            + f"End-of-data for Chan {code} acceleration\n"
        )
    return "".join(blocks)


def geonet_text(names, values):
    blocks = []
    for name in names:
        numbers = [
            "    2016      11      13      11       2     560       0       0    2016      11"
        ]
        numbers += ["       0" * 8 + "      13      11", "       0" * 10]
        numbers += ["       0" * 8 + "       2   19715"] + ["     0.0" * 10] * 6
        blocks.append(
            "Uncorrected accelerogram X GNS Science\n"
            "Site WTMC      42 30 00S  173 15 00E     Cusp file:  X\n"
            + "text\n"
            * 7
            + f"Number of points  {len(values)}    Duration 1 s\n"
            "Raw readings in units of 1.00 mm/s/s  at intervals of 0.005 s\nunfiltered\n"
            f"Component {name}\nAcceleration:  Peak 0\nVelocity record unevaluated\n"
            "Displacement record unevaluated\n"
            + "\n".join(numbers)
            + "\n"
            + columns(values, 8, 10, 1)
        )
    return "".join(blocks)


def at2_text(last, values, old=False):
    counted = f"{len(values)} 0.0200 NPTS, DT" if old else f"NPTS= {len(values)}, DT= .0200 SEC,"
    rows = "\n".join(f"{value:15.7E}" for value in values)
    return (
        "PEER NGA STRONG MOTION DATABASE RECORD\n"
        f"Northridge-01, 1/17/1994, LA - 116th St, {last}\n"
        f"ACCELERATION TIME SERIES IN UNITS OF G\n{counted}\n{rows}\n"
    )


VALUES = np.array([1.0, -2.5, 3.25, -99.875, 0.0, 12.5, 7.0, -1.0, 0.5, 2.0, -4.0, 6.0])


def quiet_obspy():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import obspy
    return obspy


# Real files


@pytest.mark.parametrize(
    "name", ["MYG0041103111446.EW", "MYG0041103111446", ""], ids=["file", "prefix", "folder"]
)
def test_knets_largest_record_is_found_by_file_prefix_or_folder(shared_data, name):
    record = read_accelerogram(shared_data / "strong_motion/knet_MYG004_tohoku2011" / name)
    peaks = np.abs(record.acceleration - record.acceleration.mean(axis=0)).max(axis=0)
    # NIED's own figures in the headers, to their last digit of 0.001 gal.
    assert_allclose(peaks, [12.68488, 26.99886, 18.79929], atol=1.1e-5)
    assert record.start_utc_ns == 1_299_822_396_000_000_000  # 05:46:36
    assert (record.station, record.rate_hz, record.corrected) == ("MYG004", 100.0, False)
    assert (record.latitude_deg, record.longitude_deg) == (38.7292, 141.0217)


def test_knet_is_read_as_obspy_reads_it(shared_data):
    folder = shared_data / "strong_motion/knet_MYG004_tohoku2011"
    record = read_accelerogram(folder)
    for axis, suffix in enumerate(("EW", "NS", "UD")):
        trace = quiet_obspy().read(str(folder / f"MYG0041103111446.{suffix}"))[0]
        assert_allclose(record.acceleration[:, axis], trace.data * trace.stats.calib, rtol=1e-12)
        assert record.start_utc_ns == trace.stats.starttime.ns


def test_csmip_volume_2_holds_the_peaks_that_its_headers_state(shared_data):
    record = read_accelerogram(shared_data / "strong_motion/csmip/ce36456p_CE36456.V2")
    east = [np.abs(kind[:, 0]).max() for kind in (record.acceleration, record.velocity)]
    assert_allclose([*east, np.abs(record.displacement[:, 0]).max()], [2.67957, 0.28253, 0.05449])
    assert record.acceleration[547, 0] == pytest.approx(-2.67957)  # at 10.940 s, 90 DEG
    assert (record.rate_hz, record.corrected, record.oriented) == (50.0, True, True)
    assert record.start_utc_ns == 420_766_968_200_000_000  # 16:42:48.2 PDT, 1983-05-02


def test_axes_of_unknown_azimuth_are_marked_and_can_be_turned(shared_data):
    path = shared_data / "strong_motion/csmip/CE58667.V2"
    plain, turned = read_accelerogram(path), read_accelerogram(path, azimuth_deg=90.0)
    assert not plain.oriented
    assert_allclose(turned.acceleration[:, 0], plain.acceleration[:, 1], atol=1e-15)
    assert_allclose(turned.acceleration[:, 1], -plain.acceleration[:, 0], atol=1e-15)
    assert np.abs(plain.acceleration[:, 1]).max() == pytest.approx(0.27114, abs=1e-5)  # H1


def test_csmip_volume_1_in_tenths_of_g_keeps_the_peaks_of_its_headers(shared_data):
    record = read_accelerogram(shared_data / "strong_motion/csmip/LA116TH.RAW")
    # 90, 360 and up: -.200, -.143 and .060 g, printed to .001; film noise offsets add < .001 g
    assert_allclose(np.abs(record.acceleration).max(axis=0) / G, [0.2, 0.143, 0.06], atol=1e-3)
    peak = int(np.argmax(np.abs(record.acceleration[:, 0])))
    assert peak / record.rate_hz == pytest.approx(11.576, abs=0.006)
    assert record.acceleration[peak, 0] < 0


@pytest.mark.parametrize(
    ("name", "peaks", "padding"),
    [("WTMC_20.V1A", [11.0262, 9.2296, 31.5415], 0.0),
     ("WTMC_20.V2A", [9.7331, 7.9664, 18.0219], 5.0)],
)  # fmt: skip
def test_geonets_headers_agree_with_the_samples(shared_data, name, peaks, padding):
    folder = shared_data / "strong_motion/geonet_kaikoura2016"
    record = read_accelerogram(folder / f"20161113_110259_{name}")
    back = np.radians([332.0, 242.0])  # N28W, S62W
    east, north, up = record.acceleration.T
    axes = [np.sin(a) * east + np.cos(a) * north for a in back]
    found = [np.abs(value).max() for value in (*axes, up)]
    assert_allclose(found, peaks, atol=3e-4)  # printed to 1e-4; V1A's own differ by 2e-4
    peak = np.argmax(np.abs(axes[0])) / record.rate_hz
    assert peak - padding == pytest.approx(44.875, abs=0.01)  # 44.87 and 44.88
    # 11:02:19.715; the corrected one begins with 5 s of padding
    assert record.start_utc_ns == 1_479_034_939_715_000_000 - round(padding * 1e9)
    assert (record.velocity is not None) == record.corrected == name.endswith("V2A")
    assert record.latitude_deg == pytest.approx(-42.619, abs=1e-3)


# Written files


def write_knet(folder, counts, suffixes=("NS", "EW", "UD"), directions=("N-S", "E-W", "U-D")):
    for i, (suffix, direction) in enumerate(zip(suffixes, directions, strict=True)):
        (folder / f"ABC0011.{suffix}").write_text(knet_text(direction, counts + i))


def test_kiknets_surface_is_taken_unless_the_borehole_is_named(tmp_path):
    counts = np.arange(100)
    write_knet(tmp_path, counts, ("NS1", "EW1", "UD1"), "123")
    write_knet(tmp_path, counts + 500, ("NS2", "EW2", "UD2"), "456")
    unit = 20.0 / 8388608
    for name, first in (("", 500), ("ABC0011", 500), ("ABC0011.EW1", 0)):
        record = read_accelerogram(tmp_path / name)
        assert_allclose(record.acceleration[0], unit * (first + np.array([1, 0, 2])), rtol=1e-12)
    assert record.start_utc_ns == 1_299_855_590_000_000_000  # 2011-03-12 00:00:05 - 15 s - 9 h


def test_touching_columns_of_csmip_and_the_sign_of_down_are_read(tmp_path):
    path = tmp_path / "x.v1"
    path.write_text(csmip_v1_text(["N45E", "DOWN", "S45E"], VALUES))
    record = read_accelerogram(path)
    root = np.sqrt(0.5)
    # u1 = (E + N)/root 2, u2 = (E - N)/root 2, both VALUES: E = root 2 VALUES, N = 0.
    assert_allclose(record.acceleration[:, 0], VALUES * G / 10 / root)
    assert_allclose(record.acceleration[:, 1], 0.0, atol=1e-13)
    assert_allclose(record.acceleration[:, 2], -VALUES * G / 10)
    assert record.rate_hz == pytest.approx(100.0)
    assert record.start_utc_ns == 946_684_801_500_000_000  # 1999-12-31 16:00:01.5 PST


def test_cosmos_blocks_are_read_by_their_own_announcements(tmp_path):
    path = tmp_path / "x.v1"
    path.write_text(cosmos_text([360, 90, 401], VALUES))
    record = read_accelerogram(path)
    assert_allclose(record.acceleration, 0.01 * np.stack((VALUES, VALUES, -VALUES), axis=1),
                    atol=1e-15)  # fmt: skip
    assert (record.rate_hz, record.latitude_deg, record.source) == (100.0, 33.5, "COSMOS V1")
    assert record.start_utc_ns == 1_529_260_476_250_000_000
    path.write_text(cosmos_text([360, 90, 400], VALUES, "counts (50)"))
    with pytest.raises(InputError, match="counts"):
        read_accelerogram(path)


def test_three_files_of_peers_at2_make_a_record(tmp_path):
    for name, text in (
        ("R_A090.AT2", at2_text("90", VALUES)),
        ("R_A180.AT2", at2_text("unknown place", VALUES, old=True)),  # azimuth from the name
        ("R_A-UP.AT2", at2_text("UP", VALUES)),
    ):
        (tmp_path / name).write_text(text)
    files = sorted(tmp_path.iterdir())
    for given_as in (files, tuple(map(str, files)), tmp_path / "R_*.AT2", tmp_path):
        record = read_accelerogram(given_as)
        assert_allclose(record.acceleration, G * VALUES[:, None] * [1, -1, 1], atol=1e-12)
        assert record.rate_hz == pytest.approx(50.0)
        assert record.start_utc_ns is None
    with pytest.raises(InputError, match="0 vertical and 1 horizontal"):
        read_accelerogram(files[1])


def write_miniseed(path, channels, starts=(0, 0, 0), data=None):
    obspy = quiet_obspy()
    stream = obspy.Stream()
    data = np.arange(400, dtype=np.int32) if data is None else data
    for channel, start in zip(channels, starts, strict=True):
        header = {"station": "ABC", "channel": channel, "sampling_rate": 100.0,
                  "starttime": obspy.UTCDateTime(1_000_000_000 + start)}  # fmt: skip
        stream.append(obspy.Trace(data + len(stream), header))
    stream.write(str(path), format="MSEED")


def test_miniseed_needs_its_scale_and_is_cut_to_common_times(tmp_path):
    path = tmp_path / "record"
    write_miniseed(path, ["HNZ", "HN2", "HN1"], (0.0, 1.0, 0.5))
    with pytest.raises(InputError, match="counts"):
        read_accelerogram(path)
    record = read_accelerogram(path, scale=0.5)
    assert record.acceleration.shape == (300, 3)
    assert_allclose(record.acceleration[0], 0.5 * np.array([1.0, 52.0, 100.0]), rtol=1e-12)
    assert record.start_utc_ns == 1_000_000_001_000_000_000
    assert not record.oriented


def test_gaps_in_miniseed_are_refused(tmp_path):
    path = tmp_path / "record"
    write_miniseed(path, ["HNZ", "HNZ"], (0.0, 3e8))
    with pytest.raises(InputError, match="has gaps"):
        read_accelerogram(path, scale=1.0)


def test_pickles_are_never_opened(tmp_path):
    path = tmp_path / "stream"
    path.write_bytes(b"\x80\x04cobspy.core.stream\nStream\n.")
    with pytest.raises(InputError, match="pickled"):
        read_accelerogram(path)


# Bad files: one line that names file, line and reason


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (knet_text("N-S", range(100))[:900], "line 24: the file ends within counts: 50 of 100"),
        (knet_text("N-S", range(100)).replace(" 55", " x5"), "line 24: not numbers of counts"),
        (knet_text("N-S", range(100)).replace(" 55", "nan"), "line 24: not finite"),
        (knet_text("N-S", range(100)).replace("100Hz", "0Hz"), "sampling rate is '0'"),
        (knet_text("N-S", range(100)).replace("s)  1\n", "s)  9e9\n"), "duration"),
        (knet_text("X-Y", range(100)), "no usable field 'dir.'"),
        (csmip_v1_text(["90 DEG"], VALUES).replace("CHAN  1: 90", "CHAN  1: ??"), "direction"),
        (csmip_v1_text(["90", "UP"], VALUES), "1 vertical and 1 horizontal"),
        (csmip_v1_text(["90", "UP", "270"], VALUES), "point the same way"),
        (csmip_v1_text(["90", "UP", "0"], VALUES[::-1] * 1e9), "not numbers|values of time"),
        (csmip_v1_text(["90"], VALUES).replace("0.010", "0.000"), "do not grow"),
        (geonet_text(["N28W"], VALUES), "0 vertical and 1 horizontal"),
        (geonet_text(["N28W"], VALUES).replace("points  12", "points  1"), "number of samples"),
        (geonet_text(["N98W"], VALUES).replace("   -99.9", "********"), "line 27: not numbers"),
        (geonet_text(["Sideways"], VALUES), "line 13: unknown direction 'Sideways'"),
        (at2_text("90", VALUES).replace("NPTS= 12", "NPTS= 13"), "the file ends within"),
        (at2_text("90", VALUES).replace("DT= .02", "DT= .00"), "DT is '.0000'"),
        (cosmos_text([90, 0, 777], VALUES), "direction 777"),
        (cosmos_text([90, 0, 400], VALUES).replace("(10I8)", "(10I)"), "announcement of Integer"),
        ("hello\n", "in no known format"),
        ("", "in no known format"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_file_is_said_with_its_line(tmp_path, text, words):
    path = tmp_path / "record.x"
    path.write_text(text)
    with pytest.raises(InputError, match=words) as caught:
        read_accelerogram(path)
    assert "record.x" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_names_that_lead_nowhere_are_refused(tmp_path):
    for name in ("absent", "absent/absent", "*.AT2", "[", "x" * 300, "a\0b"):
        with pytest.raises(InputError, match=r"no such file|cannot be read"):
            read_accelerogram(tmp_path / name)
    with pytest.raises(InputError, match="empty"):
        read_accelerogram(tmp_path)
    with pytest.raises(InputError, match="no files"):
        read_accelerogram([])
    write_knet(tmp_path, np.arange(100))
    (tmp_path / "OTHER.NS").write_text("")
    with pytest.raises(InputError, match="several records"):
        read_accelerogram(tmp_path)
    (tmp_path / "ABC0011.UD").unlink()
    with pytest.raises(InputError, match="0 vertical and 2 horizontal"):
        read_accelerogram(tmp_path / "ABC0011.NS")


def test_components_of_different_rates_are_refused(tmp_path):
    write_knet(tmp_path, np.arange(100))
    path = tmp_path / "ABC0011.UD"
    path.write_text(path.read_text().replace("100Hz", "200Hz").replace("s)  1\n", "s)  0.5\n"))
    with pytest.raises(InputError, match=r"rates of the components differ: 100, 100, 200"):
        read_accelerogram(path)


@pytest.mark.parametrize("word", ["N28W", "332", "332 DEG"])
def test_directions_are_azimuths(word):
    assert direction_of(word) == (332.0, 1.0)


@pytest.mark.parametrize("word", ["", "N", "400", "N28", "??", "UPP", "1e3", "-5"])
def test_words_are_no_directions_by_accident(word):
    assert direction_of(word) in (None, (0.0, 1.0), (5.0, 1.0))


TEXTS = [
    knet_text("N-S", range(40)),
    csmip_v1_text(["90", "UP", "0"], VALUES),
    cosmos_text([360, 90, 400], VALUES),
    geonet_text(["N28W", "S62W", "Up"], VALUES),
    at2_text("90", VALUES),
]


@given(
    which=st.integers(0, len(TEXTS) - 1),
    cuts=st.lists(
        st.tuples(st.floats(0, 1), st.integers(0, 40), st.text(max_size=8)), min_size=1, max_size=6
    ),
    keep=st.floats(0.05, 1),
)
@settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
def test_no_damage_does_more_than_an_input_error(tmp_path, which, cuts, keep):
    text = TEXTS[which]
    for where, length, instead in cuts:
        at = int(where * len(text))
        text = text[:at] + instead + text[at + length :]
    path = tmp_path / "damaged.x"
    path.write_text(text[: int(keep * len(text))], encoding="utf-8")
    try:
        record = read_accelerogram(path)
    except InputError:
        return
    assert np.isfinite(record.acceleration).all()
    assert record.rate_hz > 0
