"""The errors of inertial navigation, and how they grow: layout, model, noise.

The 15 states (thesis 2.23) are, along north, east, down ``n`` and body forward-right-down ``b``:

=====  =========================================================================
POS    position, estimate minus truth [m]: metres of latitude, longitude, depth
VEL    velocity, components of the estimate minus those of the truth [m/s]
ATT    phi [rad]: the estimate is ``C_hat_nb = (I - [phi x]) C_nb``
GYRO   bias of the gyroscopes not yet removed, b [rad/s]
ACCEL  bias of the accelerometers not yet removed, ``b + M f_ref`` [m/s^2]
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
motion, and no gain is spent on them. What gravity makes of M, in the attitude of the start where
``f_ref`` is felt, cannot be told from bias and counts as such; ``M (f - f_ref)`` is considered.
The model is linear in M: it holds up to a per cent or so.

With the error of the attitude that `zero_angle` refers to, which is estimated, they are the 21
constants behind the states.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from deepseis_core.imu_grades import ImuGrade, TriadGrade
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
    """First-order Gauss-Markov processes: sd and correlation time [s] of three axes, (3,)."""

    sd: FloatArray
    correlation_time: FloatArray


def bias_model(triad: TriadGrade, constant: ArrayLike = 0.0) -> BiasModel:
    """Return the processes that stand for turn-on and in-run bias together; see the module.

    Parameters
    ----------
    triad : TriadGrade
    constant : array_like, shape () or (3,)
        Variance of what else is constant.
    """
    wander = triad.instability**2
    total = np.broadcast_to(triad.bias**2 + np.asarray(constant) + wander, (3,))
    with np.errstate(divide="ignore", invalid="ignore"):
        time = np.where(wander > 0.0, triad.correlation_time * total / wander, np.inf)
    return BiasModel(np.sqrt(total), time)


def matrix_variance(triad: TriadGrade, true_b: FloatArray) -> FloatArray:
    """Return what scale factors and misalignments make of a vector, variances, shape (3,)."""
    square = true_b**2
    return triad.scale**2 * square + triad.misalignment**2 * (square.sum() - square)


def bias_models(grade: ImuGrade, force_ref_b: FloatArray) -> tuple[BiasModel, BiasModel]:
    """Return those of gyroscopes and accelerometers under a steady force, shape (3,) [m/s^2].

    Gyroscopes that are sensitive to it have a bias of it. What shaking makes of that averages
    out: 1 deg/h/g at 2 g and 1 Hz is 1.5 urad.
    """
    felt = (grade.gyros.g_sensitivity**2) * float(force_ref_b @ force_ref_b)
    accelerometers = grade.accelerometers
    return (
        bias_model(grade.gyros, felt),
        bias_model(accelerometers, matrix_variance(accelerometers, force_ref_b)),
    )


def noise_model(grade: ImuGrade, force_ref_b: FloatArray) -> FloatArray:
    """Return the array of noise figures that the kernels want; offsets there."""
    model = np.zeros(kernels.MODEL_SIZE)
    model[kernels.GYRO_WALK2] = grade.gyros.walk**2
    model[kernels.ACCEL_WALK2] = grade.accelerometers.walk**2
    for first, bias in zip((0, 3), bias_models(grade, force_ref_b), strict=True):
        part = slice(kernels.BIAS_VARIANCE + first, kernels.BIAS_VARIANCE + first + 3)
        model[part] = bias.sd**2
        part = slice(kernels.BIAS_RATE + first, kernels.BIAS_RATE + first + 3)
        model[part] = 1.0 / bias.correlation_time
    model[kernels.FORCE_REF : kernels.FORCE_REF + 3] = force_ref_b
    return model


def constants_block(force_ref_b: FloatArray) -> FloatArray:
    """Return what ``M f_ref`` is of the constants, shape (3, 21)."""
    block = np.zeros((3, CONSTANTS))
    for i in range(3):
        block[i, ACCEL_MATRIX.start + 3 * i : ACCEL_MATRIX.start + 3 * i + 3] = force_ref_b
    return block


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
    model = noise_model(grade, np.zeros(3))
    kernels.dynamics_kernel(F, nav.latitude, nav.height, vel_n, force, C_nb, model)
    return F
