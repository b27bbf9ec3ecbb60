"""Ground motion on topics: of the fused solution at IMU epochs, and of precise positions alone.

Displacements are from where the station was surveyed to stand, in the axes at the monument. That
of the fused solution is the IMU's, which stands on the ground; that of precise positions is the
antenna's. They differ by what the lever arm between them turns. What a survey is off by moves
neither, and does not count in their sigmas.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deepseis_core.gps_time import GpsTime
from deepseis_core.imu_grades import STANDARD_GRAVITY, ImuGrade
from deepseis_core.types import (
    Displacement,
    DisplacementSource,
    Float32Array,
    FloatArray,
    InsSolution,
    PrecisePosition,
)
from deepseis_ins.antenna_motion import KnotInterpolator
from deepseis_ins.error_state import ACCEL, ATT, VEL
from deepseis_ins.fusion_output import SolutionWriter
from deepseis_ins.fusion_present import Present
from deepseis_ins.fusion_smoother import LateMotion
from deepseis_ins.fusion_time import Timebase
from deepseis_ins.gnss_epochs import is_placed
from deepseis_ins.measurement_kernels import matrix_of

_TO_ENU = [1, 0, 2]
"""East, north and up (but for its sign) of north, east, down."""
_GRAVITY_CROSS = np.array(
    [[0.0, STANDARD_GRAVITY, 0.0], [-STANDARD_GRAVITY, 0.0, 0.0], [0.0, 0.0, 0.0]]
)
"""``[f x]`` of the specific force at rest, north, east, down [m/s^2]."""


class GroundMotion:
    """Turns solutions into displacements.

    Parameters
    ----------
    grade : ImuGrade
        For the noise of accelerations.
    interval : float
        Of the IMU [s].
    interpolator : KnotInterpolator
        That which the solution's accelerations are from.

    Attributes
    ----------
    origin_enu : ndarray, shape (3,)
        Where the IMU was surveyed to stand, from the monument [m].
    """

    def __init__(self, grade: ImuGrade, interval: float, interpolator: KnotInterpolator) -> None:
        self.grade, self.interval, self.interpolator = grade, interval, interpolator
        self.origin_enu: FloatArray = np.zeros(3)
        self._velocity: FloatArray | None = None

    def fused(self, solution: InsSolution, present: Present) -> Displacement | None:
        """Return the motion at a solution's epochs; None if there are none."""
        n = len(solution.sample_index)
        if not n:
            return None
        P = present.covariance
        position = _sd(present.moved_covariance)
        velocity = _sd(P[VEL, VEL])
        return Displacement(
            source=int(DisplacementSource.FUSED),
            smoothed=False,
            valid_through=solution.valid_through,
            interval=self.interval,
            tow_ns=solution.tow_ns,
            week=solution.week,
            displacement=solution.position_enu - self.origin_enu,
            velocity=solution.velocity_enu,
            acceleration=solution.acceleration_enu,
            displacement_sd=np.repeat(position[None], n, axis=0),
            velocity_sd=np.repeat(velocity[None], n, axis=0),
            acceleration_sd=self._acceleration_sd(solution, present),
        )

    def late(
        self, parts: Sequence[LateMotion], timebase: Timebase, writer: SolutionWriter, through: int
    ) -> tuple[Displacement, ...]:
        """Return the smoothed motion of some steps, each at IMU epochs, in order.

        Its accelerations are differences of velocities, means of the intervals before.
        """
        out = []
        for part in parts:
            week, tow_ns = timebase.times(part.sample_index)
            n, C = len(part.sample_index), writer.C_enu_e
            velocity = part.velocity_ecef @ C.T
            before = velocity[:1] if self._velocity is None else self._velocity
            self._velocity = velocity[-1:]
            moved = (part.position_ecef - writer.monument_ecef) @ C.T - self.origin_enu
            sds = [_sd(P) for P in (part.position_covariance, part.velocity_covariance)]
            noise = self.grade.accelerometers.walk / self.interval**0.5
            out.append(
                Displacement(
                    source=int(DisplacementSource.FUSED),
                    smoothed=True,
                    valid_through=through,
                    interval=self.interval,
                    tow_ns=tow_ns,
                    week=week,
                    displacement=moved,
                    velocity=velocity,
                    acceleration=np.diff(velocity, axis=0, prepend=before) / self.interval,
                    displacement_sd=np.repeat(sds[0][None], n, axis=0),
                    velocity_sd=np.repeat(sds[1][None], n, axis=0),
                    acceleration_sd=np.full((n, 3), noise, np.float32),
                )
            )
        return tuple(out)

    def _acceleration_sd(self, solution: InsSolution, present: Present) -> Float32Array:
        """Return one sigma of accelerations: of tilt and bias, and the accelerometers' noise."""
        C_nb = matrix_of(present.trajectory.quat_nb[-1])
        H = np.hstack([_GRAVITY_CROSS, C_nb])
        chosen = np.r_[ATT, ACCEL]
        slow = (H @ present.covariance[np.ix_(chosen, chosen)] * H).sum(axis=1)
        index, points = present.nodes.sample_index, self.interpolator.lever_points
        rate = self.interpolator.weights(index, solution.sample_index, points)[1]
        # Velocities are sums of increments: each has the weight of all velocities after it.
        of_increments = np.cumsum(rate[:, ::-1], axis=1)[:, -2::-1]
        walk2 = self.grade.accelerometers.walk**2 * self.interval
        white = walk2 * (of_increments**2).sum(axis=1)
        return np.sqrt(slow[_TO_ENU] + white[:, None]).astype(np.float32)


