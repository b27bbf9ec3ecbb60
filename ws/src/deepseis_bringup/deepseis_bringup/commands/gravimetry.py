"""Command: gravimetry."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from deepseis_bringup.commands.common import Out, add_command, into_run_folder, say

Bags = Annotated[
    list[Path], typer.Argument(help="Bags of one survey: folders, runs' folders or MCAP files.")
]


def gravimetry(
    bags: Bags,
    output: Out = None,
    installation: Annotated[
        Path | None,
        typer.Option(help="Velocimeter's installation.json; without, GNSS calibrates it."),
    ] = None,
    grade: Annotated[
        str, typer.Option(help="Grade of the IMU, where the bag does not name it.")
    ] = "",
    cutoff_hz: Annotated[float, typer.Option(help="Cut-off of the low-pass [Hz].")] = 0.008,
    half_length: Annotated[float, typer.Option(help="Half of its length [s].")] = 150.0,
) -> None:
    r"""Work out gravity along the lines of a survey.

    Every bag is one drive: an IMU, a velocimeter or a GNSS receiver or both, a rest at the start.
    Leaves profiles.csv and series.csv [mGal], summary.json, report.html, installation.json.

    \b
    Example:
      ./deepseis sim gravity-lines --short -o runs/lines
      ./deepseis gravimetry runs/lines -o runs/gravity
    """

    def work(folder: Path) -> None:
        from deepseis_bringup.survey.gravimetry import Drive, GravimetryConfig, work_out
        from deepseis_bringup.survey.gravimetry_files import read_installation, write_files
        from deepseis_bringup.survey.survey_data import data_of_bag
        from deepseis_core.config import check
        from deepseis_core.errors import InputError
        from deepseis_ins.gravimetry import GravityFilter

        low_pass = GravityFilter(cutoff_hz=cutoff_hz, half_length=half_length)
        try:
            check(low_pass)
        except ValueError as error:
            raise InputError("gravity filter", str(error)) from None
        known = None if installation is None else read_installation(installation)
        config = GravimetryConfig(filter=low_pass)
        drives = []
        for bag in bags:
            say(f"{bag}: reading")
            drives.append(Drive(data_of_bag(bag, grade), config))
        result = work_out(drives, config, known, say=say)
        summary = write_files(result, folder)
        for method, lines in summary["methods"].items():
            for number, figures in enumerate(lines, 1):
                agreed = figures.get("total_mgal")
                more = "" if agreed is None else f", agree within {agreed:.2f} mGal"
                typer.echo(
                    f"{method}: line {number}, {figures['length_m'] / 1000:.2f} km, "
                    f"{figures['passes']} passes{more}"
                )

    into_run_folder(output, work)


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    add_command(app, gravimetry)
