"""Time offset and lever arm of an IMU beside a GNSS antenna, from the data of both.

Two steps. `deepseis_ins.mounting_search` correlates the velocities of both over time: it finds
the offset to a tenth of a sample of GNSS and, where nobody has surveyed it, the heading. Then
`deepseis_ins.mounting_fit` fits, over stretches of some seconds, what the IMU's mechanisation
says the antenna did to what GNSS says it did, by least squares: offset, lever arm and scale
factors are one for all stretches, where a stretch begins and the IMU's biases are its own.

Time runs on the clock of GNSS: ``time of GNSS = stamp of the IMU + offset``. Inside, axes are
north-east-down and forward-right-down; what comes out is forward-left-up.

A lever arm shows only where the unit turns: its sigma is then smaller than what was known before.
The offset shows wherever it accelerates: ``sd = sd(v) / (rms(a) sqrt(n))`` of n velocities.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deepseis_core.config import check
from deepseis_core.errors import InputError
from deepseis_core.rotation import euler_from_quat, flu_from_frd, quat_from_euler, quat_multiply
from deepseis_core.types import FloatArray
from deepseis_ins import mounting_fit as fit
from deepseis_ins import mounting_search as search
from deepseis_ins.alignment import earth_rate
from deepseis_ins.mounting_data import AntennaSeries, ImuSeries, MountingConfig
from deepseis_ins.mounting_kernels import attitude_kernel

__all__ = ["AntennaSeries", "ImuSeries", "Mounting", "MountingConfig", "estimate_mounting"]


@dataclass(frozen=True)
class Mounting:
    """How an IMU stands to the antenna.

    Attributes
    ----------
    time_offset, time_offset_sd : float
        To be added to the IMU's stamps [s].
    imu_to_antenna, imu_to_antenna_sd : ndarray, shape (3,)
        Lever arm, forward, left, up [m].
    covariance : ndarray, shape (4, 4)
        Of offset and lever arm.
    roll_pitch_heading : ndarray, shape (3,)
        At the IMU's first sample [rad].
    agreement : float
        Correlation of the velocities at the offset found by the search [-].
    searched_offset : float
        What the search found [s].
    residual_ratio : float
        R.m.s. of what is left to what was expected; sigmas are widened by it if it is over 1.
    stretches : int
        That were fitted.
    lever_arm_shows : ndarray of bool, shape (3,)
        Whether the data has told more of it than was known.
    """

    time_offset: float
    time_offset_sd: float
    imu_to_antenna: FloatArray
    imu_to_antenna_sd: FloatArray
    covariance: FloatArray
    roll_pitch_heading: FloatArray
    agreement: float
    searched_offset: float
    residual_ratio: float
    stretches: int
    lever_arm_shows: NDArray[np.bool_]


def estimate_mounting(
    imu: ImuSeries,
    antenna: AntennaSeries,
    *,
    quat_nb: FloatArray | None = None,
    lever_arm: FloatArray | None = None,
    config: MountingConfig | None = None,
) -> Mounting:
    """Estimate time offset and lever arm.

    Parameters
    ----------
    imu : ImuSeries
    antenna : AntennaSeries
        Positions or velocities.
    quat_nb : ndarray, shape (4,), optional
        Surveyed attitude at the IMU's first sample; without, it is levelled over ``level_s`` at
        the start, and the heading found.
    lever_arm : ndarray, shape (3,), optional
        What is known of it, forward, left, up [m].
    config : MountingConfig, optional

    Raises
    ------
    InputError
        The two do not overlap, do not move, or do not agree.
    """
    config = config or MountingConfig()
    try:
        check(config)
    except ValueError as error:
        raise InputError("mounting", str(error)) from None
    still = imu.before(imu.time[0] + config.level_s)
    omega_b = still.delta_theta_b.sum(axis=0) / still.dt.sum()
    first = _levelled(still) if quat_nb is None else np.asarray(quat_nb, np.float64)
    bias = omega_b if np.linalg.norm(omega_b) < 3.0 * config.gyro_bias_sd else np.zeros(3)
    rough = search.search(
        search.velocity_spectrum_source(imu, _attitudes(imu, antenna, first, bias)),
        antenna,
        config.largest_offset,
        heading_known=quat_nb is not None,
    )
    if not rough.agreement >= config.least_agreement:
        reason = f"IMU and GNSS agree by {rough.agreement:.2f} only, at {rough.offset:+.3f} s"
        raise InputError("mounting", reason, "more motion, or the IMU's axes are not as said")
    if quat_nb is None:
        turn = np.array([0.0, 0.0, np.sin(0.5 * rough.turn), np.cos(0.5 * rough.turn)])
        first = quat_multiply(turn, first)
    prior = np.zeros(3) if lever_arm is None else flu_from_frd(lever_arm)
    found = fit.fit_mounting(
        imu, antenna, _attitudes(imu, antenna, first, bias), bias, rough.offset, prior, config
    )
    sd = np.sqrt(np.diag(found.covariance))
    return Mounting(
        time_offset=found.offset,
        time_offset_sd=float(sd[0]),
        imu_to_antenna=flu_from_frd(found.lever_arm),
        imu_to_antenna_sd=sd[1:],
        covariance=_outside(found.covariance),
        roll_pitch_heading=euler_from_quat(found.first_quat_nb),
        agreement=rough.agreement,
        searched_offset=rough.offset,
        residual_ratio=found.residual_ratio,
        stretches=found.stretches,
        lever_arm_shows=sd[1:] < 0.5 * config.lever_arm_sd,
    )


def _levelled(still: ImuSeries) -> FloatArray:
    """Level by gravity, heading north."""
    force = still.delta_vel_b.sum(axis=0)
    down = -force / np.linalg.norm(force)
    pitch = np.arcsin(np.clip(-down[0], -1.0, 1.0))
    return quat_from_euler(np.array([np.arctan2(down[1], down[2]), pitch, 0.0]))


def _attitudes(
    imu: ImuSeries, antenna: AntennaSeries, first: FloatArray, bias: FloatArray
) -> FloatArray:
    """Carry the attitude through the whole recording, shape (n + 1, 4)."""
    out = np.empty((len(imu.time) + 1, 4))
    theta = imu.delta_theta_b - bias * imu.dt[:, None]
    attitude_kernel(first, theta, imu.dt, earth_rate(antenna.latitude), out)
    return out


def _outside(covariance: FloatArray) -> FloatArray:
    """Turn the lever arm's part to forward, left, up."""
    sign = np.array([1.0, 1.0, -1.0, -1.0])
    return covariance * np.outer(sign, sign)
