"""RTCM 3 and NMEA: RTKLIB encodes the same bytes and decodes ours; so do pyrtcm and pynmeagps."""

from dataclasses import replace

import numpy as np
import pynmeagps
import pyrtcm
import pyrtklib as rtk
import pytest
from numpy.testing import assert_allclose
from unit.pvt.tracked_signals import ephemeris as made_ephemeris
from unit.pvt.tracked_signals import rtklib_ephemeris

from deepseis_bringup.export.nmea import gga
from deepseis_bringup.export.rtcm_msm import lock_indicator, msm7
from deepseis_bringup.export.rtcm_station import gps_ephemeris, reference_point
from deepseis_core.constants import L1_WAVELENGTH, SPEED_OF_LIGHT
from deepseis_core.errors import InputError
from deepseis_core.geodesy import ecef_from_geodetic
from deepseis_core.gps_time import GpsTime
from deepseis_core.lnav import quantise
from deepseis_core.types import Observations, Pvt, PvtStatus

WEEK, TOW_NS = 2190, 525_618_020_000_000
MONUMENT = np.array([-3959783.1234, 3352586.5678, 3697489.0001])
SATELLITES = ("G31", "G05", "G12", "G20", "G01")


def ephemeris(prn=7):
    """Return an ephemeris as a satellite sends it: every number a whole number of its unit."""
    return quantise(made_ephemeris(prn))


def epoch(seed=0, count=5):
    rng = np.random.default_rng(seed)
    ranges = rng.uniform(2.0e7, 2.6e7, count)
    small = np.zeros(count, np.float32)
    return Observations(
        0, 0.0, WEEK, TOW_NS, 0, 0.02, SATELLITES[:count], ranges,
        (ranges + rng.uniform(-60, 60, count)) / L1_WAVELENGTH,
        rng.uniform(-4500, 4500, count),
        rng.uniform(25, 55, count).astype(np.float32),
        np.array([0, 0, 2, 0, 0], np.uint8)[:count],
        rng.uniform(0, 3000, count).astype(np.float32),
        small, small, small, small, np.zeros(count, np.uint16),
    )  # fmt: skip


def rtklib_decoder():
    rtcm = rtk.rtcm_t()
    assert rtk.init_rtcm(rtcm)
    rtcm.time = rtk.gpst2time(WEEK, 525_600.0)  # messages say neither week nor day
    return rtcm


def feed(rtcm, data):
    """Return RTKLIB's verdicts on the bytes: 0 nothing yet, 1 observations, 2 ephemeris, ..."""
    return [rtk.input_rtcm3(rtcm, byte) for byte in data]


def parsed(data):
    """Return pyrtcm's reading, its checksum verified."""
    return pyrtcm.RTCMReader.parse(data, validate=pyrtcm.VALCKSUM, labelmsm=1)


def kinds(data):
    """Return the numbers of messages that follow each other, as pyrtcm parses them."""
    return [int(m.identity) for m in messages(data)]


def messages(data):
    """Return messages that follow each other."""
    found = []
    while data:
        length = 6 + int.from_bytes(data[1:3], "big")
        found.append(pyrtcm.RTCMReader.parse(data[:length], validate=pyrtcm.VALCKSUM))
        data = data[length:]
    return found


