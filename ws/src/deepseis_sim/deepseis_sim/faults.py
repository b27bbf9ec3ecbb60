"""Faults of a station's inputs, put into a recording that has none.

A fault is written ``kind:start:duration`` or ``kind:start:duration:amount``, times in seconds
from the recording's beginning: ``imu-gap:26:1``, ``imu-clip:26:5:14.7``, ``imu-sparse:20:22:0.3``.

- ``imu-gap``: no IMU samples whose interval ends within;
- ``imu-clip``: specific force held at +-amount [m/s^2], as a sensor at the end of its range does;
- ``imu-sparse``: each IMU sample is missing with probability ``amount``;
- ``no-signal``: antenna off. Every block's samples in random order: power and distribution of the
  levels stay, no satellite does;
- ``if-gap``: blocks of samples that begin within are missing;
- ``base-gap``: no epochs of the base.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from deepseis_core.errors import InputError
from deepseis_core.types import IfBlock, ImuSample

AMOUNTS: Final[dict[str, str]] = {
    "imu-gap": "",
    "imu-clip": "largest specific force [m/s^2]",
    "imu-sparse": "share that is missing, 0 to 1",
    "no-signal": "",
    "if-gap": "",
    "base-gap": "",
}
"""Kinds, and what their amount is; empty: they have none."""
TOPIC_OF: Final[dict[str, str]] = {
    "imu-gap": "imu/data_raw",
    "imu-clip": "imu/data_raw",
    "imu-sparse": "imu/data_raw",
    "no-signal": "if/samples",
    "if-gap": "if/samples",
    "base-gap": "base/observations",
}


@dataclass(frozen=True)
class Fault:
    """One fault.

    Attributes
    ----------
    kind : str
    start, duration : float
        [s] of the recording.
    amount : float
        Of the kinds that have one (`AMOUNTS`).

    Examples
    --------
    >>> Fault.parse("imu-clip:26:5:14.7")
    Fault(kind='imu-clip', start=26.0, duration=5.0, amount=14.7)
    >>> str(Fault("imu-gap", 26.0, 1.0))
    'imu-gap:26:1'
    """

    kind: str
    start: float
    duration: float
    amount: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        if self.kind not in AMOUNTS:
            raise InputError(f"fault {self.kind}", "is not known", "known: " + ", ".join(AMOUNTS))
        finite = np.isfinite([self.start, self.duration, self.amount]).all()
        if not finite or self.start < 0.0 or self.duration <= 0.0:
            raise InputError(f"fault {self}", "has no time", "kind:start:duration[:amount]")
        if bool(AMOUNTS[self.kind]) != (self.amount > 0.0):
            wanted = AMOUNTS[self.kind] or "none"
            raise InputError(f"fault {self}", "amount does not fit", f"wanted: {wanted}")
        if self.kind == "imu-sparse" and self.amount > 1.0:
            raise InputError(f"fault {self}", "amount does not fit", AMOUNTS[self.kind])

    @classmethod
    def parse(cls, text: str) -> Fault:
        """Read the written form.

        Raises
        ------
        InputError
            It makes no sense.
        """
        kind, *numbers = text.split(":")
        try:
            values = [float(number) for number in numbers]
        except ValueError:
            values = []
        if len(values) not in (2, 3):
            raise InputError(f"fault {text!r}", "is not kind:start:duration[:amount]")
        return cls(kind, *values)

    def __str__(self) -> str:
        """Return the written form."""
        amount = f":{self.amount:g}" if self.amount else ""
        return f"{self.kind}:{self.start:g}:{self.duration:g}{amount}"

    @property
    def end(self) -> float:
        """When the input is whole again [s]."""
        return self.start + self.duration

    def covers(self, time: float) -> bool:
        """Tell whether a moment [s] lies within."""
        return self.start <= time < self.end


class FaultyInputs:
    """Puts faults into values; what it draws depends on the seed and the order of values.

    Parameters
    ----------
    faults : sequence of Fault
    seed : int, optional

    Attributes
    ----------
    touched : dict
        How many values each fault dropped or changed, by its written form.
    """

    def __init__(self, faults: Sequence[Fault], seed: int = 1) -> None:
        self.faults = tuple(faults)
        self.touched = {str(fault): 0 for fault in self.faults}
        self._random = {
            str(fault): np.random.default_rng([seed, number])
            for number, fault in enumerate(self.faults)
        }

    def _now(self, topic: str, time: float) -> list[Fault]:
        return [f for f in self.faults if TOPIC_OF[f.kind] == topic and f.covers(time)]

    def imu(self, sample: ImuSample, end: float) -> ImuSample | None:
        """Return what is left of a sample whose interval ends at ``end`` [s]; None: nothing."""
        for fault in self._now("imu/data_raw", end):
            name = str(fault)
            if fault.kind == "imu-clip":
                force = np.clip(sample.linear_acceleration, -fault.amount, fault.amount)
                self.touched[name] += bool((force != sample.linear_acceleration).any())
                sample = replace(sample, linear_acceleration=force)
            elif fault.kind == "imu-gap" or self._random[name].random() < fault.amount:
                self.touched[name] += 1
                return None
        return sample

    def block(self, block: IfBlock, begin: float) -> IfBlock | None:
        """Return what is left of a block of samples that begins at ``begin`` [s]."""
        for fault in self._now("if/samples", begin):
            self.touched[str(fault)] += 1
            if fault.kind == "if-gap":
                return None
            order = self._random[str(fault)].permutation
            block = replace(block, data=_mixed(block, order))
        return block

    def keeps_base(self, time: float) -> bool:
        """Tell whether an epoch of the base is left."""
        faults = self._now("base/observations", time)
        for fault in faults:
            self.touched[str(fault)] += 1
        return not faults


def _mixed(block: IfBlock, permutation: object) -> NDArray[np.uint8]:
    """Return a block's bytes in random order, those of one sample kept together.

    Where a byte holds several samples they stay neighbours: a quarter of a chip, no signal.
    """
    size = max(1, len(block.data) // block.sample_count)
    whole = len(block.data) // size * size
    rows = block.data[:whole].reshape(-1, size)
    mixed = rows[permutation(len(rows))]  # type: ignore[operator]
    return np.concatenate([mixed.ravel(), block.data[whole:]])
