"""Fusion with ranges of single satellites (coupling ``tight``), span by span.

As `fusion_engine`, with one input more: observations. PVT tells the time alone. Fewer than four
satellites still help, as far as they go.
"""

from __future__ import annotations

from bisect import bisect_right, insort
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deepseis_core.errors import InputError
from deepseis_core.types import (
    Float32Array,
    InsFilter,
    InsSolution,
    Observations,
)
from deepseis_ins.delayed_filter import DelayedFilter
from deepseis_ins.delayed_tight import RangeUpdate, TightDelayedFilter
from deepseis_ins.filter_steps import GnssUpdate
from deepseis_ins.fusion_engine import FusionEngine
from deepseis_ins.fusion_output import INNOVATIONS, FusionOutput
from deepseis_ins.loose import LooseFilter
from deepseis_ins.range_config import RangeConfig
from deepseis_ins.range_epochs import RangeBuilder
from deepseis_ins.satellite_book import NOBODY
from deepseis_ins.tight import TightConfig, TightFilter
from deepseis_ins.tight_kernels import TIGHT_STATES

SATELLITES = 32
"""Columns of innovations for each of ranges and range rates."""


class TightFusionEngine(FusionEngine):
    """Gives solution and aiding of successive 20 ms spans.

    Parameters
    ----------
    given, more
        As `FusionEngine`'s.
    tight : TightConfig, optional
    ranges : RangeConfig, optional
    """

    delayed: TightDelayedFilter | None

    def __init__(
        self,
        *given: Any,
        tight: TightConfig | None = None,
        ranges: RangeConfig | None = None,
        **more: Any,
    ) -> None:
        super().__init__(*given, **more)
        if self.oscillator is not None:
            raise InputError("oscillator_on_body", "is not estimated here", "coupling: loose")
        self.tight, self.range_config = tight or TightConfig(), ranges or RangeConfig()
        self.builder = RangeBuilder(self.range_config, self.site.C_enu_e[2])
        self._observations: list[Observations] = []

    @property
    def statistics(self) -> dict[str, int]:
        """Counts since the start, for diagnostics."""
        return {**super().statistics, "dropped_observations": self.builder.dropped}

    def push_observations(self, observations: Observations) -> None:
        """Take an epoch of observations, in any order; `pvt_valid` is of them too."""
        insort(self._observations, observations, key=_sample_index)

    def push_klobuchar(self, alpha: Any, beta: Any) -> None:
        """Take parameters of the ionosphere; before the start."""
        self.builder.klobuchar = np.array([*alpha, *beta], np.float64)

    def _take(self, begin: int, end: int) -> None:
        super()._take(begin, end)
        horizon = self.known("pvt", begin - self.delay)
        count = bisect_right(self._observations, horizon, key=_sample_index)
        due, chosen, predictor = self._observations[:count], NOBODY, self.timebase.predictor
        del self._observations[:count]
        if due and predictor is not None:
            time = predictor.gps_time(begin)
            told = horizon + self.delay
            chosen = self.book.choose(begin, time, self.site.monument_ecef, told)
        for observations in due:
            epoch = self.builder.take(observations, chosen)
            if epoch is not None and self.delayed is not None:
                self.delayed.push_ranges(epoch)

    def _make_filter(self, *arguments: Any, **keywords: Any) -> LooseFilter:
        lever = self.site.lever_arm_b
        return TightFilter(*arguments, tight=self.tight, lever_arm_b=lever, **keywords)

    def _make_delayed(self, filter: LooseFilter, row: int) -> DelayedFilter:
        return TightDelayedFilter(
            self.config, filter, row, self.history, self.timeline, self.site.lever_arm_b,
            self.sample_rate_hz, ranges=self.range_config,
        )  # fmt: skip

    def _produce(self, begin: int, end: int, updates: list[GnssUpdate]) -> FusionOutput:
        output = super()._produce(begin, end, updates)
        if self.delayed is None or not len(output.solution.sample_index):
            return output
        return replace(output, solution=self._with_clock(output.solution, self.delayed, updates))

    def _with_clock(
        self, solution: InsSolution, delayed: TightDelayedFilter, updates: list[GnssUpdate]
    ) -> InsSolution:
        """Add clock, its sigmas and the innovations of ranges to a solution."""
        samples = solution.sample_index
        bias, drift, sd = delayed.clock_at(int(samples[-1]))
        before = (samples - samples[-1]) / self.sample_rate_hz
        n = len(samples)
        sds = np.concatenate([solution.state_sd, np.repeat(sd[None], n, axis=0)], axis=1)
        innovation, innovation_sd, accepted = _innovations(solution, updates)
        return replace(
            solution,
            filter=int(InsFilter.TIGHT),
            clock_bias=bias + drift * before,
            clock_drift=np.full(n, drift),
            state_sd=sds.astype(np.float32),
            state_count=TIGHT_STATES,
            innovation=innovation,
            innovation_sd=innovation_sd,
            innovation_size=innovation.shape[1],
            innovation_accepted=accepted,
        )


def _innovations(
    solution: InsSolution, updates: list[GnssUpdate]
) -> tuple[Float32Array, Float32Array, NDArray[np.bool_]]:
    """Return innovations by columns: position and velocity, then ranges and rates by PRN."""
    m = len(updates)
    width = INNOVATIONS + 2 * SATELLITES
    z, sd = (np.full((m, width), np.nan, np.float32) for _ in range(2))
    accepted = solution.innovation_accepted.copy()
    z[:, :INNOVATIONS], sd[:, :INNOVATIONS] = solution.innovation, solution.innovation_sd
    for row, update in enumerate(updates):
        if not isinstance(update, RangeUpdate) or update.ranges is None:
            continue
        at = np.array([INNOVATIONS + int(name[1:]) - 1 for name in update.satellites])
        columns = np.concatenate([at, at + SATELLITES])
        z[row, columns], sd[row, columns] = update.ranges.z, update.ranges.sd
        accepted[row] = bool(update.ranges.accepted[np.isfinite(update.ranges.sd)].all())
    return z, sd, accepted


def _sample_index(item: Observations) -> int:
    return item.sample_index
