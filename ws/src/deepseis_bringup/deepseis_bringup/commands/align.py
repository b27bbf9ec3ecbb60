"""Command: align."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from deepseis_bringup.bags.bag_place import bag_of
from deepseis_bringup.commands.common import Bag, add_command, one_line_errors


def align(
    run: Bag,
    imu: Annotated[
        Path | None,
        typer.Option(help="The IMU: a bag, or text of columns; without, that of the run's bag."),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Write the figures there too [JSON].")
    ] = None,
) -> None:
    r"""Find an IMU's time offset and lever arm from a run without it.

    The antenna's motion by GNSS and the IMU's by mechanisation are fitted to each other: what is
    to be added to the IMU's times, where the antenna is from it, and its attitude, each with its
    sigma. Both must have moved: half a minute of gentle shaking (0.1 to 0.5 g) gives the offset,
    turning to and fro by some degrees the lever arm. The last lines are for the IMU's
    description (docs/tutorials/own-data.md).

    \b
    Example:
      ./deepseis process capture.bin --for-align --position '35.68 139.77 10' -o runs/gnss
      ./deepseis align runs/gnss --imu imu.csv

    Exit status: 0 found, 2 they do not agree, or bad input.
    """
    with one_line_errors():
        from deepseis_bringup.commission import align as work

        bag = bag_of(run)
        figures = work.align(bag, imu)
        for key, value in figures.items():
            typer.echo(f"{key} = {value}")
        so_far = work.offset_so_far(imu, work.run_clock(bag))
        typer.echo(work.as_yaml(figures, so_far))
        if output is not None:
            output.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    add_command(app, align)
