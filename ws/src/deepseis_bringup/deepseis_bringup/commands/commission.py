"""Command: commission."""

from __future__ import annotations

from typing import Annotated

import typer

from deepseis_bringup.bags.bag_place import bag_of
from deepseis_bringup.commands.common import Bag, Out, add_command, one_line_errors


def commission(
    run: Bag,
    output: Out = None,
    longest: Annotated[
        float, typer.Option(help="Look at so much of the bag [s].", min=5.0)
    ] = 600.0,
    strict: Annotated[
        bool, typer.Option("--strict", help="Checks that the data leave open fail as well.")
    ] = False,
) -> None:
    r"""Check on its first minutes that a new station stands as it is said to.

    Monument and antenna, clock, signal, axes and signs of the IMU by gravity, the Earth's turn
    and by shaking, its noise against its grade, time offset, lever arm. The bag of a run that is
    still being recorded may be given. Leaves commission.html and commission.json in a new folder.
    docs/operations.md tells what to do for each check.

    \b
    Example:
      ./deepseis commission runs/first-hour -o runs/commission

    Exit status: 0 passed, 1 a check failed, 2 bad input.
    """
    with one_line_errors():
        from deepseis_bringup import run_folder
        from deepseis_bringup.commission import commissioning as work

        folder = run_folder.new_run_folder(output)
        with run_folder.half_written_is_removed(folder):
            result = work.commission(bag_of(run), folder, longest_s=longest)
        for check in result["checks"]:
            parts = (check[key] for key in ("status", "name", "found", "text"))
            typer.echo("\t".join(parts).rstrip())
        typer.echo(result["verdict"])
        typer.echo(str(folder / "commission.html"))
        bad = result["failed"] + (result["open"] if strict else 0)
    raise typer.Exit(1 if bad else 0)


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    add_command(app, commission)
