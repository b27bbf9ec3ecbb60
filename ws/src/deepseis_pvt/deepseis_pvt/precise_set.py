"""All precise positions of an epoch: from phases alone, and against a base."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from deepseis_core.miss_log import EVER
from deepseis_core.types import (
    FloatArray,
    MotionState,
    Observations,
    PrecisePosition,
    PreciseStatus,
)
from deepseis_pvt.ephemeris_book import EphemerisBook
from deepseis_pvt.phase_values import PhaseConfig
from deepseis_pvt.precise import PhasePositions, PreciseConfig, phase_positions
from deepseis_pvt.precise_rtk import BaseConfig, RtkPositions, rtk_positions
from deepseis_pvt.rtk import RtkConfig
from deepseis_pvt.spp import SppConfig
from deepseis_pvt.still_reference import ReferenceConfig

PHASE_TOPIC: Final = "gnss/precise"
RTK_TOPIC: Final = "gnss/rtk"


class PrecisePositions:
    """What a surveyed station knows of its antenna: one value a method and epoch.

    Parameters
    ----------
    phase : PhasePositions or None
        None: the antenna has not been surveyed, and nothing is said.
    rtk : RtkPositions or None
        None: there is no base.
    wait_base : bool
        Epochs wait until the base is valid for them.
    """

    def __init__(
        self, phase: PhasePositions | None, rtk: RtkPositions | None, wait_base: bool
    ) -> None:
        self.phase, self.rtk, self.wait_base = phase, rtk, wait_base

    def late(self, sample_index: int) -> dict[str, int]:
        """Tell what the epoch at a sample lacks, motion or base, and how far each is there."""
        found = {} if self.phase is None else self.phase.late(sample_index)
        if self.rtk is not None and self.wait_base:
            found |= self.rtk.late(sample_index)
        return found

    @property
    def statistics(self) -> dict[str, int]:
        """Counts since the start, for diagnostics."""
        counts = {} if self.phase is None else dict(self.phase.statistics)
        return counts | ({} if self.rtk is None else self.rtk.counts)

    @property
    def base_trouble(self) -> str:
        """What is wrong with the base, in words; empty if nothing is, or the graph has none."""
        return self.rtk.trouble if self.rtk is not None and self.wait_base else ""

    def push_motion(self, state: MotionState) -> None:
        """Take a decision on motion, in order."""
        if self.phase is not None:
            self.phase.push_motion(state)

    def motion_valid(self, through: int) -> None:
        """All decisions on motion through this sample have been pushed."""
        if self.phase is not None:
            self.phase.motion_valid(through)

    def push_base(self, observations: Observations) -> None:
        """Take an epoch of the base, in order."""
        if self.rtk is not None:
            self.rtk.push_base(observations)

    def push_base_place(self, position_ecef: FloatArray, utc_ns: int) -> None:
        """Take where the base is for its epochs from a UTC on."""
        if self.rtk is not None:
            self.rtk.push_place(position_ecef, utc_ns)

    def base_valid(self, through: int) -> None:
        """All of the base's epochs through this sample have been pushed."""
        if self.rtk is not None:
            self.rtk.base_valid(through)

    def solve(
        self, observations: Observations, missed: Mapping[str, int] | None = None
    ) -> list[tuple[str, PrecisePosition]]:
        """Return topic and value of every method; epochs come in order.

        Of what was ``missed``, only what came through the sample given counts.
        """
        if self.phase is None:
            return []
        known = missed or {}
        found = self.phase.solve(observations, known.get("motion", EVER))
        values = [(PHASE_TOPIC, found)]
        if self.rtk is not None:
            if self.phase.filter.doubts:
                self.rtk.doubt(observations.sample_index)
            slipped = found.rejected if found.status != PreciseStatus.NONE else ()
            value = self.rtk.solve(
                observations, slipped, self.phase.rest, self.phase.filter.stress,
                known.get("base", EVER),
            )  # fmt: skip
            values.append((RTK_TOPIC, value))
        return values


def precise_positions(
    position_ecef: Sequence[float],
    book: EphemerisBook,
    sample_rate_hz: float,
    config: PreciseConfig,
    phase: PhaseConfig,
    reference: ReferenceConfig,
    spp: SppConfig,
    rtk: RtkConfig,
    base: BaseConfig,
) -> PrecisePositions:
    """Return what solves for precise positions, as far as antenna and base are known."""
    return PrecisePositions(
        phase_positions(position_ecef, book, config, phase, reference, spp, sample_rate_hz),
        rtk_positions(
            position_ecef, book, rtk, base, sample_rate_hz, phase, is_there=config.wait_base
        ),
        config.wait_base,
    )
