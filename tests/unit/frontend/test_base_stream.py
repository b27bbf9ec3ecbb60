"""A live base: RTCM 3 decoded, cut and damaged, over TCP and NTRIP, lost and found again."""

import time
from dataclasses import replace

import numpy as np
import pytest
from base_caster import caster, eventually, pieces, rtcm_of_rinex, rtklib_caster
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from deepseis_bringup.export.rtcm_msm import msm7
from deepseis_bringup.export.rtcm_station import reference_point
from deepseis_core.errors import InputError
from deepseis_core.gps_time import GpsTime
from deepseis_core.rtcm_frame import Bits, frame
from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import Observations
from deepseis_frontend.base_events import Arcs, BaseReference, Row
from deepseis_frontend.base_link import BaseLink
from deepseis_frontend.base_rtklib import RtcmDecoder, rinex_events, rtcm_events
from deepseis_frontend.nodes.base_open import base_events
from deepseis_frontend.ntrip import Connection, RefusedError, address_of

START = GpsTime(2400, 100_000 * 10**9)
CLOCK = SampleClock(START.to_utc_ns(), 4e6)
PLACE = np.array([-3959403.8133, 3385705.8562, 3667525.8580])


def epochs(count, interval_ms=1000):
    """Return epochs of three satellites, each phase near its range."""
    arcs, out = Arcs(), []
    for k in range(count):
        time = GpsTime(START.week, START.tow_ns + k * interval_ms * 10**6)
        rows = [
            Row(name, r + 300.0 * k, (r + 300.0 * k) / 0.19029367, -1576.0 + n, 45.0 - n, 0)
            for n, (name, r) in enumerate([("G03", 2.1e7), ("G17", 2.3e7), ("G31", 2.5e7)])
        ]
        out.append(arcs.epoch(time, CLOCK.sample_at(time.to_utc_ns()), rows))
    return out


EPOCHS = epochs(40)
SENT = [reference_point(7, PLACE) + msm7(7, EPOCHS[0]), *(msm7(7, o) for o in EPOCHS[1:])]


def only_epochs(events):
    return [event for event in events if isinstance(event, Observations)]


def decoded(data, clock=CLOCK):
    decoder = RtcmDecoder(clock)
    events = [event for piece in pieces(data) for event in decoder.push(piece)]
    return events + decoder.finish(), decoder


def assert_same(got, sent, phase_shift=0.0):
    """Equal but for the resolution of MSM7: 2^-29 ms of code, 2^-31 ms of phase [m]."""
    assert len(got) == len(sent)
    for one, other in zip(got, sent, strict=True):
        assert (one.week, one.tow_ns, one.satellites) == (
            other.week,
            other.tow_ns,
            other.satellites,
        )
        assert one.sample_index == other.sample_index
        assert_allclose(one.pseudorange, other.pseudorange, rtol=0, atol=3e-4)
        difference = one.carrier_phase_cycles - other.carrier_phase_cycles
        assert_allclose(difference - np.round(difference), 0, atol=4e-4)
        assert_allclose(one.carrier_doppler_hz, other.carrier_doppler_hz, rtol=0, atol=1e-3)
        assert_allclose(one.cn0_dbhz, other.cn0_dbhz, atol=0.04)


def test_what_our_encoder_says_comes_back_by_the_time_of_the_samples():
    events, decoder = decoded(b"".join(SENT))
    assert isinstance(events[0], BaseReference)
    assert events[0].utc_ns == START.to_utc_ns()
    assert_allclose(events[0].position_ecef, PLACE, rtol=0, atol=1e-4)
    assert_same(only_epochs(events), EPOCHS)
    assert [o.sample_index for o in only_epochs(events)] == [4_000_000 * k for k in range(40)]
    assert [o.interval for o in only_epochs(events)][1:] == [1.0] * 39
    assert only_epochs(events)[-1].lock_time.tolist() == [39.0] * 3
    assert decoder.frames.damaged == 0


