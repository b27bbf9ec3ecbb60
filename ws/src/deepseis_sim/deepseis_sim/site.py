"""Where the bench stands: from the tangent frame of a motion to ECEF, and to points on the body.

Positions, velocities and accelerations in ECEF are plain derivatives of the coordinates (no
Coriolis term, no gravity), as everywhere in DeepSeis.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from deepseis_core.errors import InputError
from deepseis_core.geodesy import ecef_from_geodetic, rotation_enu_ecef
from deepseis_core.rotation import quat_from_matrix
from deepseis_core.types import FloatArray
from deepseis_sim.motion import Kinematics, Motion
from deepseis_sim.motions_attitude import turn

_STEP = 2.0**-12
"""Of the difference quotients of the angular rate [s]: a power of two, as t + step is exact."""

ORIGIN_OF_BODY = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class EcefStates:
    """A point at m times: position, velocity, acceleration [m, m/s, m/s^2], each (m, 3)."""

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray


class Site:
    """The tangent frame's place on the Earth.

    Parameters
    ----------
    origin_geodetic : array_like, shape (3,)
        Latitude [rad], longitude [rad], height [m]; `Surroundings.origin`.

    Attributes
    ----------
    origin_ecef : ndarray, shape (3,)
        Origin of the tangent frame [m].
    C_e_enu : ndarray, shape (3, 3)
        Takes east, north, up to ECEF.

    Raises
    ------
    InputError
        The origin is not on this Earth.
    """

    def __init__(self, origin_geodetic: ArrayLike) -> None:
        origin = np.asarray(origin_geodetic, np.float64)
        limits = np.array([np.pi / 2, 2 * np.pi, 1e6])
        if origin.shape != (3,) or not np.all(np.abs(origin) <= limits):
            hint = "latitude [rad], longitude [rad], height [m]"
            raise InputError(f"origin {np.ravel(origin).tolist()}", "is no place on Earth", hint)
        self.origin_geodetic = origin
        self.origin_ecef = ecef_from_geodetic(origin)
        self.C_e_enu: FloatArray = np.ascontiguousarray(rotation_enu_ecef(*origin[:2]).T)

    def ecef(
        self,
        kinematics: Kinematics,
        lever_arm_b: ArrayLike = ORIGIN_OF_BODY,
        omega_rate_b: FloatArray | None = None,
    ) -> EcefStates:
        """Return the motion of a point of the body.

        With ``r`` the lever arm and ``w`` the body's rate, in body axes::

            p = p_0 + C r,  v = v_0 + C (w x r),  a = a_0 + C (dw/dt x r + w x (w x r))

        Parameters
        ----------
        kinematics : Kinematics
        lever_arm_b : array_like, shape (3,), optional
            From the body's origin to the point, forward-left-up [m].
        omega_rate_b : ndarray, shape (3,) or (m, 3), optional
            Derivative of ``kinematics.omega_b``, from `angular_acceleration`. Needed for points
            off the origin of a body that turns; `states` looks after that.

        Returns
        -------
        EcefStates

        Raises
        ------
        ValueError
            The body turns and ``omega_rate_b`` is missing.
        """
        lever = np.asarray(lever_arm_b, np.float64)
        position, velocity = kinematics.position, kinematics.velocity
        acceleration = kinematics.acceleration
        if np.any(lever):
            C, omega = kinematics.C_enu_b, kinematics.omega_b
            position = position + turn(C, lever)
            if omega.ndim == 2 or np.any(omega):
                if omega_rate_b is None:
                    raise ValueError(
                        "a lever arm on a turning body needs omega_rate_b: Site.states"
                    )
                along = np.cross(omega, lever)
                velocity = velocity + turn(C, along)
                inward = np.cross(omega_rate_b, lever) + np.cross(omega, along)
                acceleration = acceleration + turn(C, inward)
        return EcefStates(
            self.origin_ecef + turn(self.C_e_enu, position),
            turn(self.C_e_enu, velocity),
            turn(self.C_e_enu, acceleration),
        )

    def states(
        self, motion: Motion, time: FloatArray, lever_arm_b: ArrayLike = ORIGIN_OF_BODY
    ) -> EcefStates:
        """Evaluate a point of the body at times [s], shape (m,); see `ecef`."""
        rate = None
        if motion.rotates and np.any(lever_arm_b):
            rate = angular_acceleration(motion, time)
        return self.ecef(motion.at(time), lever_arm_b, rate)

    def trajectory(
        self, motion: Motion, lever_arm_b: ArrayLike = ORIGIN_OF_BODY
    ) -> Callable[[FloatArray], FloatArray]:
        """Return ECEF positions [m], shape (m, 3), of a point as a function of time [s], (m,)."""
        lever = np.asarray(lever_arm_b, np.float64)

        def trajectory(time: FloatArray) -> FloatArray:
            now = motion.at(time)
            position = now.position + turn(now.C_enu_b, lever)
            return self.origin_ecef + turn(self.C_e_enu, position)

        return trajectory


def angular_acceleration(motion: Motion, time: FloatArray) -> FloatArray:
    """Return the derivative of ``omega_b`` [rad/s^2], shape (m, 3) or (3,).

    The central difference of fourth order over +-0.5 ms, ``h^4/30 d^5 omega/dt^5`` off: 4e-8
    rad/s^2 at the edges of a tilt by 10 deg within half a second.
    """
    if not motion.rotates:
        return np.zeros(3)
    far, near = (
        motion.at(time + k * _STEP).omega_b - motion.at(time - k * _STEP).omega_b for k in (2, 1)
    )
    return (8.0 * near - far) / (12.0 * _STEP)


def orientation_xyzw(kinematics: Kinematics, previous: FloatArray | None = None) -> FloatArray:
    """Return the attitude as quaternions of continuous sign.

    Parameters
    ----------
    kinematics : Kinematics
        At times in order.
    previous : ndarray, shape (4,), optional
        The quaternion before; without it the first one has w >= 0. Handed on from chunk to chunk
        it makes the signs independent of the cuts.

    Returns
    -------
    ndarray, shape (4,) or (m, 4)
        x, y, z, w; takes forward-left-up to east-north-up. One where the attitude is one matrix.
    """
    quat = quat_from_matrix(kinematics.C_enu_b.reshape(-1, 3, 3))
    if quat.shape[0] == 0:
        return quat
    before = np.array([0.0, 0.0, 0.0, 1.0]) if previous is None else previous
    sign = np.ones(quat.shape[0])
    sign[0] = -1.0 if quat[0] @ before < 0.0 else 1.0
    sign[1:] = np.where((quat[1:] * quat[:-1]).sum(axis=1) < 0.0, -1.0, 1.0)
    quat *= np.cumprod(sign)[:, None]
    return quat if kinematics.C_enu_b.ndim == 3 else quat[0]
