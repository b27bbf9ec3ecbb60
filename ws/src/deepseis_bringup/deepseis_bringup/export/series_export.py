"""Ground motion and IMU of a station into an archive: native rate and the lower ones.

Batches are gathered and written a minute or so at a time, so memory does not grow with the bag.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from deepseis_bringup.export.decimation import Decimator
from deepseis_bringup.export.fdsn_channels import ChannelCode
from deepseis_bringup.export.sample_runs import GapCount, Run, RunCutter
from deepseis_bringup.export.stationxml import ChannelEpoch
from deepseis_core.types import Displacement, FloatArray, IntArray

LOWER: Final[Mapping[float, float]] = {50.0: 0.8, 1.0: 0.6}
"""Rates made from higher ones [Hz]: flat up to this fraction of their Nyquist frequency."""

BATCH = 16_384  # samples gathered before they are written

Write = Callable[[Run, tuple[ChannelCode, ...]], None]


@dataclass
class _Lower:
    """A lower rate of a series."""

    decimator: Decimator
    channels: tuple[ChannelCode, ...]


class SeriesExport:
    """One group of channels that share their samples' times.

    Parameters
    ----------
    channels : tuple of ChannelCode
        One for each column.
    write : callable
        Takes a run and its channels.
    lower : mapping, optional
        Rates to make besides, each with its flat fraction; those at or above the native rate, or
        that do not divide it, are left out.
    batch : int, optional
        Samples that are gathered before they are written.
    """

    def __init__(
        self,
        channels: tuple[ChannelCode, ...],
        write: Write,
        lower: Mapping[float, float],
        batch: int = BATCH,
    ) -> None:
        self.channels, self.write, self.batch = channels, write, batch
        self.rate_hz = channels[0].rate_hz
        self.cutter = RunCutter(self.rate_hz)
        self.epochs: dict[tuple[str, str], ChannelEpoch] = {}
        self._times: list[IntArray] = []
        self._values: list[FloatArray] = []
        self._gathered = 0
        self._lower = [
            _Lower(
                Decimator(self.rate_hz, rate, fraction),
                tuple(channel.at_rate(rate) for channel in channels),
            )
            for rate, fraction in lower.items()
            if self.rate_hz > rate and self.rate_hz % rate == 0
        ]

    @property
    def count(self) -> GapCount:
        """What was missing."""
        return self.cutter.count

    def push(self, gps_ns: IntArray, values: FloatArray) -> None:
        """Take samples: times since the GPS epoch (n,) [ns], values (n, number of channels)."""
        self._times.append(gps_ns)
        self._values.append(values)
        self._gathered += len(gps_ns)
        if self._gathered >= self.batch:
            self.flush()

    def flush(self) -> None:
        """Write what has been gathered."""
        if not self._times:
            return
        times, values = np.concatenate(self._times), np.concatenate(self._values)
        self._times, self._values, self._gathered = [], [], 0
        for run in self.cutter.push(times, values):
            self._give(run, self.channels, None)
            for lower in self._lower:
                kept = lower.decimator.push(run)
                if kept is not None:
                    self._give(kept, lower.channels, lower.decimator)

    def _give(
        self, run: Run, channels: tuple[ChannelCode, ...], decimator: Decimator | None
    ) -> None:
        self.write(run, channels)
        first, last = int(run.gps_ns[0]), int(run.gps_ns[-1])
        stages = decimator.stages if decimator else ()
        for channel in channels:
            known = self.epochs.get((channel.location, channel.code))
            begin = known.first_gps_ns if known else first
            self.epochs[channel.location, channel.code] = ChannelEpoch(
                channel, begin, last, stages
            )


@dataclass
class SeriesSet:
    """The series of a station, made as they appear.

    ``alias`` also writes derived channels under source Y, which some networks use for GNSS.
    ``lower`` are the rates made besides. ``batch_s`` is the length of data that is gathered [s];
    None: a good number of samples.
    """

    write: Write
    alias: bool = False
    lower: Mapping[float, float] = field(default_factory=lambda: LOWER)
    batch_s: float | None = None
    series: dict[object, SeriesExport] = field(default_factory=dict)

    def displacement(
        self,
        value: Displacement,
        gps_ns: IntArray,
        channels: Mapping[str, tuple[ChannelCode, ...]],
    ) -> None:
        """Take a batch of ground motion at true GPS times [ns]."""
        for quantity, codes in channels.items():
            values = np.asarray(getattr(value, quantity), np.float64).reshape(-1, 3)
            if len(values) == len(gps_ns):  # a source may leave a quantity empty
                self.push((codes[0].location, codes[0].code), codes, gps_ns, values, self.lower)

    def push(
        self,
        key: object,
        channels: tuple[ChannelCode, ...],
        gps_ns: IntArray,
        values: FloatArray,
        lower: Mapping[float, float],
    ) -> None:
        """Take samples of a series named by ``key``."""
        if key not in self.series:
            batch = BATCH
            if self.batch_s is not None:
                batch = max(1, round(self.batch_s * channels[0].rate_hz))
            self.series[key] = SeriesExport(channels, self._write, lower, batch)
        self.series[key].push(gps_ns, values)

    def _write(self, run: Run, channels: tuple[ChannelCode, ...]) -> None:
        self.write(run, channels)
        if self.alias and channels[0].source == "X":
            self.write(run, tuple(replace(channel, source="Y") for channel in channels))

    def finish(self) -> list[ChannelEpoch]:
        """Write the rest; returns every channel written with its span."""
        for series in self.series.values():
            series.flush()
        return self.epochs()

    def epochs(self) -> list[ChannelEpoch]:
        """Return every channel written so far with its span."""
        epochs = [epoch for series in self.series.values() for epoch in series.epochs.values()]
        if self.alias:
            epochs += [
                replace(epoch, channel=replace(epoch.channel, source="Y"))
                for epoch in epochs
                if epoch.channel.source == "X"
            ]
        return epochs

    def gaps(self) -> GapCount:
        """Return what was missing, all series together."""
        total = GapCount()
        for series in self.series.values():
            total.gaps += series.count.gaps
            total.missing += series.count.missing
            total.repeated += series.count.repeated
        return total
