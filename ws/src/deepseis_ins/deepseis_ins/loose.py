"""Loosely coupled filter of inertial navigation and GNSS: 15 states, closed loop.

States and their noise: `deepseis_ins.error_state`; measurements: `deepseis_ins.measurements`.
Errors estimated are taken off the navigation state at once, so that the filter's own state is
zero between updates (thesis section 2.2.4). Scale factors and misalignments of the IMU are
considered, not estimated: they widen the covariance as the motion demands.
"""

from __future__ import annotations

from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from deepseis_core.config import check
from deepseis_core.errors import InputError
from deepseis_core.geodesy import normal_gravity
from deepseis_core.imu_grades import ImuGrade
from deepseis_core.kalman import chi_square_limit, correct_kernel, innovation_kernel
from deepseis_core.rotation import matrix_from_quat
from deepseis_core.types import FloatArray
from deepseis_ins import loose_kernels as kernels
from deepseis_ins.error_state import (
    ACCEL,
    ATT,
    CONSTANTS,
    GYRO,
    POS,
    REFERENCE,
    STATES,
    VEL,
    bias_models,
    constants_block,
    constants_covariance,
    noise_model,
)
from deepseis_ins.loose_values import Innovation, LooseConfig, Snapshot
from deepseis_ins.measurements import Measurement
from deepseis_ins.nav_array import covariance, increments, pack, unpack, vector
from deepseis_ins.smoother import FilterStep
from deepseis_ins.smoother_tape import StepTape
from deepseis_ins.strapdown import NavState, Trajectory
from deepseis_ins.strapdown_kernels import ATTITUDE, DELTA_THETA, DELTA_VEL, INTERVAL

__all__ = ["Innovation", "LooseConfig", "LooseFilter", "Snapshot"]

_NOTHING = (0.0, 0.0, 0.0)
_NO_MATRICES = np.zeros((3, CONSTANTS - 3))
_UNTOLD = np.zeros((0, STATES + CONSTANTS))


