"""Command: accept."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from deepseis_bringup.cli_common import Out, add_command, into_run_folder, say

NAMES = ("tracking",)


def accept(
    name: Annotated[str, typer.Argument(help=f"What to repeat: {', '.join(NAMES)}.")],
    output: Out = None,
    short: Annotated[bool, typer.Option("--short", help="Short forms of the scenarios.")] = False,
) -> None:
    r"""Repeat a paper's tables: published value, ours, goal, limit.

    Leaves NAME.csv and NAME.html. Exit status 0 means that it was measured, not that every goal
    is met; the last column says that.

    \b
    Example:
      ./deepseis accept tracking --short -o runs/accept
    """

    def work(folder: Path) -> None:
        from deepseis_bringup.accept_tracking import accept_tracking
        from deepseis_core.errors import InputError

        if name not in NAMES:
            raise InputError(f"accept {name}", "is not known", "known: " + ", ".join(NAMES))
        acceptance = accept_tracking(folder, short=short, say=say)
        met, goals = acceptance.counts()
        for row in acceptance.rows:
            if row.met is False:
                typer.echo(f"missed: {', '.join(row.cells()[1:8])}")
        typer.echo(f"{met} of {goals} goals met")

    into_run_folder(output, work)


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    add_command(app, accept)
