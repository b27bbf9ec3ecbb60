"""Calibration of a velocimeter's installation on a drive with GNSS.

Scale, pitch and yaw are constants of the filter (`deepseis_ins.survey`). The lever arm shows in
how the sensor swings as the vehicle pitches and turns: in steps from one window to the next,
where slow errors of navigation cancel,

    z_b = omega x (l_hat - l) + noise

is solved for the lever arm by least squares, in the two components that the beams see. The filter
follows a part of the swing, which makes the steps larger, by 4 % with windows of 0.2 s: what the
first pass leaves the second one finds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from deepseis_core.errors import InputError
from deepseis_core.types import FloatArray
from deepseis_ins.ldv import LdvInstallation
from deepseis_ins.loose import LooseFilter
from deepseis_ins.survey import Aids, Survey
from deepseis_ins.survey_records import Track

FEWEST: Final = 100
"""Windows for a lever arm."""
LEVER_TIME: Final = 900.0
"""From the drive's start, for the lever arm alone [s]."""
LEVER_PASSES: Final = 2


@dataclass(frozen=True)
class LeverArm:
    """Error of a lever arm, forward-right-down, and its sd; shapes (3,) [m]."""

    error: FloatArray
    sd: FloatArray


def lever_arm_error(residual_b: FloatArray, turn_b: FloatArray) -> LeverArm:
    """Return what is wrong with a lever arm.

    Parameters
    ----------
    residual_b, turn_b : ndarray, shape (k, 3)
        As in `Track`.

    Raises
    ------
    InputError
        There are too few windows, or the vehicle did not turn enough.
    """
    if len(residual_b) < FEWEST:
        raise InputError("lever arm", f"{len(residual_b)} windows tell too little", f"{FEWEST}")
    p, q, r = np.diff(turn_b, axis=0).T
    none = np.zeros_like(p)
    # Forward: q l_z - r l_y; down: p l_y - q l_x.
    design = np.concatenate([np.stack([none, -r, q], 1), np.stack([-q, p, none], 1)])
    steps = np.diff(residual_b, axis=0)
    values = np.concatenate([steps[:, 0], steps[:, 2]])
    normal = design.T @ design
    if not np.linalg.cond(normal) < 1e8:
        raise InputError("lever arm", "cannot be told: the vehicle neither pitched nor turned")
    error = np.linalg.solve(normal, design.T @ values)
    left = values - design @ error
    inverse = np.linalg.inv(normal)
    return LeverArm(error, np.sqrt(np.diag(inverse) * float(left @ left) / (left.size - 3)))


def calibrate(
    survey: Survey,
    start: Callable[[], LooseFilter],
    installation: LdvInstallation,
    aids: Aids | None = None,
) -> tuple[LdvInstallation, LeverArm, Track]:
    """Calibrate on a drive: first the lever arm, then everything else with it.

    Parameters
    ----------
    survey : Survey
    start : callable
        Makes the filter as it is at the start of the drive.
    installation : LdvInstallation
        What is known before.
    aids : Aids, optional
        When GNSS is there.

    Returns
    -------
    LdvInstallation
    LeverArm
        What was found wrong with the given one, and its sd.
    Track
        Of the drive.
    """
    better = installation
    for _ in range(LEVER_PASSES):
        first = survey.run(start(), better, aids, until=LEVER_TIME)
        lever = lever_arm_error(first.residual_b, first.turn_b)
        better = replace(better, lever_arm_b=better.lever_arm_b - lever.error)
    track = survey.run(start(), better, aids)
    wrong = installation.lever_arm_b - track.installation.lever_arm_b
    return track.installation, LeverArm(wrong, lever.sd), track
