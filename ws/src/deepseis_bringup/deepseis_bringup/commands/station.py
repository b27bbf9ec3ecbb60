"""Command: station."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from deepseis_bringup.commands.common import (
    Out,
    add_command,
    into_run_folder,
    one_line_errors,
    say,
)
from deepseis_bringup.commands.web import WebAddress, WebNames, WebPort, WebToken, web_options

Config = Annotated[
    Path | None, typer.Option(help="Configuration [YAML]; `--example` prints one, explained.")
]


def station(
    config: Config = None,
    output: Out = None,
    example: Annotated[
        bool, typer.Option("--example", help="Print the example configuration and end.")
    ] = False,
    web: WebPort = None,
    web_address: WebAddress = None,
    web_token_file: WebToken = None,
    web_name: WebNames = None,
) -> None:
    r"""Run the station live until Ctrl-C or the end of its source.

    Starts one process for each part of the graph (source, acquisition, trackers, position,
    recorder) in the present ROS_DOMAIN_ID, under the station's name as namespace, at the pace of
    the clock. Ctrl-C or SIGTERM stops the source first, lets the others work through what it has
    sent, and finishes all files. A second station of the same name in the domain is refused.

    The run folder gets bag/, the RINEX files, summary.json, logs/ (what each node printed) and
    parameters/ (what each node was given).

    \b
    Examples:
      ./deepseis station --example > my.yaml
      ./deepseis station --config my.yaml -o runs/tonight

    Exit status: 0 ended by Ctrl-C or by the source, 2 bad input or a node failed.
    """
    with one_line_errors():
        if example:
            typer.echo(example_path().read_text(encoding="utf-8"), nl=False)
            raise typer.Exit(0)

    def work(folder: Path) -> None:
        from deepseis_bringup.runs import console
        from deepseis_bringup.station import run_station
        from deepseis_bringup.station_config import read_station_config
        from deepseis_core.errors import InputError

        settings = read_station_config(config or example_path())
        if not settings.source.get("file"):
            hint = "an IF recording, a bag, a device; ./deepseis station --example explains it"
            raise InputError(config or "no --config", "source.file names nothing", hint)
        page = web_options(web, web_address, web_token_file, web_name, settings.live_page)
        settings = replace(settings, live_page=page)
        with console.status("starting") as status:
            show = status.update if console.is_terminal else lambda _line: None
            figures = run_station(settings, folder, say=say, show=show)
        typer.echo(f"ended_by = {figures['ended_by']}")
        typer.echo(f"duration_s = {figures['duration_s']}")

    into_run_folder(output, work)


def example_path() -> Path:
    """Return the installed example configuration."""
    from ament_index_python.packages import get_package_share_directory

    share = Path(get_package_share_directory("deepseis_bringup"))
    return share / "config" / "station.yaml"


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    add_command(app, station)
