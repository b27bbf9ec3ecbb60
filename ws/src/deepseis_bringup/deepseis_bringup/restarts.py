"""When a node that has died is started again: at once, then later and later, then no more."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from time import monotonic
from typing import Final

NEVER: Final = frozenset({"if_source", "ldv_source", "recorder"})
"""Nodes without which there is no run, or that cannot join one: their death ends it."""


class State(Enum):
    """How a node fares."""

    RUNNING = "running"
    WAITING = "waits to be started again"
    JOINING = "started again"


@dataclass(frozen=True)
class RestartConfig:
    """Limits of starting again.

    Attributes
    ----------
    limit : int
        Restarts of one node within ``window_s``; the next death ends the run.
    backoff_s : tuple of float
        Wait before the first, second, ... restart within the window [s]; the last goes on.
    window_s : float
        A node that has lived so long since counts as healthy again [s].
    """

    limit: int = 5
    backoff_s: tuple[float, ...] = (0.0, 0.5, 1.0, 2.0)
    window_s: float = 60.0


@dataclass
class Fate:
    """One node's deaths."""

    state: State = State.RUNNING
    due_at: float = 0.0
    deaths: list[float] = field(default_factory=list)
    restarts: int = 0
    reason: str = ""
    away_s: float = 0.0
    """From the last death to the first word of the new process [s]."""


class Restarts:
    """Decides on restarts by the clock; knows nothing of processes.

    Parameters
    ----------
    config : RestartConfig, optional
    clock : callable, optional
        Seconds, monotonic.
    never : frozenset of str, optional
        Nodes that are not started again.

    Attributes
    ----------
    fates : dict
        Of the nodes that have died, by name.

    Examples
    --------
    >>> now = 0.0
    >>> restarts = Restarts(RestartConfig(limit=1), clock=lambda: now)
    >>> restarts.died("fusion", "was killed by signal 9"), restarts.due()
    (True, ['fusion'])
    >>> restarts.died("fusion", "was killed by signal 9")
    False
    """

    def __init__(
        self,
        config: RestartConfig | None = None,
        *,
        clock: Callable[[], float] = monotonic,
        never: frozenset[str] = NEVER,
    ) -> None:
        self.config, self.clock, self.never = config or RestartConfig(), clock, never
        self.fates: dict[str, Fate] = {}

    def died(self, name: str, reason: str) -> bool:
        """Note a death; returns whether the node will be started again."""
        if name in self.never:
            return False
        now = self.clock()
        fate = self.fates.setdefault(name, Fate())
        fate.deaths = [t for t in fate.deaths if now - t < self.config.window_s]
        fate.reason = reason
        if len(fate.deaths) >= self.config.limit:
            return False
        waits = self.config.backoff_s
        fate.due_at = now + waits[min(len(fate.deaths), len(waits) - 1)]
        fate.deaths.append(now)
        fate.state = State.WAITING
        return True

    def due(self) -> list[str]:
        """Return the nodes to be started now; they count as started."""
        now = self.clock()
        names = [
            name
            for name, fate in self.fates.items()
            if fate.state is State.WAITING and fate.due_at <= now
        ]
        for name in names:
            self.fates[name].state = State.JOINING
            self.fates[name].restarts += 1
        return names

    def joined(self, name: str) -> None:
        """Note that a restarted node is part of the graph again."""
        if name in self.fates and self.fates[name].state is State.JOINING:
            fate = self.fates[name]
            fate.state, fate.away_s = State.RUNNING, self.clock() - fate.deaths[-1]

    def waits(self, name: str) -> bool:
        """Tell whether a node is dead and waits to be started again."""
        return name in self.fates and self.fates[name].state is State.WAITING

    @property
    def missing(self) -> list[str]:
        """Nodes that are not part of the graph now."""
        return [name for name, fate in self.fates.items() if fate.state is not State.RUNNING]

    @property
    def count(self) -> int:
        """Restarts so far, of all nodes."""
        return sum(fate.restarts for fate in self.fates.values())

    def text(self) -> str:
        """Say in one line how the nodes fare."""
        parts = [
            f"{name} {fate.state.value}: it {fate.reason}"
            for name, fate in self.fates.items()
            if fate.state is not State.RUNNING
        ]
        return "; ".join(parts) or "all nodes run"