def test_the_week_is_told_by_the_samples_clock():
    for weeks in (-900, 0, 3):
        start = GpsTime(START.week + weeks, START.tow_ns + 3000 * 10**9)
        events, _ = decoded(SENT[0], SampleClock(start.to_utc_ns(), 4e6))
        assert only_epochs(events)[0].week == START.week + weeks


@pytest.mark.parametrize("kind", [1004, 1074, 1075, 1076, 1077])
def test_rtklibs_encoder_of_a_real_base_gives_its_rinex_file_again(shared_data, tmp_path, kind):
    path = shared_data / "rinex/cssrlib_5km_1hz/3034265G.21O"
    clock = SampleClock(GpsTime(2176, 282_000 * 10**9).to_utc_ns(), 4e6)
    items = rtcm_of_rinex(path, kind)[:60]
    (tmp_path / "base.rtcm").write_bytes(b"".join(items))
    events = list(base_events(tmp_path / "base.rtcm", clock))
    expected = list(base_events(path, clock))
    assert_allclose(events[0].position_ecef, expected[0].position_ecef, rtol=0, atol=1e-4)
    got, sent = only_epochs(events), only_epochs(expected)[:60]
    assert len(got) == len(sent) == 60
    # 1004 and MSM 4, 5: 2^-24 ms, 2^-29 ms, i.e. 18 mm and 0.6 mm; 1004 0.02 m, 0.5 mm.
    code, phase = (0.02, 5e-3) if kind in (1004, 1074, 1075) else (3e-4, 1e-3)
    for one, other in zip(got, sent, strict=True):
        assert (one.week, one.tow_ns) == (other.week, other.tow_ns)
        assert one.satellites == other.satellites
        assert_allclose(one.pseudorange, other.pseudorange, rtol=0, atol=code)
        turned = one.carrier_phase_cycles - other.carrier_phase_cycles
        assert_allclose(turned - np.round(turned), 0, atol=phase)
    steps = [np.diff([o.carrier_phase_cycles[0] for o in part]) for part in (got, sent)]
    assert_allclose(steps[0], steps[1], rtol=0, atol=2 * phase)  # no cycle lost between epochs


def test_gps_is_given_when_another_constellation_follows(shared_data):
    path = shared_data / "rinex/rtklib_geonet_3km_30s/30400920.05o"
    data = b"".join(rtcm_of_rinex(path, gps_only=False)[:20])
    clock = SampleClock(GpsTime(1316, 518_400 * 10**9).to_utc_ns(), 4e6)
    got, sent = (only_epochs(e) for e in (decoded(data, clock)[0], rinex_events(path, clock)))
    assert [o.tow_ns for o in got] == [o.tow_ns for o in sent[:20]]


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_damage_costs_what_it_hits_and_nothing_else(data):
    stream = bytearray(b"".join(SENT[:12]))
    for _ in range(data.draw(st.integers(0, 4))):
        at = data.draw(st.integers(0, len(stream) - 1))
        how = data.draw(st.sampled_from(["flip", "cut", "insert"]))
        if how == "flip":
            stream[at] ^= 1 << data.draw(st.integers(0, 7))
        elif how == "cut":
            del stream[at : at + data.draw(st.integers(1, 150))]
        else:
            stream[at:at] = data.draw(st.binary(min_size=1, max_size=60))
    got = only_epochs(decoded(bytes(stream))[0])
    by_time = {o.tow_ns: o for o in EPOCHS}
    assert len(got) >= 12 - 4 * 3  # an edit hits two frames at most, and bytes kept between
    assert_same(got, [by_time[o.tow_ns] for o in got])


