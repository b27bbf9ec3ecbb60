"""StationXML of exported channels: place, axes, counts per unit, filters of lower rates."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from deepseis_bringup.export.decimation import Stage
from deepseis_bringup.export.fdsn_channels import ChannelCode, Place
from deepseis_bringup.export.quiet_obspy import obspy_modules
from deepseis_bringup.export.utc_pieces import UtcMoment
from deepseis_core.errors import InputError
from deepseis_core.types import Station

UNITS: Final[Mapping[str, tuple[str, str]]] = {
    "M": ("m", "displacement in metres"),
    "M/S": ("m/s", "velocity in metres per second"),
    "M/S**2": ("m/s**2", "acceleration in metres per second squared"),
    "RAD/S": ("rad/s", "angular rate in radians per second"),
}
FREQUENCY_HZ: Final = 0.1
"""Where the sensitivity holds; it holds from zero on."""


@dataclass(frozen=True)
class ChannelEpoch:
    """A channel with the time of its first and last sample [ns since the GPS epoch].

    The last is None where the channel goes on. ``stages`` are the filters that made it from a
    higher rate.
    """

    channel: ChannelCode
    first_gps_ns: int
    last_gps_ns: int | None
    stages: tuple[Stage, ...] = ()


def write_stationxml(
    path: Path,
    place: Place,
    epochs: Iterable[ChannelEpoch],
    station: Station | None = None,
    *,
    validate: bool = True,
) -> None:
    """Write the inventory, whole or not at all.

    ``validate``: against the schema of FDSN StationXML 1.2, which takes a second or two.

    Raises
    ------
    InputError
        It cannot be written.
    """
    inventory = build_inventory(place, list(epochs), station)
    part = path.with_name(path.name + ".part")
    try:
        inventory.write(str(part), format="STATIONXML", validate=validate)
        part.replace(path)
    except OSError as error:
        raise InputError(path, f"cannot be written: {error.strerror}") from None


def build_inventory(
    place: Place, epochs: list[ChannelEpoch], station: Station | None = None
) -> Any:
    """Return the station's channels as an ObsPy ``Inventory``."""
    obspy = obspy_modules()
    inv = obspy.core.inventory
    channels = [_channel(epoch, place, station) for epoch in sorted(epochs, key=_order)]
    start = min((c.start_date for c in channels), default=None)
    where = {
        "latitude": place.latitude_deg,
        "longitude": place.longitude_deg,
        "elevation": place.height,
    }
    site = inv.Site(name=station.name if station and station.name else place.station)
    stand = inv.Station(
        code=place.station,
        **where,
        channels=channels,
        site=site,
        start_date=start,
        creation_date=start,
        description="Elevation is the height above the WGS-84 ellipsoid",
    )
    network = inv.Network(code=place.network, stations=[stand], start_date=start)
    return inv.Inventory(
        networks=[network], source="DeepSeis", sender=place.network, module="DeepSeis"
    )


def _order(epoch: ChannelEpoch) -> tuple[str, str]:
    return epoch.channel.location, epoch.channel.code


def _channel(epoch: ChannelEpoch, place: Place, station: Station | None) -> Any:
    obspy = obspy_modules()
    inv, channel = obspy.core.inventory, epoch.channel
    start, end = (
        None if ns is None else obspy.UTCDateTime(ns=UtcMoment.of_gps_ns(ns).unix_ns)
        for ns in (epoch.first_gps_ns, epoch.last_gps_ns)
    )
    return inv.Channel(
        code=channel.code,
        location_code=channel.location,
        latitude=place.latitude_deg,
        longitude=place.longitude_deg,
        elevation=place.height,
        depth=0.0,
        azimuth=channel.azimuth_deg,
        dip=channel.dip_deg,
        sample_rate=channel.rate_hz,
        types=["CONTINUOUS", "GEOPHYSICAL"],
        description=channel.description,
        sensor=_sensor(channel, station),
        response=_response(epoch),
        start_date=start,
        end_date=end,
    )


def _sensor(channel: ChannelCode, station: Station | None) -> Any:
    inv = obspy_modules().core.inventory
    if station is None:
        return inv.Equipment(description=channel.description)
    if channel.source == "X":
        kind, serial = f"{station.receiver}, antenna {station.antenna}", station.receiver_serial
    else:
        kind, serial = station.imu, station.imu_serial
    return inv.Equipment(
        type=kind or None, serial_number=serial or None, description=channel.description
    )


def _response(epoch: ChannelEpoch) -> Any:
    """Return counts per unit as stage 1, then each FIR filter with its delay made good."""
    inv, channel = obspy_modules().core.inventory, epoch.channel
    unit, words = UNITS[channel.unit]
    sensitivity = inv.InstrumentSensitivity(
        value=channel.counts,
        frequency=FREQUENCY_HZ,
        input_units=unit,
        output_units="count",
        input_units_description=words,
        output_units_description="digital counts",
    )
    rate = epoch.stages[0].rate_hz if epoch.stages else channel.rate_hz
    first = inv.CoefficientsTypeResponseStage(
        stage_sequence_number=1,
        stage_gain=channel.counts,
        stage_gain_frequency=FREQUENCY_HZ,
        input_units=unit,
        output_units="count",
        cf_transfer_function_type="DIGITAL",
        numerator=[1.0],
        denominator=[],
        **_decimation(rate, 1, 0.0),
    )
    stages = [first, *(_fir(stage, number) for number, stage in enumerate(epoch.stages, 2))]
    return inv.Response(instrument_sensitivity=sensitivity, response_stages=stages)


def _fir(stage: Stage, number: int) -> Any:
    inv = obspy_modules().core.inventory
    return inv.FIRResponseStage(
        stage_sequence_number=number,
        stage_gain=1.0,
        stage_gain_frequency=FREQUENCY_HZ,
        input_units="count",
        output_units="count",
        symmetry="ODD",
        coefficients=stage.taps[: stage.half + 1].tolist(),
        **_decimation(stage.rate_hz, stage.factor, stage.half / stage.rate_hz),
    )


def _decimation(rate_hz: float, factor: int, delay_s: float) -> dict[str, float]:
    return {
        "decimation_input_sample_rate": rate_hz,
        "decimation_factor": factor,
        "decimation_offset": 0,
        "decimation_delay": delay_s,
        "decimation_correction": delay_s,
    }
