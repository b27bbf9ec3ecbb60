"""What a soak test does to a station and when: drawn by chance, the same for the same seed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from deepseis_sim.faults import Fault

FIRST_S: Final = 40.0
"""Undisturbed at first: the station starts, and calibrates [s]."""
LAST_S: Final = 15.0
"""Undisturbed at the end [s]."""
LENGTHS: Final[dict[str, tuple[float, float]]] = {
    "imu-gap": (0.1, 2.0),
    "if-gap": (0.02, 1.0),
    "no-signal": (1.0, 8.0),
    "outage": (1.0, 8.0),
    "kill": (0.0, 0.0),
}
"""Shortest and longest of each kind [s]; of satellites one at a time is out."""


@dataclass(frozen=True)
class Disturbance:
    """One disturbance: kind, beginning and length [s]; ``victim``: node, or satellite's number."""

    kind: str
    begin: float
    length: float
    victim: str = ""

    @property
    def end(self) -> float:
        """When the input is back [s]; of a kill not known before."""
        return self.begin + self.length

    @property
    def name(self) -> str:
        """What it is, without when."""
        return f"{self.kind} {self.victim}" if self.kind == "kill" else self.kind

    def fault(self) -> Fault | None:
        """Return it as a fault of a recording, if it is one."""
        recorded = self.kind in ("imu-gap", "if-gap", "no-signal")
        return Fault(self.kind, self.begin, self.length) if recorded else None


def plan(
    duration: float,
    seed: int,
    *,
    every_s: float = 20.0,
    kinds: Sequence[str] = tuple(LENGTHS),
    victims: Sequence[str] = (),
    satellites: int = 1,
) -> list[Disturbance]:
    """Draw disturbances one after the other, every kind as often as the others.

    Parameters
    ----------
    duration : float
        Of the run [s].
    seed : int
    every_s : float, optional
        From one to the next, in the mean [s]; at least 0.6 and at most 1.4 of it.
    kinds : sequence of str, optional
        Of `LENGTHS`.
    victims : sequence of str, optional
        Nodes that may be killed.
    satellites : int, optional
        How many may be masked.

    Examples
    --------
    >>> found = plan(300.0, 1, victims=["fusion"])
    >>> found == plan(300.0, 1, victims=["fusion"]), found[0].begin >= FIRST_S
    (True, True)
    """
    random = np.random.default_rng(seed)
    now, found = FIRST_S, list[Disturbance]()
    bag, targets = list[str](), list[str]()
    while True:
        bag = bag or [str(kind) for kind in random.permutation(np.array(kinds))]
        kind = bag.pop()
        length = round(float(random.uniform(*LENGTHS[kind])), 2)
        victim = ""
        if kind == "kill":
            targets = targets or [str(name) for name in random.permutation(np.array(victims))]
            victim = targets.pop()
        elif kind == "outage":
            victim = str(int(random.integers(satellites)))
        if now + length > duration - LAST_S:
            return found
        # On the grid of the blocks of samples, so that a gap is as long as it says.
        found.append(Disturbance(kind, round(now / 0.02) * 0.02, length, victim))
        now += length + every_s * float(random.uniform(0.6, 1.4))
