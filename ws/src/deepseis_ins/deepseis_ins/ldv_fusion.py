"""Settings of the fusion with a velocimeter (coupling ``ldv``)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from deepseis_core.config import setting
from deepseis_core.errors import InputError
from deepseis_core.rotation import flu_from_frd
from deepseis_core.types import FloatArray
from deepseis_ins.ldv import LdvConfig, LdvInstallation

WINDOW_S: Final = 0.2
"""To which the settings of noise refer [s]."""


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