class LooseFilter:
    """Navigation state, biases and covariance, carried on by increments and by measurements.

    Parameters
    ----------
    config : LooseConfig
    grade : ImuGrade
        Of the unit whose increments come.
    nav : NavState
        Where it starts.
    attitude_sd, position_sd, velocity_sd : array_like, shape (3,)
        Standard deviations of that, north, east, down [rad, m, m/s]; or attitude_sd of shape
        (3, 3), a covariance [rad^2].
    gyro_bias, accel_bias : array_like, shape (3,)
        Forward-right-down [rad/s, m/s^2].
    gyro_bias_sd, accel_bias_sd : array_like, shape (3,), optional
        What is unknown of them; without, all that the grade says. The latter is of bias and
        what gravity makes of scale factors and misalignments together.
    smoothing : bool
        Write down what a smoother needs; `take_steps` returns it.

    Notes
    -----
    The attitude given is that which `zero_angle` refers to, until `refer_attitude` says otherwise.

    Examples
    --------
    A unit at rest for a second, its bias unknown:

    >>> from deepseis_core.imu_grades import grade_named
    >>> start = NavState(0.6, 2.4, 50.0, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
    >>> filter = LooseFilter(
    ...     LooseConfig(), grade_named("span-fsas"), start, attitude_sd=[1e-3] * 3,
    ...     position_sd=[1.0] * 3, velocity_sd=[0.01] * 3,
    ... )
    >>> _ = filter.propagate(np.zeros((200, 3)), np.tile([0.0, 0.0, -0.0489], (200, 1)), 0.005)
    >>> [round(float(sd), 3) for sd in filter.sd[3:6]]
    [0.017, 0.017, 0.014]
    """

    _joint = STATES + CONSTANTS
    _estimated = STATES + 3
    """The states and the error of the reference attitude; behind them come what is considered."""

    def __init__(
        self,
        config: LooseConfig,
        grade: ImuGrade,
        nav: NavState,
        *,
        attitude_sd: ArrayLike,
        position_sd: ArrayLike,
        velocity_sd: ArrayLike,
        gyro_bias: ArrayLike = _NOTHING,
        accel_bias: ArrayLike = _NOTHING,
        gyro_bias_sd: ArrayLike | None = None,
        accel_bias_sd: ArrayLike | None = None,
        smoothing: bool = False,
    ) -> None:
        try:
            check(config)
        except ValueError as error:
            raise InputError("loose filter", str(error)) from None
        if not grade.has_gyros:
            raise InputError("loose filter", "needs gyroscopes, this grade has none")
        self.config, self.grade = config, grade
        self._x = pack(nav)
        self._bias = np.hstack([vector("gyro bias", gyro_bias), vector("accel bias", accel_bias)])
        force_ref_b = _force_at_rest(nav)
        self._model, self._B = noise_model(grade, force_ref_b), constants_covariance(grade)
        self._P, self._U = np.zeros((STATES, STATES)), np.zeros((STATES, CONSTANTS))
        gyro, accel = bias_models(grade, force_ref_b)
        self._P[POS, POS] = covariance("position", position_sd)
        self._P[VEL, VEL] = covariance("velocity", velocity_sd)
        self._P[ATT, ATT] = covariance("attitude", attitude_sd)
        self._P[GYRO, GYRO] = covariance("gyro bias", _given(gyro_bias_sd, gyro.sd))
        self._P[ACCEL, ACCEL] = covariance("accel bias", _given(accel_bias_sd, accel.sd))
        if accel_bias_sd is None:
            self._U[ACCEL] = constants_block(force_ref_b) @ self._B
        self._pending = np.zeros(kernels.PENDING_SIZE)
        kernels.begin_kernel(self._x, self._pending)
        self._limit = (
            chi_square_limit(3, config.false_alarm_probability)
            if config.false_alarm_probability > 0.0
            else np.inf
        )
        self._rejected: dict[str, int] = {}
        self._reference_error = np.zeros(3)
        self._tape = StepTape(self._joint) if smoothing else None
        self._transition = np.eye(STATES, STATES + CONSTANTS) if smoothing else _UNTOLD
        self.refer_attitude()

    # What is known

    @property
    def nav(self) -> NavState:
        """Position, velocity, attitude, with all corrections."""
        return unpack(self._x)

    @property
    def gyro_bias(self) -> FloatArray:
        """Estimate, shape (3,) [rad/s]: what is taken off the increments."""
        return self._bias[:3].copy()

    @property
    def accel_bias(self) -> FloatArray:
        """Estimate, shape (3,) [m/s^2]."""
        return self._bias[3:].copy()

    @property
    def omega_ib_b(self) -> FloatArray:
        """Angular rate of the last interval, bias removed, shape (3,) [rad/s]."""
        interval = self._x[INTERVAL]
        return self._x[DELTA_THETA:DELTA_VEL] / interval if interval > 0.0 else np.zeros(3)

    @property
    def P(self) -> FloatArray:  # noqa: N802
        """Covariance of the errors now, shape (15, 15); see `deepseis_ins.error_state`."""
        P, U = self._P.copy(), self._U.copy()
        kernels.complete_kernel(
            self._x, self._bias.copy(), self._pending.copy(), P, U, self._B, self._model, _UNTOLD
        )
        return P

    @property
    def sd(self) -> FloatArray:
        """Standard deviations, shape (15,)."""
        return np.sqrt(np.diag(self.P))

    # What moves it

    def propagate(
        self, delta_theta_b: ArrayLike, delta_vel_b: ArrayLike, dt: ArrayLike
    ) -> Trajectory:
        """Carry everything over m intervals; arguments and result of `Strapdown.propagate`.

        Increments are as measured: the biases are removed here. However a span is cut into
        calls, the result is the same to the bit.
        """
        delta_theta, delta_vel, dts = increments(delta_theta_b, delta_vel_b, dt)
        count = dts.size
        self._has_moved()
        out = Trajectory(np.empty((count, 3)), np.empty((count, 3)), np.empty((count, 4)))
        kernels.propagate_kernel(
            self._x, self._bias, self._pending, self._P, self._U, self._B, self._model,
            self._transition, self.config.covariance_step, delta_theta, delta_vel, dts,
            out.geodetic, out.vel_n, out.quat_nb,
        )  # fmt: skip
        return out

    def update(self, measurement: Measurement) -> Innovation:
        """Work a measurement in, unless it cannot be true.

        Its normalised square is held against chi-square. What is rejected changes nothing; after
        so many rejections of one kind in a row it is the filter that must be wrong: the states
        measured are widened by the innovation, and the measurement is believed.

        Raises
        ------
        InputError
            The measurement is not finite or its covariance not positive definite.
        """
        m = measurement
        z = m.z - m.D @ self._reference_error
        if not np.isfinite(z).all():
            raise InputError(f"measurement {m.name}", "is not finite")
        self._complete()
        P, H = self._joined(), self._sensitivity(m)
        PHt, S = np.empty((len(P), 3)), np.empty((3, 3))
        squared = innovation_kernel(P, H, m.R, z, PHt, S)
        if not squared >= 0.0:
            raise InputError(f"measurement {m.name}", "has a covariance that is no covariance")
        accepted, sd = bool(squared <= self._limit), np.sqrt(np.diag(S))
        rejected = 0 if accepted else self._rejected.get(m.name, 0) + 1
        recovered = m.recovers and rejected >= self.config.rejections_before_recovery
        self._rejected[m.name] = 0 if recovered else rejected
        if recovered:
            diagonal = np.arange(len(P))[m.states]
            P[diagonal, diagonal] += z**2
            innovation_kernel(P, H, m.R, z, PHt, S)
            self._has_moved()
        if accepted or recovered:
            x, before = np.empty(len(P)), P.copy()
            correct_kernel(P, H, m.R, z, PHt, S, self._estimated, x)
            self._part(P)
            self._feed_back(x)
            if self._tape is not None:
                self._tape.measure(before, x, P)
        return Innovation(m.name, z, sd, squared, accepted or recovered, recovered)

    def widen(
        self,
        *,
        position_sd: ArrayLike = 0.0,
        velocity_sd: ArrayLike = 0.0,
        attitude_sd: ArrayLike = 0.0,
        moved: float = 0.0,
    ) -> None:
        """Add uncertainty, as after a gap or while the IMU clipped (arguments: [m, m/s, rad]).

        ``moved`` is the covariance of position and velocity, each axis on itself [m^2/s]: what
        made the velocity uncertain has moved the station meanwhile.
        """
        self._complete()
        for name, part, sd in (
            ("position", POS, position_sd),
            ("velocity", VEL, velocity_sd),
            ("attitude", ATT, attitude_sd),
        ):
            self._P[part, part] += covariance(name, sd)
        if moved:
            self._P[POS, VEL] += moved * np.eye(3)
            self._P[VEL, POS] += moved * np.eye(3)
        self._has_moved()

    def replace_nav(self, nav: NavState) -> None:
        """Put another state in the place of the present one, the covariance as it is.

        For gaps in the increments: carry the state over it by other means, `widen`, and set
        ``previous_dt`` to 0.
        """
        self._complete()
        self._x = pack(nav)
        kernels.begin_kernel(self._x, self._pending)
        self._has_moved()

    def refer_attitude(
        self, C_nb_reference: ArrayLike | None = None, sd: ArrayLike = 0.0
    ) -> FloatArray:
        """Set the attitude that `zero_angle` refers to from now on; return it, shape (3, 3).

        Parameters
        ----------
        C_nb_reference : array_like, shape (3, 3), optional
            From a survey that has nothing to do with the filter's attitude. Without, it is the
            filter's attitude now, whose error it then shares.
        sd : array_like, shape () or (3,)
            Of such a survey, north, east, down [rad].
        """
        self._complete()
        self._reference_error = np.zeros(3)
        self._U[:, REFERENCE] = 0.0
        self._B[REFERENCE, :], self._B[:, REFERENCE] = 0.0, 0.0
        if C_nb_reference is None:
            reference = matrix_from_quat(self._x[ATTITUDE:DELTA_THETA])
            self._U[:, REFERENCE] = self._P[:, ATT]
            self._B[REFERENCE, :] = self._U[ATT, :]
            self._B[:, REFERENCE] = self._U[ATT, :].T
            self._B[REFERENCE, REFERENCE] = self._P[ATT, ATT]
        else:
            reference = np.array(C_nb_reference, np.float64)
            self._B[REFERENCE, REFERENCE] = covariance("reference attitude", sd)
        if self._tape is not None:
            own = self._tape.transition[ATT] if C_nb_reference is None else 0.0
            self._tape.transition[self._estimated - 3 : self._estimated] = own
            self._has_moved()
        return reference

    def refer_constants(self, sd: ArrayLike) -> None:
        """Let the three constants of `Measurement.D` begin anew, of given sd (or covariance).

        They are the errors of what measurements refer to in place of an attitude.
        """
        self.refer_attitude(np.eye(3), sd)

    def take_constants(self) -> tuple[FloatArray, FloatArray]:
        """Return their estimate and covariance; the caller corrects, the filter goes on from 0."""
        error, self._reference_error = self._reference_error, np.zeros(3)
        return error, self._B[REFERENCE, REFERENCE].copy()

    def constants_sd(self) -> FloatArray:
        """Return the standard deviations of these constants, shape (3,)."""
        return np.sqrt(np.diag(self._B)[REFERENCE])

    # Smoothing

    def take_steps(self) -> list[FilterStep]:
        """Return what a smoother needs of the time since the last call; the last step is now.

        The errors are those of the 15 states, of the reference attitude and of the parameters
        considered, 36 in all; `deepseis_ins.smoother_loose` makes states of what comes out.

        Raises
        ------
        InputError
            The filter was not told to write it down.
        """
        if self._tape is None:
            raise InputError("loose filter", "has kept no steps", "smoothing=True")
        self._complete()
        return self._tape.take(self._joined())

    # Undo

    def snapshot(self) -> Snapshot:
        """Return all that the filter is now."""
        return Snapshot(
            self._x.copy(), self._bias.copy(), self._pending.copy(), self._P.copy(),
            self._U.copy(), self._B.copy(), self._reference_error.copy(),
            MappingProxyType(dict(self._rejected)),
            self._transition.copy(), self._tape.state() if self._tape is not None else None,
        )  # fmt: skip

    def restore(self, snapshot: Snapshot) -> None:
        """Be again what the filter was."""
        s = snapshot
        self._x, self._bias, self._pending = s.x.copy(), s.bias.copy(), s.pending.copy()
        self._P, self._U, self._B = s.P.copy(), s.U.copy(), s.B.copy()
        self._reference_error, self._rejected = s.reference_error.copy(), dict(s.rejected)
        if self._tape is not None and s.tape is not None:
            self._transition = s.transition.copy()
            self._tape.restore(s.tape)

    def _complete(self) -> None:
        """Carry the covariance to now."""
        kernels.complete_kernel(
            self._x, self._bias, self._pending, self._P, self._U, self._B, self._model,
            self._transition,
        )  # fmt: skip
        if self._tape is not None and self._tape.moved:
            self._tape.carry(self._joint_transition())
            self._transition[:] = np.eye(STATES, STATES + CONSTANTS)

    def _joint_transition(self) -> FloatArray:
        """Return that of all that `_joined` holds, since the covariance was last complete."""
        T = np.eye(self._joint)
        T[:STATES] = self._transition
        return T

    def _has_moved(self) -> None:
        if self._tape is not None:
            self._tape.move()

    def _joined(self) -> FloatArray:
        """Return the covariance of states and constants together, shape (36, 36)."""
        n = STATES + len(self._B)
        P = np.empty((n, n))
        P[:STATES, :STATES], P[:STATES, STATES:] = self._P, self._U
        P[STATES:, :STATES], P[STATES:, STATES:] = self._U.T, self._B
        return P

    def _sensitivity(self, m: Measurement) -> FloatArray:
        """Return that of a measurement to all that `_joined` holds."""
        return np.hstack([m.H, m.D, _NO_MATRICES])

    def _feed_back(self, x: FloatArray) -> None:
        """Take what was estimated off the state."""
        self._reference_error += x[STATES : self._estimated]
        kernels.feed_back_kernel(self._x, self._bias, x)
        kernels.begin_kernel(self._x, self._pending)

    def _part(self, P: FloatArray) -> None:
        self._P, self._U = P[:STATES, :STATES].copy(), P[:STATES, STATES:].copy()
        self._B = P[STATES:, STATES:].copy()


def _given(sd: ArrayLike | None, otherwise: FloatArray) -> ArrayLike:
    return otherwise if sd is None else sd


def _force_at_rest(nav: NavState) -> FloatArray:
    """Return the specific force, body [m/s^2], that holds against gravity."""
    gravity = float(normal_gravity(nav.latitude, nav.height))
    return -gravity * matrix_from_quat(nav.quat_nb)[2]
