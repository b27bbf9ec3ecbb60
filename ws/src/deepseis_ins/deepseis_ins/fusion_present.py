"""The present: where the delayed filter stands, carried on by mechanisation alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deepseis_core.constants import L1_WAVELENGTH
from deepseis_core.types import Float32Array, FloatArray
from deepseis_ins.antenna_motion import Nodes
from deepseis_ins.delayed_filter import DelayedFilter
from deepseis_ins.error_state import POS, VEL
from deepseis_ins.fusion_kernels import carry_on_kernel
from deepseis_ins.measurement_kernels import ned_from_ecef_kernel
from deepseis_ins.strapdown import Trajectory


@dataclass(frozen=True)
class Present:
    """Epochs from the filter's to the end of a span.

    Attributes
    ----------
    trajectory : Trajectory
        n states.
    nodes : Nodes
        The same in ECEF.
    gained_b : ndarray, shape (n, 3)
        Sum of the velocity increments as measured, since the first epoch [m/s].
    gyro_bias, accel_bias : ndarray, shape (3,)
        Forward-right-down [rad/s, m/s^2].
    covariance : ndarray, shape (15, 15)
        The filter's, what its velocity makes of it since, and IMU data that are missing.
    moved_covariance : ndarray, shape (3, 3)
        Of the displacement from where the station was surveyed to stand, NED [m^2].
    lever_rate_variance : float
        Of the velocity that white noise of the gyroscopes gives to the antenna [m^2/s^2].
    """

    trajectory: Trajectory
    nodes: Nodes
    gained_b: FloatArray
    gyro_bias: FloatArray
    accel_bias: FloatArray
    covariance: FloatArray
    moved_covariance: FloatArray
    lever_rate_variance: float

    @classmethod
    def of(cls, delayed: DelayedFilter, row: int, origin: FloatArray) -> Present:
        """Carry the filter's state to the end of a row; ``origin`` ECEF, near [m]."""
        history, filter, nav = delayed.history, delayed.filter, delayed.filter.nav
        begin, end = delayed.row, row + 1
        n = end - begin
        x = np.concatenate(
            [
                [nav.latitude, nav.longitude, nav.height],
                nav.vel_n,
                nav.quat_nb,
                nav.previous_delta_theta_b,
                nav.previous_delta_vel_b,
                [nav.previous_dt],
            ]
        )
        bias = np.concatenate([filter.gyro_bias, filter.accel_bias])
        trajectory = Trajectory(np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 4)))
        gained = np.empty((n, 3))
        carry_on_kernel(
            x, bias, history.rows(begin + 1, end), history.dt,
            trajectory.geodetic, trajectory.vel_n, trajectory.quat_nb, gained,
        )  # fmt: skip
        nodes = Nodes.of(history.indices(begin, end), trajectory, delayed.lever_arm_b, origin)
        covariance, moved = delayed.covariances()
        unknown = history.unknown(begin + 1, end)
        stray = _stray(covariance, (n - 1) * history.dt) + unknown.position * np.eye(3)
        covariance[POS, POS] += stray
        moved += stray
        covariance[VEL, VEL] += unknown.velocity * np.eye(3)
        turn2 = filter.grade.gyros.walk**2 / history.dt
        swing2 = turn2 * float(delayed.lever_arm_b @ delayed.lever_arm_b)
        return cls(trajectory, nodes, gained, bias[:3], bias[3:], covariance, moved, swing2)

    def velocity_sd(self) -> float:
        """Return the largest sigma of velocity [m/s]."""
        return float(np.sqrt(np.diag(self.covariance)[VEL].max()))

    def doppler_sd_hz(self, unit: FloatArray) -> Float32Array:
        """Return one sigma of the Doppler, shape (n,), along lines of sight, ECEF, (n, 3).

        With what noise of the gyroscopes the lever arm makes of it; it lasts an interval.
        """
        latitude, longitude, _ = self.trajectory.geodetic[-1]
        unit_n = unit @ ned_from_ecef_kernel(latitude, longitude).T
        variance = ((unit_n @ self.covariance[VEL, VEL]) * unit_n).sum(axis=1)
        variance += self.lever_rate_variance
        return (np.sqrt(variance) / L1_WAVELENGTH).astype(np.float32)


def _stray(covariance: FloatArray, seconds: float) -> FloatArray:
    """Return by what a position's covariance grows while its velocity carries it on [m^2]."""
    together = covariance[POS, VEL] * seconds
    return np.asarray(together + together.T + seconds**2 * covariance[VEL, VEL])
