"""What a measurement says about the errors of inertial navigation.

Each is ``z = H x + D e + v``: prediction minus measurement, its sensitivity to the 15 states
(`deepseis_ins.error_state`) and to the error of a reference attitude, and the covariance R of v.
Thesis 2.26 and 2.27 have the antenna at the IMU; here it stands at a lever arm.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from deepseis_core.errors import InputError
from deepseis_core.rotation import rotvec_from_matrix
from deepseis_core.types import FloatArray
from deepseis_ins import measurement_kernels as kernels
from deepseis_ins.error_state import ATT, POS, STATES, VEL
from deepseis_ins.measurement_kernels import matrix_of
from deepseis_ins.strapdown import NavState


def _no_reference() -> FloatArray:
    return np.zeros((3, 3))


@dataclass(frozen=True)
class Measurement:
    """Three values, north, east, down.

    Attributes
    ----------
    z : ndarray, shape (3,)
        Prediction minus measurement [m, m/s or rad].
    H : ndarray, shape (3, 15)
        Sensitivity to the errors of the states.
    R : ndarray, shape (3, 3)
        Covariance of the measurement.
    name : str
        Its kind: innovations are gated and counted by it.
    states : slice
        The states it measures; they are widened when the gate has to be opened.
    D : ndarray, shape (3, 3)
        Sensitivity to the error of the reference attitude.
    recovers : bool
        Whether many of its kind that are refused prove the filter wrong.
    """

    z: FloatArray
    H: FloatArray
    R: FloatArray
    name: str
    states: slice
    D: FloatArray = field(default_factory=_no_reference)
    recovers: bool = True


def gnss_position(
    nav: NavState, position_ecef: ArrayLike, covariance_ecef: ArrayLike, lever_arm_b: ArrayLike
) -> Measurement:
    """Compare the antenna's position: ``H = [I 0 [C l x] 0 0]``.

    Parameters
    ----------
    nav : NavState
        Of the filter, at the time of the measurement.
    position_ecef : array_like, shape (3,)
        Of the antenna [m].
    covariance_ecef : array_like, shape (3, 3)
        [m^2]
    lever_arm_b : array_like, shape (3,)
        From the IMU to the antenna, forward-right-down [m].

    Raises
    ------
    InputError
        Something is not finite or has the wrong shape.
    """
    position, R, lever = _checked("GNSS position", position_ecef, covariance_ecef, lever_arm_b)
    z, H, R_n = np.empty(3), np.zeros((3, STATES)), np.empty((3, 3))
    kernels.position_kernel(
        nav.latitude, nav.longitude, nav.height, nav.quat_nb, lever, position, R, z, H, R_n
    )
    return Measurement(z, H, R_n, "position", POS)


def gnss_velocity(
    nav: NavState,
    omega_ib_b: ArrayLike,
    velocity_ecef: ArrayLike,
    covariance_ecef: ArrayLike,
    lever_arm_b: ArrayLike,
    *,
    rate_sd: float = 0.0,
) -> Measurement:
    """Compare the antenna's velocity over ground.

    ``v + C (omega_ib x l) - omega_ie x C l`` is predicted, and
    ``H = [0 I ([C (omega_ib x l) x] - [omega_ie x][C l x]) -C [l x] 0]``.

    Parameters
    ----------
    nav : NavState
    omega_ib_b : array_like, shape (3,)
        Angular rate without bias, forward-right-down [rad/s]; `LooseFilter.omega_ib_b`.
    velocity_ecef, covariance_ecef, lever_arm_b : array_like
        As in `gnss_position` [m/s, m^2/s^2, m].
    rate_sd : float
        White noise of ``omega_ib_b`` [rad/s], which the lever arm turns into velocity.
    """
    velocity, R, lever = _checked("GNSS velocity", velocity_ecef, covariance_ecef, lever_arm_b)
    omega = np.ascontiguousarray(omega_ib_b, np.float64)
    if omega.shape != (3,) or not np.isfinite(omega).all():
        raise InputError("angular rate", "is not three finite numbers", "rad/s")
    z, H, R_n = np.empty(3), np.zeros((3, STATES)), np.empty((3, 3))
    kernels.velocity_kernel(
        nav.latitude, nav.longitude, nav.vel_n, nav.quat_nb, omega, lever, velocity, R, rate_sd,
        z, H, R_n,
    )  # fmt: skip
    return Measurement(z, H, R_n, "velocity", VEL)


def zero_velocity(nav: NavState, sd: ArrayLike) -> Measurement:
    """Say that the body stands still: ``H = [0 I 0 0 0]`` (thesis 3.24 to 3.26).

    Parameters
    ----------
    nav : NavState
    sd : array_like, shape () or (3,)
        What is left of movement while still, white [m/s].
    """
    H = np.zeros((3, STATES))
    H[:, VEL] = np.eye(3)
    return Measurement(np.array(nav.vel_n, np.float64), H, _variance(sd), "zero_velocity", VEL)


def zero_angle(nav: NavState, C_nb_reference: ArrayLike, sd: ArrayLike) -> Measurement:
    """Say that the body stands as it is known to stand (thesis 3.27 to 3.37, corrected).

    With ``C_hat C_ref^T = exp(-[zeta x])`` measured is ``zeta = phi - e + w``, e being the error
    of the reference itself. It is the same at every update: the filter knows it as one constant
    (`LooseFilter.refer_attitude`), and no repetition averages it away.

    Parameters
    ----------
    nav : NavState
    C_nb_reference : array_like, shape (3, 3)
        Reference attitude, forward-right-down to north-east-down.
    sd : array_like, shape () or (3,)
        How far the body turns about it while still, white [rad]; not the error of the reference.
    """
    C_ref = np.asarray(C_nb_reference, np.float64)
    if C_ref.shape != (3, 3) or not np.allclose(C_ref @ C_ref.T, np.eye(3), atol=1e-6):
        raise InputError("reference attitude", "is not a rotation matrix", "C_nb, 3 by 3")
    H = np.zeros((3, STATES))
    H[:, ATT] = np.eye(3)
    zeta = -rotvec_from_matrix(matrix_of(nav.quat_nb) @ C_ref.T)
    return Measurement(zeta, H, _variance(sd), "zero_angle", ATT, -np.eye(3))


def _checked(
    name: str, value: ArrayLike, covariance: ArrayLike, lever_arm_b: ArrayLike
) -> tuple[FloatArray, FloatArray, FloatArray]:
    shapes = (3,), (3, 3), (3,)
    arrays = [np.ascontiguousarray(each, np.float64) for each in (value, covariance, lever_arm_b)]
    for what, array, shape in zip(("", "'s covariance", "'s lever arm"), arrays, shapes,
                                  strict=True):  # fmt: skip
        if array.shape != shape:
            raise InputError(name + what, f"has shape {array.shape}", f"{shape}")
        if not np.isfinite(array).all():
            raise InputError(name + what, "is not finite")
    return arrays[0], arrays[1], arrays[2]


def _variance(sd: ArrayLike) -> FloatArray:
    sds = np.broadcast_to(np.asarray(sd, np.float64), (3,))
    if not (np.all(sds > 0.0) and np.isfinite(sds).all()):
        raise InputError("standard deviation of a constraint", f"is {sd!r}", "a positive number")
    return np.diag(sds**2)
