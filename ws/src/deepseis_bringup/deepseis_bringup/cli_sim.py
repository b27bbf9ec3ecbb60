"""Command: sim, with one subcommand for each scenario."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from deepseis_bringup.cli_common import add_command, one_line_errors

SHORT_SECONDS = 24.0
"""Enough for subframes 1 to 3, from 2 s before the first: a first fix from what was decoded."""

sim = typer.Typer(
    help="Simulate a scenario: makes an input bag, with the truth beside it.",
    no_args_is_help=True,
)

Folder = Annotated[
    Path, typer.Option("-o", "--output", help="Folder for the result, new or empty.")
]


def still(
    output: Folder,
    short: Annotated[
        bool, typer.Option("--short", help=f"{SHORT_SECONDS:g} s instead of 40 s.")
    ] = False,
    duration: Annotated[
        float | None, typer.Option(help="Length of the signal [s].", min=0.1)
    ] = None,
    seed: Annotated[
        int, typer.Option(help="Of noise, phases and constellation: same seed, same bytes.")
    ] = 1,
    if_format: Annotated[
        str, typer.Option(help="Packing of the samples: preset or text, see docs/formats.md.")
    ] = "iq2",
    rate: Annotated[float, typer.Option(help="Sampling rate [Hz].")] = 4.0e6,
    if_hz: Annotated[float, typer.Option("--if-hz", help="Intermediate frequency [Hz].")] = 0.0,
    nav: Annotated[
        Path | None,
        typer.Option(help="RINEX navigation file; default: a nominal constellation."),
    ] = None,
    raw: Annotated[
        bool, typer.Option("--raw", help="Leave the raw IF file if.bin and its descriptor too.")
    ] = False,
) -> None:
    r"""Simulate an antenna that stands still under an open sky.

    Starts 2 s before a subframe 1, so that a receiver has a position after 20 s. Leaves bag/
    (`./deepseis replay DIR` runs it), truth.npz, nav.rnx and summary.json.

    \b
    Example:
      ./deepseis sim still --short --seed 7 --if-format iq8 -o runs/input
    """
    with one_line_errors():
        from deepseis_bringup import simulate
        from deepseis_bringup.runs import new_run_folder
        from deepseis_sim.scenario import StillConfig

        default = StillConfig()
        config = replace(
            default,
            duration=duration or (SHORT_SECONDS if short else default.duration),
            seed=seed,
            if_format=if_format,
            sample_rate_hz=rate,
            intermediate_frequency_hz=if_hz,
            nav_file=str(nav or ""),
        )
        folder = new_run_folder(output)
        summary = simulate.still(config, folder, keep_raw=raw)
        typer.echo(f"satellites = {' '.join(summary['satellites'])}")
        typer.echo(str(folder))


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    add_command(sim, still)
    app.add_typer(sim, name="sim")
