"""Fusion of a vehicle with a velocimeter (coupling ``ldv``), span by span.

As `fusion_engine`, with one input more. GNSS helps where there is any: it tells place and heading,
and with them the velocimeter's installation. Without it the velocimeter goes on alone.
"""

from __future__ import annotations

from bisect import bisect_right, insort
from dataclasses import replace
from typing import Any

from deepseis_core.errors import InputError
from deepseis_core.types import InsFilter, LdvVelocity
from deepseis_ins.delayed_filter import DelayedFilter
from deepseis_ins.delayed_ldv import LdvDelayedFilter
from deepseis_ins.filter_steps import GnssUpdate
from deepseis_ins.fusion_engine import FusionEngine
from deepseis_ins.fusion_output import FusionOutput
from deepseis_ins.gnss_offset import UNKNOWN_SD
from deepseis_ins.ldv_filter import LdvFilter, Unknowns
from deepseis_ins.ldv_fusion import LdvFusionConfig
from deepseis_ins.loose import LooseFilter


class LdvFusionEngine(FusionEngine):
    """Gives solution and aiding of successive 20 ms spans.

    Parameters
    ----------
    given, more
        As `FusionEngine`'s.
    ldv : LdvFusionConfig, optional
    """

    delayed: LdvDelayedFilter | None

    def __init__(self, *given: Any, ldv: LdvFusionConfig | None = None, **more: Any) -> None:
        super().__init__(*given, **more)
        self.ldv_config = ldv or LdvFusionConfig()
        self.ldv_config.installation()
        if self.config.smoothing_lag_s > 0.0:
            raise InputError("smoothing_lag_s", "is for stations", "0 with coupling: ldv")
        self._velocities: list[LdvVelocity] = []
        self._through["ldv"] = -1
        self._counts["late_ldv"] = 0

    def push_ldv(self, value: LdvVelocity) -> None:
        """Take a measurement of the velocimeter, in any order."""
        insort(self._velocities, value, key=_sample_index)

    def ldv_valid(self, through: int) -> None:
        """All measurements whose intervals end at ``through`` or before have been pushed."""
        self._valid("ldv", through)

    def needed(self) -> dict[str, int]:
        """Return how far each input has to be there for the next span.

        What counts are measurements up to D before it; their intervals have ended by its begin.
        """
        return {**super().needed(), "ldv": self.next_sample}

    def report(self) -> dict[str, object]:
        """Return what is known of the velocimeter's installation, for diagnostics."""
        return self.delayed.report() if self.delayed is not None else {}

    def _take(self, begin: int, end: int) -> None:
        super()._take(begin, end)
        horizon = self.known("ldv", begin) - self.delay
        count = bisect_right(self._velocities, horizon, key=_sample_index)
        due = self._velocities[:count]
        del self._velocities[:count]
        if self.delayed is not None:
            for value in due:
                self.delayed.push_ldv(value)

    def _make_filter(self, *arguments: Any, **keywords: Any) -> LooseFilter:
        c = self.config
        sd = UNKNOWN_SD, c.velocity_offset_sd, self.ldv_config.ldv_lever_sd
        unknowns = Unknowns(sd, (c.position_growth, c.velocity_growth))
        return LdvFilter(*arguments, unknowns=unknowns, **keywords)

    def _make_delayed(self, filter: LooseFilter, row: int) -> DelayedFilter:
        return LdvDelayedFilter(
            self.config, filter, row, self.history, self.timeline, self.site.lever_arm_b,
            self.sample_rate_hz, self.oscillator, ldv=self.ldv_config,
        )  # fmt: skip

    def _produce(self, begin: int, end: int, updates: list[GnssUpdate]) -> FusionOutput:
        output = super()._produce(begin, end, updates)
        solution = replace(output.solution, filter=int(InsFilter.LDV))
        return replace(output, solution=solution)


def _sample_index(item: LdvVelocity) -> int:
    return item.sample_index
