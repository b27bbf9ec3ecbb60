"""One browser's live connection: frames as fast as it can show them, and not one more."""

from __future__ import annotations

import asyncio
import re
import time
from collections import OrderedDict, deque
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from aiohttp import WSMsgType, web

from deepseis_bringup.live.frames import FrameWriter
from deepseis_bringup.live.model import LiveModel

FRAME_S: Final = 1 / 15
"""Time between frames [s]."""
AHEAD: Final = 3
"""Frames that a browser may have before it has said that it shows them."""
SAID = re.compile(r"([sr])(\d{1,15})")
"""What a browser says: shown, or (in a hidden tab) received, and the frame."""


class Viewer:
    """Sends frames to one browser.

    A frame is made when it is sent, and only if the browser has shown all but the last few: a slow
    browser is skipped, and nothing queues up for it.

    Parameters
    ----------
    model : LiveModel
    socket : aiohttp.web.WebSocketResponse
        Prepared.
    more : callable
        What else to tell in a state.
    """

    def __init__(
        self,
        model: LiveModel,
        socket: web.WebSocketResponse,
        more: Callable[[], dict[str, Any]] = dict,
    ) -> None:
        self.model, self.socket, self.more = model, socket, more
        self.writer = FrameWriter(model)
        self._open: OrderedDict[int, int] = OrderedDict()
        self._latencies: deque[float] = deque(maxlen=150)

    async def run(self) -> None:
        """Send until the browser goes."""
        listening = asyncio.create_task(self._listen())
        try:
            while not listening.done():
                await self._send()
                await asyncio.wait([listening], timeout=FRAME_S)
        except (ConnectionError, RuntimeError):
            pass  # it went while a frame was on its way
        finally:
            listening.cancel()

    async def _send(self) -> None:
        if len(self._open) >= AHEAD:
            return
        frame = self.writer.next(shown=self._shown(), **self.more())
        if frame is not None:
            self._open[self.writer.number] = self.model.newest[1]
            await self.socket.send_bytes(frame)

    async def _listen(self) -> None:
        """Hear what was shown; anything else ends the connection."""
        async for message in self.socket:
            said = SAID.fullmatch(message.data) if message.type is WSMsgType.TEXT else None
            if said is None:
                return
            self._take(said[1] == "s", int(said[2]))

    def _take(self, shown: bool, number: int) -> None:
        """Take that a frame, and so all before it, is there."""
        source_ns = self._open.get(number, 0)
        if shown and source_ns:
            self._latencies.append(1e-6 * (time.time_ns() - source_ns))
        while self._open and next(iter(self._open)) <= number:
            self._open.popitem(last=False)

    def _shown(self) -> dict[str, float] | None:
        """Return the time from a sample's sending by the source to its picture [ms]."""
        if not self._latencies:
            return None
        found = np.array(self._latencies)
        median, most = np.median(found), found.max()
        return {"median_ms": round(float(median), 1), "max_ms": round(float(most), 1)}
