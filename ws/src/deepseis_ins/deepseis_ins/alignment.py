"""Attitude and biases at rest, before a filter starts: surveyed, levelled, gyrocompassed.

A station's attitude is surveyed; a vehicle's is levelled by gravity, and a tactical grade finds
north from the Earth's rate (P. D. Groves, "Principles of GNSS, Inertial, and Multisensor
Integrated Navigation Systems", 2nd ed., section 5.6). Axes are north-east-down and
forward-right-down; attitude errors are phi of `deepseis_ins.error_state`, and so are their
covariances. What comes out is what `LooseFilter` wants to start with.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from deepseis_core.constants import WGS84_EARTH_RATE
from deepseis_core.errors import InputError
from deepseis_core.geodesy import normal_gravity
from deepseis_core.imu_grades import ImuGrade, TriadGrade
from deepseis_core.rotation import (
    matrix_from_euler,
    matrix_from_quat,
    quat_from_matrix,
)
from deepseis_core.types import FloatArray
from deepseis_ins.error_state import bias_model, matrix_variance
from deepseis_ins.nav_array import covariance, increments

_MOVING = 0.05  # of gravity: a mean force this far from it is no stillness
_HEADING_SD_MAX = 0.2  # [rad] beyond it the filter is not linear


@dataclass(frozen=True)
class Alignment:
    """Attitude, shape (4,), and the covariance of its phi, north, east, down [rad^2]."""

    quat_nb: FloatArray
    covariance: FloatArray

    @property
    def sd(self) -> FloatArray:
        """Standard deviations about north, east, down, shape (3,) [rad]."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def C_nb(self) -> FloatArray:  # noqa: N802
        """Matrix, shape (3, 3)."""
        return matrix_from_quat(self.quat_nb)


@dataclass(frozen=True)
class Still:
    """Means over a stretch at rest, forward-right-down.

    Attributes
    ----------
    omega_b, force_b : ndarray, shape (3,)
        Mean angular rate [rad/s] and specific force [m/s^2].
    duration : float
        [s]
    """

    omega_b: FloatArray
    force_b: FloatArray
    duration: float


@dataclass(frozen=True)
class Bias:
    """A bias at the end of the stretch that it was estimated from, and its sd; shapes (3,)."""

    value: FloatArray
    sd: FloatArray


def still_mean(delta_theta_b: ArrayLike, delta_vel_b: ArrayLike, dt: ArrayLike) -> Still:
    """Average increments; arguments of `Strapdown.propagate`.

    Raises
    ------
    InputError
        There is no sample.
    """
    theta, vel, dts = increments(delta_theta_b, delta_vel_b, dt)
    duration = float(dts.sum())
    if duration <= 0.0:
        raise InputError("alignment", "there is no sample to average")
    return Still(theta.sum(axis=0) / duration, vel.sum(axis=0) / duration, duration)


def surveyed(roll_pitch_heading: ArrayLike, sd: ArrayLike) -> Alignment:
    """Take an attitude as given.

    Parameters
    ----------
    roll_pitch_heading : array_like, shape (3,)
        [rad]
    sd : array_like, shape () or (3,)
        Of the turns about north, east and down that are left [rad].
    """
    euler = np.asarray(roll_pitch_heading, np.float64)
    if euler.shape != (3,) or not np.isfinite(euler).all():
        raise InputError("surveyed attitude", "is not roll, pitch, heading", "three numbers, rad")
    quat_nb = quat_from_matrix(matrix_from_euler(euler))
    return Alignment(quat_nb, covariance("surveyed attitude", sd))


def levelled(
    still: Still,
    heading: float,
    heading_sd: float,
    latitude: float,
    height: float,
    grade: ImuGrade,
) -> Alignment:
    """Level by gravity; the heading is given.

    ``sin(pitch) = f_x / g``, ``tan(roll) = f_y / f_z``; an accelerometer's error ``df`` across
    gravity tilts by ``df / g``.

    Parameters
    ----------
    still : Still
    heading, heading_sd : float
        [rad]
    latitude, height : float
        Geodetic [rad, m].
    grade : ImuGrade
        Its accelerometers' errors make the covariance.
    """
    g = _gravity(still, latitude, height)
    down = -still.force_b / np.linalg.norm(still.force_b)
    pitch, roll = np.arcsin(np.clip(-down[0], -1.0, 1.0)), np.arctan2(down[1], down[2])
    C_nb = matrix_from_euler(np.array([roll, pitch, heading]))
    error = _mean_covariance(grade.accelerometers, still.duration, still.force_b, C_nb)
    # Level is where f - phi x f + df has no horizontal part.
    by_force = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]) / g
    P = by_force @ error @ by_force.T
    P[2, 2] = heading_sd**2
    return Alignment(quat_from_matrix(C_nb), P)


