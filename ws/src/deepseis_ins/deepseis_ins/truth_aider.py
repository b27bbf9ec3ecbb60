"""Aiding from the truth, span by span, with the dependence that the fusion has (bench only)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from deepseis_core.config import setting
from deepseis_core.ephemeris import pack, select_ephemerides
from deepseis_core.gps_time import GpsTime
from deepseis_core.propagation import line_of_sight
from deepseis_core.types import Aiding, Ephemeris, FloatArray
from deepseis_ins.aiding import DopplerPredictor, KnotGrid
from deepseis_ins.truth_motion import Trajectory

BLOCK_S = 0.02
RENEWAL_S = 60.0
"""Ephemerides and visible satellites are chosen anew at multiples of this [s]."""


@dataclass(frozen=True)
class TruthAiderConfig:
    """Delay, what is played, and errors put in on purpose."""

    sample_rate_hz: float = setting(4e6, "IF sampling rate [Hz]", low=1e5)
    start_s: float = setting(0.0, "where in the recording the source starts [s]", low=0)
    feedback_delay_ms: int = setting(
        100, "D: aiding up to t waits for PVT up to t - D [ms]", low=60, high=10_000
    )
    elevation_mask_deg: float = setting(-2.0, "lowest satellite aided [deg]", low=-90, high=90)
    motion_scale: float = setting(1.0, "error on purpose: motion times this [-]")
    delay_samples: int = setting(0, "error on purpose: motion late by this [samples]")


class TruthAider:
    """Gives the aiding of successive 20 ms spans.

    A span is due once the source has announced its first sample and PVT is complete through the
    span's last sample less D: the dependence of a fusion node, whose IMU data come with the IF.

    Parameters
    ----------
    config : TruthAiderConfig
    trajectory : Trajectory
        The antenna by time since sample 0.
    start : GpsTime
        GPS time of sample 0.
    ephemerides : iterable of Ephemeris
    satellites : iterable of str
        Whom to aid, if above the mask.
    wait_pvt : bool, optional
        False: do not wait for PVT (realtime: the truth does not need it).
    """

    def __init__(
        self,
        config: TruthAiderConfig,
        trajectory: Trajectory,
        start: GpsTime,
        ephemerides: Iterable[Ephemeris],
        satellites: Iterable[str],
        *,
        wait_pvt: bool = True,
    ) -> None:
        self.config, self.trajectory, self.wait_pvt = config, trajectory, wait_pvt
        rate = config.sample_rate_hz
        self.predictor = DopplerPredictor("truth", start, rate)
        wanted = frozenset(satellites)
        self.ephemerides = [item for item in ephemerides if item.satellite in wanted]
        self.block = max(1, round(BLOCK_S * rate))
        self.delay = round(config.feedback_delay_ms * 1e-3 * rate)
        self.first_sample = round(config.start_s * rate) // self.block * self.block
        self.next_sample = self.first_sample
        self.source_through = self.pvt_through = -1
        self._names: tuple[str, ...] = ()
        self._packed: FloatArray = np.zeros((0, 22))
        self._chosen_for = -1

    @property
    def valid_through(self) -> int:
        """Last sample that aiding has been given for."""
        return self.next_sample - 1

    def join(self, sample: int) -> None:
        """Begin with the span of a sample: the graph runs already."""
        self.first_sample = self.next_sample = sample // self.block * self.block

    def source_valid(self, through: int) -> None:
        """Note that the source has announced samples up to ``through``."""
        self.source_through = max(self.source_through, through)

    def pvt_valid(self, through: int) -> None:
        """PVT is complete through sample ``through``."""
        self.pvt_through = max(self.pvt_through, through)

    def waiting_for(self) -> str:
        """Name what the next span waits for: samples, pvt or nothing."""
        if self.source_through < self.next_sample:
            return "samples"
        needed = self.next_sample + self.block - 1 - self.delay
        if self.wait_pvt and needed >= self.first_sample and self.pvt_through < needed:
            return "pvt"
        return ""

    def advance(self) -> Aiding | None:
        """Return the aiding of the next span, or None if it is not due."""
        if self.waiting_for():
            return None
        aiding = self.span(self.next_sample, self.block)
        self.next_sample += self.block
        return aiding

    def span(self, sample_index: int, sample_count: int) -> Aiding:
        """Return the aiding of any span."""
        rate = self.config.sample_rate_hz
        grid = KnotGrid.of_span(sample_index, sample_count, rate)
        self._choose(sample_index)
        time = (grid.samples - self.config.delay_samples) / rate
        antenna = self.trajectory.states(time, scale=self.config.motion_scale)
        return self.predictor.predict(grid, antenna, self._names, self._packed)

    def _choose(self, sample_index: int) -> None:
        """Choose satellites and ephemerides, the same for a whole renewal interval."""
        interval = round(RENEWAL_S * self.config.sample_rate_hz)
        number = sample_index // interval
        if number == self._chosen_for:
            return
        self._chosen_for = number
        time = self.predictor.gps_time(number * interval)
        chosen = select_ephemerides(self.ephemerides, time.week, time.tow_ns)
        packed = pack(list(chosen.values()))
        view = line_of_sight(packed, time.week, time.tow_ns, self.trajectory.origin)
        high = view.elevation >= np.deg2rad(self.config.elevation_mask_deg)
        self._names = tuple(np.array(list(chosen), dtype=object)[high])
        self._packed = packed[high]
