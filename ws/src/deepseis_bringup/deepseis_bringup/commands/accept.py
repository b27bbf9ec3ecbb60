"""Command: accept."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, cast

import typer

from deepseis_bringup.commands.common import Out, add_command, into_run_folder, say
from deepseis_core.errors import InputError

if TYPE_CHECKING:
    from deepseis_bringup.accept.tables import Acceptance

REPEATED: Final = ("displacement", "faults", "tight", "tracking", "gyrofree", "gravimetry")


def repeater(name: str) -> Callable[..., Acceptance]:
    """Return what repeats a table: `accept_NAME` of the module NAME of `deepseis_bringup.accept`.

    Raises
    ------
    InputError
        No table has this name.
    """
    if name not in REPEATED:
        raise InputError(f"accept {name}", "is not known", "known: " + ", ".join(REPEATED))
    module = import_module(f"deepseis_bringup.accept.{name}")
    return cast("Callable[..., Acceptance]", getattr(module, f"accept_{name}"))


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
        acceptance = repeater(name)(folder, short=short, say=say)
        met, goals = acceptance.counts()
        for row in acceptance.rows:
            if row.met is False:
                typer.echo(f"missed: {', '.join(row.cells()[1:8])}")
        typer.echo(f"{met} of {goals} goals met")

    into_run_folder(output, work)


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    add_command(app, accept)
