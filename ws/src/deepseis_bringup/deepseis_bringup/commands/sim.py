"""Commands of the test bench: sim, fault."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from deepseis_bringup.bags.bag_place import bag_of
from deepseis_bringup.commands.common import (
    Bag,
    add_command,
    into_run_folder,
    one_line_errors,
    say,
)


def sim(
    scenario: Annotated[
        str, typer.Argument(help="Name of a scenario, or a YAML file; none: list them.")
    ] = "",
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Folder, new or empty; default runs/<UTC>."),
    ] = None,
    short: Annotated[bool, typer.Option("--short", help="The scenario's short form.")] = False,
    seed: Annotated[
        int | None, typer.Option(help="Of all that is drawn by chance: same seed, same bytes.")
    ] = None,
    signal: Annotated[
        bool | None,
        typer.Option("--if/--no-if", help="Make IF samples, or observations in their place."),
    ] = None,
    if_format: Annotated[
        str, typer.Option(help="Packing of the samples: preset or text, see docs/formats.md.")
    ] = "",
    rate: Annotated[float | None, typer.Option(help="Sampling rate [Hz].")] = None,
    if_hz: Annotated[
        float | None, typer.Option("--if-hz", help="Intermediate frequency [Hz].")
    ] = None,
    raw: Annotated[
        bool, typer.Option("--raw", help="Leave the raw IF file if.bin and its descriptor too.")
    ] = False,
    changes: Annotated[
        list[str] | None,
        typer.Option("--set", help="Change a setting, such as imu.grade=mti-g; may be repeated."),
    ] = None,
) -> None:
    r"""Simulate a scenario of the test bench: an input bag, with the truth beside it.

    Leaves bag/ (`./deepseis replay DIR` runs the graph on it), truth.npz, nav.rnx, RINEX of the
    base, summary.json and report.html. Scenarios are described in docs/scenarios.md.

    \b
    Examples:
      ./deepseis sim sine-2hz --short -o runs/input
      ./deepseis sim quake --set imu.grade=mti-g --seed 7
    """
    with one_line_errors():
        from deepseis_core.errors import InputError
        from deepseis_sim.scenario import load_scenario, scenario_names

        if not scenario:
            for name in scenario_names():
                typer.echo(f"{name:14} {load_scenario(name).title}")
            return
        settings = list(changes or [])
        given = {
            "seed": seed,
            "signal": signal,
            "receiver.if_format": if_format or None,
            "receiver.sample_rate_hz": rate,
            "receiver.intermediate_frequency_hz": if_hz,
        }
        settings += [f"{key}={_yaml(value)}" for key, value in given.items() if value is not None]
        loaded = load_scenario(scenario, short=short, settings=settings)
        if raw and not loaded.signal:
            raise InputError("--raw", f"{loaded.name} makes no samples", "add --if")

    def work(folder: Path) -> None:
        from deepseis_bringup.simulation.simulate import simulate
        from deepseis_bringup.station import terminate_is_interrupt

        with terminate_is_interrupt():
            summary = simulate(loaded, folder, keep_raw=raw)
        if summary["motion_stands_in"]:
            say(f"{loaded.name}: its record is not at hand, an artificial motion stands in")
        typer.echo(f"satellites = {' '.join(summary['satellites'])}")

    into_run_folder(output, work)


def fault(
    bag: Bag,
    faults: Annotated[
        list[str],
        typer.Option(
            "--fault",
            help="kind:start:duration[:amount] [s]; may be repeated. Kinds: imu-gap, imu-clip "
            "(amount: m/s^2), imu-sparse (share), no-signal, if-gap, base-gap.",
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Folder, new or empty; default runs/<UTC>."),
    ] = None,
    seed: Annotated[int, typer.Option(help="Of what is drawn by chance.")] = 1,
) -> None:
    r"""Copy a recording with faults put in, to see what the station makes of them.

    Leaves bag/ and, of a simulated recording, truth, orbits and base beside it, so that
    `./deepseis replay DIR` compares with the truth.

    \b
    Examples:
      ./deepseis fault runs/quake -o runs/gap --fault imu-gap:34.5:1
      ./deepseis fault runs/quake -o runs/bad --fault imu-clip:20:22:14.7 --fault no-signal:30:3
    """

    def work(folder: Path) -> None:
        from deepseis_bringup.faults.faulty_bag import faulty_bag
        from deepseis_sim.faults import Fault

        found = faulty_bag(bag_of(bag), folder, [Fault.parse(text) for text in faults], seed=seed)
        for name, count in found.items():
            typer.echo(f"{name} = {count} messages")

    into_run_folder(output, work)


def _yaml(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if isinstance(value, str) else str(value)


def register(app: typer.Typer) -> None:
    """Add the commands to the application."""
    add_command(app, sim)
    add_command(app, fault)
