"""What one browser has, and the next piece for it: samples since the last, and the state.

A frame is one binary message: the length of its header as a 32-bit number, the header (JSON), then
for each block its times (float64) and values (float32), little endian; header and blocks each fill
up to eight bytes.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from deepseis_bringup.live.model import LiveModel
from deepseis_bringup.live.trace import Trace

VERSION: Final = 1
"""Of the frames; the page asks for its own anew when this is another."""
LONGEST_S: Final = 4.0
"""A frame holds at most so much of the newest samples [s]; a slow browser gets no more."""
MOST_CELLS: Final = 600
"""And at most so many cells of each envelope."""
STATE_S: Final = 0.25
"""Time between states [s]."""


class FrameWriter:
    """Frames for one browser.

    Parameters
    ----------
    model : LiveModel
        What there is.

    Attributes
    ----------
    number : int
        Of the last frame.
    skipped : int
        Samples and cells that were left out because the browser was slow.
    """

    def __init__(self, model: LiveModel) -> None:
        self.model = model
        self.number = self.skipped = 0
        self._generations: dict[str, int] = {}
        self._counts: dict[tuple[str, int], int] = {}
        self._state_at = -np.inf

    def next(self, **more: Any) -> bytes | None:
        """Return the next frame, with ``more`` in its header; None: there is nothing new."""
        blocks = [block for trace in self.model.traces.values() for block in self._trace(trace)]
        header: dict[str, Any] = {"version": VERSION, "origin_ms": self.model.origin_ns / 1e6}
        now = self.model.clock()
        if now - self._state_at >= STATE_S:
            self._state_at = now
            header["state"] = {**self.model.state(), **more}
        elif not blocks:
            return None
        self.number += 1
        header |= {"frame": self.number, "blocks": [block for block, *_ in blocks]}
        parts = [_padded(json.dumps(header, separators=(",", ":"), allow_nan=False).encode(), 4)]
        for _, times, values in blocks:
            parts += [times.astype("<f8").tobytes(), _padded(values.astype("<f4").tobytes())]
        return len(parts[0]).to_bytes(4, "little") + b"".join(parts)

    def _trace(self, trace: Trace) -> Iterator[tuple[dict[str, Any], Any, Any]]:
        fresh = self._generations.get(trace.name) != trace.generation
        if fresh:
            self._generations[trace.name] = trace.generation
            for level in range(len(trace.levels)):
                self._counts[trace.name, level] = 0
        for level, ring in enumerate(trace.rings):
            known = self._counts[trace.name, level]
            most = ring.room if fresh else self._most(trace, level)
            times, values = ring.since(known, most)
            self._counts[trace.name, level] = ring.count
            lost = 0 if fresh else ring.count - known - len(times)
            self.skipped += lost
            if len(times) or fresh:
                about = {"trace": trace.name, "level": level, "count": len(times)}
                about |= {"columns": values.shape[1], "fresh": fresh}
                about |= {"room": ring.room, "interval": trace.interval, "lost": lost}
                yield about, times, values

    @staticmethod
    def _most(trace: Trace, level: int) -> int:
        return MOST_CELLS if level else max(1, round(LONGEST_S / trace.interval))


def _padded(data: bytes, taken: int = 0) -> bytes:
    """Fill up to a multiple of eight bytes, after ``taken`` others."""
    return data + b" " * (-(len(data) + taken) % 8)
