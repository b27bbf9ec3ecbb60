"""Solutions as the values that cross packages."""

from __future__ import annotations

import numpy as np

from deepseis_core.types import Observations, Pvt, PvtStatus
from deepseis_pvt.spp import SppSolution


def no_position(observations: Observations) -> Pvt:
    """Return the statement that an epoch has no position."""
    return Pvt(
        sample_index=observations.sample_index,
        week=observations.week,
        tow_ns=observations.tow_ns,
        valid_through=observations.valid_through,
        status=PvtStatus.NONE,
        position_ecef=np.full(3, np.nan),
        velocity_ecef=np.full(3, np.nan),
        clock_bias=float("nan"),
        clock_drift=float("nan"),
        position_covariance_ecef=np.full((3, 3), np.nan),
        velocity_covariance_ecef=np.full((3, 3), np.nan),
    )


def pvt_of(observations: Observations, satellites: list[str], solution: SppSolution) -> Pvt:
    """Return a solution as the value that crosses packages."""
    used = np.flatnonzero(solution.used)
    dops = solution.dops.tolist()
    return Pvt(
        sample_index=observations.sample_index,
        week=observations.week,
        tow_ns=observations.tow_ns,
        valid_through=observations.valid_through,
        status=PvtStatus.SINGLE,
        position_ecef=solution.position_ecef,
        velocity_ecef=solution.velocity_ecef,
        clock_bias=solution.clock_bias,
        clock_drift=solution.clock_drift,
        position_covariance_ecef=solution.covariance[:3, :3].copy(),
        velocity_covariance_ecef=solution.velocity_covariance[:3, :3].copy(),
        satellites=tuple(satellites[k] for k in used),
        pseudorange_residual=solution.pseudorange_residual[used].astype(np.float32),
        range_rate_residual=solution.range_rate_residual[used].astype(np.float32),
        elevation=solution.elevation[used].astype(np.float32),
        azimuth=solution.azimuth[used].astype(np.float32),
        gdop=dops[0],
        pdop=dops[1],
        hdop=dops[2],
        vdop=dops[3],
        rejected=tuple(satellites[k] for k in np.flatnonzero(solution.rejected)),
    )
