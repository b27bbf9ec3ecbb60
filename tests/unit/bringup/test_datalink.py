"""DataLink: byte for byte against a loopback peer; it dies, refuses, comes back."""

import io
import os
import socket
import threading
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest
from unit.bringup.test_miniseed import PLACE, START, channel, quake

from deepseis_bringup.export.datalink import LIMIT, DataLink, address_of, stream_of
from deepseis_bringup.export.miniseed import day_records, record_span, sample_times
from deepseis_bringup.export.quiet_obspy import obspy_modules
from deepseis_bringup.export.sample_runs import Run
from deepseis_core.errors import InputError

NAME = Path("2022/XX/DSEI/HXE.D/XX.DSEI.30.HXE.D.2022.001")
GREETING = b"ID DataLink 2020.075 :: DLPROTO:1.0 PACKETSIZE:512 WRITE"


def records(count=400):
    run = Run(sample_times(START, count, 200.0), quake(count, 200.0), 200.0)
    ((_, data),) = day_records(run, 0, channel(), PLACE)
    return data


class Peer:
    """A server that answers by rote and keeps what it got."""

    def __init__(self, greeting=GREETING, answers=None, port=0):
        self.greeting, self.answers = greeting, answers
        self.received, self.connections = b"", 0
        self.socket = socket.create_server(("127.0.0.1", port))
        self.port = self.socket.getsockname()[1]
        self.link = None
        self.thread = threading.Thread(target=self.serve, daemon=True)
        self.thread.start()

    def serve(self):
        try:
            while True:
                self.link, _ = self.socket.accept()
                self.connections += 1
                self.talk(self.link)
                self.link.close()
        except OSError:
            pass  # closed by the test

    def take(self, link, count):
        data = b""
        while len(data) < count:
            part = link.recv(count - len(data))
            if not part:
                raise ConnectionError
            data += part
        self.received += data
        return data

    def talk(self, link):
        try:
            while True:
                head = self.take(link, 3)
                header = self.take(link, head[2])
                if header.startswith(b"ID"):
                    answer = self.greeting
                else:
                    self.take(link, int(header.split()[-1]))
                    answer = self.answers.pop(0) if self.answers else b"OK 17 0"
                if answer is None:
                    return
                header, _, text = answer.partition(b"|")
                link.sendall(b"DL" + bytes([len(header)]) + header + text)
        except OSError:
            pass

    def close(self):
        for item in (self.socket, self.link):
            if item is not None:
                with suppress(OSError):
                    item.shutdown(socket.SHUT_RDWR)  # wakes the thread that waits at it
                item.close()
        self.thread.join(5.0)


@contextmanager
def connected(peer):
    said = []
    link = DataLink("127.0.0.1", peer.port, said.append)
    try:
        yield link, said
    finally:
        link.close()
        peer.close()


def wait_for(condition, seconds=20.0):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "did not happen in time"
        time.sleep(0.005)


def test_every_byte_is_that_of_the_protocol():
    data, peer = records(), Peer()
    with connected(peer) as (link, _):
        link.put(NAME, data)
        wait_for(lambda: link.sent == len(data) // 512)
    hello = f"ID DeepSeis::{os.getpid()}:".encode()
    expected = b"DL" + bytes([len(hello)]) + hello
    for at in range(0, len(data), 512):
        record = data[at : at + 512]
        (trace,) = obspy_modules().read(io.BytesIO(record))
        start, end = (t.ns // 1000 for t in (trace.stats.starttime, trace.stats.endtime))
        header = f"WRITE XX_DSEI_30_HXE/MSEED {start} {end} A 512".encode()
        expected += b"DL" + bytes([len(header)]) + header + record
    assert peer.received == expected


def test_a_record_that_was_not_acknowledged_is_sent_again():
    data = records()
    peer = Peer(answers=[b"OK 1 0", None])  # the second: the server goes
    with connected(peer) as (link, said):
        link.put(NAME, data)
        wait_for(lambda: link.sent == len(data) // 512)
    assert peer.connections == 2
    assert peer.received.count(data[512:1024]) == 2
    assert any("will try again" in text for text in said)


def test_a_refusal_is_told_and_tried_again():
    data, peer = records(), Peer(answers=[b"ERROR 0 9|full disk"])
    with connected(peer) as (link, said):
        link.put(NAME, data[:512])
        wait_for(lambda: link.sent == 1)
    assert any("full disk" in text for text in said)


@pytest.mark.parametrize("greeting", [b"ID SeedLink", b"ID DataLink 2020 :: DLPROTO:1.0"])
def test_other_servers_get_no_record(greeting):
    peer = Peer(greeting)
    with connected(peer) as (link, _):
        link.put(NAME, records()[:512])
        wait_for(lambda: peer.connections >= 2)
        assert link.sent == 0
    assert b"WRITE" not in peer.received


def test_a_server_that_is_not_there_costs_no_more_than_the_limit():
    free = Peer()
    free.close()
    link = DataLink("127.0.0.1", free.port, print)
    data = records()[:512]
    for _ in range(LIMIT + 5):
        link.put(NAME, data)
    assert link.dropped == 5
    link.close(wait_s=0.0)


def test_a_server_that_comes_later_gets_everything_in_order():
    first = Peer()
    first.close()
    link = DataLink("127.0.0.1", first.port, lambda _text: None)
    data = records()
    link.put(NAME, data)
    later = Peer(port=first.port)
    try:
        wait_for(lambda: link.sent == len(data) // 512)
    finally:
        link.close()
        later.close()
    places = [later.received.index(data[at : at + 512]) for at in range(0, len(data), 512)]
    assert places == sorted(places)


def test_spans_are_obspys():
    data = records(3000)
    for at in range(0, len(data), 512):
        (trace,) = obspy_modules().read(io.BytesIO(data[at : at + 512]))
        assert record_span(data[at : at + 512]) == (
            trace.stats.starttime.ns,
            trace.stats.endtime.ns,
        )
    starts = [record_span(data[at : at + 512])[0] for at in range(0, len(data), 512)]
    assert np.all(np.diff(starts) > 0)


def test_names_and_addresses():
    assert stream_of(NAME) == "XX_DSEI_30_HXE/MSEED"
    for text in ("", ":1", "host:port", "host:70000"):
        with pytest.raises(InputError, match="is not host:port"):
            address_of(text)
