"""A check of a new station: what its data say, against what its description says.

It fails where the difference is beyond what chance and the sensors' grade allow. What the data
cannot tell is said to be open.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from deepseis_core.types import FloatArray

PASS, FAIL, OPEN = "pass", "fail", "open"
AXES: Final = ("forward", "left", "up")


@dataclass(frozen=True)
class Check:
    """One check: what was found, what it should be and how far off it may be, what to look at."""

    name: str
    status: str
    found: str
    expected: str
    text: str = ""


def judge(name: str, bad: bool, found: str, expected: str, text: str = "") -> Check:
    """Return a check that fails where it is bad; ``text`` says then what to look at."""
    return Check(name, FAIL if bad else PASS, found, expected, text if bad else "")


def enu(value: FloatArray, digits: int = 2) -> str:
    """Return three numbers with their signs."""
    return " ".join(f"{v:+.{digits}f}" for v in value)


def allan(values: FloatArray, step: float, tau: float) -> float:
    """Return the overlapping Allan deviation of rates or frequencies at one averaging time.

    Examples
    --------
    >>> white = np.random.default_rng(1).standard_normal(100_000)
    >>> bool(abs(allan(white, 0.01, 1.0) / 0.1 - 1.0) < 0.05)
    True
    """
    m = max(1, round(tau / step))
    phase = np.concatenate([[0.0], np.cumsum(values)]) * step
    second = phase[2 * m :] - 2.0 * phase[m:-m] + phase[: -2 * m]
    return float(np.sqrt(0.5 * np.mean(second**2)) / (m * step))
