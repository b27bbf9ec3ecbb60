"""Command: rtk."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from deepseis_bringup.commands.common import Out, add_command, into_run_folder


def rtk(
    rover: Annotated[Path, typer.Argument(help="RINEX observations of the antenna that moves.")],
    base: Annotated[Path, typer.Argument(help="RINEX observations of the base.")],
    navigation: Annotated[list[Path], typer.Argument(help="RINEX navigation files.")],
    output: Out = None,
    base_position: Annotated[
        str,
        typer.Option(
            help="Base's antenna, 'latitude longitude height' [deg deg m]; default: as its file"
            " says."
        ),
    ] = "",
    frequencies: Annotated[
        int, typer.Option(help="Carriers: 1 (L1) or 2 (L1 and L2).", min=1, max=2)
    ] = 2,
    mask: Annotated[float, typer.Option(help="Elevation mask [deg].")] = 15.0,
    ratio: Annotated[float, typer.Option(help="Least ratio of a fixed epoch [-].")] = 3.0,
    hold: Annotated[
        bool,
        typer.Option("--hold", help="Hold integers once fixed, not find them anew."),
    ] = False,
) -> None:
    r"""Solve a receiver's RINEX files against a base's, epoch by epoch, after the fact.

    GPS, RTKLIB's kinematic mode, forward only; epochs of any rate stay apart (RTKLIB's own file
    loop merges those above 40 Hz). Leaves solution.csv, solution.pos (as RTKLIB writes), page
    rtk.html and summary.json.

    \b
    Example:
      ./deepseis rtk rover.21o base.21o brdc.21n -o runs/rtk
    """

    def work(folder: Path) -> None:
        import numpy as np

        from deepseis_bringup.survey.rtk_files import solve, write_csv, write_pos, write_summary
        from deepseis_bringup.survey.rtk_page import page
        from deepseis_core.config import check
        from deepseis_core.errors import InputError
        from deepseis_core.geodesy import ecef_from_text
        from deepseis_pvt.rtk import GEODETIC, RtkConfig

        config = RtkConfig(
            rtk_mask_deg=mask,
            rtk_frequencies=frequencies,
            rtk_ratio=ratio,
            rtk_hold=hold,
            rtk_code_ratio=GEODETIC.rtk_code_ratio,
        )
        try:
            check(config)
        except ValueError as error:
            raise InputError("rtk", str(error)) from None
        place = np.array(ecef_from_text(base_position)) if base_position else None
        table = solve(rover, base, navigation, config, place)
        about = {
            "rover": rover.name,
            "base": base.name,
            "navigation": " ".join(path.name for path in navigation),
            "base_position": base_position or "as its file says",
            "frequencies": frequencies,
            "mask_deg": mask,
            "least_ratio": ratio,
            "hold": hold,
        }
        write_csv(table, folder / "solution.csv")
        write_pos(
            table, folder / "solution.pos", [f"{name}: {value}" for name, value in about.items()]
        )
        (folder / "rtk.html").write_text(page(table, about, ratio), encoding="utf-8")
        found = write_summary(table, folder / "summary.json", about)
        typer.echo(
            f"{found['fixed']} of {found['epochs']} epochs fixed ({found['fixed_percent']:g} %), "
            f"{found['float']} float, {found['none']} without a solution"
        )

    into_run_folder(output, work)


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    add_command(app, rtk)
