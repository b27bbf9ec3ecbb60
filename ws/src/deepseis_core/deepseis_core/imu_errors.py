"""What a real inertial measurement unit makes of true increments.

For the gyroscopes, and alike for the accelerometers (thesis 2.7 and 3.13), with ``dt`` the
interval of a sample::

    measured = quantise(clip((I + M) true + (b + GM + G f) dt + walk sqrt(dt) w))

``M`` has scale factor errors on its diagonal and misalignments off it, ``b`` is the turn-on bias,
``GM`` the in-run bias, a first-order Gauss-Markov process, ``G f`` the gyroscopes' sensitivity to
specific force, ``w`` unit white noise. The sensor saturates at its range; what the quantiser
leaves over goes into the next increment, so that sums of increments stay true to one step.

Axes are forward, left, up; increments are of the angle [rad] and of the velocity [m/s].
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from deepseis_core.errors import InputError
from deepseis_core.imu_grades import GRADES, ImuGrade, TriadGrade, grade_named
from deepseis_core.noise_processes import GaussMarkovNoise, WhiteNoise
from deepseis_core.types import FloatArray

__all__ = [
    "GRADES",
    "ImuErrors",
    "ImuFlag",
    "ImuGrade",
    "ImuTruth",
    "MeasuredIncrements",
    "grade_named",
]

CONSTANTS_STREAM: Final = 40
"""Streams of random numbers: what is constant in a run, white noise, in-run bias."""
WHITE_STREAM: Final = 41
WANDER_STREAM: Final = 42

GYROS, ACCELEROMETERS = slice(0, 3), slice(3, 6)


class ImuFlag(IntFlag):
    """What is wrong with one sample."""

    GYRO_CLIPPED = 1
    ACCEL_CLIPPED = 2
    NO_GYROS = 4


@dataclass(frozen=True)
class MeasuredIncrements:
    """Increments as the unit gives them.

    Attributes
    ----------
    delta_theta, delta_vel : ndarray, shape (m, 3)
        Increments [rad, m/s]. A unit without gyroscopes has no angles: NaN, and
        ``ImuFlag.NO_GYROS``; in sensor_msgs/Imu that is ``angular_velocity_covariance[0] = -1``.
    flags : ndarray of uint8, shape (m,)
        Bits of `ImuFlag`.
    """

    delta_theta: FloatArray
    delta_vel: FloatArray
    flags: NDArray[np.uint8]


@dataclass(frozen=True)
class ImuTruth:
    """The errors that a unit really has.

    Attributes
    ----------
    gyro_bias, accel_bias : ndarray, shape (m, 3)
        Turn-on and in-run bias together, at samples [rad/s, m/s^2].
    gyro_matrix, accel_matrix : ndarray, shape (3, 3)
        ``M``: scale factor errors and misalignments, the share of true that is added.
    gyro_g_matrix : ndarray, shape (3, 3)
        ``G``: rate for a specific force [rad/s per m/s^2].
    """

    gyro_bias: FloatArray
    accel_bias: FloatArray
    gyro_matrix: FloatArray
    accel_matrix: FloatArray
    gyro_g_matrix: FloatArray


class ImuErrors:
    """One unit, as drawn by a seed.

    Parameters
    ----------
    grade : ImuGrade
    rate_hz : float
        Increments a second.
    seed : int
        Same seed, same unit.
    """

    def __init__(self, grade: ImuGrade, rate_hz: float, seed: int) -> None:
        if not 0.0 < rate_hz <= grade.max_rate_hz:
            raise InputError(
                "IMU rate", f"is {rate_hz:g} Hz", f"this grade gives up to {grade.max_rate_hz:g}"
            )
        self.grade, self.rate_hz = grade, rate_hz
        triads = (grade.gyros, grade.accelerometers)
        self._white = WhiteNoise(seed, WHITE_STREAM, 6)
        self._wander = GaussMarkovNoise(
            seed,
            WANDER_STREAM,
            np.repeat([triad.instability for triad in triads], 3),
            np.repeat([triad.correlation_time for triad in triads], 3),
            1.0 / rate_hz,
        )
        rng = np.random.default_rng([seed, CONSTANTS_STREAM])
        self._units = [_Triad(triad, rate_hz, rng) for triad in triads]
        self._next = 0

    @property
    def clipped(self) -> NDArray[np.int64]:
        """Samples so far at the limits of their range, shape (6,): gyroscopes first."""
        return np.concatenate([unit.clipped for unit in self._units])

    def apply(
        self, first: int, delta_theta: FloatArray, delta_vel: FloatArray
    ) -> MeasuredIncrements:
        """Measure the true increments of samples ``first, first + 1, ...``.

        Chunks follow one another from sample 0, cut anyhow.

        Parameters
        ----------
        first : int
            Number of the first sample.
        delta_theta, delta_vel : ndarray, shape (m, 3)
            True increments [rad, m/s]; the latter of specific force.
        """
        theta = _increments("angle increments", delta_theta)
        vel = _increments("velocity increments", delta_vel)
        if first != self._next or theta.shape != vel.shape:
            raise InputError(
                "IMU increments",
                f"{len(theta)} angles and {len(vel)} velocities from sample {first}",
                f"sample {self._next} is next, with as many of both",
            )
        self._next += len(theta)
        white, wander = self._white(first, len(theta)), self._wander(first, len(theta))
        flags = np.zeros(len(theta), np.uint8)
        gyros, accelerometers = self._units
        measured_vel = accelerometers.measure(
            vel, vel, white[:, ACCELEROMETERS], wander[:, ACCELEROMETERS],
            flags, ImuFlag.ACCEL_CLIPPED,
        )  # fmt: skip
        if not self.grade.has_gyros:
            flags |= np.uint8(ImuFlag.NO_GYROS)
            return MeasuredIncrements(np.full_like(theta, np.nan), measured_vel, flags)
        measured_theta = gyros.measure(
            theta, vel, white[:, GYROS], wander[:, GYROS], flags, ImuFlag.GYRO_CLIPPED
        )
        return MeasuredIncrements(measured_theta, measured_vel, flags)

    def truth(self, first: int, count: int) -> ImuTruth:
        """Return the errors drawn, with the biases of samples ``first .. first + count``."""
        wander = self._wander(first, count)
        gyros, accelerometers = self._units
        return ImuTruth(
            gyro_bias=gyros.bias + wander[:, GYROS],
            accel_bias=accelerometers.bias + wander[:, ACCELEROMETERS],
            gyro_matrix=gyros.matrix.copy(),
            accel_matrix=accelerometers.matrix.copy(),
            gyro_g_matrix=gyros.coupling.copy(),
        )


class _Triad:
    """Three sensors: what is constant of them, and the quantisers' remainders."""

    def __init__(self, grade: TriadGrade, rate_hz: float, rng: np.random.Generator) -> None:
        # Everything is drawn whether its sigma is zero or not: the grades of one seed have the
        # same errors but for their sizes, and a comparison of grades compares just these.
        self.bias = grade.bias * rng.standard_normal(3)
        scale = grade.scale * rng.standard_normal(3)
        self.matrix = grade.misalignment * rng.standard_normal((3, 3))
        np.fill_diagonal(self.matrix, scale)
        self.coupling = grade.g_sensitivity * rng.standard_normal((3, 3))
        self.clipped = np.zeros(3, np.int64)
        self._remainder = np.zeros(3)
        self._dt = 1.0 / rate_hz
        self._walk = grade.walk * np.sqrt(self._dt)
        self._limit, self._resolution = grade.range * self._dt, grade.resolution

    def measure(
        self,
        true: FloatArray,
        force: FloatArray,
        white: FloatArray,
        wander: FloatArray,
        flags: NDArray[np.uint8],
        bit: ImuFlag,
    ) -> FloatArray:
        out = np.empty_like(true)
        measure_triad(
            true, force, white, wander, self.matrix, self.coupling, self.bias, self._dt,
            self._walk, self._limit, self._resolution, self._remainder, out, flags,
            np.uint8(bit), self.clipped,
        )  # fmt: skip
        return out


