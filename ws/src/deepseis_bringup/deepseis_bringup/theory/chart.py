"""What a theoretical figure is made of: curves, and what the paper's text says of it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deepseis_core.types import FloatArray

TOTAL, PART, OTHER = "total", "part", "other"
"""Kinds of curves: thick; thin; dashed."""


@dataclass(frozen=True)
class Curve:
    """A named line; angles in degrees."""

    name: str
    y: FloatArray
    kind: str = PART


@dataclass(frozen=True)
class Chart:
    """A figure: ``x`` is (name, unit); ``marks`` are x values that the paper's text names."""

    key: str
    title: str
    caption: str
    x_name: str
    x: FloatArray
    curves: tuple[Curve, ...]
    y_name: str = "phase error [deg]"
    y_range: tuple[float, float] = (0.0, 30.0)
    limit: float | None = 15.0
    marks: tuple[tuple[float, str], ...] = ()
    half: bool = True

    def write_csv(self, folder: Path) -> Path:
        """Write x and all curves as columns."""
        path = folder / f"{self.key}.csv"
        table = np.column_stack([self.x, *(curve.y for curve in self.curves)])
        header = ",".join(_cell(text) for text in (self.x_name, *(c.name for c in self.curves)))
        np.savetxt(path, table, fmt="%.6g", delimiter=",", header=header, comments="")
        return path


@dataclass(frozen=True)
class Comparison:
    """A published number beside ours."""

    source: str
    quantity: str
    published: str
    ours: str
    remark: str = ""


def write_comparisons(rows: Iterable[Comparison], path: Path) -> None:
    """Write published values and ours as CSV."""
    lines = ["source,quantity,published,ours,remark"]
    lines += [",".join(_cell(str(value)) for value in vars(row).values()) for row in rows]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _cell(text: str) -> str:
    """Quote a cell where it must be.

    Examples
    --------
    >>> _cell("total, T 3.7"), _cell("thermal")
    ('"total, T 3.7"', 'thermal')
    """
    return f'"{text.replace(chr(34), chr(34) * 2)}"' if "," in text or '"' in text else text


def degrees(value: float | FloatArray) -> FloatArray:
    """Turn radians into degrees, for a person's eye."""
    return np.asarray(np.degrees(value), np.float64)
