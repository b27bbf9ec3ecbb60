"""Commands that run the graph on a recording: demo, replay, process."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from deepseis_bringup.cli_common import Bag, Out, bag_of, into_run_folder, say_figures


def demo(
    output: Out = None,
    duration: Annotated[float, typer.Option(help="Length of the signal [s].", min=5.0)] = 40.0,
    if_format: Annotated[str, typer.Option(help="Packing of the samples.")] = "iq2",
    seed: Annotated[int, typer.Option(help="Seed of noise and phases.")] = 1,
) -> None:
    """Simulate 40 s of GPS signal, run the whole station on it over DDS, report with pictures."""

    def work(folder: Path) -> None:
        from deepseis_bringup import runs

        summary = runs.demo(folder, duration=duration, if_format=if_format, seed=seed)
        say_figures(summary)

    into_run_folder(output, work)


def replay(
    bag: Bag,
    output: Out = None,
    realtime: Annotated[
        bool, typer.Option("--realtime", help="At the pace of the clock, with deadlines.")
    ] = False,
    separate: Annotated[
        bool, typer.Option("--separate", help="One process for each satellite.")
    ] = False,
    without_if: Annotated[
        bool, typer.Option("--without-if", help="Do not record the samples again.")
    ] = False,
) -> None:
    """Run a recorded bag's samples through the graph again."""

    def work(folder: Path) -> None:
        from deepseis_bringup import runs

        options = runs.RunOptions(
            mode="realtime" if realtime else "lockstep",
            one_process=not separate,
            record_if=not without_if,
        )
        say_figures(runs.replay(bag_of(bag), folder, options))

    into_run_folder(output, work)


def process(
    if_file: Annotated[Path, typer.Argument(help="IF recording.")],
    format: Annotated[str, typer.Option(help="Packing: preset or text; see docs/formats.")] = "",
    rate: Annotated[float, typer.Option(help="Sampling rate [Hz].")] = 0.0,
    intermediate_frequency: Annotated[
        float, typer.Option("--if-hz", help="Nominal intermediate frequency [Hz].")
    ] = 0.0,
    start_utc: Annotated[str, typer.Option(help="Coarse UTC of the first sample.")] = "",
    length: Annotated[float, typer.Option(help="Use so much [s]; 0: all.")] = 0.0,
    nav: Annotated[
        Path | None, typer.Option(help="RINEX navigation file for an assisted start.")
    ] = None,
    output: Out = None,
) -> None:
    """Run a recording of your own through the graph."""

    def work(folder: Path) -> None:
        from deepseis_bringup import runs
        from deepseis_bringup.report import write_report
        from deepseis_core.rinex_nav import read_rinex_nav

        pvt = {}
        if nav is not None:
            read_rinex_nav(nav)
            pvt["nav_file"] = str(nav.resolve())
        selection = runs.Selection(
            str(if_file), format, rate, intermediate_frequency, start_utc, length_s=length
        )
        options = runs.RunOptions(record_if=False, parameters={"pvt": pvt})
        figures = runs.run_recording(selection, folder, options)
        say_figures(
            write_report(folder, truth=None, title=f"DeepSeis {if_file.name}", extra=figures)
        )

    into_run_folder(output, work)


def register(app: typer.Typer) -> None:
    """Add the commands to the application."""
    for command in (demo, replay, process):
        app.command()(command)
