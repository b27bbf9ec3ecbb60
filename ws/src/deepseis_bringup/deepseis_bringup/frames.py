"""Static frames of a station for tf: earth, map, base_link, imu_link, gnss_antenna (REP-105).

``map`` is east-north-up at the monument, ``base_link`` forward-left-up where the IMU is. A
translation is where the child is in the parent's axes, a quaternion (x, y, z, w) turns
components of the child to those of the parent.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from deepseis_core.geodesy import geodetic_from_ecef, rotation_enu_ecef
from deepseis_core.rotation import matrix_from_quat, quat_from_matrix
from deepseis_core.types import FloatArray

STILL = np.array([0.0, 0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Transform:
    """Where a frame is: translation, shape (3,) [m], and quaternion, shape (4,)."""

    parent: str
    child: str
    translation: FloatArray
    quat: FloatArray

    def arguments(self) -> list[str]:
        """Return the arguments of tf2_ros' static_transform_publisher."""
        words: list[str] = []
        for names, values in ((("x", "y", "z"), self.translation),
                              (("qx", "qy", "qz", "qw"), self.quat)):  # fmt: skip
            for name, value in zip(names, values, strict=True):
                words += [f"--{name}", f"{float(value):.12g}"]
        return [*words, "--frame-id", self.parent, "--child-frame-id", self.child]


def static_transforms(fusion: Mapping[str, Any]) -> list[Transform]:
    """Return the frames of a station; none if its place is not known.

    Parameters
    ----------
    fusion : mapping
        Parameters of the fusion: monument_ecef, antenna_lever_arm, imu_to_antenna [m],
        imu_orientation_xyzw; zeros of the last, an attitude not surveyed, leave the body out.
    """
    monument = np.array(fusion.get("monument_ecef", (0.0, 0.0, 0.0)), np.float64)
    if not monument.any():
        return []
    latitude, longitude, _ = geodetic_from_ecef(monument)
    C_e_enu = rotation_enu_ecef(latitude, longitude).T
    frames = [Transform("earth", "map", monument, quat_from_matrix(C_e_enu))]
    quat = np.array(fusion.get("imu_orientation_xyzw", (0.0,) * 4), np.float64)
    if not quat.any():
        return frames
    arm = np.array(fusion.get("imu_to_antenna", (0.0,) * 3), np.float64)
    antenna = np.array(fusion.get("antenna_lever_arm", (0.0,) * 3), np.float64)
    imu = antenna - matrix_from_quat(quat) @ arm
    return [
        *frames,
        Transform("map", "base_link", imu, quat),
        Transform("base_link", "imu_link", np.zeros(3), STILL),
        Transform("base_link", "gnss_antenna", arm, STILL),
    ]
