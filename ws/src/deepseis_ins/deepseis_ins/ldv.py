"""A two-beam laser velocimeter in a vehicle: beams, installation, and what it says of errors.

Beam i leaves the sensor at the elevation ``e_i`` above its forward axis and measures how fast
the ground comes nearer along it; two beams give the velocity along the sensor's forward and down
axes ``d``::

    [d_1]   [cos e_1   -sin e_1] [v_x]
    [d_2] = [cos e_2   -sin e_2] [v_z]

What crosses the plane of the beams is not seen. A vehicle that does not slip has no velocity to
its right at its rear axle: that is the third component.

The installation leads to body axes, ``v_b = C_bd v_d / (1 + s)``. Each beam has a scale of its
own; as long as the vehicle follows its own forward axis, two scales are the same as one and a
pitch, and a roll is the same as nothing. So scale, pitch and yaw are what can be calibrated and
what matters, and the lever arm to the sensor, which swings as the vehicle pitches.

The measurement is that of [1]_, equation 6, in n::

    z = v + C_nb (omega_eb x l) - C_nb v_b

Equation 7 there has ``H = [0 I 0 0 0]``, as if the velocimeter's velocity were measured in n. It
is turned there by the attitude that is to be corrected: with ``C_hat = (I - [phi x]) C`` stands
``-[C v_b x]`` in the columns of phi. At 20 m/s 50 urad of pitch are 1 mm/s upwards.

References
----------
.. [1] Wei G. et al., "Strapdown vehicle autonomous gravimetry method based on two-dimensional
   laser Doppler velocimeter", Infrared and Laser Engineering 52(6), 2023.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from deepseis_core.config import setting
from deepseis_core.errors import InputError
from deepseis_core.rotation import matrix_from_euler, matrix_from_rotvec, skew
from deepseis_core.types import FloatArray
from deepseis_ins.alignment import earth_rate
from deepseis_ins.error_state import ATT, GYRO, STATES, VEL
from deepseis_ins.measurements import Measurement

NAME: Final = "ldv_velocity"
MOST_PARALLEL: Final = 0.05
"""Sine of the least angle between beams."""


@dataclass(frozen=True)
class LdvConfig:
    """How a velocimeter is used."""

    quality: float = setting(100.0, "least quality factor of a usable measurement [-]", low=0.0)
    window: float = setting(0.2, "measurements averaged for one update [s]", low=0.01, high=10.0)
    noise: float = setting(
        0.002, "of an update beside the beams' own noise: road, vibration [m/s]", low=0.0, high=1.0
    )
    lateral_sd: float = setting(
        0.05, "of an update: slip to the side at the rear axle [m/s]", low=1e-4, high=10.0
    )
    scale_sd: float = setting(2e-3, "of the scale before calibration [-]", low=0.0, high=0.2)
    angle_sd_deg: float = setting(
        0.5, "of pitch and yaw of the installation before calibration [deg]", low=0.0, high=10.0
    )


def _origin() -> FloatArray:
    return np.zeros(3)


@dataclass(frozen=True)
class LdvInstallation:
    """How the sensor sits in the vehicle.

    Attributes
    ----------
    C_bd : ndarray, shape (3, 3)
        Sensor axes forward-right-down to body axes.
    scale : float
        What it reads in excess, relative [-].
    lever_arm_b : ndarray, shape (3,)
        From the IMU to the sensor, forward-right-down [m].
    sd : ndarray, shape (3,)
        Of scale [-], pitch and yaw [rad].
    """

    C_bd: FloatArray = field(default_factory=lambda: np.eye(3))
    scale: float = 0.0
    lever_arm_b: FloatArray = field(default_factory=_origin)
    sd: FloatArray = field(default_factory=_origin)

    @classmethod
    def nominal(
        cls, config: LdvConfig, lever_arm_b: ArrayLike = (0.0, 0.0, 0.0)
    ) -> LdvInstallation:
        """Return one that is not calibrated."""
        angle = np.radians(config.angle_sd_deg)
        sd = np.array([config.scale_sd, angle, angle])
        return cls(lever_arm_b=np.array(lever_arm_b, np.float64), sd=sd)

    @classmethod
    def from_angles(
        cls, roll_pitch_yaw: ArrayLike, scale: float, lever_arm_b: ArrayLike, sd: ArrayLike
    ) -> LdvInstallation:
        """Return that of Euler angles [rad], sensor to body."""
        angles, arm, sds = (np.array(x, np.float64) for x in (roll_pitch_yaw, lever_arm_b, sd))
        if not all(part.shape == (3,) and np.isfinite(part).all() for part in (angles, arm, sds)):
            raise InputError("velocimeter's installation", "is not made of finite numbers")
        return cls(matrix_from_euler(angles), float(scale), arm, sds)

    def corrected(self, error: FloatArray) -> LdvInstallation:
        """Take errors of scale, pitch, yaw off, shape (3,) (estimate minus truth)."""
        turn = matrix_from_rotvec(np.array([0.0, error[1], error[2]]))
        return replace(self, C_bd=turn @ self.C_bd, scale=self.scale - float(error[0]))

    def velocity_b(self, velocity_d: FloatArray) -> FloatArray:
        """Return velocities in body axes, shape (m, 3), of those in the sensor's, (m, 3)."""
        return velocity_d @ self.C_bd.T / (1.0 + self.scale)


