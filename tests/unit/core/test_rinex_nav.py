"""RINEX navigation files: real ones of versions 2 and 3, round trip, malformed ones, names."""

import dataclasses
import gzip

import pytest

from deepseis_core import rinex_nav
from deepseis_core.errors import InputError
from deepseis_core.gps_time import GpsTime
from deepseis_core.rinex_nav import read_rinex_nav, rinex3_name, write_rinex_nav

HEADER_2 = (
    "     2              NAVIGATION DATA                         RINEX VERSION / TYPE\n"
    "    0.1211D-07 -0.7451D-08 -0.5960D-07  0.1192D-06          ION ALPHA           \n"
    "    0.1167D+06 -0.2458D+06 -0.6554D+05  0.1114D+07          ION BETA            \n"
    "    0.279396772385D-08 0.799360577730D-14   147456     2191 DELTA-UTC: A0,A1,T,W\n"
    "    18                                                      LEAP SECONDS        \n"
    "                                                            END OF HEADER       \n"
)
RECORD = """\
 2 22  1  1  0  0  0.0-0.647393986583D-03-0.113686837722D-11 0.000000000000D+00
    0.410000000000D+02-0.142718750000D+03 0.455626121514D-08-0.453245129719D+00
   -0.748783349991D-05 0.206388905644D-01 0.423192977905D-05 0.515366817474D+04
    0.518400000000D+06-0.258907675743D-06-0.112496293255D+01 0.122934579849D-06
    0.964744088915D+00 0.303625000000D+03-0.146476911829D+01-0.868964767299D-08
   -0.262153776900D-09 0.100000000000D+01 0.219000000000D+04 0.000000000000D+00
    0.200000000000D+01 0.000000000000D+00-0.176951289177D-07 0.410000000000D+02
    0.512376000000D+06 0.400000000000D+01 0.000000000000D+00 0.000000000000D+00
"""
HEADER_4 = (
    "     4.00           NAVIGATION DATA     M                   RINEX VERSION / TYPE\n"
    "    18                                                      LEAP SECONDS        \n"
    "                                                            END OF HEADER       \n"
)
IONO_4 = """\
> ION G30 LNAV
    2022 01 01 00 00 00 1.118000000000E-08-7.451000000000E-09-5.960000000000E-08
     1.192000000000E-07 1.167000000000E+05-2.294000000000E+05-6.554000000000E+04
     1.049000000000E+06 0.000000000000E+00
> EPH E05 INAV
E05 2022 01 01 00 00 00 1.0
     1.0
"""


def test_a_version_2_record_is_read_number_by_number(tmp_path):
    path = tmp_path / "brdc.22n"
    path.write_text(HEADER_2 + RECORD)
    found = read_rinex_nav(path)
    (item,) = found.ephemerides
    assert (item.satellite, item.week, item.toe, item.toc) == ("G02", 2190, 518400.0, 518400.0)
    assert (item.af0, item.af1, item.af2) == (-0.647393986583e-3, -0.113686837722e-11, 0.0)
    assert (item.iode, item.crs, item.delta_n, item.m0) == (
        *(41, -142.71875, 0.455626121514e-8, -0.453245129719),
    )
    assert (item.sqrt_a, item.omega_dot, item.i_dot) == (
        *(5153.66817474, -0.868964767299e-8, -0.2621537769e-9),
    )
    assert (item.accuracy, item.health, item.tgd, item.iodc) == (2.0, 0, -0.176951289177e-7, 41)
    assert (item.transmit_tow, item.fit_interval_flag) == (512376.0, 0)
    assert item.iono_alpha == found.iono_alpha == (0.1211e-7, -0.7451e-8, -0.5960e-7, 0.1192e-6)
    assert (found.leap_seconds, found.utc.tot, found.utc.week_t) == (18, 147456.0, 2191)


def test_gzip_and_version_4_give_the_same_ephemeris(tmp_path):
    packed = tmp_path / "brdc.22n.gz"
    packed.write_bytes(gzip.compress((HEADER_2 + RECORD).encode()))
    (two,) = read_rinex_nav(packed).ephemerides
    lines = rinex_nav.format_rinex_nav([two]).splitlines()
    body = "\n".join(lines[lines.index(f"{'':60}END OF HEADER") + 1 :])
    path = tmp_path / "four.rnx"
    path.write_text(HEADER_4 + IONO_4 + "> EPH G02 LNAV\n" + body + "\n> EPH G02 CNAV\nG02 x\n")
    found = read_rinex_nav(path)
    (four,) = found.ephemerides
    assert found.iono_alpha == (1.118e-8, -7.451e-9, -5.96e-8, 1.192e-7)
    assert found.iono_beta == (1.167e5, -2.294e5, -6.554e4, 1.049e6)
    assert dataclasses.replace(four, iono_alpha=two.iono_alpha, iono_beta=two.iono_beta) == two