@settings(max_examples=200, deadline=None)
@given(
    st.sampled_from([1001, 1002, 1003, 1004, 1005, 1006, 1074, 1075, 1076, 1077]),
    st.binary(max_size=400),
)
def test_messages_that_only_their_checksum_makes_good_do_no_harm(kind, body):
    bits = Bits().unsigned(kind, 12).unsigned(0, 4)
    for byte in body:
        bits.unsigned(byte, 8)
    decoder = RtcmDecoder(CLOCK)
    decoder.push(frame(bits) + frame(bits))
    decoder.finish()
    # A base that has said this goes on to be understood.
    decoder.push(SENT[1])
    events = decoder.push(SENT[2]) + decoder.push(SENT[3])
    assert_same(only_epochs(events)[-1:], EPOCHS[3:4])
    decoder.close()


def test_files_that_are_no_base_are_named(tmp_path):
    (tmp_path / "text").write_text("nothing")
    (tmp_path / "noise").write_bytes(b"\xd3\x00\x13" * 50)
    with pytest.raises(InputError, match="holds no base"):
        base_events(tmp_path / "text", CLOCK)
    with pytest.raises(InputError, match="holds no GPS observations"):
        list(rtcm_events(tmp_path / "noise", CLOCK))
    with pytest.raises(InputError, match="does not exist"):
        base_events(tmp_path / "gone", CLOCK)
    with pytest.raises(InputError, match="holds a password"):
        address_of("ntrip://me:secret@host/MOUNT")
    for text in ("ntrip://host", "tcp://host:5000/mount", "tcp://host", "ntrip://:1/M"):
        with pytest.raises(InputError, match="is none"):
            address_of(text)


def collect(link, count, seconds=20.0):
    """Return events once there are so many epochs among them."""
    events = []

    def enough():
        events.extend(link.take())
        return len(only_epochs(events)) >= count

    eventually(enough, seconds)
    return events


def test_rtklibs_caster_is_understood(monkeypatch):
    monkeypatch.setenv("DEEPSEIS_NTRIP_PASSWORD", "secret")
    with rtklib_caster(SENT, "me", "secret") as port:
        link = BaseLink(address_of(f"ntrip://me@127.0.0.1:{port}/MOUNT"), CLOCK)
        events = collect(link, len(SENT))
        assert link.connected
        link.close()
        with pytest.raises(RefusedError, match="no mountpoint ELSE"):
            Connection(address_of(f"ntrip://me@127.0.0.1:{port}/ELSE"), 3.0)
        monkeypatch.setenv("DEEPSEIS_NTRIP_PASSWORD", "wrong")
        with pytest.raises(OSError, match="closed"):
            Connection(address_of(f"ntrip://me@127.0.0.1:{port}/MOUNT"), 3.0)
    assert_same(only_epochs(events), EPOCHS)


def chunked(link, _request, _number):
    """Answer as a caster of version 2 does, cut anywhere."""
    body = b"".join(b"%x\r\n%s\r\n" % (len(item), item) for item in SENT)
    head = b"HTTP/1.1 200 OK\r\nNtrip-Version: Ntrip/2.0\r\nTransfer-Encoding: chunked\r\n\r\n"
    for piece in pieces(head + body, longest=40):
        link.sendall(piece)
    time.sleep(0.2)


def old(link, _request, _number):
    for piece in pieces(b"ICY 200 OK\r\n\r\n" + b"".join(SENT), longest=40):
        link.sendall(piece)
    time.sleep(0.2)


def plain(link, _request, _number):
    for piece in pieces(b"".join(SENT), longest=40):
        link.sendall(piece)
    time.sleep(0.2)


@pytest.mark.parametrize("answer", [chunked, old, plain])
def test_every_kind_of_caster_gives_the_same(answer):
    tcp = answer is plain
    with caster(answer, asks=not tcp) as port:
        where = f"tcp://127.0.0.1:{port}" if tcp else f"ntrip://127.0.0.1:{port}/BASE"
        link = BaseLink(address_of(where), CLOCK)
        events = collect(link, len(SENT))
        link.close()
    assert_same(only_epochs(events), EPOCHS)
    assert link.counts["damaged_frames"] == 0


