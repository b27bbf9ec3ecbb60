"""Command: hypocentre."""

from __future__ import annotations

from typing import Annotated

import typer

from deepseis_bringup.commands.common import add_command, one_line_errors


def hypocentre(
    at: Annotated[
        str | None, typer.Option(help="'latitude longitude depth' [deg deg km].")
    ] = None,
    station: Annotated[
        str, typer.Option(help="The running station's namespace; default: none.")
    ] = "",
    withdraw: Annotated[
        bool, typer.Option("--withdraw", help="It was wrong: back to the station's settings.")
    ] = False,
) -> None:
    r"""Tell a running station where an earthquake was: magnitude from peak displacement.

    It counts for the event in progress, or the last one if that ended within 10 minutes, which
    is reported anew, and for those that begin within the next 10. For a recorded run: `replay
    RUN --set seismic_event.hypocentre=[38.297,142.373,29.0]`.

    \b
    Example:
      ./deepseis hypocentre --station DSEI --at '38.297 142.373 29'
    """
    with one_line_errors():
        from deepseis_bringup.hypocentre import hypocentre_of, tell
        from deepseis_core.errors import InputError

        if (at is None) != withdraw:
            raise InputError("hypocentre", "is missing or said twice", "--at or --withdraw")
        event = tell(hypocentre_of(at) if at else [], station)
        if event is None:
            typer.echo("event = none yet")
            return
        typer.echo(f"event = {event.event_id}{' (ended)' if event.ended else ''}")
        typer.echo(f"peak_displacement_m = {event.peak_displacement:.4f}")
        typer.echo(f"hypocentral_distance_km = {1e-3 * event.hypocentral_distance:.1f}")
        typer.echo(f"magnitude = {event.magnitude:.2f} +- {event.magnitude_sd:.2f}")


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    add_command(app, hypocentre)
