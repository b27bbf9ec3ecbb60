"""Commands that run the graph on a recording: demo, replay, process."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import typer

from deepseis_bringup.bags.bag_place import bag_of
from deepseis_bringup.commands.common import (
    Bag,
    Out,
    add_command,
    into_run_folder,
    say,
    say_figures,
)
from deepseis_bringup.commands.web import WebAddress, WebNames, WebPort, WebToken, web_options

Coupling = Annotated[
    str,
    typer.Option(
        help="What moves the fusion's filter: loose (positions), tight (ranges of single"
        " satellites), ldv (a velocimeter)."
    ),
]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", help="Parameter of a node: tracker.pll_bandwidth_hz=20; repeatable."),
]

NOTHING_FOUND = (
    "deepseis: no satellite was found: look at packing (qi for iq), rate and the sign of the"
    " intermediate frequency (docs/formats.md), then at the antenna"
)


def demo(
    output: Out = None,
    duration: Annotated[float, typer.Option(help="Length of the signal [s].", min=5.0)] = 40.0,
    if_format: Annotated[str, typer.Option(help="Packing of the samples.")] = "iq2",
    seed: Annotated[int, typer.Option(help="Seed of noise and phases.")] = 1,
) -> None:
    r"""Simulate GPS, run the whole station on it, report with pictures.

    Makes 40 s of signal at 4 MHz for a still antenna, then plays it through one process for each
    part of the graph over DDS (lockstep: as fast as the slowest). Takes about half a minute.
    The run folder gets bag/ (MCAP with everything, the samples too), input/ (truth, navigation
    data), RINEX files, report.html and summary.json; its path is the last line printed.

    \b
    Example:
      ./deepseis demo -o runs/first
    """

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
    without_misses: Annotated[
        bool,
        typer.Option(
            "--without-misses", help="Wait also for what the recorded realtime run did not."
        ),
    ] = False,
    without_imu: Annotated[
        bool, typer.Option("--without-imu", help="Leave the IMU aside: loops without aiding.")
    ] = False,
    coupling: Coupling = "",
    base: Annotated[
        str,
        typer.Option(
            help="Base station for RTK: RINEX, RTCM 3 or a bag; ntrip://user@host:port/MOUNT,"
            " ntrips://..., tcp://host:port, station://NAME."
        ),
    ] = "",
    settings: Settings = None,
    web: WebPort = None,
    web_address: WebAddress = None,
    web_token_file: WebToken = None,
    web_name: WebNames = None,
) -> None:
    r"""Run a recorded run's samples through the graph again.

    In lockstep (default) the same bag gives the same bytes on every topic and in the RINEX
    files, with one process or many, on a loaded machine or an idle one; a realtime run's bytes
    come again with its misses. --realtime keeps the pace of the clock; what misses a deadline is
    flagged in the data and counted.

    \b
    Example:
      ./deepseis replay runs/first -o runs/again
    """

    def work(folder: Path) -> None:
        from deepseis_bringup import runs

        options = runs.RunOptions(
            mode="realtime" if realtime else "lockstep",
            one_process=not separate,
            record_if=not without_if,
            aiding="" if without_imu else "auto",
            base_from=base,
            repeat_misses=not without_misses,
            parameters=coupled(parameters_of(settings or ()), coupling),
            web=web_options(web, web_address, web_token_file, web_name),
        )
        say_figures(runs.replay(bag_of(bag), folder, options))

    into_run_folder(output, work)


def process(
    if_file: Annotated[Path, typer.Argument(help="IF recording.")],
    format: Annotated[
        str, typer.Option(help="Packing: preset or text; see docs/formats.md.")
    ] = "",
    rate: Annotated[float, typer.Option(help="Sampling rate [Hz].")] = 0.0,
    intermediate_frequency: Annotated[
        float, typer.Option("--if-hz", help="Nominal intermediate frequency [Hz].")
    ] = 0.0,
    start_utc: Annotated[
        str, typer.Option(help="UTC of the first sample to some seconds, ISO 8601.")
    ] = "",
    length: Annotated[float, typer.Option(help="Use so much [s]; 0: all.")] = 0.0,
    nav: Annotated[
        Path | None, typer.Option(help="RINEX navigation file for an assisted start.")
    ] = None,
    position: Annotated[
        str,
        typer.Option(
            help="Surveyed antenna, 'latitude longitude height' [deg deg m]: with --nav and"
            " --start-utc a fix needs no subframe."
        ),
    ] = "",
    imu: Annotated[
        Path | None,
        typer.Option(
            help="IMU beside the recording: a bag, or text of columns that <file>.yaml describes;"
            " aids the loops."
        ),
    ] = None,
    coupling: Coupling = "",
    base: Annotated[
        str,
        typer.Option(
            help="Base station for RTK: RINEX, RTCM 3 or a bag; ntrip://user@host:port/MOUNT,"
            " ntrips://..., tcp://host:port, station://NAME."
        ),
    ] = "",
    for_align: Annotated[
        bool,
        typer.Option(
            "--for-align", help="Positions without the loops' lag, for `align`; needs --position."
        ),
    ] = False,
    settings: Settings = None,
    output: Out = None,
    web: WebPort = None,
    web_address: WebAddress = None,
    web_token_file: WebToken = None,
    web_name: WebNames = None,
) -> None:
    r"""Run an IF recording of your own through the graph.

    Packing and rate come from a descriptor beside the file, <file>.yaml, or from the options
    (docs/formats.md lists presets and texts, and tells how an IMU's columns are described).
    With --base and --position the antenna's displacement is solved by RTK too (gnss/rtk); the
    password of an NTRIP caster is taken from DEEPSEIS_NTRIP_PASSWORD or ~/.netrc.
    Leaves a run folder as the demo does, without the samples in the bag.

    \b
    Examples:
      ./deepseis process capture.bin --format pocketsdr_iq8 --rate 4e6 --start-utc 2022-01-01T02:00
      ./deepseis process capture.bin --imu imu.csv --position '35.68 139.77 10' --nav brdc.rnx
    """

    def work(folder: Path) -> None:
        from deepseis_bringup import runs
        from deepseis_bringup.report.run_report import write_report
        from deepseis_core.geodesy import ecef_from_text
        from deepseis_core.rinex_nav import read_rinex_nav

        known: dict[str, Any] = {}
        if nav is not None:
            read_rinex_nav(nav)
            known["nav_file"] = str(nav.resolve())
        if position:
            known["position_ecef"] = ecef_from_text(position)
        selection = runs.Selection(
            str(if_file), format, rate, intermediate_frequency, start_utc, length_s=length
        )
        given: dict[str, dict[str, Any]] = {"pvt": dict(known), "acquisition": dict(known)}
        if imu and nav:
            given["fusion"] = {"nav_file": known["nav_file"]}
        if for_align:
            given["pvt"] |= {"add_discriminator": True, "loop_bandwidth_hz": 25.0}
        for kind, values in parameters_of(settings or ()).items():
            given[kind] = {**given.get(kind, {}), **values}
        options = runs.RunOptions(
            record_if=False,
            imu_file=str(imu) if imu else "",
            base_from=base,
            parameters=coupled(given, coupling),
            web=web_options(web, web_address, web_token_file, web_name),
        )
        figures = runs.run_recording(selection, folder, options)
        title = f"Recording {if_file.name}"
        summary = write_report(folder, truth=None, title=title, extra=figures)
        if not summary["satellites_tracked"]:
            say(NOTHING_FOUND)
        say_figures(summary)

    into_run_folder(output, work)


def coupled(parameters: dict[str, dict[str, Any]], coupling: str) -> dict[str, dict[str, Any]]:
    """Return parameters with a coupling of the fusion; as they are if it is empty.

    Raises
    ------
    InputError
        There is no such coupling.
    """
    from deepseis_core.errors import InputError
    from deepseis_ins.fusion_config import COUPLINGS

    if not coupling:
        return parameters
    if coupling not in COUPLINGS:
        raise InputError(f"--coupling {coupling}", "is none", "one of " + ", ".join(COUPLINGS))
    return {**parameters, "fusion": {**parameters.get("fusion", {}), "coupling": coupling}}


def parameters_of(settings: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Return the parameters of nodes, by kind, that ``kind.name=value`` texts set.

    Raises
    ------
    InputError
        A text is none, or names no kind of node.
    """
    import yaml

    from deepseis_bringup.graph import KINDS
    from deepseis_core.errors import InputError

    found: dict[str, dict[str, Any]] = {}
    for text in settings:
        name, equals, value = text.partition("=")
        kind, dot, parameter = name.partition(".")
        if not (equals and dot and parameter) or kind not in KINDS:
            hint = "such as tracker.aided_bandwidth_hz=5.0; kinds: " + ", ".join(KINDS)
            raise InputError(f"--set {text}", "is not KIND.NAME=VALUE", hint)
        found.setdefault(kind, {})[parameter] = yaml.safe_load(value)
    return found


def register(app: typer.Typer) -> None:
    """Add the commands to the application."""
    for command in (demo, replay, process):
        add_command(app, command)
