"""GDRT messages: read back by C's sscanf as the format's table says, and off a loopback port."""

import ctypes
import socket
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from unit.bringup.test_convert import MONUMENT, START, displacement

from deepseis_bringup.export.gdrt import GdrtPosition, GdrtSender, message
from deepseis_core.errors import InputError
from deepseis_core.geodesy import ecef_from_enu
from deepseis_core.gps_time import GpsTime
from deepseis_core.ros import codecs
from deepseis_core.types import DisplacementSource

# The fields of the table, in C's words.
TABLE = b"> %4s %4d%2d%2d%2d%2d%lf" + b"%d" * 4 + b"%lf%d" + b"%lf" * 9 + b"%4s %1s"


def scanned(data):
    """Return what C reads: strings, integers, doubles in the order of the table."""
    kinds = ["s", *"iiiii", "d", *"iiii", "d", "i", *"ddddddddd", "s", "s"]
    made = {
        "s": lambda: ctypes.create_string_buffer(8),
        "i": lambda: ctypes.c_int(),
        "d": lambda: ctypes.c_double(),
    }
    out = [made[kind]() for kind in kinds]
    given = [item if k == "s" else ctypes.byref(item) for k, item in zip(kinds, out, strict=True)]
    assert ctypes.CDLL(None).sscanf(data, TABLE, *given) == len(kinds)
    return [item.value for item in out]


def position(**changes):
    covariance = np.array([[0.04, 0.01, -0.02], [0.01, 0.09, 0.03], [-0.02, 0.03, 0.16]])
    time = GpsTime.from_utc_calendar(2022, 1, 1, 2, 3, 4_500_000_000).total_ns
    return replace(GdrtPosition(time, MONUMENT, covariance, True, 9), **changes)


def test_c_reads_every_field_of_the_table():
    found = scanned(message("DSEI", position()))
    assert found[:7] == [b"DSEI", 2022, 1, 1, 2, 3, 4.5]
    assert found[7:13] == [0, 17, 3, 1, 0.0, 9_000_000]
    assert_allclose(found[13:16], MONUMENT, rtol=0, atol=5.1e-5)
    assert found[16:22] == [0.04, 0.09, 0.16, 0.01, -0.02, 0.03]
    assert found[22:] == [b"none", b"!"]


def test_every_byte():
    made = message("DSEI", position(position_ecef=np.array([1.0, -2.5, 6e6]), fused=False))
    numbers = "".join(
        f" {text:>14}"
        for text in (
            *("1.0000", "-2.5000", "6000000.0000", "0.0400", "0.0900", "0.1600"),
            *("0.0100", "-0.0200", "0.0300"),
        )
    )
    head = "> DSEI 20220101020304.50  0  1  3  1   0.00 09000000"
    assert made == f"{head}{numbers} none !".encode()


def test_a_leap_second_and_the_rounding_to_hundredths():
    leap = GpsTime.from_utc_calendar(2016, 12, 31, 23, 59, 60 * 10**9).total_ns
    assert message("DSEI", position(gps_ns=leap)).split()[2] == b"20161231235960.00"
    assert message("DSEI", position(gps_ns=leap - 4_000_000)).split()[2] == b"20161231235960.00"
    assert message("DSEI", position(gps_ns=leap - 6_000_000)).split()[2] == b"20161231235959.99"


@pytest.fixture
def peer():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as made:
        made.bind(("127.0.0.1", 0))
        made.settimeout(10.0)
        yield made


@pytest.mark.parametrize("size", [1, 20, 400])
def test_one_packet_a_second_with_the_motion_of_that_second(peer, size):
    sender = GdrtSender(peer.getsockname(), "DSEI", MONUMENT, print)
    sender.satellites = 7
    times, offset_ns = START.total_ns + np.arange(800) * 5_000_000, -123_456
    for k in range(0, 800, size):
        # As it comes off a topic: arrays are flat there.
        value, _ = codecs.DISPLACEMENT.decode(
            codecs.DISPLACEMENT.encode(displacement(k, size, 200), 0)
        )
        sender.take(value, times[k : k + size] + offset_ns)
    for second in range(4):
        found = scanned(peer.recv(2000))
        assert found[6] == 50 + second  # 01:59:50 UTC on
        motion = displacement(200 * second, 1, 200).displacement[0]
        assert_allclose(found[13:16], ecef_from_enu(motion, MONUMENT), rtol=0, atol=5.1e-5)
        assert found[12] == 7_000_000
    assert sender.sent == 4
    sender.close()


def test_sigmas_turn_with_the_axes(peer):
    sender = GdrtSender(peer.getsockname(), "DSEI", MONUMENT, print)
    sd = np.tile(np.array([1.0, 2.0, 5.0], np.float32), (1, 1))
    value = replace(displacement(0, 1, 200), displacement_sd=sd)
    sender.take(value, np.array([START.total_ns]))
    xx, yy, zz, xy, xz, yz = scanned(peer.recv(2000))[16:22]
    covariance = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    assert_allclose(np.linalg.eigvalsh(covariance), [1.0, 4.0, 25.0], atol=2e-4)
    up = MONUMENT / np.linalg.norm(MONUMENT)  # within 0.2 degrees of the normal
    assert up @ covariance @ up == pytest.approx(25.0, abs=0.01)
    sender.close()


def test_other_sources_and_unknown_values_are_not_sent(peer):
    sender = GdrtSender(peer.getsockname(), "DSEI", MONUMENT, print)
    times = np.array([START.total_ns])
    sender.take(displacement(0, 1, 50, DisplacementSource.GNSS), times)
    bad = displacement(0, 1, 200)
    sender.take(replace(bad, displacement=np.full((1, 3), np.nan)), times)
    assert sender.sent == 0
    sender.close()


def test_a_name_that_is_not_four_letters_is_refused():
    with pytest.raises(InputError, match="GDRT station 'DS'"):
        GdrtSender(("127.0.0.1", 1), "DS", MONUMENT, print)
