"""A live station's ground motion and IMU as miniSEED records, half a second at a time.

Records are whole when they are handed on, and short: a killed process loses what had not filled
a packet, and nothing that was written.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from deepseis_bringup.export.fdsn_channels import (
    ChannelCode,
    Place,
    displacement_channels,
    imu_channels,
    place_of_station,
)
from deepseis_bringup.export.imu_series import Batch, ImuGathering
from deepseis_bringup.export.miniseed import RECORD_BYTES, SEQUENCES, day_records
from deepseis_bringup.export.sample_runs import Run
from deepseis_bringup.export.sds import sds_path
from deepseis_bringup.export.series_export import SeriesSet
from deepseis_bringup.export.stationxml import write_stationxml
from deepseis_bringup.export.true_time import TimeFinder, TrueTime
from deepseis_core.config import setting
from deepseis_core.gps_time import GpsTime
from deepseis_core.types import Displacement, ImuSample, IntArray, Pvt, Station

RATE_STAMPS = 100
"""IMU samples whose stamps tell the rate."""
IMU_BATCH = 10
"""IMU samples worked through together: 50 ms of them at 200 Hz."""

PacketSink = Callable[[Path, bytes], None]
"""Takes a day file's name below the archive, and whole records."""

MotionSink = Callable[[Displacement, IntArray], None]
"""Takes a batch of ground motion and its true GPS times [ns]."""


@dataclass(frozen=True)
class LiveConfig:
    """What is exported, and under which codes."""

    network: str = setting("", "FDSN network code; empty: the station's, or XX [-]")
    station_code: str = setting("", "station code; empty: the station's [-]")
    packet_ms: float = setting(500.0, "data in a packet of records [ms]", low=20.0, high=1000.0)
    alias: bool = setting(False, "derived channels under source Y too [-]")


class LiveExport:
    """Turns values, as they come, into records.

    Nothing is given out before the station is known: its codes are in every record. IMU samples
    wait for the first position, which ties their clock to GPS time. What comes before is counted
    in ``held`` and not kept.

    Parameters
    ----------
    config : LiveConfig
    sample_rate_hz : float or None
        Of the IF samples; None: their stamps tell it.
    sink : callable
        Takes the records.

    Attributes
    ----------
    on_motion : callable or None
        Also takes every batch of ground motion that is exported.
    """

    def __init__(self, config: LiveConfig, sample_rate_hz: float | None, sink: PacketSink) -> None:
        self.config, self.sink = config, sink
        self.place: Place | None = None
        self.station: Station | None = None
        self.held = self.records = 0
        self.newest_utc_ns = 0
        self._finder = TimeFinder(sample_rate_hz, keep=2)
        self._time: TrueTime = self._finder.finish()
        seconds = config.packet_ms * 1e-3
        self._series = SeriesSet(self._write, config.alias, {}, seconds)
        self._imu = ImuGathering(batch=IMU_BATCH, looked_at=RATE_STAMPS)
        self._imu_codes: Mapping[str, tuple[ChannelCode, ...]] = {}
        self._described = 0
        self.on_motion: MotionSink | None = None

    @property
    def series(self) -> SeriesSet:
        """What has been exported, with its gaps."""
        return self._series

    @property
    def knows_coarse_clock(self) -> bool:
        """Whether stamps of samples can be tied to positions."""
        return self._finder.coarse is not None

    def take_station(self, station: Station) -> None:
        """Learn codes and places; the first word holds."""
        if self.place is None:
            self.place = place_of_station(station, self.config.network, self.config.station_code)
            self.station = station

    def take_pvt(self, pvt: Pvt) -> None:
        """Learn the clock's error."""
        self._finder.take_pvt(pvt)
        self._time = self._finder.finish()

    def take_stamp(self, sample_index: int, utc_ns: int) -> None:
        """Learn the coarse time of a sample."""
        self._finder.take_stamp(sample_index, utc_ns)

    def take_displacement(self, value: Displacement) -> None:
        """Take a batch of ground motion."""
        if self.place is None or value.interval <= 0 or not len(value.tow_ns):
            self.held += len(value.tow_ns)
            return
        rate_hz = round(1.0 / value.interval, 6)
        week_ns = GpsTime(value.week, 0).total_ns
        gps_ns = self._time.of_receiver(week_ns + np.asarray(value.tow_ns, np.int64))
        if self.on_motion is not None:
            self.on_motion(value, gps_ns)
        channels = displacement_channels(value.source, value.smoothed, rate_hz)
        self._series.displacement(value, gps_ns, channels)

    def take_imu(self, sample: ImuSample, utc_ns: int) -> None:
        """Take an IMU sample with its coarse stamp."""
        if self.place is None or not self._time.known or self._time.coarse is None:
            self.held += 1
            return
        for batch in self._imu.push(sample, utc_ns):
            self._push_imu(batch)

    def _push_imu(self, batch: Batch) -> None:
        rate_hz, utc_ns, values = batch
        gps_ns = self._time.of_stamps(utc_ns) - round(0.5e9 / rate_hz)
        parts = (slice(0, 3), slice(3, 6))
        self._imu_codes = self._imu_codes or imu_channels(self.station, rate_hz)
        for columns, (quantity, channels) in zip(parts, self._imu_codes.items(), strict=True):
            self._series.push(("imu", quantity), channels, gps_ns, values[:, columns], {})

    def _write(self, run: Run, channels: tuple[ChannelCode, ...]) -> None:
        assert self.place is not None
        newest = GpsTime(0, int(run.gps_ns[-1])).to_utc_ns()
        self.newest_utc_ns = max(self.newest_utc_ns, newest)
        for column, channel in enumerate(channels):
            sequence = self.records % SEQUENCES + 1
            for day_ns, data in day_records(run, column, channel, self.place, sequence):
                self.records += len(data) // RECORD_BYTES
                self.sink(sds_path(self.place, channel, day_ns), data)

    def describe(self, folder: Path) -> Path | None:
        """Write the StationXML anew if channels have come; returns its path if so.

        Not validated: messages would wait for it.
        """
        epochs = self._series.epochs()
        if len(epochs) <= self._described or self.place is None:
            return None
        self._described = len(epochs)
        path = folder / f"{self.place.network}.{self.place.station}.xml"
        going_on = [replace(epoch, last_gps_ns=None) for epoch in epochs]
        write_stationxml(path, self.place, going_on, self.station, validate=False)
        return path

    def close(self) -> None:
        """Give out what has not filled a packet."""
        for batch in self._imu.finish() if self.place is not None else ():
            self._push_imu(batch)
        self._series.finish()
