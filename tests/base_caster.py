"""Casters for tests: RTKLIB's own, and one whose answers and cuts a test chooses."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pyrtklib as rtklib

_Bytes = getattr(rtklib, "Arr1Dunsigned char")


def rtcm_of_rinex(
    path: Path, kind: int = 1077, *, reference_every: int = 10, gps_only: bool = True
) -> list[bytes]:
    """Return RTCM 3 of a RINEX file by RTKLIB's encoder: an item for each epoch."""
    obs, nav, station = rtklib.obs_t(), rtklib.nav_t(), rtklib.sta_t()
    assert rtklib.readrnx(str(path), 2, "", obs, nav, station) > 0
    out, items = rtklib.rtcm_t(), []
    rtklib.init_rtcm(out)
    for i in range(3):
        out.sta.pos[i] = station.pos[i]

    def message(number: int, more: int) -> bytes:
        assert rtklib.gen_rtcm3(out, number, 0, more)
        return bytes(out.buff[i] for i in range(out.nbyte))

    groups = groupby(range(obs.n), key=lambda i: (obs.data[i].time.time, obs.data[i].time.sec))
    for number, (_, group) in enumerate(groups):
        rows = [obs.data[i] for i in group]
        parts = [message(1006, 0)] if number % reference_every == 0 else []
        systems = ("G",) if gps_only else ("G", "R")
        for place, letter in enumerate(systems):
            mine = [d for d in rows if _name(d.sat)[:1] == letter]
            out.time = rows[0].time
            for k, d in enumerate(mine):
                out.obs.data[k] = d
            out.obs.n = len(mine)
            last = place == len(systems) - 1
            if mine:
                parts.append(message(kind if letter == "G" else kind + 10, 0 if last else 1))
        items.append(b"".join(parts))
    rtklib.free_rtcm(out)
    return items


def _name(number: int) -> str:
    name = rtklib.Arr1Dchar(8)
    rtklib.satno2id(number, name)
    return str(name.ptr)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def rtklib_caster(items: Sequence[bytes], user: str = "me", password: str = "") -> Iterator[int]:
    """Serve items at ``/MOUNT`` by RTKLIB's caster once somebody listens; yield its port."""
    port, stream, ended = free_port(), rtklib.stream_t(), threading.Event()
    rtklib.strinit(stream)
    path = f"{user}:{password}@:{port}/MOUNT:x"
    assert rtklib.stropen(stream, rtklib.STR_NTRIPCAS, rtklib.STR_MODE_RW, path)

    def serve() -> None:
        waiting, room = list(items), _Bytes(1024)
        while not ended.is_set():
            rtklib.strread(stream, room, 1000)  # lets it take connections
            if waiting:
                data = _Bytes(len(waiting[0]))
                for i, byte in enumerate(waiting[0]):
                    data[i] = byte
                if rtklib.strwrite(stream, data, len(waiting[0])) == len(waiting[0]):
                    waiting.pop(0)
            time.sleep(0.001)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield port
    finally:
        ended.set()
        thread.join()
        rtklib.strclose(stream)


Answer = Callable[[socket.socket, bytes, int], None]
"""Takes a connection, the request (empty for plain TCP) and how many came before."""


@contextmanager
def caster(answer: Answer, *, asks: bool = True) -> Iterator[int]:
    """Answer connections one after the other; yield the port."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(0.05)
        ended = threading.Event()

        def serve() -> None:
            number = 0
            while not ended.is_set():
                with suppress(TimeoutError):
                    link, _ = server.accept()
                    with link, suppress(OSError):
                        link.settimeout(5.0)
                        request = b""
                        while asks and not request.endswith(b"\r\n\r\n"):
                            request += link.recv(4096)
                        answer(link, request, number)
                    number += 1

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield server.getsockname()[1]
        finally:
            ended.set()
            thread.join()


def pieces(data: bytes, seed: int = 1, longest: int = 700) -> Iterator[bytes]:
    """Cut bytes anywhere."""
    random = np.random.default_rng(seed)
    at = 0
    while at < len(data):
        size = int(random.integers(1, longest))
        yield data[at : at + size]
        at += size


def eventually(found: Callable[[], Any], seconds: float = 20.0) -> Any:
    """Return what something gives once it is true."""
    deadline = time.monotonic() + seconds
    while not (value := found()):
        assert time.monotonic() < deadline, "nothing came"
        time.sleep(0.005)
    return value
