"""Addresses of live bases, and the connection to one: TCP, or NTRIP 2 and 1, plain or by TLS.

A base may be another station in the same ROS domain too: ``station://NAME`` (`base_topic`).

References
----------
RTCM 10410.1, NTRIP 2.0: HTTP/1.1 with ``Ntrip-Version``; a caster of version 1 answers
``ICY 200 OK``, and with its table of sources where it does not know the mountpoint.
"""

from __future__ import annotations

import base64
import netrc
import os
import re
import socket
import ssl
from contextlib import suppress
from dataclasses import dataclass
from typing import Final
from urllib.parse import unquote, urlsplit

from deepseis_core.errors import InputError

STATION: Final = "station"
PORTS: Final = {"ntrip": 2101, "ntrips": 443, "tcp": 0, STATION: 0}
"""Schemes, and the port where none is given."""
PASSWORD_VARIABLE: Final = "DEEPSEIS_NTRIP_PASSWORD"
TIMEOUT_S: Final = 10.0
_HEAD_BYTES: Final = 16384
_HINT: Final = (
    "such as ntrip://name@caster.example:2101/MOUNT, tcp://host:port, or station://NAME in ROS"
)
_STATION_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


class RefusedError(OSError):
    """The caster answers, and does not give the stream: wrong mountpoint, or not allowed."""


@dataclass(frozen=True)
class Address:
    """Where a stream of RTCM 3 comes from, or whose topics are listened to (``host``).

    Passwords are not part of it, for settings are recorded: they come from the environment
    (``DEEPSEIS_NTRIP_PASSWORD``) or from ``~/.netrc``.
    """

    scheme: str
    host: str
    port: int
    mount: str = ""
    user: str = ""

    def __str__(self) -> str:
        """Return it without the user."""
        if self.scheme == STATION:
            return f"{STATION}://{self.host}"
        return f"{self.scheme}://{self.host}:{self.port}" + (
            f"/{self.mount}" if self.mount else ""
        )

    def password(self) -> str:
        """Return the password of the user; empty if there is none."""
        if PASSWORD_VARIABLE in os.environ:
            return os.environ[PASSWORD_VARIABLE]
        try:
            known = netrc.netrc().authenticators(self.host)
        except (OSError, netrc.NetrcParseError):
            return ""
        return (known[2] or "") if known and known[0] in (self.user, "") else ""


def is_address(text: str) -> bool:
    """Tell whether a text names a stream, and no file.

    Examples
    --------
    >>> is_address("tcp://base:5000"), is_address("base.rtcm")
    (True, False)
    """
    return text.partition("://")[0] in PORTS and "://" in text


def address_of(text: str) -> Address:
    """Return the address that a text gives.

    Raises
    ------
    InputError
        It gives none, or a password.

    Examples
    --------
    >>> address_of("ntrip://me@caster.example/BASE0")
    Address(scheme='ntrip', host='caster.example', port=2101, mount='BASE0', user='me')
    >>> str(address_of("tcp://10.0.0.7:5015"))
    'tcp://10.0.0.7:5015'
    >>> str(address_of("station://KOBE"))
    'station://KOBE'
    """
    parts = urlsplit(text)
    if parts.scheme == STATION:
        name = parts.netloc
        if not _STATION_NAME.fullmatch(name) or parts.path.strip("/"):
            raise InputError(f"base address {text!r}", "names no station", _HINT)
        return Address(STATION, name, 0)
    if parts.password is not None:
        hint = f"put it into {PASSWORD_VARIABLE} or ~/.netrc: settings are recorded"
        raise InputError("base address", "holds a password", hint)
    try:
        port = parts.port or PORTS.get(parts.scheme, 0)
    except ValueError:
        port = 0
    mount = parts.path.strip("/")
    good = parts.scheme in PORTS and parts.hostname and port
    if not good or bool(mount) != (parts.scheme != "tcp"):
        raise InputError(f"base address {text!r}", "is none", _HINT)
    return Address(parts.scheme, str(parts.hostname), port, mount, unquote(parts.username or ""))


