"""Cross-coupling: what horizontal acceleration leaks into gravity, from passes that disagree.

An accelerometer's axis that is not square to the others feels ``m f`` of the horizontal specific
force. A gyroscope's that is not square turns the pitch by ``m`` of every bend's angle, and with it
the upward part of the velocimeter's velocity: ``v m d(psi)/dt`` is ``m`` times the lateral
acceleration. 20 urad are 2 mGal at 1 m/s^2, which no low-pass removes: a bend is as long as the
filter.

Where a road is driven both ways, every bend turns the other way and gravity does not. So the
deviations of passes from their mean, regressed on those of the forces, tell the coefficients: the
cross-correlation method of shipboard gravimetry [1]_, with repeated lines in place of crossings.
The coefficients have the instrument's grade as their prior: where all passes run one way the
prior, zero, is what comes out.

References
----------
.. [1] L. J. B. LaCoste, "Crosscorrelation method for evaluating and correcting shipboard gravity
   data", Geophysics 38(4), 1973.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from deepseis_core.imu_grades import MGAL, ImuGrade
from deepseis_core.types import FloatArray
from deepseis_ins.gravimetry_lines import Line


@dataclass(frozen=True)
class Coupling:
    """Coefficients of forward and right, and their sd, shapes (2,) [mGal per m/s^2]."""

    coefficient: FloatArray
    sd: FloatArray


def coupling_prior(grade: ImuGrade) -> float:
    """Return the sd of a coefficient by the grade's misalignments [mGal per m/s^2]."""
    return float(np.hypot(grade.accelerometers.misalignment, grade.gyros.misalignment) / MGAL)


def find_coupling(lines: Sequence[Line], prior: float, independent_s: float) -> Coupling:
    """Return how forces leak into the disturbance of passes [mGal].

    Parameters
    ----------
    lines : sequence of Line
    prior : float
        Standard deviation of a coefficient before [mGal per m/s^2].
    independent_s : float
        Time from one independent value of the low-pass to the next [s].
    """
    normal, right, residual, count = np.zeros((2, 2)), np.zeros(2), 0.0, 0.0
    for line in lines:
        gravity, force = line.gravity, np.array([item.force for item in line.passes])
        common = np.isfinite(gravity).all(axis=0) & np.isfinite(force).all(axis=(0, 1))
        if len(line.passes) < 2 or not common.any():
            continue
        value = _from_mean(gravity[:, common])
        design = _from_mean(force[:, :, common])
        time = sum(item.end - item.begin for item in line.passes)
        share = max(time / independent_s, 1.0) / value.size  # of a value that is independent
        normal += share * np.einsum("kis,kjs->ij", design, design)
        right += share * np.einsum("kis,ks->i", design, value)
        residual += share * float(np.sum(value**2))
        count += share * value.size
    if count == 0.0 or prior == 0.0:
        return Coupling(np.zeros(2), np.full(2, prior))
    # The noise of an independent value is what the fit leaves; one step from the whole settles.
    noise = residual / count
    for _ in range(5):
        covariance = np.linalg.inv(normal / noise + np.eye(2) / prior**2)
        found = covariance @ right / noise
        left = residual - 2.0 * float(found @ right) + float(found @ normal @ found)
        noise = max(left / count, 1e-12)
    return Coupling(found, np.sqrt(np.diag(covariance)))


def without_coupling(lines: Sequence[Line], coupling: Coupling) -> list[Line]:
    """Return lines whose passes are rid of what leaks in."""
    return [
        replace(
            line,
            passes=tuple(
                replace(item, gravity=item.gravity - coupling.coefficient @ item.force)
                for item in line.passes
            ),
        )
        for line in lines
    ]


def _from_mean(values: FloatArray) -> FloatArray:
    return values - values.mean(axis=0)