def gyrocompassed(still: Still, latitude: float, height: float, grade: ImuGrade) -> Alignment:
    """Level by gravity and find north from the Earth's rate.

    The horizontal rate is ``w cos(lat)`` northward. A gyroscope's error ``dw`` eastward turns
    the heading by ``dw / (w cos(lat))``, a tilt about north by its ``tan(lat)``, so that heading
    and tilt are correlated.

    The tilt found has the accelerometers' bias in it: `LooseFilter`, which takes the two for
    independent, is a little too careful at first.

    Raises
    ------
    InputError
        The gyroscopes drown the Earth's rate: the heading's sd would exceed 0.2 rad.
    """
    level = levelled(still, 0.0, 0.0, latitude, height, grade)
    rate = level.C_nb @ still.omega_b
    heading = float(np.arctan2(-rate[1], rate[0]))
    found = levelled(still, heading, 0.0, latitude, height, grade)
    earth_b = found.C_nb.T @ earth_rate(latitude)
    error = _mean_covariance(grade.gyros, still.duration, earth_b, found.C_nb)
    # North is where omega - phi x omega + domega has no east part.
    P, tan_lat = found.covariance, np.tan(latitude)
    P[2, :2] = P[:2, 2] = -tan_lat * P[0, :2]
    P[2, 2] = error[1, 1] / (WGS84_EARTH_RATE * np.cos(latitude)) ** 2 + tan_lat**2 * P[0, 0]
    if not P[2, 2] < _HEADING_SD_MAX**2:
        raise InputError(
            "gyrocompassing",
            f"the heading would be good to {np.degrees(np.sqrt(P[2, 2])):.3g} deg only",
            "give the heading, or a better grade, or a longer still",
        )
    return found


def gyro_bias(still: Still, alignment: Alignment, latitude: float, grade: ImuGrade) -> Bias:
    """Estimate the gyroscopes' bias at rest in a known attitude: mean less the Earth's rate.

    What is left is the noise of the mean, the bias's wander between the stretch's middle and its
    end, and the Earth's rate in axes that are ``alignment.sd`` off.
    """
    earth = earth_rate(latitude)
    C_bn = alignment.C_nb.T
    earth_b = C_bn @ earth
    turned = np.cross(np.eye(3), earth)
    by_attitude = np.diag(C_bn @ turned @ alignment.covariance @ turned.T @ C_bn.T)
    triad = grade.gyros
    variance = _noise_variance(triad, still.duration) + matrix_variance(triad, earth_b)
    return Bias(still.omega_b - earth_b, np.sqrt(variance + by_attitude))


def earth_rate(latitude: float) -> FloatArray:
    """Return the Earth's rate, north, east, down, shape (3,) [rad/s]."""
    return WGS84_EARTH_RATE * np.array([np.cos(latitude), 0.0, -np.sin(latitude)])


def _gravity(still: Still, latitude: float, height: float) -> float:
    g = float(normal_gravity(latitude, height))
    force = float(np.linalg.norm(still.force_b))
    if not abs(force - g) < _MOVING * g:
        raise InputError(
            "alignment", f"the mean specific force is {force:.4g} m/s^2", f"{g:.4g} at rest"
        )
    return g


def _mean_covariance(
    triad: TriadGrade, duration: float, true_b: FloatArray, C_nb: FloatArray
) -> FloatArray:
    """Return the covariance along n of the error of a mean, shape (3, 3)."""
    variance = bias_model(triad).sd ** 2 + triad.walk**2 / duration
    return C_nb @ np.diag(variance + matrix_variance(triad, true_b)) @ C_nb.T


def _noise_variance(triad: TriadGrade, duration: float) -> float:
    """Return the variance of mean minus value at the end, white noise and in-run bias.

    Of a Gauss-Markov process, with ``a = duration / T``:
    ``s^2 (1 + 2 (a - 1 + exp(-a)) / a^2 - 2 (1 - exp(-a)) / a)``.
    """
    a = duration / triad.correlation_time
    if a < 1e-3:
        wander = 2.0 / 3.0 * a  # the rest is lost to rounding below here
    else:
        e = np.exp(-a)
        wander = 1.0 + 2.0 * (a - 1.0 + e) / a**2 - 2.0 * (1.0 - e) / a
    return float(triad.walk**2 / duration + triad.instability**2 * wander)
