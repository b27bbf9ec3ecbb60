"""The filter behind the present with ranges of single satellites in the place of PVT.

At rest slow errors of the satellites are learnt and the receiver's clock is kept; in motion the
ranges without these errors move the filter, as many as there are. Precise positions stay what they
are in the loose coupling: while there are any, ranges are not needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from deepseis_core.types import FloatArray, Pvt
from deepseis_ins.delayed_filter import DelayedFilter
from deepseis_ins.filter_steps import RANGES, GnssUpdate, antenna_ecef, change_after
from deepseis_ins.gnss_epochs import Epoch
from deepseis_ins.gnss_offset import inflation
from deepseis_ins.range_config import RangeConfig
from deepseis_ins.range_epochs import RangeEpoch
from deepseis_ins.satellite_errors import SatelliteErrors
from deepseis_ins.tight import RangeInnovations, Ranges, TightFilter


@dataclass(frozen=True)
class RangeUpdate(GnssUpdate):
    """What became of an epoch of ranges."""

    satellites: tuple[str, ...] = ()
    ranges: RangeInnovations | None = None


@dataclass(frozen=True)
class RangeErrors:
    """What is known of slow errors: of ranges [m] and of range rates [m/s]."""

    ranges: SatelliteErrors
    rates: SatelliteErrors

    @classmethod
    def at_start(cls, config: RangeConfig) -> RangeErrors:
        """Return what is known before anything has been measured."""
        c = config
        return cls(
            SatelliteErrors(
                c.range_offset_sd, c.range_growth, c.range_correlation_s, c.range_common_s
            ),
            SatelliteErrors(c.range_rate_offset_sd, c.range_rate_growth, 0.0, c.range_common_s),
        )


class TightDelayedFilter(DelayedFilter):
    """Works through steps, with epochs of ranges among them.

    Parameters
    ----------
    given
        As `DelayedFilter`'s; the filter is a `TightFilter`.
    ranges : RangeConfig
    """

    filter: TightFilter

    def __init__(self, *given: Any, ranges: RangeConfig) -> None:
        self.range_config = ranges
        self.errors = RangeErrors.at_start(ranges)
        self._ranges: list[RangeEpoch] = []
        self._range_counts = dict.fromkeys(("range_epochs", "ranges", "rejected_ranges"), 0)
        super().__init__(*given)

    @property
    def counts(self) -> dict[str, int]:
        """Counts since the start, for diagnostics."""
        return super().counts | self._range_counts

    def push(self, pvt: Pvt) -> None:
        """Leave a position of PVT aside: its ranges are used."""

    def push_ranges(self, epoch: RangeEpoch) -> None:
        """Take an epoch of ranges that counts from now on."""
        self._push(self._ranges, epoch, RANGES)

    def clock_at(self, sample_index: int) -> tuple[float, float, FloatArray]:
        """Return the receiver clock's bias [m] at a sample, its drift [m/s], and their sigmas."""
        late = (sample_index - self.history.sample_index(self.row)) / self.sample_rate_hz
        bias, drift = self.filter.clock_bias, self.filter.clock_drift
        sd = np.sqrt(np.diag(self.filter.tight_P)[-2:])
        return bias + late * drift, drift, sd

    def _waiting(self) -> Sequence[tuple[int, list[Any]]]:
        return (*super()._waiting(), (RANGES, self._ranges))

    def _kept(self) -> RangeErrors:
        return self.errors

    def _put_back(self, kept: Any) -> None:
        self.errors = kept

    def _measured(self, epoch: Epoch | RangeEpoch, *, still: bool) -> GnssUpdate | None:
        if not isinstance(epoch, RangeEpoch):
            return super()._measured(epoch, still=still)
        offsets = self.offsets
        if offsets.kind and epoch.sample_index - offsets.used_at <= self.gnss.hold:
            return None
        dt = self._interval_before(self._ranges, epoch)
        seconds = epoch.sample_index / self.sample_rate_hz
        ranges = self._at_the_row(epoch)
        if still:
            self._learn(seconds, epoch, ranges, dt)
        innovations = self.filter.update_ranges(self._without_errors(seconds, epoch, ranges, dt))
        counts = self._range_counts
        counts["range_epochs"] += 1
        counts["ranges"] += int(innovations.accepted.sum())
        offered = np.isfinite(innovations.sd)
        counts["rejected_ranges"] += int((offered & ~innovations.accepted).sum())
        if still:
            return None
        return RangeUpdate(epoch.sample_index, (None, None), epoch.satellites, innovations)

    def _at_the_row(self, epoch: RangeEpoch) -> Ranges:
        """Bring an epoch to where the filter stands, less than an interval before it.

        The satellites are where they were when the signals left: only the antenna and the clock
        go on meanwhile.
        """
        filter, ranges = self.filter, epoch.ranges
        late = epoch.sample_index - self.history.sample_index(self.row)
        moved, gained = change_after(
            filter, self.history, self.row, epoch.sample_index, self.sample_rate_hz
        )
        receiver = antenna_ecef(filter.nav, self.lever_arm_b)
        unit = receiver - ranges.satellites[:, :3]
        unit /= np.linalg.norm(unit, axis=1)[:, None]
        ticked = np.nan_to_num(filter.clock_drift) * late / self.sample_rate_hz
        return replace(
            ranges,
            pseudorange=ranges.pseudorange - unit @ moved - ticked,
            range_rate=ranges.range_rate - unit @ gained,
        )

    def _learn(self, seconds: float, epoch: RangeEpoch, ranges: Ranges, dt: float) -> None:
        """Learn slow errors: the filter is where the station was surveyed to stand, at rest."""
        off, n = -self.filter.residuals(ranges), len(epoch.satellites)
        errors, names = self.errors, epoch.satellites
        self.errors = RangeErrors(
            errors.ranges.learn(seconds, names, off[:n], ranges.pseudorange_sd**2, dt),
            errors.rates.learn(seconds, names, off[n:], ranges.range_rate_sd**2, dt),
        )

    def _without_errors(
        self, seconds: float, epoch: RangeEpoch, ranges: Ranges, dt: float
    ) -> Ranges:
        """Take slow errors off; what is unknown of them adds to the noise."""
        names, errors = epoch.satellites, self.errors
        range_off, range_unknown = errors.ranges.of(seconds, names, dt)
        rate_off, rate_unknown = errors.rates.of(seconds, names, dt)
        return replace(
            ranges,
            pseudorange=ranges.pseudorange - range_off,
            range_rate=ranges.range_rate - rate_off,
            pseudorange_sd=np.sqrt(
                inflation(self.range_config.range_correlation_s, dt) * ranges.pseudorange_sd**2
                + range_unknown
            ),
            range_rate_sd=np.sqrt(ranges.range_rate_sd**2 + rate_unknown),
        )
