"""Command: theory."""

from __future__ import annotations

from pathlib import Path

import typer

from deepseis_bringup.commands.common import Out, add_command, into_run_folder


def theory(output: Out = None) -> None:
    r"""Redraw the papers' theoretical figures of the tracking loops from our code.

    Figures 3.5, 3.6, 3.8, 3.9 and 3.10 of the thesis, 2, 4, 5, 6 and table 1 of the
    Doppler-aided paper, and the discrete loop that is used. Leaves report.html, a CSV file for
    each figure, published.csv (their numbers beside ours) and summary.json.

    \b
    Example:
      ./deepseis theory -o runs/theory
    """

    def work(folder: Path) -> None:
        from deepseis_bringup.theory.redraw import redraw

        summary = redraw(folder)
        typer.echo(f"figures = {len(summary['figures'])}")
        typer.echo(f"published_numbers = {len(summary['comparisons'])}")

    into_run_folder(output, work)


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    add_command(app, theory)
