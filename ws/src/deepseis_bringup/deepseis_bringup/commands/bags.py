"""Commands on bags: info, recover, record."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from deepseis_bringup.bags.bag_place import bag_of
from deepseis_bringup.commands.common import (
    Bag,
    Out,
    add_command,
    into_run_folder,
    one_line_errors,
    say,
)


def info(bag: Bag) -> None:
    r"""Tell what a bag holds: topics, rates, times, versions, gaps, damage.

    Reads the whole bag, also one that was cut short. Where the output is no terminal, the
    topics come as lines with tabs between the columns.

    \b
    Example:
      ./deepseis info runs/20260101T000000Z
    """
    with one_line_errors():
        from deepseis_bringup.bags import info as bag_info
        from deepseis_bringup.bags import text as bag_text

        bag_text.show_info(bag_info.bag_info(bag_of(bag)))


def recover(
    bag: Bag,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="New folder for the whole bag; BAG is only read."),
    ] = None,
    replace: Annotated[
        bool, typer.Option("--replace", help="Do not keep damaged files as NAME.mcap.damaged.")
    ] = False,
) -> None:
    r"""Make a bag whole again that was cut short or damaged, by kill -9 or a loss of power.

    Keeps every message that can be read, writes the index and metadata.yaml anew, and tells what
    was lost, topic by topic. A damaged file stays beside its successor; one that is whole is left
    as it is, one that is being recorded is refused. RINEX that was still growing in the run folder
    gets its name.

    \b
    Examples:
      ./deepseis recover runs/20260101T000000Z
      ./deepseis recover runs/20260101T000000Z -o /data/whole
    """
    with one_line_errors():
        from deepseis_bringup.bags import recovery
        from deepseis_bringup.bags import text as bag_text
        from deepseis_pvt.rinex_left import finish_left

        results = recovery.recover_bag(bag_of(bag), target=output, replace=replace)
        for line in bag_text.recovery_lines(results):
            typer.echo(line)
        if bag.is_dir() and output is None:
            for path in finish_left(bag):
                typer.echo(f"{path}: finished")


def record(
    output: Out = None,
    station: Annotated[
        str | None,
        typer.Option(help="Only this station's topics (its namespace); default: all."),
    ] = None,
    duration: Annotated[
        float, typer.Option(help="Record so long, then stop; 0: until Ctrl-C [s].", min=0.0)
    ] = 0.0,
) -> None:
    r"""Record all topics of a running station until Ctrl-C.

    Looks for DeepSeis topics in the present ROS_DOMAIN_ID (0 if unset); what appears after the
    start is not recorded. Takes no part in the graph's flow control: it may come and go. The
    run folder gets bag/ (MCAP and metadata.yaml), logs/ and parameters/.

    \b
    Example:
      ./deepseis record --station DSEI -o runs/aside
    """

    def work(folder: Path) -> None:
        from deepseis_bringup.bags import record as recording
        from deepseis_bringup.runs import console

        with console.status("looking for topics") as status:
            count = recording.record(
                folder, station=station, duration=duration, say=say, show=status.update
            )
        typer.echo(f"messages = {count}")

    into_run_folder(output, work)


def register(app: typer.Typer) -> None:
    """Add the commands to the application."""
    for command in (info, recover, record):
        add_command(app, command)