@pytest.mark.parametrize("seed", range(4))
def test_rtklib_reads_every_observation_to_the_messages_resolution(seed):
    rtcm, o = rtklib_decoder(), epoch(seed)
    assert feed(rtcm, msm7(17, o))[-1] == 1
    assert rtcm.staid == 17
    assert rtcm.obs.n == 5
    for i in range(5):
        d, name = rtcm.obs.data[i], rtk.Arr1Dchar(8)
        rtk.satno2id(d.sat, name)
        k = o.satellites.index(name.ptr)
        week = rtk.Arr1Dint(1)
        assert rtk.time2gpst(d.time, week) == pytest.approx(TOW_NS / 1e9, abs=1e-9)
        assert week[0] == WEEK
        # Half a unit: 2^-29 and 2^-31 light milliseconds; Doppler 0.1 mm/s, single precision.
        assert_allclose(d.P[0], o.pseudorange[k], rtol=0, atol=2.9e-4)
        assert_allclose(d.L[0] * L1_WAVELENGTH, o.carrier_phase_cycles[k] * L1_WAVELENGTH, rtol=0,
                        atol=7.5e-5)  # fmt: skip
        assert_allclose(d.D[0], o.carrier_doppler_hz[k], rtol=0, atol=6e-4)
        assert_allclose(d.SNR[0] * rtk.SNR_UNIT, o.cn0_dbhz[k], rtol=0, atol=1 / 32 + 1e-3)
        assert d.code[0] == rtk.CODE_L1C
        assert bool(d.LLI[0] & 2) == bool(o.lli[k] & 2)


def rtklib_encoder(o):
    """Return RTKLIB's encoder with the same epoch, locks as old as ours."""
    rtcm = rtklib_decoder()
    rtcm.staid, rtcm.time = 17, rtk.gpst2time(o.week, o.tow_ns / 1e9)
    rtcm.obs.n = len(o.satellites)
    for i, k in enumerate(sorted(range(rtcm.obs.n), key=lambda k: o.satellites[k])):
        d = rtcm.obs.data[i]
        d.time, d.sat = rtcm.time, rtk.satno(rtk.SYS_GPS, int(o.satellites[k][1:]))
        d.code[0], d.LLI[0] = rtk.CODE_L1C, int(o.lli[k])
        d.P[0], d.L[0] = float(o.pseudorange[k]), float(o.carrier_phase_cycles[k])
        d.D[0] = float(o.carrier_doppler_hz[k])
        d.SNR[0] = round(float(o.cn0_dbhz[k]) / rtk.SNR_UNIT)
    return rtcm


def encoded_by_rtklib(rtcm, kind):
    assert rtk.gen_rtcm3(rtcm, kind, 0, 0) == 1
    return bytes(rtcm.buff[i] & 0xFF for i in range(rtcm.nbyte))


@pytest.mark.parametrize("seed", range(4))
def test_observations_are_byte_for_byte_rtklibs(seed):
    o = epoch(seed)
    # RTKLIB keeps Doppler in single precision.
    o = replace(o, carrier_doppler_hz=o.carrier_doppler_hz.astype(np.float32).astype(float))
    rtcm = rtklib_encoder(o)
    for satellite, lock in zip(o.satellites, o.lock_time.tolist(), strict=True):
        number = rtk.satno(rtk.SYS_GPS, int(satellite[1:]))
        rtcm.lltime[number - 1, 0] = rtk.timeadd(rtcm.time, -lock)
    assert msm7(17, o) == encoded_by_rtklib(rtcm, 1077)


@pytest.mark.parametrize("prn", [1, 7, 16, 32])
def test_ephemeris_is_byte_for_byte_rtklibs_and_comes_back_whole(prn):
    ours = ephemeris(prn)
    rtcm, theirs = rtklib_decoder(), rtklib_ephemeris(ours)
    rtcm.nav.eph[theirs.sat - 1], rtcm.ephsat = theirs, theirs.sat
    data = gps_ephemeris(ours)
    assert data == encoded_by_rtklib(rtcm, 1019)
    reader = rtklib_decoder()
    assert feed(reader, data)[-1] == 2
    back = reader.nav.eph[theirs.sat - 1]
    assert (back.week, back.toes, back.iode, back.iodc) == (ours.week, ours.toe, *(ours.iode,) * 2)
    names = ("M0", "e", "i0", "OMG0", "omg", "deln", "OMGd", "idot", "crc", "cus", "f0", "f1")
    for name in names:
        assert getattr(back, name) == pytest.approx(getattr(theirs, name), rel=1e-14)


