"""Memory and file handles of processes over time, and whether they grow."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from deepseis_core.types import FloatArray

PAGE_MB: Final = os.sysconf("SC_PAGE_SIZE") / 2**20
WARM_S: Final = 30.0
"""A process takes so long to load, compile and fill its buffers [s of its life]."""
LEAST_SAMPLES: Final = 8


def resident_mb(pid: int) -> float:
    """Return the resident memory of a process [MB]; not a number if it has gone."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * PAGE_MB
    except (OSError, IndexError):
        return float("nan")


def handles(pid: int) -> float:
    """Return how many file handles a process holds; not a number if it has gone."""
    try:
        return float(len(os.listdir(f"/proc/{pid}/fd")))
    except OSError:
        return float("nan")


@dataclass(frozen=True)
class Growth:
    """How a process' memory and handles went, after it was warm.

    Attributes
    ----------
    name : str
    hours : float
        Of its longest life, by the clock of the samples.
    first_mb, last_mb : float
        Medians of the first and last quarter.
    slope_mb_per_h, slope_sd : float
        Robust slope and its sigma.
    first_handles, last_handles : float
    """

    name: str
    hours: float
    first_mb: float
    last_mb: float
    slope_mb_per_h: float
    slope_sd: float
    first_handles: float
    last_handles: float


@dataclass
class Resources:
    """Samples of several processes; every life of a process is a row of its own."""

    rows: dict[tuple[str, int], list[tuple[float, float, float]]] = field(default_factory=dict)

    def sample(self, time: float, pids: Mapping[str, int]) -> None:
        """Take a sample of every process at a time [s]."""
        for name, pid in pids.items():
            found = resident_mb(pid), handles(pid)
            if all(np.isfinite(found)):
                self.rows.setdefault((name, pid), []).append((time, *found))

    def table(self, name: str) -> FloatArray:
        """Return time [s], memory [MB] and handles of a process' longest life, (m, 3)."""
        lives = [rows for (who, _), rows in self.rows.items() if who == name]
        longest = max(lives, key=lambda rows: rows[-1][0] - rows[0][0])
        return np.array(longest)

    @property
    def names(self) -> list[str]:
        """Processes seen."""
        return sorted({name for name, _ in self.rows})

    def growth(self) -> list[Growth]:
        """Return how every process went; those that did not live long enough are left out."""
        found = []
        for name in self.names:
            table = self.table(name)
            warm = table[table[:, 0] >= table[0, 0] + WARM_S]
            if len(warm) >= LEAST_SAMPLES:
                found.append(growth_of(name, warm))
        return found


def growth_of(name: str, table: FloatArray) -> Growth:
    """Fit a slope to samples of time [s], memory [MB] and handles, shape (m, 3).

    The slope is that of Theil and Sen, the median over pairs: a step up and down again does not
    make one. Its sigma is from the scatter of the slopes of the pairs that are far apart.

    Examples
    --------
    >>> t = np.arange(0.0, 3600.0, 10.0)
    >>> table = np.column_stack([t, 100.0 + t / 360.0, np.full(t.size, 7.0)])
    >>> round(growth_of("x", table).slope_mb_per_h, 6)
    10.0
    """
    t, memory, count = table.T
    hours = (t - t[0]) / 3600.0
    thin = slice(None, None, max(1, len(t) // 300))
    x, y = hours[thin], memory[thin]
    i, j = np.triu_indices(len(x), max(1, len(x) // 3))
    slopes = (y[j] - y[i]) / (x[j] - x[i])
    spread = float(np.median(np.abs(slopes - np.median(slopes)))) * 1.4826
    quarter = max(1, len(t) // 4)
    return Growth(
        name,
        float(hours[-1]),
        float(np.median(memory[:quarter])),
        float(np.median(memory[-quarter:])),
        float(np.median(slopes)),
        spread / np.sqrt(max(1.0, len(x) / 3.0)),
        float(np.median(count[:quarter])),
        float(np.median(count[-quarter:])),
    )