class PreciseMotion:
    """The motion that successive precise positions show; they tell their spacing themselves."""

    def __init__(self) -> None:
        self._at: GpsTime | None = None
        self._step = np.inf
        self._unspaced: list[PrecisePosition] = []

    def take(self, position: PrecisePosition, valid_through: int) -> list[Displacement]:
        """Take the next position; return what it shows, and those before whose spacing it tells.

        Parameters
        ----------
        position : PrecisePosition
            One that does not say where the antenna is shows nothing.
        valid_through : int
            Of the messages [samples].
        """
        before, self._at = self._at, GpsTime(position.week, position.tow_ns)
        if before is not None and (step := 1e-9 * self._at.diff_ns(before)) > 0.0:
            self._step = min(self._step, step)  # more where epochs are lost
        if not is_placed(position):
            return []
        self._unspaced.append(position)
        if not np.isfinite(self._step):
            return []
        due, self._unspaced = self._unspaced, []
        return [shown for item in due for shown in of_precise(item, valid_through, self._step)]


def of_precise(
    position: PrecisePosition, valid_through: int, interval: float
) -> list[Displacement]:
    """Return the motions that one precise position shows; it knows no velocity.

    By GNSS alone; and by the loops' own phases, where those are aided and not the former's.
    """
    covariance = np.reshape(position.covariance_enu, (3, 3))
    found = [(DisplacementSource.GNSS, position.displacement_enu, np.sqrt(np.diag(covariance)))]
    if np.isfinite(position.loops_displacement_enu).all():
        by_loops = position.loops_displacement_enu, position.loops_sd_enu
        found.append((DisplacementSource.AIDED, *by_loops))
    unknown = np.full((1, 3), np.nan)
    return [
        Displacement(
            source=int(source),
            smoothed=False,
            valid_through=valid_through,
            interval=interval,
            tow_ns=np.array([position.tow_ns], np.int64),
            week=position.week,
            displacement=np.reshape(displacement, (1, 3)),
            velocity=unknown,
            acceleration=unknown,
            displacement_sd=np.reshape(sd, (1, 3)).astype(np.float32),
            velocity_sd=unknown.astype(np.float32),
            acceleration_sd=unknown.astype(np.float32),
        )
        for source, displacement, sd in found
    ]


def displacement_utc_ns(motion: Displacement) -> int:
    """Return the UTC of the first epoch [ns]: what its message is stamped with."""
    return GpsTime(motion.week, int(motion.tow_ns[0])).to_utc_ns()


def _sd(covariance_n: FloatArray) -> Float32Array:
    """Return sigmas east, north, up of a covariance north, east, down."""
    return np.sqrt(np.diag(covariance_n)[_TO_ENU]).astype(np.float32)