@pytest.mark.parametrize(
    ("head", "told"),
    [
        (b"HTTP/1.1 401 Unauthorized\r\n\r\n", "401 Unauthorized"),
        (b"SOURCETABLE 200 OK\r\n\r\n", "no mountpoint BASE"),
        (b"HTTP/1.1 200 OK\r\nContent-Type: gnss/sourcetable\r\n\r\n", "no mountpoint BASE"),
        (b"220 smtp.example ESMTP\r\n", "no NTRIP caster"),
    ],
)
def test_a_refusal_is_told_in_words(head, told):
    with caster(lambda link, _request, _number: link.sendall(head)) as port:
        link = BaseLink(address_of(f"ntrip://127.0.0.1:{port}/BASE"), CLOCK, retry_s=(60.0, 60.0))
        eventually(lambda: told in link.state)
        assert not link.connected
        assert link.counts["failed"] == 1
        link.close()


def test_a_lost_connection_is_made_again_and_nothing_is_said_twice():
    """Each connection ends in the middle of a frame, and begins with two epochs of the last."""

    def cut(link, _request, number):
        begin = max(0, 10 * number - 2)
        data = b"".join(SENT[begin : 10 * number + 10])
        link.sendall(data[: -20 if number < 3 else None])
        if number >= 3:
            time.sleep(0.3)

    with caster(cut, asks=False) as port:
        link = BaseLink(address_of(f"tcp://127.0.0.1:{port}"), CLOCK, retry_s=(0.01, 0.05))
        events = collect(link, len(SENT))
        link.close()
    times = [o.tow_ns for o in only_epochs(events)]
    assert times == [o.tow_ns for o in EPOCHS]
    assert link.counts["connections"] >= 4
    assert link.counts["lost"] >= 3
    assert link.counts["repeated"] >= 3


def test_waits_between_attempts_grow_until_epochs_come():
    attempts = []

    def refuse(_address, _timeout):
        attempts.append(time.monotonic())
        raise ConnectionRefusedError("nobody there")

    address = address_of("tcp://127.0.0.1:9")
    link = BaseLink(address, CLOCK, retry_s=(0.02, 0.08), connect=refuse)
    eventually(lambda: len(attempts) >= 6)
    link.close()
    assert np.all(np.diff(attempts)[:5] >= [0.02, 0.04, 0.08, 0.08, 0.08])
    assert link.counts["failed"] == len(attempts)
    assert "nobody there" in link.state


def test_a_connection_that_says_nothing_new_is_given_up():
    def repeat(link, _request, _number):
        for _ in range(200):
            link.sendall(SENT[0])
            time.sleep(0.02)

    with caster(repeat, asks=False) as port:
        link = BaseLink(
            address_of(f"tcp://127.0.0.1:{port}"), CLOCK, silence_s=0.2, retry_s=(0.01, 0.05)
        )
        eventually(lambda: link.counts["connections"] >= 3)
        events = link.take()
        link.close()
    assert len(only_epochs(events)) == 1


def test_an_epoch_at_an_impossible_time_is_left_out():
    later = replace(EPOCHS[5], tow_ns=EPOCHS[5].tow_ns + 2 * 86400 * 10**9)
    events, decoder = decoded(b"".join([*SENT[:5], msm7(7, later), *SENT[6:9]]))
    assert decoder.implausible == 1
    assert_same(only_epochs(events), [*EPOCHS[:5], *EPOCHS[6:9]])


def test_half_cycles_and_slips_are_marked():
    marked = replace(EPOCHS[5], lli=np.array([0, 2, 0], np.uint8))
    slipped = replace(EPOCHS[6], lock_time=np.zeros(3, np.float32))
    data = b"".join([*SENT[:5], msm7(7, marked), msm7(7, slipped), *SENT[7:9]])
    got = only_epochs(decoded(data)[0])
    assert [o.lli[1] & 2 for o in got[4:7]] == [0, 2, 0]
    assert_array_equal(got[6].lli & 1, 1)
    assert_array_equal(got[8].lli & 1, 0)
    assert got[8].lock_time.tolist() == [2.0] * 3
