"""What the commands share: one-line errors, run folders, options."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

Out = Annotated[
    Path | None, typer.Option("-o", "--output", help="Run folder, made new; default runs/<UTC>.")
]
Bag = Annotated[Path, typer.Argument(help="A bag: its folder, the run's folder, or an MCAP file.")]

FIGURES = (
    "satellites_tracked",
    "time_to_first_fix_s",
    "position_error_m",
    "slips",
    "events",
    "pga_mps2",
    "pgd_m",
    "displacement_error_horizontal_m.fused_real_time",
    "displacement_error_up_m.fused_real_time",
    "real_time_factor",
    "lost_samples",
)


def add_command(app: typer.Typer, command: Callable[..., None]) -> None:
    r"""Add a command; a paragraph of its docstring that begins with ``\b`` keeps its lines."""
    app.command(help=inspect.cleandoc(command.__doc__ or "").replace(r"\b", "\b"))(command)


@contextmanager
def one_line_errors() -> Iterator[None]:
    """Say in one line on stderr what is wrong: exit status 2 for bad input, 1 for the system."""
    from deepseis_core.errors import InputError

    try:
        yield
    except InputError as error:
        typer.echo(f"deepseis: {error}", err=True)
        raise typer.Exit(2) from None
    except BrokenPipeError:  # nobody reads on; click ends quietly
        raise
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        typer.echo(f"deepseis: {where}{error.strerror or error}", err=True)
        raise typer.Exit(1) from None
    except KeyboardInterrupt:
        typer.echo("deepseis: interrupted", err=True)
        raise typer.Exit(130) from None


def into_run_folder(output: Path | None, work: Callable[[Path], Any]) -> None:
    """Do ``work`` into a new run folder; its path is the last line printed."""
    with one_line_errors():
        from deepseis_bringup import run_folder

        folder = run_folder.new_run_folder(output)
        with run_folder.half_written_is_removed(folder):
            work(folder)
        typer.echo(str(folder))


def say(text: str) -> None:
    """Tell on stderr what happens, past a status line if there is one."""
    from deepseis_bringup.runs import console

    console.print(text, markup=False, highlight=False, soft_wrap=True)


def say_figures(summary: dict[str, Any]) -> None:
    """Print the figures a person looks for first."""
    for key in FIGURES:
        if key in summary:
            typer.echo(f"{key} = {summary[key]}")
