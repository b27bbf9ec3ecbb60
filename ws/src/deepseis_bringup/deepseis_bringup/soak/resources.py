"""Memory and file handles of processes over time, and whether they grow."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from deepseis_core.types import FloatArray

WARM_S: Final = 900.0
"""A process takes so long, or a quarter of its life if that is shorter, to load, compile and fill
its buffers, rings and arenas [s of its life]."""
LEAST_SAMPLES: Final = 8
BLOCKS: Final = 12
"""Into which a life is cut to see how steady its growth is."""


def resident_mb(pid: int) -> float:
    """Return the memory that a process has taken for itself [MB]; not a number if it has gone.

    Resident pages but those of files: code and mapped files come and go as the system likes, and
    are no memory that a process holds. Memory shared with others, as DDS has it, counts.
    """
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
        found = dict(line.split(":", 1) for line in lines)
        return sum(int(found[part].split()[0]) for part in ("RssAnon", "RssShmem")) / 1024.0
    except (OSError, KeyError, ValueError):
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
            life = table[-1, 0] - table[0, 0]
            warm = table[table[:, 0] >= table[0, 0] + min(WARM_S, life / 4.0)]
            if len(warm) >= LEAST_SAMPLES:
                found.append(growth_of(name, warm))
        return found


def growth_of(name: str, table: FloatArray) -> Growth:
    """Fit a slope to samples of time [s], memory [MB] and handles, shape (m, 3).

    The slope is that of Theil and Sen, the median over pairs: a step up and down again does not
    make one. Memory goes in steps that stay, as a random walk does, so its samples are not
    independent: the sigma is that of the mean change from block to block of the life.

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
    quarter = max(1, len(t) // 4)
    return Growth(
        name,
        float(hours[-1]),
        float(np.median(memory[:quarter])),
        float(np.median(memory[-quarter:])),
        float(np.median((y[j] - y[i]) / (x[j] - x[i]))),
        _slope_sd(hours, memory),
        float(np.median(count[:quarter])),
        float(np.median(count[-quarter:])),
    )


def _slope_sd(hours: FloatArray, memory: FloatArray) -> float:
    """Return the sigma of the mean change from block to block [MB/h].

    Neighbouring changes share a block: noise of the level itself makes them anticorrelated, and
    then their mean is better known than their spread says.
    """
    parts = min(BLOCKS, len(hours) // 2)
    levels, times = (
        np.array([part.mean() for part in np.array_split(values, parts)])
        for values in (memory, hours)
    )
    changes = np.diff(levels) / np.diff(times)
    count, changes = len(changes), changes - changes.mean()
    alone = float(changes @ changes) / max(count - 1, 1)
    shared = float(changes[1:] @ changes[:-1]) / max(count - 1, 1)
    return float(np.sqrt(max(alone + 2.0 * shared, alone / count) / count))
