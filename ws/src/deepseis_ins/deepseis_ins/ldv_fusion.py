"""Settings of the fusion with a velocimeter (coupling ``ldv``), and its lever arm as time goes on.

The lever arm shows in steps of the residual from one window to the next (`ldv_calibration`). Here
their normal equations are summed up while the vehicle moves; each sum of some hundred windows is a
measurement of what is wrong with the lever arm, worked into it by its weight.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from deepseis_core.config import setting
from deepseis_core.errors import InputError
from deepseis_core.rotation import flu_from_frd
from deepseis_core.types import FloatArray
from deepseis_ins.ldv import LdvConfig, LdvInstallation

WINDOW_S: Final = 0.2
"""To which the settings of noise refer [s]."""
_WORST_CONDITION: Final = 1e8


@dataclass(frozen=True)
class LdvFusionConfig:
    """How a velocimeter is used, and how it sits in the vehicle; axes forward, left, up."""

    ldv_quality: float = setting(
        100.0, "least quality factor of a usable measurement [-]", low=0.0
    )
    ldv_noise: float = setting(
        0.002, "of 0.2 s, beside the beams' own: road, vibration [m/s]", low=0.0, high=1.0
    )
    ldv_lateral_sd: float = setting(
        0.05, "of 0.2 s: slip to the side at the rear axle [m/s]", low=1e-4, high=10.0
    )
    ldv_least_speed: float = setting(
        0.2, "measured forward speed that is no rest [m/s]", low=0.0, high=10.0
    )
    ldv_scale: float = setting(0.0, "what it reads in excess, relative [-]", low=-0.5, high=0.5)
    ldv_scale_sd: float = setting(2e-3, "of that; 0: exact [-]", low=0.0, high=0.2)
    ldv_orientation_deg: list[float] = setting(
        [0.0, 0.0, 0.0], "turn of the sensor about forward, left, up [deg]"
    )
    ldv_angle_sd_deg: float = setting(
        0.5, "of its pitch and yaw; 0: exact [deg]", low=0.0, high=10.0
    )
    ldv_lever_arm: list[float] = setting([0.0, 0.0, 0.0], "from the IMU to the sensor [m]")
    ldv_lever_sd: float = setting(0.1, "of that; 0: exact [m]", low=0.0, high=10.0)
    ldv_lever_windows: int = setting(
        1500, "windows from which a part of the lever arm is told", low=100
    )
    ldv_no_slip_arm: list[float] = setting(
        [0.0, 0.0, 0.0], "from the IMU to the point that does not slip sideways [m]"
    )

    def use(self, length_s: float) -> LdvConfig:
        """Return how a window of a length is used; noise averages out over it."""
        more = float(np.sqrt(WINDOW_S / length_s))
        return LdvConfig(
            quality=self.ldv_quality,
            window=WINDOW_S,
            noise=min(self.ldv_noise * more, 1.0),
            lateral_sd=min(self.ldv_lateral_sd * more, 10.0),
            scale_sd=self.ldv_scale_sd,
            angle_sd_deg=self.ldv_angle_sd_deg,
        )

    def installation(self) -> LdvInstallation:
        """Return how the sensor is said to sit.

        Raises
        ------
        InputError
            The settings are not what they should be.
        """
        arm = three("ldv_lever_arm", self.ldv_lever_arm)
        roll, pitch, yaw = np.radians(three("ldv_orientation_deg", self.ldv_orientation_deg))
        angle = float(np.radians(self.ldv_angle_sd_deg))
        sd = [self.ldv_scale_sd, angle, angle]
        return LdvInstallation.from_angles(
            [roll, -pitch, -yaw], self.ldv_scale, flu_from_frd(arm), sd
        )


def three(name: str, values: list[float]) -> FloatArray:
    """Return three finite numbers, or complain."""
    array = np.array(values, np.float64)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise InputError(name, f"is {values}, not three numbers")
    return array


def _zeros() -> FloatArray:
    return np.zeros(3)


def _square() -> FloatArray:
    return np.zeros((3, 3))


@dataclass(frozen=True)
class LeverSums:
    """Normal equations of the lever arm's error, and what is known of it (frozen).

    Attributes
    ----------
    covariance : ndarray, shape (3, 3)
        Of the lever arm, forward-right-down [m^2]; zeros: it is exact.
    normal, right : ndarray, shapes (3, 3), (3,)
    squares : float
        Sum of the squares of the steps.
    count : int
        Windows in the sums.
    residual, turn : ndarray, shape (3,)
        Of the window before [m/s, rad/s].
    row : int
        Row of increments at whose end that window ended; -1: none.
    """

    covariance: FloatArray = field(default_factory=_square)
    normal: FloatArray = field(default_factory=_square)
    right: FloatArray = field(default_factory=_zeros)
    squares: float = 0.0
    count: int = 0
    residual: FloatArray = field(default_factory=_zeros)
    turn: FloatArray = field(default_factory=_zeros)
    row: int = -1

    @property
    def sd(self) -> FloatArray:
        """Standard deviations of the lever arm, shape (3,) [m]."""
        return np.sqrt(np.diag(self.covariance))

    def add(self, residual: FloatArray, turn: FloatArray, first: int, row: int) -> LeverSums:
        """Return the same with a window of rows ``first`` to ``row``.

        Parameters
        ----------
        residual, turn : ndarray, shape (3,)
            Predicted less measured velocity, mean angular rate, body axes.
        """
        here = replace(self, residual=residual, turn=turn, row=row)
        if self.row < 0 or first != self.row + 1:
            return here
        p, q, r = turn - self.turn
        step = (residual - self.residual)[[0, 2]]
        design = np.array([[0.0, -r, q], [-q, p, 0.0]])
        return replace(
            here,
            normal=self.normal + design.T @ design,
            right=self.right + design.T @ step,
            squares=self.squares + float(step @ step),
            count=self.count + 1,
        )

    def solved(self, windows: int) -> tuple[FloatArray, LeverSums]:
        """Return by what the lever arm is wrong, shape (3,), and sums that begin anew.

        Zero, and the same sums, as long as there are not enough windows or the vehicle has not
        turned enough.
        """
        if self.count < windows or not np.linalg.cond(self.normal) < _WORST_CONDITION:
            return np.zeros(3), self
        error = np.linalg.solve(self.normal, self.right)
        variance = (self.squares - float(error @ self.right)) / (2 * self.count - 3)
        R = max(variance, 1e-12) * np.linalg.inv(self.normal)
        gain = self.covariance @ np.linalg.inv(self.covariance + R)
        P = self.covariance - gain @ self.covariance
        again = LeverSums(0.5 * (P + P.T), residual=self.residual, turn=self.turn, row=self.row)
        return gain @ error, again
