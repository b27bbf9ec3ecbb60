"""The deepseis command: declares what can be run; each command imports what it needs."""

import signal
import sys
from pathlib import Path
from typing import Annotated

import typer

from deepseis_bringup.commands import accept as cli_accept
from deepseis_bringup.commands import align as cli_align
from deepseis_bringup.commands import bags as cli_bags
from deepseis_bringup.commands import commission as cli_commission
from deepseis_bringup.commands import convert as cli_convert
from deepseis_bringup.commands import gravimetry as cli_gravimetry
from deepseis_bringup.commands import hypocentre as cli_hypocentre
from deepseis_bringup.commands import rtk as cli_rtk
from deepseis_bringup.commands import runs as cli_runs
from deepseis_bringup.commands import sim as cli_sim
from deepseis_bringup.commands import soak as cli_soak
from deepseis_bringup.commands import station as cli_station
from deepseis_bringup.commands import theory as cli_theory
from deepseis_bringup.commands.web import with_default_port

app = typer.Typer(
    help="A GNSS/INS seismograph station: ground motion through strong earthquakes.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
    rich_markup_mode=None,
    epilog="Exit status: 0 done, 1 failed, 2 bad input (one line says why), 130 interrupted.",
    context_settings={"max_content_width": 100},
)

PASS_ON = {"ignore_unknown_options": True, "allow_extra_args": True}
NODE_ARGUMENTS = {"ignore_unknown_options": True, "allow_interspersed_args": False}


@app.command()
def check() -> None:
    """Check style, types and the direction of imports."""
    from deepseis_bringup import checks

    raise typer.Exit(0 if checks.check() else 1)


@app.command()
def docs(
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder of the site.")],
) -> None:
    """Build the site of docs/: guide, algorithms, all commands and messages."""
    from deepseis_bringup import checks

    built = checks.build_site(output.resolve())
    if built:
        typer.echo(output / "index.html")
    raise typer.Exit(0 if built else 1)


@app.command("test", context_settings=PASS_ON)
def run_tests(
    context: typer.Context,
    full: Annotated[bool, typer.Option("--full", help="Run the slow tests too.")] = False,
    skip_check: Annotated[bool, typer.Option("--no-check", help="Run the tests alone.")] = False,
) -> None:
    """Run the checks, then all tests; further arguments go to pytest."""
    from deepseis_bringup import checks

    raise typer.Exit(checks.test(context.args, full=full, skip_check=skip_check))


@app.command(context_settings=NODE_ARGUMENTS)
def run(
    package: Annotated[
        str, typer.Argument(help="Package of the node, such as deepseis_tracking.")
    ],
    node: Annotated[str, typer.Argument(help="Name of the node, such as tracker.")],
    arguments: Annotated[
        list[str] | None, typer.Argument(help="Its arguments, such as --ros-args -p name:=1.")
    ] = None,
) -> None:
    """Run one node, as `ros2 run` does."""
    from deepseis_bringup import executables

    try:
        executables.become(package, node, arguments or [])
    except executables.UnknownExecutableError as error:
        typer.echo(f"deepseis: {error}", err=True)
        raise typer.Exit(2) from None


for commands in (
    cli_runs,
    cli_station,
    cli_bags,
    cli_hypocentre,
    cli_convert,
    cli_sim,
    cli_theory,
    cli_gravimetry,
    cli_align,
    cli_commission,
    cli_rtk,
    cli_accept,
    cli_soak,
):
    commands.register(app)


def main() -> None:
    """Run the command; SIGINT ends it also where a shell's background job would ignore it."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    app(with_default_port(sys.argv[1:]), prog_name="deepseis")


if __name__ == "__main__":
    main()