@pytest.mark.parametrize(("kind", "height"), [(1005, None), (1006, 1.5)])
def test_reference_point_is_rtklibs_but_for_the_glonass_flag(kind, height):
    place = np.array([-3959783.125, 3352586.5625, 3697489.0])  # RTKLIB cuts, we round
    rtcm = rtklib_decoder()
    rtcm.staid, rtcm.sta.hgt = 17, height or 0.0
    for k in range(3):
        rtcm.sta.pos[k] = place[k]
    ours, theirs = (
        int.from_bytes(data[3:-3], "big") << (0 if height else 16)
        for data in (reference_point(17, place, height), encoded_by_rtklib(rtcm, kind))
    )
    # RTKLIB claims GLONASS too: bit 31 of 168.
    assert ours ^ theirs == 1 << (167 - 31)


@pytest.mark.parametrize("height", [None, 1.2345])
def test_rtklib_reads_the_reference_point(height):
    rtcm = rtklib_decoder()
    assert feed(rtcm, reference_point(17, MONUMENT, height))[-1] == 5
    assert_allclose([rtcm.sta.pos[k] for k in range(3)], MONUMENT, rtol=0, atol=1e-8)
    assert rtcm.sta.hgt == pytest.approx(height or 0.0, abs=1e-9)


def test_pyrtcm_reads_all_messages():
    o = epoch()
    found = parsed(msm7(17, o))
    order = sorted(range(5), key=lambda k: o.satellites[k])
    assert (found.identity, found.NSat, found.NSig, found.CELLSIG_01) == ("1077", 5, 1, "1C")
    assert found.DF004 == TOW_NS // 10**6
    for i, k in enumerate(order, 1):
        rough = getattr(found, f"DF397_{i:02d}") + getattr(found, f"DF398_{i:02d}")
        ms = SPEED_OF_LIGHT * 1e-3
        code = (rough + getattr(found, f"DF405_{i:02d}")) * ms
        phase = (rough + getattr(found, f"DF406_{i:02d}")) * ms
        rate = getattr(found, f"DF399_{i:02d}") + getattr(found, f"DF404_{i:02d}")
        assert getattr(found, f"PRN_{i:02d}") == o.satellites[k][1:].zfill(3)
        assert_allclose(code, o.pseudorange[k], rtol=0, atol=2.9e-4)
        assert_allclose(phase, o.carrier_phase_cycles[k] * L1_WAVELENGTH, rtol=0, atol=7.5e-5)
        assert_allclose(rate, -o.carrier_doppler_hz[k] * L1_WAVELENGTH, rtol=0, atol=5.1e-5)
    station = parsed(reference_point(4095, MONUMENT, 1.2345))
    assert (station.identity, station.DF003) == ("1006", 4095)
    assert pytest.approx(1.2345, abs=1e-12) == station.DF028
    assert_allclose([station.DF025, station.DF026, station.DF027], MONUMENT, rtol=0, atol=1e-8)
    item = parsed(gps_ephemeris(ephemeris()))
    assert (item.identity, item.DF009, item.DF076) == ("1019", 7, WEEK % 1024)
    assert pytest.approx(ephemeris().eccentricity, abs=1e-16) == item.DF090


def test_what_a_field_cannot_hold_is_marked_and_never_wrapped():
    o = epoch()
    phase, doppler, ranges = (
        x.copy() for x in (o.carrier_phase_cycles, o.carrier_doppler_hz, o.pseudorange)
    )
    phase[0], phase[1] = np.nan, phase[1] + 1200.0 / L1_WAVELENGTH
    doppler[2], ranges[3], ranges[4] = np.nan, np.nan, -5.0
    bad = replace(o, carrier_phase_cycles=phase, carrier_doppler_hz=doppler, pseudorange=ranges)
    rtcm = rtklib_decoder()
    assert feed(rtcm, msm7(17, bad))[-1] == 1
    by_name = {}
    for i in range(rtcm.obs.n):
        name = rtk.Arr1Dchar(8)
        rtk.satno2id(rtcm.obs.data[i].sat, name)
        by_name[name.ptr] = rtcm.obs.data[i]
    assert set(by_name) == set(o.satellites[:3])
    assert by_name["G31"].L[0] == by_name["G05"].L[0] == 0.0
    assert by_name["G12"].D[0] == 0.0
    assert by_name["G12"].P[0] == pytest.approx(o.pseudorange[2], abs=3e-4)


