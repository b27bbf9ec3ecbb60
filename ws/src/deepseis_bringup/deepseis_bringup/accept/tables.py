"""Acceptance: a paper's tables repeated, published value beside ours, goal and limit.

``./deepseis accept NAME`` writes ``NAME.csv`` and ``NAME.html``. What is missed is said to be
missed; the command's exit status tells only whether it could be measured.
"""

from __future__ import annotations

import csv
import operator
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any, Final

from deepseis_bringup.report.document import TIMES, Tile, document, page_head, place
from deepseis_bringup.report.plot import Colours, Figure

COLUMNS: Final = (
    *("table", "scenario", "quantity", "unit", "published", "ours", "goal", "limit", "met"),
)
NUMBERS: Final = ("unit", "ours", "goal", "limit", "met")
NOTHING: Final = "nothing came out"
WHOLE: Final = ' style="white-space:nowrap"'
"""Of cells whose text must not be broken."""
RELATIONS: Final[dict[str, Callable[[float, float], bool]]] = {
    "<=": operator.le,
    ">=": operator.ge,
}


@dataclass(frozen=True)
class Goal:
    """What a value must be: ``<= 1.1``, ``>= 40``, within a share of a value, or near it.

    Examples
    --------
    >>> Goal.at_most(1.1).met(1.0), Goal.within(0.15, 29.0).met(20.0)
    (True, False)
    >>> str(Goal.within(0.15, 29.0))
    '29 +-15 %'
    >>> str(Goal.near(37.74, 0.05))
    '37.74 +-0.05'
    """

    relation: str
    value: float
    share: float = 0.0
    tolerance: float = 0.0

    @classmethod
    def at_most(cls, value: float) -> Goal:
        """Return an upper bound."""
        return cls("<=", value)

    @classmethod
    def at_least(cls, value: float) -> Goal:
        """Return a lower bound."""
        return cls(">=", value)

    @classmethod
    def within(cls, share: float, value: float) -> Goal:
        """Return a value to be met within a share of it."""
        return cls("~", value, share)

    @classmethod
    def near(cls, value: float, tolerance: float) -> Goal:
        """Return a value to be met within a tolerance of the same unit."""
        return cls("+-", value, tolerance=tolerance)

    def met(self, ours: float) -> bool:
        """Tell whether a value meets the goal; not a number does not."""
        if self.relation == "~":
            return bool(abs(ours - self.value) <= self.share * abs(self.value))
        if self.relation == "+-":
            return bool(abs(ours - self.value) <= self.tolerance)
        return bool(RELATIONS[self.relation](ours, self.value))

    def __str__(self) -> str:
        """Return the goal as a reader writes it."""
        if self.relation == "~":
            return f"{self.value:g} +-{100 * self.share:g} %"
        if self.relation == "+-":
            return f"{self.value:g} +-{self.tolerance:g}"
        return f"{self.relation} {self.value:g}"


@dataclass(frozen=True)
class Row:
    """One line of a table.

    ``published`` is what the paper prints, ``limit`` what theory allows at best; both may be
    missing. Without a goal the line is a report.
    """

    table: str
    scenario: str
    quantity: str
    unit: str
    ours: float | str | None
    published: float | str | None = None
    goal: Goal | None = None
    limit: float | None = None

    @property
    def met(self) -> bool | None:
        """Whether the goal is met; None without one."""
        if self.goal is None:
            return None
        return isinstance(self.ours, (int, float)) and self.goal.met(float(self.ours))

    def cells(self) -> list[str]:
        """Return the texts of `COLUMNS`."""
        met = {None: "", True: "yes", False: "no"}[self.met]
        goal = "" if self.goal is None else str(self.goal)
        values = [_text(value) for value in (self.published, self.ours)]
        return [
            self.table, self.scenario, self.quantity, self.unit, *values, goal,
            _text(self.limit), met,
        ]  # fmt: skip


@dataclass
class Acceptance:
    """The lines and pictures of one acceptance run."""

    name: str
    title: str
    rows: list[Row] = field(default_factory=list)
    figures: list[tuple[str, list[Figure]]] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    def add(self, *rows: Row) -> None:
        """Append lines."""
        self.rows += rows

    def write(self, folder: Path) -> None:
        """Write ``NAME.csv`` and ``NAME.html``."""
        path = folder / f"{self.name}.csv"
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(COLUMNS)
            writer.writerows(row.cells() for row in self.rows)
        (folder / f"{self.name}.html").write_text(self.page(), encoding="utf-8")

    def counts(self) -> tuple[int, int]:
        """Return how many goals are met, and how many there are."""
        goals = [row.met for row in self.rows if row.met is not None]
        return sum(goals), len(goals)

    def page(self) -> str:
        """Return the page."""
        panels: list[dict[str, Any]] = []
        body: list[str] = []
        drawn: dict[str, list[Figure]] = {}
        for name, figures in self.figures:
            drawn.setdefault(name, []).extend(figures)
        for table, rows in _by_table(self.rows):
            figures = drawn.pop(table, [])
            pictures = place(figures, panels, Colours([])) if figures else ""
            body.append(f"<h2>{escape(table)}</h2><figure>{_table(rows)}</figure>{pictures}")
        for name, figures in drawn.items():
            body.append(f"<h2>{escape(name)}</h2>{place(figures, panels, Colours([]))}")
        met, goals = self.counts()
        lead = f"{met} of {goals} goals are met. " + " ".join(self.remarks)
        missed = sum(row.met is False for row in self.rows)
        tiles = [
            Tile("Goals met", f"{met}", f"of {goals}"),
            Tile("Missed", f"{missed}", bad=missed > 0),
            Tile("Lines", f"{len(self.rows)}", more="those without a goal are reports"),
            Tile("Tables", f"{len(dict(_by_table(self.rows)))}"),
        ]
        head = page_head("acceptance", self.title, lead, tiles=tiles)
        return document(self.title, head, body, panels, footer=TIMES if panels else "")


def _by_table(rows: Sequence[Row]) -> Iterable[tuple[str, list[Row]]]:
    tables: dict[str, list[Row]] = {}
    for row in rows:
        tables.setdefault(row.table, []).append(row)
    return tables.items()


def _table(rows: Sequence[Row]) -> str:
    texts = [row.cells() for row in rows]
    shown = [k for k in range(1, len(COLUMNS)) if any(cells[k] for cells in texts)]
    head = "".join(f"<th>{escape(COLUMNS[k])}</th>" for k in shown)
    lines = []
    for row, texts_of_row in zip(rows, texts, strict=True):
        style = ' class="bad"' if row.met is False else ""
        cells = "".join(
            f"<td{WHOLE if COLUMNS[k] in NUMBERS else ''}>{escape(texts_of_row[k])}</td>"
            for k in shown
        )
        lines.append(f"<tr{style}>{cells}</tr>")
    table = f'<table class="words"><tr>{head}</tr>{"".join(lines)}</table>'
    return f'<div class="scroll" tabindex="0">{table}</div>'


def _text(value: float | str | None) -> str:
    if value is None:
        return ""
    if isinstance(value, str):
        return value
    if value != value:
        return NOTHING
    return f"{value:.4g}"
