"""Commands: convert, export."""

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

Folder = Annotated[
    Path | None, typer.Option("-o", "--output", help="Folder, made new; default runs/<UTC>.")
]
RtcmRate = Annotated[float, typer.Option(help="Epochs of RTCM a second.", min=0.01, max=100.0)]


def convert(
    bag: Bag,
    to: Annotated[str, typer.Option("--to", help="miniseed, rinex, csv, rtcm or nmea.")],
    output: Folder = None,
    network: Annotated[
        str, typer.Option(help="FDSN network code; default: the bag's, or XX.")
    ] = "",
    station: Annotated[str, typer.Option(help="Station code; default: the bag's, or DSEI.")] = "",
    rinex_version: Annotated[str, typer.Option(help="3.05 or 4.02.")] = "3.05",
    rinex_name: Annotated[
        str, typer.Option(help="Nine characters that RINEX names begin with, as DSEI00JPN.")
    ] = "",
    alias: Annotated[
        bool, typer.Option("--alias", help="Derived channels under source Y too (LY? for LX?).")
    ] = False,
    rtcm_rate: RtcmRate = 1.0,
) -> None:
    r"""Write a recorded bag in other formats: miniSEED, RINEX, CSV, RTCM 3, NMEA.

    miniseed: an SDS archive of ground motion, IMU and rotation rate, its StationXML, and QuakeML
    of the events. rinex: hourly files of observations and navigation data. csv: a table for each
    kind of value. rtcm: a base's stream (MSM7, antenna, ephemerides). nmea: GGA of every position.
    docs/formats-out.md tells channels, units and times.

    \b
    Example:
      ./deepseis convert runs/20260101T000000Z --to miniseed -o archive
    """

    def work(folder: Path) -> None:
        from deepseis_bringup.export import convert as conversion
        from deepseis_bringup.export.convert_survey import ConvertOptions

        options = ConvertOptions(network, station, rinex_version, rinex_name, alias, rtcm_rate)
        written = conversion.convert(bag_of(bag), to, folder, options, say)
        typer.echo(f"files = {len(written)}")

    into_run_folder(output, work)


def export(
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Root of the archive, made if need be.")
    ],
    station: Annotated[
        str, typer.Option(help="The running station's namespace; default: none.")
    ] = "",
    datalink: Annotated[
        str, typer.Option(help="Send the records to a ringserver too: host:port.")
    ] = "",
    gdrt: Annotated[
        str, typer.Option(help="Send positions to SeisComP's gdrt_plugin by UDP: host:port.")
    ] = "",
    rtcm: Annotated[
        str,
        typer.Option(help="Be a base: RTCM 3 for whoever connects to host:port, 0.0.0.0:2101."),
    ] = "",
    rtcm_rate: RtcmRate = 1.0,
    nmea: Annotated[str, typer.Option(help="NMEA GGA for whoever connects to host:port.")] = "",
) -> None:
    r"""Write a running station's ground motion and IMU as miniSEED, until Ctrl-C.

    Records of half a second go into an SDS archive as they fill; kill -9 costs less than a
    second. Takes no part in the graph's flow control: it may come and go. With --rtcm it is a
    base for other receivers: observations (MSM7), antenna and ephemerides. More settings:
    ./deepseis run deepseis_bringup exporter --ros-args -p ...

    \b
    Example:
      ./deepseis export --station DSEI -o archive --datalink localhost:16000
      ./deepseis export -o archive --rtcm 127.0.0.1:2101
    """
    with one_line_errors():
        from deepseis_bringup import executables

        space = ["-r", f"__ns:=/{station}"] if station else []
        given = {"directory": str(output.resolve()), "datalink": datalink, "gdrt": gdrt}
        given |= {"rtcm": rtcm, "nmea": nmea, "rtcm_rate_hz": str(rtcm_rate)}
        words = [w for k, v in given.items() if v for w in ("-p", f"{k}:={v}")]
        executables.become("deepseis_bringup", "exporter", ["--ros-args", *space, *words])


def register(app: typer.Typer) -> None:
    """Add the commands to the application."""
    for command in (convert, export):
        add_command(app, command)