@pytest.mark.parametrize(
    ("name", "count", "week", "leap"),
    [
        ("if_captures/independent_sim/brdc0010.22n", 422, 2190, 18),
        ("if_captures/sxnsr_flight/sxnsr_test_data_flight.12n", 408, 1672, 15),
        ("gnss_ins/instinct_tckf_static/reach-m2-01_raw_202306291111.nav", 11, 2268, 18),
        ("gnss_ins/psins/01.15n", 64, 1829, None),
        ("rinex/rtklib_geonet_3km_30s/07590920.05n", 162, 1316, 13),
        ("rinex/cssrlib_5km_1hz/SEPT078M.21P", 24, 2149, 18),
        ("rinex/cssrlib_5km_1hz/SEPT2650.21P", 49, 2176, 18),
    ],
)
def test_real_files_are_read_and_survive_writing(shared_data, tmp_path, name, count, week, leap):
    found = read_rinex_nav(shared_data / name)
    assert len(found.ephemerides) == count
    assert {item.week for item in found.ephemerides} <= {week - 1, week, week + 1}
    assert found.leap_seconds == leap
    path = tmp_path / "out.rnx"
    write_rinex_nav(path, found.ephemerides, leap_seconds=leap)
    back = read_rinex_nav(path)
    key = dataclasses.astuple
    assert sorted(map(key, back.ephemerides)) == sorted(map(key, found.ephemerides))
    assert back.leap_seconds == leap


def test_rtklib_reads_the_written_file_as_we_do(tmp_path):
    rtklib = pytest.importorskip("pyrtklib")
    source = tmp_path / "brdc.22n"
    source.write_text(HEADER_2 + RECORD)
    (ours,) = read_rinex_nav(source).ephemerides
    path = tmp_path / "DEEP00XXX_R_20220010000_01H_GN.rnx"
    write_rinex_nav(path, [ours], leap_seconds=18)
    nav = rtklib.nav_t()
    assert rtklib.readrnx(str(path), 1, "", rtklib.obs_t(), nav, rtklib.sta_t()) == 1
    assert nav.n == 1
    theirs = nav.eph[0]
    assert (theirs.sat, theirs.week, theirs.toes, theirs.A) == (2, 2190, ours.toe, ours.sqrt_a**2)
    assert (theirs.M0, theirs.f0, theirs.iode, theirs.iodc) == (ours.m0, ours.af0, 41, 41)
    assert [nav.ion_gps[i] for i in range(8)] == [*ours.iono_alpha, *ours.iono_beta]


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        ("", 0, "not a RINEX file"),
        ("hello\n", 1, "not a RINEX file"),
        (HEADER_2.replace("NAVIGATION DATA", "OBSERVATION DAT"), 1, "not GPS navigation data"),
        (HEADER_2.replace("     2   ", "     9   "), 1, "version 9"),
        (HEADER_2[:200], 3, "within its header"),
        (HEADER_2.replace("0.1211D-07", "0.12x1D-07"), 2, "'0.12x1D-07' is not a number"),
        (HEADER_2 + RECORD[:300], 10, "cis of G02: '' is not"),
        (HEADER_2 + RECORD[:560], 13, "ends after 7 of 8 lines"),
        (HEADER_2 + RECORD[:240] + RECORD, 9, "ends after 3 of 8 lines"),
        (
            HEADER_2 + RECORD.replace("0.515366817474D+04", "0.5153668?7474D+04"),
            9,
            "sqrt_a of G02",
        ),
        (HEADER_2 + RECORD.replace("0.515366817474D+04", " " * 18), 9, "sqrt_a of G02"),
        (HEADER_2 + RECORD.replace("0.515366817474D+04", "0.515366817474D+05"), 14, "impossible"),
        (HEADER_2 + RECORD.replace("22  1  1", "22 13  1"), 7, "is no date"),
        (HEADER_2 + "77" + RECORD[2:], 7, "not a GPS satellite"),
    ],
)
def test_malformed_files_are_named_with_line_and_reason(tmp_path, text, line, reason):
    path = tmp_path / "bad.22n"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_rinex_nav(path)
    assert reason in str(caught.value)
    assert str(path) in str(caught.value)
    assert f"line {line}" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_files_directories_and_broken_gzip_are_named(tmp_path):
    for path in (tmp_path, tmp_path / "none.22n"):
        with pytest.raises(InputError, match=path.name):
            read_rinex_nav(path)
    broken = tmp_path / "cut.gz"
    broken.write_bytes(gzip.compress(HEADER_2.encode())[:60])
    with pytest.raises(InputError, match=r"cut\.gz"):
        read_rinex_nav(broken)


def test_nothing_half_written_stays(tmp_path):
    with pytest.raises(InputError):
        write_rinex_nav(tmp_path / "no" / "such.rnx", [])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("duration", "interval", "expected"),
    [  # file period and epoch rate of RINEX 3.05 table A1
        (900, None, "15M_GN"),
        (3600, 30, "01H_30S_GN"),
        (86400, 1, "01D_01S_GN"),
        (86400, 0.1, "01D_10Z_GN"),
        (61, 0.02, "02M_50Z_GN"),
        (30, 0.01, "01M_01C_GN"),
        (5400, 60, "90M_01M_GN"),
        (101 * 60, 0.5, "02H_02Z_GN"),
    ],
)
def test_names_state_period_and_rate(duration, interval, expected):
    start = GpsTime.from_calendar(2021, 12, 31, 23, 5)
    name = rinex3_name("DEEP00XXX", start, duration, "GN", interval_s=interval)
    assert name == f"DEEP00XXX_R_20213652305_{expected}.rnx"
