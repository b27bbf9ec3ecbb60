"""QuakeML of what the station saw of earthquakes: onset, peaks, a magnitude if there is one.

One station locates nothing, so an event has a pick and amplitudes and no origin.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from deepseis_bringup.export.fdsn_channels import Place
from deepseis_bringup.export.quiet_obspy import obspy_modules
from deepseis_core.errors import InputError


@dataclass(frozen=True)
class StationEvent:
    """A ``SeismicEvent`` message; times are UTC [ns since 1970]."""

    utc_ns: int
    event_id: str
    onset_utc_ns: int
    ended: bool
    onset_ratio: float
    peak_displacement: float
    peak_velocity: float
    peak_acceleration: float
    hypocentral_distance: float
    magnitude: float
    magnitude_sd: float


PEAKS: Final = (
    ("PGD", "peak_displacement", "m", "other"),
    ("PGV", "peak_velocity", "m/s", "other"),
    ("PGA", "peak_acceleration", "m/(s*s)", "other"),
)
"""Type, field, QuakeML's unit, its category (a maximum has no period)."""


def latest_reports(events: Iterable[StationEvent]) -> list[StationEvent]:
    """Return the last report of each event, in order of onset."""
    last: dict[str, StationEvent] = {}
    for event in events:
        known = last.get(event.event_id)
        if known is None or event.utc_ns >= known.utc_ns:
            last[event.event_id] = event
    return sorted(last.values(), key=lambda event: event.onset_utc_ns)


def write_quakeml(path: Path, place: Place, events: Iterable[StationEvent]) -> None:
    """Write the last report of each event; validated against the schema (QuakeML 1.2).

    Raises
    ------
    InputError
        It cannot be written.
    """
    ev = obspy_modules().core.event
    catalog = ev.Catalog(
        events=[_event(event, place) for event in latest_reports(events)],
        resource_id=_id(place, "catalog"),
    )
    try:
        catalog.write(str(path), format="QUAKEML", validate=True)
    except OSError as error:
        raise InputError(path, f"cannot be written: {error.strerror}") from None


def _id(place: Place, *parts: str) -> Any:
    text = "/".join((place.network, place.station, *parts))
    plain = "".join(c if c.isalnum() or c in "-._~/" else "_" for c in text)
    return obspy_modules().core.event.ResourceIdentifier(f"smi:local/deepseis/{plain}")


def _event(event: StationEvent, place: Place) -> Any:
    obspy = obspy_modules()
    ev = obspy.core.event
    stream = ev.WaveformStreamID(place.network, place.station, "30", "HXZ")
    mode, status = "automatic", "final" if event.ended else "preliminary"
    pick = ev.Pick(
        resource_id=_id(place, event.event_id, "pick"),
        time=obspy.UTCDateTime(ns=event.onset_utc_ns),
        waveform_id=stream,
        evaluation_mode=mode,
        comments=[ev.Comment(text=f"STA/LTA at onset {event.onset_ratio:.2f}")],
    )
    amplitudes = [
        ev.Amplitude(
            resource_id=_id(place, event.event_id, kind),
            generic_amplitude=getattr(event, name),
            type=kind,
            unit=unit,
            category=category,
            waveform_id=stream,
            pick_id=pick.resource_id,
            evaluation_mode=mode,
            comments=[ev.Comment(text="largest length of the east-north-up vector so far")],
        )
        for kind, name, unit, category in PEAKS
        if math.isfinite(getattr(event, name))
    ]
    magnitudes = []
    if math.isfinite(event.magnitude):
        sd = event.magnitude_sd if math.isfinite(event.magnitude_sd) else None
        magnitudes = [
            ev.Magnitude(
                resource_id=_id(place, event.event_id, "Mpgd"),
                mag=event.magnitude,
                mag_errors=ev.QuantityError(uncertainty=sd),
                magnitude_type="Mpgd",
                station_count=1,
                evaluation_mode=mode,
                evaluation_status=status,
                comments=[
                    ev.Comment(text=f"hypocentral distance {event.hypocentral_distance:.0f} m")
                ],
            )
        ]
    return ev.Event(
        resource_id=_id(place, event.event_id),
        picks=[pick],
        amplitudes=amplitudes,
        magnitudes=magnitudes,
        preferred_magnitude_id=magnitudes[0].resource_id if magnitudes else None,
        creation_info=ev.CreationInfo(
            author="DeepSeis", creation_time=obspy.UTCDateTime(ns=event.utc_ns)
        ),
    )
