"""Displacement from accelerometers and GNSS positions at a station that does not turn.

The ground moves without turning, so a station can do without gyroscopes (accelerometer-PPP paper
[1]_). In the tangent frame east, north, up at the monument, which turns with the Earth at W::

    dp/dt = v,    dv/dt = C f - b + g + G p - 2 W x v

``C`` is the surveyed attitude, f the specific force, g normal gravity and G its gradient. The
states are errors, estimate minus truth, and what is not yet taken off (equation 9):

=====  ==========================================================================
POS    displacement [m]
VEL    velocity [m/s]
BIAS   bias of the accelerometers along east, north, up, first-order Gauss-Markov
       with turn-on and in-run bias together (`deepseis_ins.error_state`) [m/s^2];
       whatever the survey's attitude lacks is part of it: 1 mrad is 1 mg
DRIFT  slow error of the GNSS positions, first-order Gauss-Markov [m]
=====  ==========================================================================

The nine of the paper take all of the GNSS error for white (equation 10). It is not: most of it
drifts over minutes. With ``drift_sd`` the filter has twelve states, the measurement is
``p + d + white``, and while the ground is known to be still (`GyroFreeFilter.hold_still`) GNSS
tells the drift and nothing else.

The filter corrects itself: what a measurement tells is taken off at once. Scale factors and
misalignments are not considered: 300 ppm of a displacement of 0.5 m is 0.15 mm.

References
----------
.. [1] X. Min, X. Niu, Y. Li and C. Shi, the paper on accelerometers loosely coupled with PPP and
   smoothed (RTS) for earthquakes, section 3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from deepseis_core.config import check, setting
from deepseis_core.errors import InputError
from deepseis_core.geodesy import normal_gravity
from deepseis_core.imu_grades import ImuGrade
from deepseis_core.kalman import (
    chi_square_limit,
    correct_kernel,
    innovation_kernel,
    symmetrise_kernel,
)
from deepseis_core.types import FloatArray
from deepseis_ins import gyrofree_kernels as kernels
from deepseis_ins.error_state import bias_models
from deepseis_ins.gyrofree_model import (
    BIAS,
    DRIFT,
    POS,
    VEL,
    discretise_exactly,
    dynamics,
    mechanics,
)
from deepseis_ins.loose import Innovation
from deepseis_ins.nav_array import covariance
from deepseis_ins.smoother import FilterStep
from deepseis_ins.smoother_tape import StepTape


@dataclass(frozen=True)
class GyroFreeConfig:
    """Settings of the filter without gyroscopes; three values are east, north, up."""

    drift_sd: tuple[float, ...] = setting(
        (),
        "Gauss-Markov drift of GNSS positions [m]; none: it counts as white",
        low=0.0,
        high=10.0,
    )
    drift_correlation_time: tuple[float, ...] = setting(
        (300.0, 300.0, 300.0), "of the drift [s]", low=1e-3, high=1e7
    )
    position_sd: float = setting(1.0, "of the displacement at the start [m]", low=0.0, high=1e3)
    velocity_sd: float = setting(0.01, "of the velocity at the start [m/s]", low=0.0, high=100.0)
    still_position_sd: float = setting(
        1e-4, "movement left while still, white [m]", low=1e-7, high=1.0
    )
    still_velocity_sd: float = setting(
        1e-4, "velocity left while still, white [m/s]", low=1e-7, high=1.0
    )
    false_alarm_probability: float = setting(
        1e-5, "of a good innovation to be rejected [-]", low=0.0, high=0.1
    )
    rejections_before_recovery: int = setting(
        10, "in a row, then the states are widened and GNSS is believed", low=1
    )

    @property
    def states(self) -> int:
        """How many: 12 with the drift, else 9."""
        return 12 if self.drift_sd else 9


@dataclass(frozen=True)
class Motion:
    """Motion at the end of m intervals, east, north, up, shapes (m, 3) [m, m/s, m/s^2].

    The acceleration is the mean of each interval.
    """

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray


class GyroFreeFilter:
    """Displacement, velocity and biases, carried on by increments and by GNSS positions.

    Parameters
    ----------
    config : GyroFreeConfig
    grade : ImuGrade
        Of the accelerometers; gyroscopes are not asked for.
    C_enu_b : array_like, shape (3, 3)
        Surveyed attitude: axes of the accelerometers to east, north, up.
    latitude, height : float
        Of the station [rad, m].
    smoothing : bool
        Write down what a smoother needs; `take_steps` returns it.

    Examples
    --------
    A minute of rest, positions good to a centimetre once a second:

    >>> from deepseis_core.imu_grades import grade_named
    >>> grade = grade_named("accelerometers")
    >>> filter = GyroFreeFilter(GyroFreeConfig(), grade, np.eye(3), latitude=0.6)
    >>> still = np.tile([0.0, 0.0, 0.0489826], (200, 1))
    >>> for _ in range(60):
    ...     _ = filter.propagate(still, 0.005)
    ...     _ = filter.update_position([0.0, 0.0, 0.0], 1e-4 * np.eye(3))
    >>> [round(float(sd), 4) for sd in filter.sd[:3]]
    [0.0054, 0.0054, 0.0054]
    """

    def __init__(
        self,
        config: GyroFreeConfig,
        grade: ImuGrade,
        C_enu_b: ArrayLike,
        *,
        latitude: float,
        height: float = 0.0,
        smoothing: bool = False,
    ) -> None:
        self.config, self.grade = config, grade
        _check(config)
        self._C = np.ascontiguousarray(C_enu_b, np.float64)
        if self._C.shape != (3, 3) or not np.allclose(self._C @ self._C.T, np.eye(3), atol=1e-6):
            raise InputError(
                "attitude of the accelerometers", "is not a rotation matrix", "C_enu_b"
            )
        self._x, n = np.zeros(kernels.SIZE), config.states
        gravity = float(normal_gravity(latitude, height))
        _, bias = bias_models(grade, self._C.T @ [0.0, 0.0, gravity])
        drift_rates = 1.0 / np.array(config.drift_correlation_time)
        self._model = mechanics(latitude, height, 1.0 / bias.correlation_time.max(), drift_rates)
        self._F, self._Q = dynamics(self._model, n), np.zeros((n, n))
        sensor = grade.accelerometers
        self._Q[VEL, VEL] = sensor.walk**2 * np.eye(3)
        self._Q[BIAS, BIAS] = 2.0 * sensor.instability**2 / sensor.correlation_time * np.eye(3)
        self._P = np.zeros((n, n))
        self._P[POS, POS] = config.position_sd**2 * np.eye(3)
        self._P[VEL, VEL] = config.velocity_sd**2 * np.eye(3)
        self._P[BIAS, BIAS] = self._C @ np.diag(bias.sd**2) @ self._C.T
        if n == 12:
            drift = np.diag(np.square(config.drift_sd))
            self._Q[DRIFT, DRIFT] = 2.0 * drift * drift_rates
            self._P[DRIFT, DRIFT] = drift
        self._known: dict[int, tuple[FloatArray, FloatArray]] = {}
        self._limit = (
            chi_square_limit(3, config.false_alarm_probability)
            if config.false_alarm_probability > 0.0
            else np.inf
        )
        self._rejected, self._unaided = 0, 0.0
        self._tape = StepTape(n) if smoothing else None

    # What is known

    @property
    def position(self) -> FloatArray:
        """Displacement east, north, up, shape (3,) [m]."""
        return self._x[POS].copy()

    @property
    def velocity(self) -> FloatArray:
        """Shape (3,) [m/s]."""
        return self._x[VEL].copy()

    @property
    def accel_bias(self) -> FloatArray:
        """Estimate along east, north, up, shape (3,) [m/s^2]."""
        return self._x[BIAS].copy()

    @property
    def drift(self) -> FloatArray:
        """Estimate of the drift of GNSS, shape (3,) [m]; zero with nine states."""
        return self._x[DRIFT].copy()

    @property
    def P(self) -> FloatArray:  # noqa: N802
        """Covariance of the errors, shape (9, 9) or (12, 12)."""
        return self._P.copy()

    @property
    def sd(self) -> FloatArray:
        """Standard deviations."""
        return np.asarray(np.sqrt(np.diag(self._P)))

    # What moves it

    def propagate(self, delta_vel_b: ArrayLike, dt: ArrayLike) -> Motion:
        """Carry everything over m intervals.

        Parameters
        ----------
        delta_vel_b : array_like, shape (m, 3)
            Integrals of the specific force over the intervals, as measured [m/s].
        dt : array_like, shape () or (m,)
            Lengths of the intervals [s].
        """
        delta_vel = np.ascontiguousarray(delta_vel_b, np.float64)
        if delta_vel.ndim != 2 or delta_vel.shape[1] != 3:
            raise InputError("accelerometer increments", f"have shape {delta_vel.shape}", "(m, 3)")
        dts = np.ascontiguousarray(np.broadcast_to(np.asarray(dt, np.float64), len(delta_vel)))
        if not (np.isfinite(delta_vel).all() and np.isfinite(dts).all() and np.all(dts > 0.0)):
            raise InputError("accelerometer increments", "are not finite over positive intervals")
        count = len(dts)
        out = Motion(np.empty((count, 3)), np.empty((count, 3)), np.empty((count, 3)))
        if count:
            kernels.mechanise_kernel(
                self._x, self._model, self._C, delta_vel, dts,
                out.position, out.velocity, out.acceleration,
            )  # fmt: skip
            self._carry(float(dts.sum()))
            self._unaided += float(dts.sum())
        return out

    def update_position(self, position_enu: ArrayLike, covariance_enu: ArrayLike) -> Innovation:
        """Work a GNSS displacement in, unless it cannot be true.

        Parameters
        ----------
        position_enu : array_like, shape (3,)
            Of the antenna from where it stood at the start or at the survey [m].
        covariance_enu : array_like, shape (3, 3)
            Of its white error [m^2]; with nine states, of all its error.
        """
        measured, R = np.asarray(position_enu, np.float64), covariance("position", covariance_enu)
        H = np.zeros((3, self.config.states))
        H[:, POS] = np.eye(3)
        if self.config.states == 12:
            H[:, DRIFT] = -np.eye(3)
        z = self._x[POS] + self._x[DRIFT] - measured
        return self._update("position", z, H, R)

    def hold_still(self) -> None:
        """Say that the ground stands where it stood at the start: no displacement, no velocity."""
        config = self.config
        for part, sd in ((POS, config.still_position_sd), (VEL, config.still_velocity_sd)):
            H = np.zeros((3, config.states))
            H[:, part] = np.eye(3)
            self._update("still", self._x[part].copy(), H, sd**2 * np.eye(3))

    def take_steps(self) -> list[FilterStep]:
        """Return what a smoother needs of the time since the last call; the last step is now."""
        if self._tape is None:
            raise InputError("gyro-free filter", "has kept no steps", "smoothing=True")
        return self._tape.take(self._P.copy())

    def _carry(self, time: float) -> None:
        """Carry the covariance."""
        key = round(time * 1e9)
        if key not in self._known:
            self._known[key] = discretise_exactly(self._F, self._Q, time)
        Phi, Q = self._known[key]
        self._P = Phi @ self._P @ Phi.T + Q
        symmetrise_kernel(self._P)
        if self._tape is not None:
            self._tape.carry(Phi)

    def _update(self, name: str, z: FloatArray, H: FloatArray, R: FloatArray) -> Innovation:
        if not np.isfinite(z).all():
            raise InputError(f"measurement {name}", "is not finite")
        n = self.config.states
        PHt, S = np.empty((n, 3)), np.empty((3, 3))
        squared = innovation_kernel(self._P, H, R, z, PHt, S)
        if not squared >= 0.0:
            raise InputError(f"measurement {name}", "has a covariance that is no covariance")
        sd, accepted = np.sqrt(np.diag(S)), bool(name == "still" or squared <= self._limit)
        recovered = False
        if name == "position":
            self._rejected = 0 if accepted else self._rejected + 1
            recovered = self._rejected >= self.config.rejections_before_recovery
        if recovered:
            self._widen(z)
            innovation_kernel(self._P, H, R, z, PHt, S)
        if accepted or recovered:
            before, x = self._P.copy(), np.empty(n)
            correct_kernel(self._P, H, R, z, PHt, S, n, x)
            self._feed_back(x)
            self._unaided = 0.0
            if self._tape is not None:
                self._tape.measure(before, x, self._P.copy())
        return Innovation(name, z, sd, squared, accepted or recovered, recovered)

    def _widen(self, z: FloatArray) -> None:
        """Give up what must be wrong: an error of z came about since GNSS was last believed.

        It may be a step of the displacement, a wrong velocity or a wrong bias.
        """
        self._rejected = 0
        time = max(self._unaided, 1e-3)
        for part, sd in ((POS, z), (VEL, z / time), (BIAS, 2.0 * z / time**2)):
            diagonal = np.arange(part.start, part.stop)
            self._P[diagonal, diagonal] += sd**2
        if self._tape is not None:
            self._tape.move()

    def _feed_back(self, x: FloatArray) -> None:
        self._x[POS] -= x[POS]
        self._x[VEL] -= x[VEL]
        self._x[BIAS] += x[BIAS]
        self._x[kernels.ACCELERATION : kernels.INTERVAL] -= x[BIAS]
        if len(x) == 12:
            self._x[DRIFT] += x[DRIFT]


def _check(config: GyroFreeConfig) -> None:
    try:
        check(config)
    except ValueError as error:
        raise InputError("gyro-free filter", str(error)) from None
    if len(config.drift_sd) not in (0, 3) or len(config.drift_correlation_time) != 3:
        raise InputError("gyro-free filter", "need three values each of the drift", "or none")
