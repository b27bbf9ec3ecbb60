"""A base that sends RTCM 3 over the network, live: read by a thread, connected again when lost."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Final

from deepseis_core.constants import NS_PER_S
from deepseis_core.sample_clock import SampleClock
from deepseis_core.types import Observations
from deepseis_frontend.base_events import BaseEvent, utc_of
from deepseis_frontend.base_rtklib import RtcmDecoder
from deepseis_frontend.ntrip import TIMEOUT_S, Address, Connection, RefusedError

RETRY_S: Final = (0.5, 30.0)
"""Wait after the first failure, and at most; it doubles."""
LIMIT: Final = 600
"""Events kept for a signal that is not there yet; then the stream is not read on."""
SET_BACK_S: Final = 60
"""A new connection that begins so long before the last epoch has another clock [s]."""


class Backoff:
    """How long to wait before another attempt.

    Examples
    --------
    >>> backoff = Backoff((0.5, 3.0))
    >>> [backoff.failed() for _ in range(4)], backoff.succeeded(), backoff.failed()
    ([0.5, 1.0, 2.0, 3.0], None, 0.5)
    """

    def __init__(self, limits: tuple[float, float]) -> None:
        self.limits, self._next = limits, limits[0]

    def failed(self) -> float:
        """Return the wait after a failure [s]; it doubles."""
        wait, self._next = self._next, min(2.0 * self._next, self.limits[1])
        return wait

    def succeeded(self) -> None:
        """Begin with the shortest wait again."""
        self._next = self.limits[0]


class BaseLink:
    """Gives a live base's events; `close` when done.

    Whoever reads takes them whenever they like: a thread keeps the connection. An epoch that does
    not come after the one before it, such as what a caster repeats after a new connection, is
    left out and counted.

    Parameters
    ----------
    address : Address
    clock : SampleClock
        Of the IF samples.
    silence_s : float
        A connection without data for so long is made anew [s].
    retry_s : tuple of float, optional
        First and longest wait between attempts [s].
    connect : callable, optional
        Makes a connection.

    Attributes
    ----------
    about_utc_ns : int
        Where the signal is, to tell the week [ns since 1970].
    counts : dict of str to int
        Connections made and lost, bytes, damaged frames and so on; they only grow.
    """

    def __init__(
        self,
        address: Address,
        clock: SampleClock,
        silence_s: float = TIMEOUT_S,
        *,
        retry_s: tuple[float, float] = RETRY_S,
        connect: Callable[[Address, float], Connection] = Connection,
    ) -> None:
        self.address, self.silence_s, self.retry_s = address, silence_s, retry_s
        self._clock, self._connect = clock, connect
        self.about_utc_ns = clock.start_utc_ns
        self.counts = dict.fromkeys(
            (
                "connections",
                "lost",
                "failed",
                "bytes",
                "damaged_frames",
                "implausible",
                "repeated",
                "epochs",
            ),
            0,
        )
        self._events: deque[BaseEvent] = deque()
        self._state = "connecting"
        self._newest, self._begins = -1, True
        self._closing = threading.Event()
        self._taken = threading.Event()
        self._connection: Connection | None = None
        self._thread = threading.Thread(target=self._run, name="base", daemon=True)
        self._thread.start()

    @property
    def state(self) -> str:
        """What goes on, in words."""
        return self._state

    @property
    def connected(self) -> bool:
        """Whether there is a connection."""
        return self._connection is not None

    def take(self) -> list[BaseEvent]:
        """Return the events that have come since the last call, in order."""
        taken = []
        while self._events:
            taken.append(self._events.popleft())
        self._taken.set()
        return taken

    def close(self) -> None:
        """End the connection and the thread."""
        self._closing.set()
        self._taken.set()
        connection = self._connection
        if connection is not None:
            connection.close()
        self._thread.join(self.silence_s + 2.0)

    def _run(self) -> None:
        backoff = Backoff(self.retry_s)
        while not self._closing.is_set():
            before = self.counts["epochs"]
            try:
                self._read()
            except OSError as error:
                self.counts["lost" if self.connected else "failed"] += 1
                refused = isinstance(error, RefusedError)
                self._state = f"{error}" if refused else f"no connection: {error}"
            self._connection = None
            if self.counts["epochs"] > before:  # a caster that only greets is no success
                backoff.succeeded()
            if self._closing.wait(backoff.failed()):
                return

    def _read(self) -> None:
        connection = self._connect(self.address, self.silence_s)
        decoder = RtcmDecoder(self._clock)
        self._connection = connection
        self.counts["connections"] += 1
        self._state, self._begins = "connected", True
        before, heard = dict(self.counts), time.monotonic()
        try:
            while not self._closing.is_set():
                data = connection.read()
                self.counts["bytes"] += len(data)
                decoder.about_utc_ns = self.about_utc_ns
                kept = self._keep(decoder.push(data))
                bad = {
                    "damaged_frames": decoder.frames.damaged,
                    "implausible": decoder.implausible,
                }
                self.counts.update({name: before[name] + n for name, n in bad.items()})
                if kept:
                    heard = time.monotonic()
                elif time.monotonic() - heard > self.silence_s:
                    raise OSError(f"no new epoch for {self.silence_s:g} s")
        finally:
            decoder.close()
            connection.close()

    def _keep(self, events: list[BaseEvent]) -> int:
        """Keep what is new; return how many epochs that is."""
        before = self.counts["epochs"]
        for event in events:
            utc_ns, is_epoch = utc_of(event), isinstance(event, Observations)
            if self._begins and utc_ns < self._newest - SET_BACK_S * NS_PER_S:
                self._newest = -1
            self._begins = False
            if utc_ns <= self._newest and (is_epoch or utc_ns < self._newest):
                self.counts["repeated"] += is_epoch
                continue
            if is_epoch:
                self._newest = utc_ns
                self.counts["epochs"] += 1
            self._events.append(event)
        while len(self._events) > LIMIT and not self._closing.is_set():
            self._taken.clear()
            self._taken.wait(0.2)
        return self.counts["epochs"] - before
