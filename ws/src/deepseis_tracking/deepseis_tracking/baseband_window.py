"""The stretch of baseband samples that channels work on."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


class BasebandWindow:
    """The last samples of the complex baseband, contiguous: one block and what came before it."""

    def __init__(self, history: int) -> None:
        self.history = history
        self.i: NDArray[np.int8] = np.zeros(0, np.int8)
        self.q: NDArray[np.int8] = np.zeros(0, np.int8)
        self.start = self.end = 0
        self.noise = 1.0

    def push(self, i: NDArray[np.int8], q: NDArray[np.int8], sample_index: int) -> bool:
        """Append a block; returns False if it does not join on to the last one."""
        joins = sample_index == self.end or self.end == self.start
        kept = min(self.history, self.end - self.start) if joins else 0
        size = kept + len(i)
        if self.i.dtype != i.dtype or len(self.i) < size:
            grown = (
                np.zeros(self.history + len(i), i.dtype),
                np.zeros(self.history + len(i), i.dtype),
            )
            old = self.end - self.start
            grown[0][:kept], grown[1][:kept] = self.i[old - kept : old], self.q[old - kept : old]
            self.i, self.q = grown
        else:
            old = self.end - self.start
            self.i[:kept], self.q[:kept] = self.i[old - kept : old], self.q[old - kept : old]
        self.i[kept:size], self.q[kept:size] = i, q
        self.start, self.end = sample_index - kept, sample_index + len(i)
        step = max(1, len(i) // 4096)
        sub_i, sub_q = i[::step].astype(np.float64), q[::step].astype(np.float64)
        self.noise = max(1e-3, math.sqrt((sub_i @ sub_i + sub_q @ sub_q) / (2 * len(sub_i))))
        return joins
