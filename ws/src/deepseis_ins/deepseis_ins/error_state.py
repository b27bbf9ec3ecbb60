"""The errors of inertial navigation, and how they grow: layout, model, noise.

The 15 states (thesis 2.23) are, along north, east, down ``n`` and body forward-right-down ``b``:

=====  =========================================================================
POS    position, estimate minus truth [m]: metres of latitude, longitude, depth
VEL    velocity, components of the estimate minus those of the truth [m/s]
ATT    phi [rad]: the estimate is ``C_hat_nb = (I - [phi x]) C_nb``
GYRO   bias of the gyroscopes not yet removed, b [rad/s]
ACCEL  bias of the accelerometers not yet removed, b [m/s^2]
=====  =========================================================================

Bias. A grade has a turn-on bias, constant with sd ``b0``, and an in-run one, Gauss-Markov with
``s`` and ``T``. One state stands for their sum: a Gauss-Markov process of variance
``V = b0^2 + s^2`` and correlation time ``T V / s^2``. Its variance is right at all times, and so
is the noise that drives it, ``2 s^2 / T``; its correlation, ``exp(-t s^2 / (T V))``, never
exceeds the true one, ``(b0^2 + s^2 exp(-t/T)) / V`` (Jensen), so that the filter does not trust
a bias for longer than it lasts.

Scale factors and misalignments are constants ``M`` that act with the motion: ``M f`` and
``M omega`` in body axes. They are no states, and white noise cannot stand for them: what 300 ppm
do to a shake of 2 g at 1 Hz is a velocity error of 1 mm/s that swings back, while noise
accumulates. They are *considered* (`deepseis_core.kalman`): the covariance is exact for any
motion, and no gain is spent on them.

With the error of the attitude that `zero_angle` refers to, which is estimated, they are the 21
constants behind the states.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from deepseis_core.imu_grades import STANDARD_GRAVITY, ImuGrade, TriadGrade
from deepseis_core.rotation import matrix_from_quat
from deepseis_core.types import FloatArray
from deepseis_ins import error_state_kernels as kernels
from deepseis_ins.strapdown import NavState

POS: Final = slice(0, 3)
VEL: Final = slice(3, 6)
ATT: Final = slice(6, 9)
GYRO: Final = slice(9, 12)
ACCEL: Final = slice(12, 15)
STATES: Final = kernels.STATES

REFERENCE: Final = slice(0, 3)
"""Of the constants: error of the reference attitude, in the sense of phi [rad]."""
ACCEL_MATRIX: Final = slice(3, 12)
"""``M`` of the accelerometers, row by row."""
GYRO_MATRIX: Final = slice(12, 21)
CONSTANTS: Final = kernels.CONSTANTS


@dataclass(frozen=True)
class BiasModel:
    """First-order Gauss-Markov process: standard deviation and correlation time [s]."""

    sd: float
    correlation_time: float


def bias_model(triad: TriadGrade) -> BiasModel:
    """Return the process that stands for turn-on and in-run bias together; see the module.

    Gyroscopes feel the 1 g of gravity: what it makes of their sensitivity is constant, and
    counts as turn-on bias. What shaking makes of it averages out.
    """
    constant = triad.bias**2 + (triad.g_sensitivity * STANDARD_GRAVITY) ** 2
    wander = triad.instability**2
    if wander == 0.0:
        return BiasModel(constant**0.5, np.inf)
    total = constant + wander
    return BiasModel(total**0.5, triad.correlation_time * total / wander)


def noise_model(grade: ImuGrade) -> FloatArray:
    """Return the array of noise figures that the kernels want; offsets there."""
    gyro, accel = bias_model(grade.gyros), bias_model(grade.accelerometers)
    model = np.zeros(kernels.MODEL_SIZE)
    model[kernels.GYRO_WALK2] = grade.gyros.walk**2
    model[kernels.ACCEL_WALK2] = grade.accelerometers.walk**2
    model[kernels.GYRO_VARIANCE] = gyro.sd**2
    model[kernels.GYRO_RATE] = 1.0 / gyro.correlation_time
    model[kernels.ACCEL_VARIANCE] = accel.sd**2
    model[kernels.ACCEL_RATE] = 1.0 / accel.correlation_time
    return model


def constants_covariance(grade: ImuGrade) -> FloatArray:
    """Return the covariance, shape (21, 21), of the constants; the reference is exact."""
    variance = np.zeros(CONSTANTS)
    for part, triad in ((ACCEL_MATRIX, grade.accelerometers), (GYRO_MATRIX, grade.gyros)):
        matrix = np.full((3, 3), triad.misalignment**2)
        np.fill_diagonal(matrix, triad.scale**2)
        variance[part] = matrix.ravel()
    return np.diag(variance)


def dynamics(nav: NavState, force_n: FloatArray, grade: ImuGrade) -> FloatArray:
    """Return ``F``, shape (15, 15), of ``dx/dt = F x + w`` [SI].

    Thesis 2.14 to 2.22 as derived anew from the mechanisation (the print has errors), with the
    gradient of gravity along the meridian.

    Parameters
    ----------
    nav : NavState
    force_n : ndarray, shape (3,)
        Specific force, north, east, down [m/s^2].
    grade : ImuGrade
        For the correlation times of the biases.
    """
    F = np.zeros((STATES, STATES))
    C_nb = np.ascontiguousarray(matrix_from_quat(nav.quat_nb))
    force = np.ascontiguousarray(force_n, np.float64)
    vel_n = np.ascontiguousarray(nav.vel_n, np.float64)
    kernels.dynamics_kernel(F, nav.latitude, nav.height, vel_n, force, C_nb, noise_model(grade))
    return F
