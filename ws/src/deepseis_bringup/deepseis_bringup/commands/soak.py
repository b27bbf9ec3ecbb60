"""Command: soak."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from deepseis_bringup.commands.common import Out, add_command, into_run_folder, say


def soak(
    output: Out = None,
    observables: Annotated[
        bool,
        typer.Option("--observables", help="Filters alone, from observables, in one process."),
    ] = False,
    minutes: Annotated[
        float | None,
        typer.Option(help="Station time [min]; default 60, with --observables 1440.", min=2),
    ] = None,
    pace: Annotated[
        float,
        typer.Option(
            help="Station seconds a second; 0: lockstep, as fast as it goes, nobody is killed.",
            min=0.0,
        ),
    ] = 1.0,
    every: Annotated[
        float, typer.Option(help="From one disturbance to the next, in the mean [s].", min=8.0)
    ] = 20.0,
    rate: Annotated[
        float, typer.Option(help="With --observables: epochs a second [Hz].", min=1.0)
    ] = 10.0,
    seed: Annotated[int, typer.Option(help="Of all that is drawn by chance.")] = 1,
) -> None:
    r"""Disturb a station by chance for a long time; say what was lost, and what grew.

    From IF samples: IF gaps, IMU gaps, the antenna off, satellites masked, and processes killed
    while the graph runs in real time. An hour takes 15 GB in the run folder. Leaves soak.csv and
    soak.html: losses beyond each gap, phases wrong without a mark, memory and file handles of
    every process.

    \b
    Examples:
      ./deepseis soak --minutes 60 -o runs/soak
      ./deepseis soak --minutes 20 --pace 0
      ./deepseis soak --observables --minutes 1440
    """

    def work(folder: Path) -> None:
        from deepseis_bringup.runs import progress_bar
        from deepseis_bringup.soak.run import soak_from_observables, soak_from_signal
        from deepseis_bringup.soak.signal import SoakConfig

        if observables:
            hours = (minutes or 1440.0) / 60.0
            with progress_bar("observables", 3600.0 * hours) as show:
                acceptance = soak_from_observables(
                    folder, hours, rate_hz=rate, seed=seed, every_s=every, show=show
                )
        else:
            config = SoakConfig(60.0 * (minutes or 60.0), pace, every, seed)
            acceptance = soak_from_signal(folder, config, say)
        for row in acceptance.rows:
            typer.echo(" | ".join(row.cells()[1:8]))
        met, goals = acceptance.counts()
        typer.echo(f"{met} of {goals} goals met")

    into_run_folder(output, work)


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    add_command(app, soak)