def test_an_epoch_without_satellites_is_a_message_without_cells():
    empty = {k: v[:0] for k, v in vars(epoch()).items() if isinstance(v, np.ndarray)}
    found = parsed(msm7(17, replace(epoch(), satellites=(), **empty)))
    assert (found.NSat, found.NCell) == (0, 0)


# DF407, table 3.5-75 of the standard: indicator, least lock time of it [ms].
@pytest.mark.parametrize(
    ("indicator", "least_ms"),
    [(0, 0), (1, 1), (63, 63), (64, 64), (65, 66), (95, 126), (96, 128), (127, 252),
     (128, 256), (159, 504), (160, 512), (671, 33_030_144), (672, 33_554_432),
     (703, 66_060_288), (704, 67_108_864)],
)  # fmt: skip
def test_lock_times_follow_the_table(indicator, least_ms):
    assert lock_indicator(least_ms / 1000) == indicator
    if least_ms:
        assert lock_indicator((least_ms - 1) / 1000) == indicator - 1


def test_epochs_between_milliseconds_and_foreign_satellites_are_refused():
    with pytest.raises(InputError, match="cannot say an epoch"):
        msm7(17, replace(epoch(), tow_ns=TOW_NS + 1))
    with pytest.raises(InputError, match="'R05' is not a GPS satellite"):
        msm7(17, replace(epoch(), satellites=("R05", *SATELLITES[1:])))
    with pytest.raises(InputError, match="4096 does not fit 12 bits"):
        msm7(4096, epoch())


def position(latitude, longitude, height, status=PvtStatus.FIX, tow_ns=TOW_NS):
    place = ecef_from_geodetic([np.radians(latitude), np.radians(longitude), height])
    return Pvt(
        0, WEEK, tow_ns, 0, status, place, np.zeros(3), 0.0, 0.0, np.eye(3).ravel(),
        np.eye(3).ravel(), tuple(f"G{k:02d}" for k in range(1, 10)), hdop=0.94,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("latitude", "longitude"),
    [(35.661234567, 139.745678901), (-33.9, 18.4), (0.5, -0.25), (89.9, -179.99)],
)
def test_pynmeagps_reads_the_position(latitude, longitude):
    text = gga(position(latitude, longitude, 61.5), geoid_separation=36.7)
    assert len(text) <= 84  # 82 of the standard, and two of minutes' further digits
    found = pynmeagps.NMEAReader.parse(text, validate=pynmeagps.VALCKSUM)
    assert found.identity == "GPGGA"
    # 1e-7 minutes: 0.1 mm.
    assert found.lat == pytest.approx(latitude, abs=1.1e-9)
    assert found.lon == pytest.approx(longitude, abs=1.1e-9)
    assert (found.quality, found.numSV, found.HDOP) == (4, 9, 0.9)
    assert (found.alt, found.sep) == (24.8, 36.7)
    assert str(found.time) == "02:00:00.020000"


@pytest.mark.parametrize(
    ("status", "quality"),
    [(PvtStatus.SINGLE, 1), (PvtStatus.FLOAT, 5), (PvtStatus.FIX, 4), (PvtStatus.NONE, 0)],
)
def test_quality_tells_the_kind_of_solution(status, quality):
    text = gga(position(35.0, 139.0, 10.0, status))
    assert text.split(",")[6] == str(quality)


def test_clock_is_utc_and_rounds_to_hundredths():
    before = GpsTime.from_utc_calendar(2022, 1, 1, 23, 59, 59_996_000_000)
    text = gga(replace(position(35.0, 139.0, 0.0), week=before.week, tow_ns=before.tow_ns))
    assert text.split(",")[1] == "000000.00"
