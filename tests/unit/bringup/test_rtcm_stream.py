"""A station as a base: what RTKLIB, pyrtcm and pynmeagps read of its stream, file and port."""

import socket
import time
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from unit.bringup.test_convert import MONUMENT, START, ephemeris, observations, station
from unit.bringup.test_rtcm import feed, kinds, rtklib_decoder

from deepseis_bringup.export.rtcm_stream import RtcmConfig, RtcmStream
from deepseis_bringup.export.tcp_out import BEHIND_BYTES, TcpOut
from deepseis_core.errors import InputError
from deepseis_core.geodesy import ecef_from_enu

ANTENNA = ecef_from_enu(station().antenna_lever_arm, MONUMENT)


def stream(rate_hz=1.0):
    made = RtcmStream(RtcmConfig(rtcm_rate_hz=rate_hz, rtcm_station_id=17))
    made.take_station(station())
    return made


def played(made, seconds=31, rate=50):
    """Say so many seconds of 50 Hz; return what was sent each time."""
    return [
        made.take_observations(observations(START.add_ns(k * 10**9 // rate), 1 / rate))
        for k in range(seconds * rate)
    ]


def test_epochs_of_the_rate_are_sent_and_the_rest_at_its_intervals():
    made = stream()
    assert kinds(made.take_ephemeris(ephemeris("G03", 525_600))) == [1019]
    assert made.take_ephemeris(ephemeris("G03", 525_600)) == b"", "said before"
    sent = played(made)
    assert [k for k, data in enumerate(sent) if data] == list(range(0, 31 * 50, 50))
    said = [kinds(data) for data in sent if data]
    assert [k for k, numbers in enumerate(said) if 1006 in numbers] == [0, 2, 12, 22]
    assert [k for k, numbers in enumerate(said) if 1019 in numbers] == [0, 22]
    assert all(numbers[-1] == 1077 for numbers in said)
    assert kinds(made.greeting()) == [1006, 1019]


def test_rtklib_has_a_base_after_the_first_epoch():
    made, decoder = stream(50.0), rtklib_decoder()
    made.take_ephemeris(ephemeris("G03", 525_600))
    verdicts = feed(decoder, b"".join(played(made, 2)))
    assert (verdicts.count(1), verdicts.count(2), verdicts.count(5)) == (100, 1, 1)
    assert_allclose([decoder.sta.pos[k] for k in range(3)], ANTENNA, atol=1e-4)
    assert decoder.sta.hgt == pytest.approx(1.5)
    assert decoder.staid == 17


def test_without_a_survey_or_below_its_monument_nothing_false_is_said():
    made = RtcmStream(RtcmConfig())
    assert kinds(b"".join(played(made, 1))) == [1077]
    sunk = replace(station(), antenna_lever_arm=np.array([0.0, 0.0, -0.3]))
    made.take_station(sunk)
    assert kinds(made.greeting()) == [1005]


def test_a_rate_between_milliseconds_is_refused():
    with pytest.raises(InputError, match="rtcm_rate_hz 3: its epochs are not whole milliseconds"):
        RtcmStream(RtcmConfig(rtcm_rate_hz=3.0))


def receive(client, count):
    """Return so many bytes, fewer if the stream ends."""
    found = b""
    while len(found) < count and (data := client.recv(count - len(found))):
        found += data
    return found


def wait_for(condition):
    deadline = time.monotonic() + 10.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.005)


def test_everybody_who_connects_gets_the_greeting_and_then_the_stream():
    server = TcpOut(("127.0.0.1", 0), "test", lambda: b"hello")
    with ExitStack() as stack:
        clients = []
        for number in (1, 2):
            client = socket.create_connection(("127.0.0.1", server.port), 10.0)
            clients.append(stack.enter_context(client))
            wait_for(lambda count=number: server.clients == count)
            server.put(b"%d" % number)
        clients[0].sendall(b"what the server does not listen to")
        server.close()
        assert receive(clients[0], 100) == b"hello12"
        assert receive(clients[1], 100) == b"hello2"
    with pytest.raises(OSError, match="refused"):
        socket.create_connection(("127.0.0.1", server.port), 1.0)


def test_who_does_not_read_is_let_go_and_costs_the_others_nothing():
    server = TcpOut(("127.0.0.1", 0), "test")
    with ExitStack() as stack:
        for count in (1, 2):
            reader = socket.create_connection(("127.0.0.1", server.port), 10.0)
            stack.enter_context(reader)
            wait_for(lambda count=count: server.clients == count)
        part, heard = bytes(BEHIND_BYTES // 4), 0
        while server.clients == 2:
            server.put(part)
            heard += len(receive(reader, len(part)))
            assert heard < 64 * BEHIND_BYTES
        server.put(b"still here")
        assert receive(reader, 10) == b"still here"
        assert server.dropped == 1
        server.close()


def test_a_port_that_is_taken_is_said():
    with socket.create_server(("127.0.0.1", 0)) as other:
        taken = other.getsockname()[1]
        with pytest.raises(InputError, match=f"nmea on 127.0.0.1 port {taken}: Address already"):
            TcpOut(("127.0.0.1", taken), "nmea")