@dataclass(frozen=True)
class LdvRecord:
    """Measurements of a velocimeter, m of them.

    Attributes
    ----------
    time : ndarray, shape (m,)
        Middle of the measuring interval [s].
    velocity : ndarray, shape (m, 2)
        Along the sensor's forward and down axes [m/s].
    variance : ndarray, shape (m, 3)
        Of forward, of down, and their covariance [m^2/s^2].
    quality : ndarray, shape (m,)
    """

    time: FloatArray
    velocity: FloatArray
    variance: FloatArray
    quality: FloatArray

    @classmethod
    def from_beams(
        cls,
        time: FloatArray,
        beam_velocity: FloatArray,
        beam_velocity_sd: FloatArray,
        beam_elevation: FloatArray,
        quality: FloatArray,
    ) -> LdvRecord:
        """Solve the beams; shapes (m,), (m, 2), (m, 2), (2,) [rad], (m,)."""
        solve = np.linalg.inv(beam_matrix(beam_elevation))
        squares = beam_velocity_sd**2
        variance = np.stack(
            [
                squares @ solve[0] ** 2,
                squares @ solve[1] ** 2,
                squares @ (solve[0] * solve[1]),
            ],
            axis=1,
        )
        return cls(time, beam_velocity @ solve.T, variance, quality)


def beam_matrix(elevation: ArrayLike) -> FloatArray:
    """Return what beams see of forward and down, shape (2, 2); elevations [rad].

    Raises
    ------
    InputError
        The beams are parallel.

    Examples
    --------
    >>> beam_matrix([0.0, -np.pi / 2]).round(6).tolist()
    [[1.0, -0.0], [0.0, 1.0]]
    """
    e = np.asarray(elevation, np.float64)
    if e.shape != (2,) or not abs(np.sin(e[1] - e[0])) > MOST_PARALLEL:
        raise InputError("velocimeter", f"beams at {np.degrees(e)} deg cannot be told apart")
    return np.stack([np.cos(e), -np.sin(e)], axis=1)


@dataclass(frozen=True)
class LdvWindow:
    """Means over the usable measurements of a window, n of them.

    Attributes
    ----------
    count : int
    predicted_n, measured_n : ndarray, shape (3,)
        Velocity of the sensor by navigation and by the velocimeter [m/s].
    variance : ndarray, shape (3,)
        Of the mean: forward, down, their covariance [m^2/s^2].
    """

    count: int
    predicted_n: FloatArray
    measured_n: FloatArray
    variance: FloatArray


def ldv_velocity(
    window: LdvWindow,
    C_nb: FloatArray,
    omega_b: FloatArray,
    latitude: float,
    installation: LdvInstallation,
    config: LdvConfig,
) -> Measurement:
    """Compare the sensor's velocity; the sensitivities are those at the window's end.

    ``D`` is the sensitivity to the errors of scale, pitch and yaw of the installation, which take
    the place of those of a reference attitude (`LooseFilter.refer_constants`).

    Parameters
    ----------
    window : LdvWindow
    C_nb : ndarray, shape (3, 3)
    omega_b : ndarray, shape (3,)
        Angular rate without bias [rad/s].
    latitude : float
        [rad]
    installation : LdvInstallation
    config : LdvConfig
    """
    lever_b, measured_n = installation.lever_arm_b, window.measured_n
    lever_n, swing_n = C_nb @ lever_b, C_nb @ np.cross(omega_b, lever_b)
    H = np.zeros((3, STATES))
    H[:, VEL] = np.eye(3)
    H[:, ATT] = skew(swing_n) - skew(earth_rate(latitude)) @ skew(lever_n) - skew(measured_n)
    H[:, GYRO] = -C_nb @ skew(lever_b)
    D = np.empty((3, 3))
    D[:, 0] = measured_n / (1.0 + installation.scale)
    D[:, 1:] = (-C_nb @ skew(C_nb.T @ measured_n))[:, 1:]
    R_d = np.diag([config.noise**2, config.lateral_sd**2, config.noise**2])
    forward, down, both = window.variance
    R_d[0, 0] += forward
    R_d[2, 2] += down
    R_d[0, 2] = R_d[2, 0] = both
    C_nd = C_nb @ installation.C_bd
    z = window.predicted_n - measured_n
    return Measurement(z, H, C_nd @ R_d @ C_nd.T, NAME, VEL, D)


def lever_sensitivity(C_nb: FloatArray, omega_b: FloatArray, latitude: float) -> FloatArray:
    """Return that of `ldv_velocity` to the lever arm's error, shape (3, 3), body to n.

    The sensor swings by ``omega x l``. Sideways nothing is measured: there the same lever arm
    leads back to the point that does not slip.

    Parameters
    ----------
    C_nb : ndarray, shape (3, 3)
    omega_b : ndarray, shape (3,)
        Angular rate without bias, mean of the window [rad/s].
    latitude : float
        [rad]
    """
    over_ground = omega_b - C_nb.T @ earth_rate(latitude)
    return np.asarray((C_nb * [1.0, 0.0, 1.0]) @ skew(over_ground))
