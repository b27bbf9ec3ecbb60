"""Tells somebody of an event: a command, or a webhook, with a time limit and repetition.

The command is a list of arguments, run without a shell; the event comes on its standard input as
one line of JSON, the same that the webhook is sent (POST, application/json). Nothing of it holds
up the station: deliveries wait in a queue of their own, which is bounded, and what could not be
delivered is counted.
"""

from __future__ import annotations

import json
import queue
import subprocess
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final
from urllib.parse import urlsplit

from deepseis_core.config import check, setting
from deepseis_core.errors import InputError

WAITING: Final = 100
"""Deliveries that may wait."""
FIRST_PAUSE_S: Final = 1.0
LONGEST_PAUSE_S: Final = 60.0


@dataclass(frozen=True)
class AlertConfig:
    """Whom to tell, and how hard to try."""

    command: tuple[str, ...] = setting((), "program and its arguments, no shell [-]")
    webhook: str = setting("", "http or https address [-]")
    time_limit_s: float = setting(10.0, "for one attempt [s]", low=0.1, high=600.0)
    attempts: int = setting(5, "before an alert is given up [-]", low=1, high=100)
    on_end: bool = setting(True, "tell of the end as well, with the final peaks [-]")

    @property
    def is_wanted(self) -> bool:
        """Whether there is anybody to tell."""
        return bool(self.command or self.webhook)


def checked(config: AlertConfig, where: object) -> AlertConfig:
    """Refuse settings that make no sense.

    Raises
    ------
    InputError
        An address is none, or a number is outside its limits.
    """
    try:
        check(config)
    except ValueError as error:
        raise InputError(where, str(error)) from None
    if config.webhook and urlsplit(config.webhook).scheme not in ("http", "https"):
        raise InputError(where, f"webhook {config.webhook!r} is no address", "https://...")
    if not all(isinstance(item, str) for item in config.command):
        raise InputError(where, "command is not a list of texts", "[/usr/bin/logger, event]")
    return config


class Alerts:
    """Delivers alerts in the background; a context manager.

    Parameters
    ----------
    config : AlertConfig
    station : str
        Goes into every alert.
    pause : callable, optional
        Waits so many seconds; returns True to give up.

    Attributes
    ----------
    delivered, failed, repeated : int
        Alerts that arrived, that were given up, and attempts after a first one.
    last_error : str
        Why the last attempt that failed did.
    """

    def __init__(
        self,
        config: AlertConfig,
        station: str,
        pause: Callable[[float], bool] | None = None,
    ) -> None:
        self.config, self.station = config, station
        self.delivered = self.failed = self.repeated = 0
        self.last_error = ""
        self._stop = threading.Event()
        self._pause = pause or self._stop.wait
        self._queue: queue.Queue[bytes | None] = queue.Queue(WAITING)
        self._told: set[tuple[str, bool]] = set()
        self._worker = threading.Thread(target=self._work, daemon=True)

    def push(self, event: Mapping[str, Any]) -> None:
        """Take an event's report: its first is told, and its end."""
        key = (str(event["event_id"]), bool(event["ended"]))
        if key in self._told or (key[1] and not self.config.on_end):
            return
        self._told.add(key)
        text = json.dumps({"station": self.station, **event}, allow_nan=True)
        try:
            self._queue.put_nowait(text.encode() + b"\n")
        except queue.Full:
            self.failed += 1
            self.last_error = "too many wait"

    def counters(self) -> dict[str, object]:
        """Return what `/diagnostics` shows."""
        return {
            "delivered": self.delivered,
            "waiting": self._queue.qsize(),
            "repeated": self.repeated,
            "failed": self.failed,
            "last_error": self.last_error,
        }

    def __enter__(self) -> Alerts:
        """Begin to deliver."""
        self._worker.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Deliver what waits, once more each, for as long as one attempt may take; then stop."""
        self._queue.put(None)
        self._worker.join(self.config.time_limit_s)
        self._stop.set()
        self._worker.join(1.0)

    def _work(self) -> None:
        while (body := self._queue.get()) is not None:
            self._deliver(body)

    def _deliver(self, body: bytes) -> None:
        left = [self._run] * bool(self.config.command) + [self._post] * bool(self.config.webhook)
        pause = FIRST_PAUSE_S
        for attempt in range(self.config.attempts):
            if attempt:
                if self._pause(pause):
                    break
                pause = min(2.0 * pause, LONGEST_PAUSE_S)
                self.repeated += 1
            left = [way for way in left if not self._tried(way, body)]
            if not left:
                self.delivered += 1
                return
        self.failed += 1

    def _tried(self, way: Callable[[bytes], None], body: bytes) -> bool:
        try:
            way(body)
        except (OSError, subprocess.SubprocessError, ValueError, urllib.error.URLError) as error:
            self.last_error = " ".join(str(error).split())[:200]
            return False
        return True

    def _run(self, body: bytes) -> None:
        """Run the command; it has to end well within the time limit."""
        ended = subprocess.run(
            self.config.command,
            input=body,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            timeout=self.config.time_limit_s,
            check=False,
        )
        if ended.returncode:
            raise OSError(f"{self.config.command[0]} ended with status {ended.returncode}")

    def _post(self, body: bytes) -> None:
        """Send the webhook; its answer has to be a 2xx within the time limit."""
        request = urllib.request.Request(
            self.config.webhook, data=body, headers={"Content-Type": "application/json"}
        )
        began = time.monotonic()
        with urllib.request.urlopen(request, timeout=self.config.time_limit_s) as answer:
            answer.read(65536)
        if time.monotonic() - began > self.config.time_limit_s:
            raise TimeoutError("the webhook answered too late")
