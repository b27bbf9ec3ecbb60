"""What the fusion gives for a span: the inertial solution at IMU epochs, and the aiding."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from deepseis_core.geodesy import ecef_from_geodetic
from deepseis_core.rotation import (
    flu_from_frd,
    quat_from_matrix,
)
from deepseis_core.types import (
    Aiding,
    Displacement,
    Float32Array,
    FloatArray,
    InsFilter,
    InsSolution,
    IntArray,
)
from deepseis_ins.aiding import KnotGrid
from deepseis_ins.antenna_motion import KnotInterpolator
from deepseis_ins.error_state import STATES
from deepseis_ins.filter_steps import GnssUpdate
from deepseis_ins.fusion_kernels import orientation_kernel
from deepseis_ins.fusion_present import Present
from deepseis_ins.fusion_time import Timebase
from deepseis_ins.strapdown import NavState, Trajectory

CHILD_FRAME = "imu_link"
VECTORS = {
    "position_enu": 3,
    "velocity_enu": 3,
    "orientation_xyzw": 4,
    "acceleration_enu": 3,
    "gyro_bias": 3,
    "accelerometer_bias": 3,
}
"""Of every epoch, and how many numbers they have."""
INNOVATIONS = 6
"""Of an epoch of GNSS: position [m] and velocity [m/s], north, east, down."""


class FusionStatus(StrEnum):
    """What the fusion is doing."""

    ALIGNING = "waiting for stillness"
    NO_TIME = "waiting for a position, for the time"
    NO_SATELLITES = "waiting for ephemerides"
    RUNNING = "running"
    IMU_LOST = "IMU data missing"
    RECOVERING = "recovering after missing IMU data"
    UNCERTAIN = "velocity too uncertain"


@dataclass(frozen=True)
class FusionOutput:
    """One span.

    Attributes
    ----------
    solution : InsSolution
        At the IMU epochs after the span's first sample, up to its end; without epochs before the
        start.
    aiding : Aiding
        Of the span; invalid and without satellites where there is none.
    status : FusionStatus
    late : str
        What was not waited for: imu, motion, pvt, with blanks between; empty if nothing.
    extrapolated : int
        IMU samples made up because they were late.
    motion : tuple of Displacement
        Ground motion: of precise positions that count from this span on, and fused.
    """

    solution: InsSolution
    aiding: Aiding
    status: FusionStatus
    late: str = ""
    extrapolated: int = 0
    motion: tuple[Displacement, ...] = ()


class SolutionWriter:
    """Turns trajectories into solutions on topics' axes.

    Parameters
    ----------
    monument_ecef : ndarray, shape (3,)
        Origin of positions [m].
    C_enu_e : ndarray, shape (3, 3)
        Axes there.
    interpolator : KnotInterpolator
        For accelerations.
    """

    def __init__(
        self, monument_ecef: FloatArray, C_enu_e: FloatArray, interpolator: KnotInterpolator
    ) -> None:
        self.monument_ecef, self.C_enu_e = monument_ecef, C_enu_e
        self.interpolator = interpolator
        self._quat_enu_e = quat_from_matrix(C_enu_e)

    def enu(self, nav: NavState) -> FloatArray:
        """Return where a state is, from the monument, shape (3,) [m]."""
        place = ecef_from_geodetic([nav.latitude, nav.longitude, nav.height])
        return self.C_enu_e @ (place - self.monument_ecef)

    def empty(self, valid_through: int) -> InsSolution:
        """Return a solution without epochs."""
        return self._solution(
            valid_through,
            np.zeros(0, np.int64),
            np.zeros(0, np.int64),
            0,
            {name: np.zeros((0, size)) for name, size in VECTORS.items()},
            np.zeros((0, STATES), np.float32),
            [],
        )

    def write(
        self,
        span: tuple[int, int],
        timebase: Timebase,
        present: Present,
        updates: list[GnssUpdate],
    ) -> InsSolution:
        """Return the solution of a span.

        Parameters
        ----------
        span : tuple of int
            Its first sample and the one after its last; epochs after the first up to that are
            given.
        timebase : Timebase
        present : Present
        updates : list of GnssUpdate
        """
        nodes, trajectory = present.nodes, present.trajectory
        n = int(np.count_nonzero(nodes.sample_index > span[0]))
        last = slice(len(nodes.sample_index) - n, None)
        sample_index = nodes.sample_index[last]
        week, tow_ns = timebase.times(sample_index)
        acceleration = self.interpolator.rate(nodes.sample_index, nodes.velocity, sample_index)
        position = nodes.position[last] + (nodes.origin - self.monument_ecef)
        biases = flu_from_frd([present.gyro_bias, present.accel_bias])
        values = (
            position @ self.C_enu_e.T,
            nodes.velocity[last] @ self.C_enu_e.T,
            self._orientation(trajectory, last),
            acceleration @ self.C_enu_e.T,
            *np.repeat(biases[:, None], n, axis=1),
        )
        vectors = dict(zip(VECTORS, values, strict=True))
        sd = np.sqrt(np.diag(present.covariance)).astype(np.float32)
        sds = np.repeat(sd[None], n, axis=0)
        return self._solution(span[1] - 1, sample_index, tow_ns, week, vectors, sds, updates)

    def _orientation(self, trajectory: Trajectory, last: slice) -> FloatArray:
        """Return the attitude against the monument's axes; local ones are those of the end."""
        latitude, longitude, _ = trajectory.geodetic[-1]
        quat_nb = trajectory.quat_nb[last]
        out = np.empty(quat_nb.shape)
        orientation_kernel(self._quat_enu_e, latitude, longitude, quat_nb, out)
        return out

    def _solution(
        self,
        valid_through: int,
        sample_index: IntArray,
        tow_ns: IntArray,
        week: int,
        vectors: dict[str, FloatArray],
        state_sd: Float32Array,
        updates: list[GnssUpdate],
    ) -> InsSolution:
        z = np.full((len(updates), INNOVATIONS), np.nan, np.float32)
        sd, accepted = z.copy(), np.zeros(len(updates), np.bool_)
        for row, update in enumerate(updates):
            given = [(k, item) for k, item in enumerate(update.innovations) if item]
            for k, item in given:
                z[row, 3 * k : 3 * k + 3], sd[row, 3 * k : 3 * k + 3] = item.z, item.sd
            accepted[row] = all(item.accepted for _, item in given)
        return InsSolution(
            child_frame_id=CHILD_FRAME,
            filter=int(InsFilter.LOOSE),
            smoothed=False,
            valid_through=valid_through,
            sample_index=sample_index,
            tow_ns=tow_ns,
            week=week,
            **vectors,
            clock_bias=np.zeros(0),
            clock_drift=np.zeros(0),
            state_sd=state_sd,
            state_count=STATES,
            innovation_sample_index=np.array([u.sample_index for u in updates], np.int64),
            innovation=z,
            innovation_sd=sd,
            innovation_size=INNOVATIONS,
            innovation_accepted=accepted,
        )


def no_aiding(source: str, grid: KnotGrid) -> Aiding:
    """Return the aiding of a span for which there is none."""
    return Aiding(
        source=source,
        valid_from=grid.valid_from,
        valid_through=grid.valid_through,
        valid=False,
        knot_sample_index=grid.first,
        knot_step_samples=grid.step,
        knot_count=0,
        satellites=(),
        carrier_doppler_hz=np.zeros((0, 0)),
        carrier_doppler_rate=np.zeros((0, 0)),
        clock_drift_hz=float("nan"),
        doppler_sd_hz=np.zeros(0, np.float32),
    )