class Connection:
    """A stream of bytes from a base.

    Parameters
    ----------
    address : Address
    timeout : float
        For the answer to the request, and for data to come [s].

    Raises
    ------
    OSError
        There is no connection; `RefusedError` where the caster says why.
    """

    def __init__(self, address: Address, timeout: float = TIMEOUT_S) -> None:
        self.address, self._chunks = address, False
        self._rest = b""
        self._left = 0
        link = socket.create_connection((address.host, address.port), timeout)
        try:
            link.settimeout(timeout)
            if address.scheme == "ntrips":
                context = ssl.create_default_context()
                link = context.wrap_socket(link, server_hostname=address.host)
            self._link = link
            if address.scheme != "tcp":
                self._request()
        except BaseException:
            link.close()
            raise

    def settimeout(self, seconds: float) -> None:
        """Wait so long for data at most [s]."""
        self._link.settimeout(seconds)

    def close(self) -> None:
        """Close it; a reader in another thread ends."""
        with suppress(OSError):
            self._link.shutdown(socket.SHUT_RDWR)
        self._link.close()

    def read(self) -> bytes:
        """Return what has come, at least a byte.

        Raises
        ------
        OSError
            Nothing came in time, or the other side has ended the stream.
        """
        data, self._rest = (self._rest, b"") if self._rest else (self._receive(), b"")
        while self._chunks:
            out, self._rest = self._unchunked(data)
            if out:
                return out
            data = self._rest + self._receive()
        return data

    def _receive(self) -> bytes:
        data = self._link.recv(65536)
        if not data:
            raise OSError("the other side closed the connection")
        return data

    def _unchunked(self, data: bytes) -> tuple[bytes, bytes]:
        """Return what HTTP chunks hold, and what of the next one is not whole yet."""
        out = bytearray()
        while data:
            if self._left > 2:
                take = data[: self._left - 2]
                out += take
                data, self._left = data[len(take) :], self._left - len(take)
            elif self._left:
                drop = min(self._left, len(data))  # CR LF behind the chunk
                data, self._left = data[drop:], self._left - drop
            else:
                line, found, behind = data.partition(b"\r\n")
                if not found:
                    break
                data, self._left = behind, self._size(line) + 2
        if len(data) > 64:
            raise OSError("the caster's chunks cannot be read")
        return bytes(out), data

    @staticmethod
    def _size(line: bytes) -> int:
        try:
            size = int(line.split(b";")[0], 16)
        except ValueError:
            raise OSError("the caster's chunks cannot be read") from None
        if not size:
            raise OSError("the caster ended the stream")
        return size

    def _request(self) -> None:
        a = self.address
        lines = [
            f"GET /{a.mount} HTTP/1.1",
            f"Host: {a.host}:{a.port}",
            "Ntrip-Version: Ntrip/2.0",
            "User-Agent: NTRIP DeepSeis/0.1",
            "Connection: close",
        ]
        if a.user:
            token = base64.b64encode(f"{a.user}:{a.password()}".encode()).decode("ascii")
            lines.append(f"Authorization: Basic {token}")
        self._link.sendall("\r\n".join([*lines, "", ""]).encode("latin-1"))
        data = b""
        while not self._answered(data):
            if len(data) > _HEAD_BYTES:
                raise OSError("the peer is no NTRIP caster")
            data += self._receive()

    def _answered(self, data: bytes) -> bool:
        """Take the head of an answer, once it is there."""
        first, found, rest = data.partition(b"\r\n")
        if not found:
            return False
        status = first.decode("latin-1")
        if status.startswith("ICY 200"):  # version 1: the stream follows, some send an empty line
            self._rest = rest.removeprefix(b"\r\n")
            return True
        if status.startswith("SOURCETABLE"):
            raise RefusedError(f"the caster has no mountpoint {self.address.mount}")
        if not status.startswith("HTTP/1."):
            raise RefusedError(f"the peer is no NTRIP caster: {status[:60]!r}")
        head, found, rest = data.partition(b"\r\n\r\n")
        if not found:
            return False
        if status.split()[1:2] != ["200"]:
            raise RefusedError(f"the caster refuses: {status[:80]}")
        text = head.decode("latin-1").lower()
        if "gnss/sourcetable" in text:
            raise RefusedError(f"the caster has no mountpoint {self.address.mount}")
        self._chunks = any(
            line.startswith("transfer-encoding:") and "chunked" in line
            for line in text.split("\r\n")
        )
        self._rest = rest
        return True
