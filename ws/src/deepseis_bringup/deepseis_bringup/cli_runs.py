"""Commands that run the graph: demo, station, replay, record, info, recover, sim."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

Out = Annotated[
    Path | None, typer.Option("-o", "--output", help="Run folder; default runs/<UTC>.")
]


@contextmanager
def one_line_errors() -> Iterator[None]:
    """Turn bad input into one line on stderr and exit status 2."""
    from deepseis_core.errors import InputError

    try:
        yield
    except InputError as error:
        typer.echo(f"deepseis: {error}", err=True)
        raise typer.Exit(2) from None
    except KeyboardInterrupt:
        typer.echo("deepseis: interrupted", err=True)
        raise typer.Exit(130) from None


def _into_run_folder(output: Path | None, work: Callable[[Path], Any]) -> None:
    """Do ``work`` into a new run folder; its path is the last line printed."""
    with one_line_errors():
        from deepseis_bringup import runs

        folder = runs.new_run_folder(output)
        with runs.half_written_is_removed(folder):
            work(folder)
        typer.echo(str(folder))


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
        _say(summary)

    _into_run_folder(output, work)


def _say(summary: dict[str, Any]) -> None:
    """Print the figures a person looks for first."""
    for key in (
        "satellites_tracked",
        "time_to_first_fix_s",
        "position_error_m",
        "real_time_factor",
        "lost_samples",
    ):
        if key in summary:
            typer.echo(f"{key} = {summary[key]}")


def replay(
    bag: Annotated[Path, typer.Argument(help="A recorded run: its bag folder or MCAP file.")],
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
        _say(runs.replay(bag, folder, options))

    _into_run_folder(output, work)


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
        _say(write_report(folder, truth=None, title=f"DeepSeis {if_file.name}", extra=figures))

    _into_run_folder(output, work)


def info(
    bag: Annotated[Path, typer.Argument(help="Bag folder or MCAP file.")],
) -> None:
    """Tell what a bag holds."""
    with one_line_errors():
        from deepseis_bringup import bag_info

        typer.echo(bag_info.describe(bag_info.bag_info(bag)))


def recover(
    bag: Annotated[Path, typer.Argument(help="Bag folder or MCAP file that was cut short.")],
) -> None:
    """Make a bag that was cut short whole again."""
    with one_line_errors():
        from deepseis_bringup import bag_info

        typer.echo(str(bag_info.recover_bag(bag)))


def register(app: typer.Typer) -> None:
    """Add the commands to the application."""
    for command in (demo, replay, process, info, recover):
        app.command()(command)
