"""DataLink 1.0: records sent to a ringserver, which gives them to SeedLink clients.

A thread sends, so that a server that hangs holds nobody back. What a server has not acknowledged
is sent again after the connection is made anew; beyond a limit the oldest records are dropped and
counted.

References
----------
EarthScope, "DataLink protocol" of libdali and ringserver: a packet is "DL", one byte with the
length of its header, the header in ASCII, and data where the header gives a size.
"""

from __future__ import annotations

import os
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Final

from deepseis_bringup.export.miniseed import RECORD_BYTES, record_span
from deepseis_core.errors import InputError

PORT: Final = 16000
LIMIT: Final = 20_000  # records kept for a server that is not there: 10 MB
TIMEOUT_S: Final = 5.0
RETRY_S: Final = (0.2, 10.0)
"""Wait after the first failure, and at most; it doubles."""

Packet = tuple[str, bytes]
"""Stream, record."""


def address_of(text: str, port: int | None = PORT) -> tuple[str, int]:
    """Return host and port of ``host:port``; without one, ``port``.

    Examples
    --------
    >>> address_of("localhost:16001"), address_of("seis.example")
    (('localhost', 16001), ('seis.example', 16000))
    """
    host, colon, number = text.partition(":")
    given = int(number) if number.isdigit() else 0 if colon else port or 0
    if not host or not 0 < given < 65536:
        raise InputError(f"address {text!r}", "is not host:port", "such as localhost:16000")
    return host, given


def stream_of(name: Path) -> str:
    """Return the stream of a file of the archive.

    Examples
    --------
    >>> stream_of(Path("2022/XX/DSEI/HXE.D/XX.DSEI.30.HXE.D.2022.001"))
    'XX_DSEI_30_HXE/MSEED'
    """
    return "_".join(name.name.split(".")[:4]) + "/MSEED"


def packet(header: str, data: bytes = b"") -> bytes:
    """Return a packet's bytes."""
    text = header.encode("ascii")
    return b"DL" + bytes([len(text)]) + text + data


def write_packet(stream: str, record: bytes) -> bytes:
    """Return the command that writes a record; acknowledgement is asked for."""
    start, end = (ns // 1000 for ns in record_span(record))
    return packet(f"WRITE {stream} {start} {end} A {len(record)}", record)


class DataLink:
    """Sends records to a server; `close` when done.

    Parameters
    ----------
    host, port : str, int
        The server's.
    say : callable
        Told of connections made and lost.
    """

    def __init__(self, host: str, port: int, say: Callable[[str], None]) -> None:
        self.host, self.port, self.say = host, port, say
        self.sent = self.dropped = 0
        self.connected = False
        self._queue: deque[Packet] = deque()
        self._wake = threading.Condition()
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="datalink", daemon=True)
        self._thread.start()

    def put(self, name: Path, records: bytes) -> None:
        """Take whole records of a file of the archive."""
        stream = stream_of(name)
        with self._wake:
            for at in range(0, len(records), RECORD_BYTES):
                self._queue.append((stream, records[at : at + RECORD_BYTES]))
            while len(self._queue) > LIMIT:
                self._queue.popleft()
                self.dropped += 1
            self._wake.notify()

    def close(self, wait_s: float = 2.0) -> None:
        """Send what is left, for a while at most."""
        with self._wake:
            self._closing = True
            self._wake.notify()
        self._thread.join(wait_s)

    def _run(self) -> None:
        wait = RETRY_S[0]
        while not (self._closing and not self._queue):
            try:
                with socket.create_connection((self.host, self.port), TIMEOUT_S) as link:
                    link.settimeout(TIMEOUT_S)
                    self._greet(link)
                    wait = RETRY_S[0]
                    self._send_all(link)
            except OSError as error:
                if self.connected:
                    self.say(f"datalink {self.host}:{self.port}: {error}, will try again")
                self.connected = False
                if self._closing:
                    return
                time.sleep(wait)
                wait = min(2 * wait, RETRY_S[1])

    def _greet(self, link: socket.socket) -> None:
        link.sendall(packet(f"ID DeepSeis::{os.getpid()}:"))
        answer = _answer(link)
        if not answer.startswith("ID DataLink"):
            raise OSError(f"the peer is no DataLink server: {answer[:40]!r}")
        if "WRITE" not in answer.split("::")[-1].split():
            raise OSError("the server lets us not write")
        self.connected = True
        self.say(f"datalink {self.host}:{self.port}: connected")

    def _send_all(self, link: socket.socket) -> None:
        while True:
            with self._wake:
                while not self._queue:
                    if self._closing:
                        return
                    self._wake.wait()
                item = self._queue[0]
            link.sendall(write_packet(*item))
            answer = _answer(link)
            if not answer.startswith("OK"):
                raise OSError(f"a record was refused: {answer[:80]}")
            with self._wake:
                self.sent += 1
                if self._queue and self._queue[0] is item:
                    self._queue.popleft()


def _answer(link: socket.socket) -> str:
    """Return an answer's header and its text."""
    head = _exactly(link, 3)
    if head[:2] != b"DL":
        raise OSError("the peer does not speak DataLink")
    text = _exactly(link, head[2]).decode("ascii", "replace")
    words = text.split()
    if words[:1] in (["OK"], ["ERROR"]) and len(words) > 2 and words[2].isdigit():
        text += " " + _exactly(link, min(int(words[2]), 4096)).decode("ascii", "replace")
    return text


def _exactly(link: socket.socket, count: int) -> bytes:
    data = b""
    while len(data) < count:
        part = link.recv(count - len(data))
        if not part:
            raise OSError("the server closed the connection")
        data += part
    return data