def _increments(name: str, values: FloatArray) -> FloatArray:
    array = np.ascontiguousarray(values, np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError(name, f"have shape {array.shape}", "one row of three a sample")
    if not np.isfinite(array).all():
        raise InputError(name, "are not all finite numbers")
    return array


@njit(cache=True, nogil=True)
def measure_triad(
    true: FloatArray,
    force: FloatArray,
    white: FloatArray,
    wander: FloatArray,
    error: FloatArray,
    coupling: FloatArray,
    bias: FloatArray,
    dt: float,
    walk: float,
    limit: float,
    resolution: float,
    remainder: FloatArray,
    out: FloatArray,
    flags: NDArray[np.uint8],
    bit: np.uint8,
    clipped: NDArray[np.int64],
) -> None:
    """Write the measured increments of three sensors; see the module for the equation."""
    for k in range(true.shape[0]):
        for i in range(3):
            value = (bias[i] + wander[k, i]) * dt + walk * white[k, i]
            for j in range(3):
                value += error[i, j] * true[k, j] + coupling[i, j] * force[k, j]
            value += true[k, i]
            if abs(value) > limit:
                value = limit if value > 0.0 else -limit
                clipped[i] += 1
                flags[k] |= bit
            if resolution > 0.0:
                wanted = value + remainder[i]
                value = np.rint(wanted / resolution) * resolution
                remainder[i] = wanted - value
            out[k, i] = value
