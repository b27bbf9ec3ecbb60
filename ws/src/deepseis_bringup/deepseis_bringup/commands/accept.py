"""Command: accept."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Annotated, Final

import typer

from deepseis_bringup.commands.common import Out, add_command, into_run_folder, say

REPEATED: Final[Mapping[str, str]] = {
    "displacement": "accept_displacement",
    "faults": "accept_faults",
    "tight": "accept_tight",
    "tracking": "accept_tracking",
    "gyrofree": "accept_gyrofree",
    "gravimetry": "accept_gravimetry",
}
"""Module of `deepseis_bringup`, and its function of the same name, that repeats each."""


def accept(
    name: Annotated[str, typer.Argument(help=f"What to repeat: {', '.join(REPEATED)}.")],
    output: Out = None,
    short: Annotated[bool, typer.Option("--short", help="Short forms of the scenarios.")] = False,
) -> None:
    r"""Repeat a paper's tables, or measure what faults cost: ours, goal, limit.

    Leaves NAME.csv and NAME.html. Exit status 0 means that it was measured, not that every goal
    is met; the last column says that.

    \b
    Example:
      ./deepseis accept tracking --short -o runs/accept
    """

    def work(folder: Path) -> None:
        from deepseis_core.errors import InputError

        if name not in REPEATED:
            raise InputError(f"accept {name}", "is not known", "known: " + ", ".join(REPEATED))
        module = import_module(f"deepseis_bringup.{REPEATED[name]}")
        acceptance = getattr(module, REPEATED[name])(folder, short=short, say=say)
        met, goals = acceptance.counts()
        for row in acceptance.rows:
            if row.met is False:
                typer.echo(f"missed: {', '.join(row.cells()[1:8])}")
        typer.echo(f"{met} of {goals} goals met")

    into_run_folder(output, work)


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    add_command(app, accept)
