"""Settings of the fusion of IMU and GNSS.

The formal sigma of a single-point position is mostly of slow errors: orbits, clocks, atmosphere.
They are estimated while the station stands still (`gnss_offset`); what remains is noise of the
loops. On the bench, with 11 satellites and loops of 8 Hz and 1 Hz, the position's noise is 0.13
of the formal sigma and correlated over 0.25 s, the velocity's 0.36 and white.

Of precise positions (carrier phases) the noise is told from what they do while the station stands
still; what creeps in them is said by `precise_growth`.
"""

from __future__ import annotations

from dataclasses import dataclass

from deepseis_core.config import check, setting
from deepseis_core.errors import InputError

COUPLINGS = ("loose", "tight", "ldv")


@dataclass(frozen=True)
class FusionConfig:
    """Settings of `fusion_engine.FusionEngine`."""

    coupling: str = setting(
        "loose", "what moves the filter: positions, ranges, a velocimeter [-]", choices=COUPLINGS
    )
    start_s: float = setting(0.0, "where in the recording the source starts [s]", low=0)
    feedback_delay_ms: int = setting(
        100, "D: what is measured at t acts at t + D [ms]", low=60, high=2_000
    )
    filter_rate_hz: float = setting(
        10.0, "steps of the filter, and constraints at rest, a second [Hz]", low=0.5, high=50.0
    )
    elevation_mask_deg: float = setting(-2.0, "lowest satellite aided [deg]", low=-90, high=90)

    alignment_s: float = setting(
        3.0, "IMU data at rest that the start needs [s]", low=0.2, high=600.0
    )
    heading_sd_deg: float = setting(0.1, "of the surveyed orientation [deg]", low=1e-4, high=180.0)
    level_sd_deg: float = setting(0.05, "of the surveyed orientation [deg]", low=1e-4, high=90.0)
    monument_sd: float = setting(0.02, "of the surveyed position [m]", low=1e-4, high=100.0)

    joined_attitude_sd_deg: float = setting(
        0.5, "of the surveyed orientation where the station may be moving [deg]", low=0.01, high=90
    )
    joined_position_sd: float = setting(
        1.0, "of the surveyed position where the station may be moving [m]", low=0.01, high=1e3
    )
    joined_velocity_sd: float = setting(
        0.3, "least, of the velocity from GNSS to start with [m/s]", low=0.01, high=10.0
    )

    still_velocity_sd: float = setting(3e-4, "zero velocity at rest [m/s]", low=1e-6, high=1.0)
    still_angle_sd_deg: float = setting(
        0.01, "zero turn since the rest began [deg]", low=1e-6, high=10.0
    )
    still_position_sd: float = setting(
        2e-3, "zero displacement since then [m]", low=1e-5, high=10.0
    )
    doubt_s: float = setting(
        15.0, "of a rest that ends the last part is not believed: motion is noticed late [s]",
        low=0.0, high=120.0,
    )  # fmt: skip
    undo_s: float = setting(3.0, "so much can still be taken back [s]", low=0.2, high=60.0)
    smoothing_lag_s: float = setting(
        0.0, "smoothed motion too, so late; more than undo_s; 0: none [s]", low=0.0, high=30.0
    )

    position_noise_share: float = setting(
        0.2, "position's noise as a part of its formal sigma [-]", low=0.0, high=10.0
    )
    position_correlation_s: float = setting(0.3, "correlation time of it [s]", low=0.0, high=1e3)
    position_growth: float = setting(
        0.02, "random walk of the position's slow error [m/sqrt(s)]", low=0.0, high=10.0
    )
    velocity_noise_share: float = setting(
        0.4, "velocity's noise as a part of its formal sigma [-]", low=0.0, high=10.0
    )
    velocity_correlation_s: float = setting(0.0, "correlation time of it [s]", low=0.0, high=1e3)
    velocity_growth: float = setting(
        1e-4, "random walk of the velocity's slow error [m/s/sqrt(s)]", low=0.0, high=1.0
    )
    velocity_offset_sd: float = setting(
        5e-3, "the velocity's slow error, before it is known [m/s]", low=0.0, high=10.0
    )
    offset_correlation_s: float = setting(
        10.0, "what is unknown of slow errors lasts so long [s]", low=0.0, high=1e5
    )

    precise: bool = setting(True, "use precise positions; PVT where there are none")
    precise_noise_share: float = setting(
        1.0, "noise of precise positions as a part of their formal sigma, at first [-]",
        low=0.1, high=3.0,
    )  # fmt: skip
    precise_correlation_s: float = setting(0.0, "correlation time of it [s]", low=0.0, high=10.0)
    precise_growth: float = setting(
        3e-4, "random walk of their slow error [m/sqrt(s)]", low=0.0, high=1.0
    )
    precise_offset_sd: float = setting(
        0.05, "their slow error, before it is known [m]", low=1e-4, high=100.0
    )
    precise_hold_s: float = setting(
        0.15, "PVT is used when there has been no precise position for so long [s]",
        low=0.02, high=10.0,
    )  # fmt: skip
    precise_rejections: int = setting(
        25, "refused in a row, then they have jumped and are compared anew", low=2, high=10_000
    )

    rtk: bool = setting(True, "use positions against a base, before all others")
    rtk_base_age_s: float = setting(
        5.0, "oldest base of a position that is used [s]", low=0.1, high=600.0
    )
    rtk_correlation_s: float = setting(
        0.03, "correlation time of their noise: the base's stays for its interval [s]",
        low=0.0, high=10.0,
    )  # fmt: skip
    rtk_growth: float = setting(
        1e-4, "random walk of their slow error [m/sqrt(s)]", low=0.0, high=1.0
    )
    afloat_sd: float = setting(
        0.1, "precise positions from a place not known are followed by a filter that knows its own"
        " so well [m]", low=0.001, high=10.0,
    )  # fmt: skip
    rtk_return_s: float = setting(
        10.0, "what crept without the base is worked off in that time once it is back [s]",
        low=0.1, high=1e4,
    )  # fmt: skip

    missing_mean_s: float = setting(
        2.0, "missing IMU data are taken as the mean over this before [s]", low=0.05, high=60.0
    )
    bridge_s: float = setting(
        0.06, "missing IMU data between others are bridged so far [s]", low=0.0, high=0.5
    )
    bridge_memory_s: float = setting(
        1.0, "how far off that may be is tried on so much before [s]", low=0.2, high=10.0
    )
    extrapolate_s: float = setting(
        0.025, "late IMU data may be extrapolated so far [s]", low=0.0, high=0.5
    )
    missing_walk: float = setting(
        3.0, "velocity random walk over missing data [m/s/sqrt(s)]", low=1e-3, high=100.0
    )
    held_walk: float = setting(
        0.1, "the least of it while late data are extrapolated [m/s/sqrt(s)]", low=0.0, high=100.0
    )
    missing_angle_walk_deg: float = setting(
        0.5, "angular random walk over missing data [deg/sqrt(s)]", low=0.0, high=90.0
    )
    clipped_walk: float = setting(
        1.0, "velocity random walk over clipped data [m/s/sqrt(s)]", low=0.0, high=100.0
    )
    regained_sd: float = setting(
        0.1, "velocity's sigma with which aiding is back after a gap [m/s]", low=1e-3, high=10.0
    )
    regained_late_sd: float = setting(
        0.5, "the same a second after it: loops have slipped, and tell no better [m/s]",
        low=1e-3, high=10.0,
    )  # fmt: skip
    greatest_sd: float = setting(
        10.0, "velocity's sigma beyond which there is no aiding [m/s]", low=1e-2, high=1e3
    )

    oscillator_on_body: bool = setting(
        False, "the oscillator shakes too: estimate and predict what it feels"
    )
    oscillator_sensitivity: list[float] = setting(
        [], "what is known of its g-sensitivity, forward, left, up; empty: nothing [1/g]"
    )
    oscillator_sensitivity_sd: float = setting(
        2e-9, "one sigma of that, each axis, before the first event [1/g]", low=0.0, high=1e-6
    )
    oscillator_walk: float = setting(
        0.025, "random walk of the clock's drift [m/s/sqrt(s)]", low=0.0, high=10.0
    )
    oscillator_phase_walk: float = setting(
        1e-4, "random walk of the clock beside that [m/sqrt(s)]", low=0.0, high=1.0
    )
    drift_noise: float = setting(0.1, "sigma of a drift of PVT [m/s]", low=1e-4, high=10.0)

    def __post_init__(self) -> None:
        """Refuse values outside their limits."""
        try:
            check(self)
        except ValueError as error:
            raise InputError("fusion", str(error)) from None
