"""Settings of the fusion with ranges of single satellites (coupling ``tight``).

Noise is that of loops of 1 Hz (code) and 8 Hz (carrier) at 45 dB-Hz; it grows as the signal's
amplitude falls. Slow errors, of atmosphere, orbits and clocks, are learnt satellite by satellite
while the station stands still (`satellite_errors`).
"""

from __future__ import annotations

from dataclasses import dataclass

from deepseis_core.config import setting
from deepseis_core.selection import ALL, RULES


@dataclass(frozen=True)
class RangeConfig:
    """Settings of `range_epochs.RangeBuilder` and `delayed_tight.TightDelayedFilter`."""

    ranges_hz: float = setting(10.0, "epochs of ranges used a second [Hz]", low=0.1, high=50.0)
    range_selection: str = setting("all", "satellites used (core.selection) [-]", choices=RULES)
    range_mask_deg: float = setting(10.0, "lowest satellite used [deg]", low=0.0, high=90.0)

    smooth_ranges: bool = setting(True, "smooth ranges by phases (Hatch filter)")
    smoothing_s: float = setting(
        100.0, "time over which they are smoothed [s]", low=0.02, high=1e4
    )
    smoothed_share: float = setting(
        0.2,
        "least part of the noise's variance that a smoothed range keeps [-]",
        low=0.0,
        high=1.0,
    )

    range_sd: float = setting(0.5, "code noise at 45 dB-Hz [m]", low=1e-3, high=100.0)
    range_floor_sd: float = setting(0.1, "code noise of every range [m]", low=0.0, high=100.0)
    range_correlation_s: float = setting(0.5, "correlation time of code noise [s]", low=0.0)
    range_offset_sd: float = setting(10.0, "slow error before it is known [m]", low=0.0, high=1e3)
    range_growth: float = setting(
        0.02, "random walk of the slow error [m/sqrt(s)]", low=0.0, high=10.0
    )

    range_rate_sd: float = setting(0.02, "noise at 45 dB-Hz [m/s]", low=1e-4, high=10.0)
    range_rate_offset_sd: float = setting(
        5e-3, "a range rate's slow error before it is known [m/s]", low=0.0, high=10.0
    )
    range_rate_growth: float = setting(
        1e-4, "random walk of that slow error [m/s/sqrt(s)]", low=0.0, high=1.0
    )
    range_common_s: float = setting(
        10.0, "what is unknown of slow errors lasts so long [s]", low=0.0, high=1e5
    )

    @property
    def everything(self) -> bool:
        """Whether all satellites above the mask are used."""
        return self.range_selection == ALL
