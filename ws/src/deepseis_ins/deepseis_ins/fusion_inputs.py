"""What comes into the fusion, in any order, and how far it is complete."""

from __future__ import annotations

from bisect import bisect_right, insort
from dataclasses import replace
from typing import TypeVar

import numpy as np

from deepseis_core.imu_grades import ImuGrade
from deepseis_core.miss_log import Inputs, MissScript
from deepseis_core.types import (
    Ephemeris,
    ImuSample,
    MotionKind,
    MotionState,
    PrecisePosition,
    Pvt,
)
from deepseis_ins.fusion_config import FusionConfig
from deepseis_ins.imu_history import ImuHistory
from deepseis_ins.motion_timeline import MotionTimeline
from deepseis_ins.satellite_book import SatelliteBook

Position = TypeVar("Position", Pvt, PrecisePosition)

SPAN_S = 0.02
"""Of samples that are worked through at once: an IF block [s]."""


def _sample_index(item: Pvt | PrecisePosition) -> int:
    return item.sample_index


class FusionInputs:
    """Keeps what comes until its time has come.

    Parameters
    ----------
    config : FusionConfig
    grade : ImuGrade
    sample_rate_hz, imu_rate_hz : float
        [Hz]
    script : MissScript, optional
        Of the run that is replayed.

    Attributes
    ----------
    next_sample : int
        First sample of the next span.
    missed : dict of str to int
        What the last span went without, and how far it was there.
    """

    def __init__(
        self,
        config: FusionConfig,
        grade: ImuGrade,
        sample_rate_hz: float,
        imu_rate_hz: float,
        script: MissScript | None = None,
    ) -> None:
        self._inputs, self.missed = Inputs(script), dict[str, int]()
        self.sample_rate_hz = sample_rate_hz
        self.block = max(1, round(SPAN_S * sample_rate_hz))
        self.delay = round(config.feedback_delay_ms * 1e-3 * sample_rate_hz)
        self.first_sample = round(config.start_s * sample_rate_hz) // self.block * self.block
        self.next_sample = self.first_sample
        self.history = ImuHistory(config, grade, imu_rate_hz, sample_rate_hz)
        self.timeline = MotionTimeline(self.delay)
        self.book = SatelliteBook(config.elevation_mask_deg, sample_rate_hz)
        self._pvts: list[Pvt] = []
        self._precise: list[PrecisePosition] = []
        self._rtk: list[PrecisePosition] = []
        self._through = dict.fromkeys(("samples", "imu", "motion", "pvt"), -1)

    def begin_at(self, sample: int) -> None:
        """Make the span that holds a sample the first one: the graph runs already."""
        self.first_sample = self.next_sample = sample // self.block * self.block

    def push_imu(self, sample: ImuSample) -> None:
        """Take an IMU sample, in any order."""
        self.history.push(sample)

    def push_pvt(self, pvt: Pvt) -> None:
        """Take a position, in any order; its covariances may be flat, as in a message."""
        position, velocity = (
            np.reshape(item, (3, 3))
            for item in (pvt.position_covariance_ecef, pvt.velocity_covariance_ecef)
        )
        square = replace(pvt, position_covariance_ecef=position, velocity_covariance_ecef=velocity)
        insort(self._pvts, square, key=_sample_index)

    def push_precise(self, position: PrecisePosition) -> None:
        """Take a precise position, in any order."""
        insort(self._precise, position, key=_sample_index)

    def push_rtk(self, position: PrecisePosition) -> None:
        """Take a position against a base, in any order."""
        insort(self._rtk, position, key=_sample_index)

    def push_motion(self, state: MotionState) -> None:
        """Take a decision on motion, in any order."""
        self.timeline.push(state)

    def push_ephemeris(self, ephemeris: Ephemeris) -> None:
        """Take an ephemeris, in any order; it counts from its effective sample on."""
        self.book.push(ephemeris)

    def source_valid(self, through: int) -> None:
        """Note that the source has announced samples up to ``through``."""
        self._valid("samples", through)

    def imu_valid(self, through: int) -> None:
        """All IMU samples up to ``through`` have been pushed."""
        self._valid("imu", through)

    def motion_valid(self, through: int) -> None:
        """All that is decided on motion through ``through`` has been pushed."""
        self._valid("motion", through)

    def pvt_valid(self, through: int) -> None:
        """All positions, precise ones too, and ephemerides up to ``through`` have been pushed."""
        self._valid("pvt", through)

    def waiting_for(self) -> str:
        """Name what the next span waits for: samples, imu, motion, pvt or nothing."""
        return next(iter(self.lacking()), "")

    def lacking(self) -> list[str]:
        """Name all that the next span has to wait for."""
        return self._inputs.lacking(self.next_sample, self.needed(), self._through)

    def needed(self) -> dict[str, int]:
        """Return how far each input has to be there for the next span."""
        begin = self.next_sample
        needed = {"samples": begin, "imu": begin + self.block, "motion": begin}
        if begin - self.delay >= self.first_sample:
            needed["pvt"] = begin - self.delay
        return needed

    def miss(self) -> None:
        """Settle how far each input counts for the next span."""
        self.missed = self._inputs.missed(self.next_sample, self.needed(), self._through)

    def known(self, what: str, needed: int) -> int:
        """Return through which sample an input counts for the next span."""
        return min(needed, self.missed.get(what, needed))

    def take_motion(self, begin: int) -> int | None:
        """Let decisions count; return the first sample for which something else holds now.

        That the station is still, or moves, is taken back once nobody has said so for D: the
        detector has died, or hangs (real time).
        """
        changed = self.timeline.take(self.known("motion", begin))
        through = self.missed.get("motion", begin)
        if begin - through <= self.delay or self.timeline.state(begin) == MotionKind.UNKNOWN:
            return changed
        nothing = np.zeros(6, np.float32)
        since = max(through + 1, self.first_sample)
        kind = int(MotionKind.UNKNOWN)
        self.timeline.push(MotionState(since, begin, kind, "silence", nothing, nothing))
        also = self.timeline.take(begin, "silence")
        return min((item for item in (changed, also) if item is not None), default=None)

    def due_pvts(self, horizon: int) -> list[Pvt]:
        """Return positions up to a sample that have not been returned yet, in order."""
        return _taken(self._pvts, horizon)

    def due_precise(self, horizon: int) -> list[PrecisePosition]:
        """Return precise positions up to a sample that have not been returned yet, in order."""
        return _taken(self._precise, horizon)

    def due_rtk(self, horizon: int) -> list[PrecisePosition]:
        """Return positions against a base up to a sample, in order, each once."""
        return _taken(self._rtk, horizon)

    def _valid(self, what: str, through: int) -> None:
        self._through[what] = max(self._through[what], through)


def _taken(waiting: list[Position], horizon: int) -> list[Position]:
    count = bisect_right(waiting, horizon, key=_sample_index)
    due = waiting[:count]
    del waiting[:count]
    return due
