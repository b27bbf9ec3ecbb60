"""Tightly coupled filter of inertial navigation and GNSS: 17 states, closed loop.

The 15 states of `deepseis_ins.error_state`, along north, east, down (the paper [1]_ has position
and velocity in ECEF and attitude in n: here one frame serves all), and the receiver's clock::

    [dr dv phi bg ba | dtu dfu]      clock bias [m] and drift [m/s]

Measured are pseudoranges and range rates, one satellite by one: three of them, or one, still
help, as far as they go. With e from satellite to receiver ([1]_, equations 10 and 13; the clock's
error is an estimate minus truth here, as all others)::

    z_rho    = e . dr_antenna + dtu
    z_rhodot = e . dv_antenna + dfu

Drift is a random walk and not the paper's Gauss-Markov process, which would pull a steady offset
of the oscillator, hundreds of metres a second, towards zero.

Everything else is the loosely coupled filter's: mechanisation, growth of the errors, considered
scale factors, the way constraints are worked in.

References
----------
.. [1] Hu J., Shi X., "Application of carrier phase smoothing pseudorange in GPS/SINS tightly
   integrated navigation system", Navigation Positioning & Timing 5(5), 2018, section 1.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from deepseis_core.config import check, setting
from deepseis_core.constants import SPEED_OF_LIGHT
from deepseis_core.ephemeris import STATE_COLUMNS
from deepseis_core.errors import InputError
from deepseis_core.imu_grades import ImuGrade
from deepseis_core.kalman import chi_square_limit
from deepseis_core.types import FloatArray
from deepseis_ins import loose_kernels
from deepseis_ins import tight_kernels as kernels
from deepseis_ins.error_state import CONSTANTS, POS, STATES
from deepseis_ins.loose import LooseConfig, LooseFilter, Snapshot
from deepseis_ins.measurements import Measurement
from deepseis_ins.nav_array import vector
from deepseis_ins.strapdown import NavState, Trajectory
from deepseis_ins.strapdown_kernels import INTERVAL

MILLISECOND = SPEED_OF_LIGHT * 1e-3
"""[m] by which receivers set their clocks."""


@dataclass(frozen=True)
class TightConfig:
    """Settings of the tightly coupled filter beside those of the loose one.

    The clock's defaults are of a TCXO.
    """

    clock_bias_noise: float = setting(
        0.1, "white frequency noise of the oscillator [m/sqrt(s)]", low=0.0, high=100.0
    )
    clock_drift_noise: float = setting(
        0.2, "random walk of its frequency [m/s/sqrt(s)]", low=1e-6, high=100.0
    )
    clock_bias_sd: float = setting(300.0, "of the clock after the first epoch [m]", low=1.0)
    clock_drift_sd: float = setting(30.0, "of its drift after the first epoch [m/s]", low=0.1)
    range_false_alarm_probability: float = setting(
        1e-4, "of a good range or range rate to be rejected [-]", low=0.0, high=0.1
    )
    epochs_before_recovery: int = setting(
        10, "most ranges rejected in so many in a row: the position is widened", low=1
    )
    klobuchar: bool = setting(True, "remove the ionosphere's delay if its parameters are given")
    troposphere: bool = setting(True, "remove the Saastamoinen delay")


@dataclass(frozen=True)
class Ranges:
    """One epoch of n satellites, all of them or some selected, raw or smoothed.

    Attributes
    ----------
    satellites : ndarray, shape (n, 12)
        States when the signals left (`core.ephemeris.states_from_pseudoranges`).
    pseudorange, range_rate : ndarray, shape (n,)
        C1C [m], and ``-lambda D1C`` [m/s]; NaN: not used.
    pseudorange_sd, range_rate_sd : ndarray, shape (n,)
        Of white noise [m, m/s].
    tow : float
        GPS seconds of week, for the ionosphere [s].
    klobuchar : ndarray, shape (8,), optional
        alpha 0..3, beta 0..3. Without, nothing is removed.
    """

    satellites: FloatArray
    pseudorange: FloatArray
    range_rate: FloatArray
    pseudorange_sd: FloatArray
    range_rate_sd: FloatArray
    tow: float = 0.0
    klobuchar: FloatArray | None = None


@dataclass(frozen=True)
class RangeInnovations:
    """How an epoch agreed with what was predicted; ranges, then range rates, shapes (2 n,).

    Attributes
    ----------
    z, sd : ndarray
        Prediction minus measurement and what it should amount to before the epoch [m, m/s].
    normalised_squared : ndarray
        Of each, after those that agree better: the sum over those accepted is chi-square with as
        many degrees of freedom.
    accepted : ndarray of bool
    recovered : bool
        The position was widened first.
    """

    z: FloatArray
    sd: FloatArray
    normalised_squared: FloatArray
    accepted: NDArray[np.bool_]
    recovered: bool = False


@dataclass(frozen=True)
class TightSnapshot(Snapshot):
    """The loose filter's, and the clock's."""

    clock: FloatArray = field(default_factory=lambda: np.zeros(2))
    clock_age: float = 0.0
    started: bool = False
    missed: int = 0


class TightFilter(LooseFilter):
    """`LooseFilter` with ranges of single satellites; it takes all that the loose one takes.

    The clock starts at the first epoch with a range: no value is needed.

    Parameters
    ----------
    config : LooseConfig
        Of propagation and of other measurements than ranges.
    grade, nav
        As `LooseFilter`'s, and so are further keywords.
    tight : TightConfig, optional
    lever_arm_b : array_like, shape (3,)
        From the IMU to the antenna, forward-right-down [m].
    """

    _joint = kernels.JOINED
    _estimated = kernels.ESTIMATED

    def __init__(
        self,
        config: LooseConfig,
        grade: ImuGrade,
        nav: NavState,
        *,
        tight: TightConfig | None = None,
        lever_arm_b: ArrayLike = (0.0, 0.0, 0.0),
        **given: Any,
    ) -> None:
        self.tight = tight or TightConfig()
        try:
            check(self.tight)
        except ValueError as error:
            raise InputError("tight filter", str(error)) from None
        self.lever_arm_b = vector("lever arm", lever_arm_b)
        self._clock, self._clock_age = np.zeros(2), 0.0
        self._started, self._missed = False, 0
        super().__init__(config, grade, nav, **given)
        self._U = np.hstack([self._U, np.zeros((STATES, 2))])
        B = np.zeros((CONSTANTS + 2, CONSTANTS + 2))
        B[:CONSTANTS, :CONSTANTS] = self._B
        self._B = B
        probability = self.tight.range_false_alarm_probability
        self._range_limit = chi_square_limit(1, probability) if probability > 0.0 else np.inf

    @property
    def clock_bias(self) -> float:
        """Receiver time minus GPS time [m]; NaN before the first range."""
        bias, drift = self._clock
        return float(bias + drift * self._clock_age) if self._started else float("nan")

    @property
    def clock_drift(self) -> float:
        """Its rate [m/s]; NaN before the first range."""
        return float(self._clock[1]) if self._started else float("nan")

    @property
    def tight_P(self) -> FloatArray:  # noqa: N802
        """Covariance of all 17 errors, shape (17, 17); the clock's stand last."""
        other = self.snapshot()
        self._complete()
        J = self._joined()[: kernels.TIGHT_STATES, : kernels.TIGHT_STATES]
        self.restore(other)
        return J

    def propagate(
        self, delta_theta_b: ArrayLike, delta_vel_b: ArrayLike, dt: ArrayLike
    ) -> Trajectory:
        """Carry everything over m intervals; as `LooseFilter.propagate`."""
        trajectory = super().propagate(delta_theta_b, delta_vel_b, dt)
        count = len(trajectory.geodetic)
        self._clock_age += float(np.sum(np.broadcast_to(np.asarray(dt, np.float64), (count,))))
        return trajectory

    def update_ranges(self, ranges: Ranges) -> RangeInnovations:
        """Work an epoch in, satellite by satellite; what cannot be true is left out.

        A common jump of whole milliseconds is the receiver setting its clock, and goes to the
        clock. Where most ranges of many epochs in a row are rejected it is the position that must
        be wrong: it and the clock are widened by what the ranges say.

        Raises
        ------
        InputError
            Shapes differ, or a sigma is not positive.
        """
        self._complete()
        n = len(ranges.pseudorange)
        z, H, R = self._rows(ranges)
        z = self._set_clock(z, n)
        if not self._started:
            nothing = np.full(2 * n, np.nan)
            return RangeInnovations(z, nothing, nothing, np.zeros(2 * n, np.bool_))
        before = self._joined()
        out = self._tried(before.copy(), z, H, R)
        offered = np.isfinite(z[:n])
        refused = offered & ~out[0].accepted[:n]
        if offered.sum() >= 3:
            self._missed = self._missed + 1 if 2 * refused.sum() > offered.sum() else 0
        if self._missed >= self.tight.epochs_before_recovery:
            self._missed = 0
            self._has_moved()
            wrong = float(np.mean(z[:n][refused] ** 2))
            for k in (*range(POS.start, POS.stop), kernels.BIAS):
                before[k, k] += wrong
            out = self._tried(before.copy(), z, H, R, recovered=True)
        innovations, J, x = out
        if innovations.accepted.any():
            self._part(J)
            self._feed_back(x)
            if self._tape is not None:
                self._tape.measure(before, x, J)
        return innovations

    def residuals(self, ranges: Ranges) -> FloatArray:
        """Return prediction minus measurement of ranges and range rates, shape (2 n,).

        The clock is this filter's, or none before it has started; nothing changes.
        """
        return self._rows(ranges)[0]

    def _rows(self, ranges: Ranges) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return innovations, sensitivities and variances of an epoch."""
        variance, air = self._checked(ranges), self._air(ranges)
        n = len(ranges.pseudorange)
        z, H, R = np.empty(2 * n), np.empty((2 * n, kernels.TIGHT_STATES)), np.empty(2 * n)
        clock = self._clock + np.array([self._clock[1] * self._clock_age, 0.0])
        kernels.rows_kernel(
            self._x, self.omega_ib_b, self.lever_arm_b, self._rate_sd(), clock,
            ranges.satellites, ranges.pseudorange, ranges.range_rate, variance, air, z, H, R,
        )  # fmt: skip
        return z, H, R

    def _tried(
        self,
        J: FloatArray,
        z: FloatArray,
        H: FloatArray,
        R: FloatArray,
        *,
        recovered: bool = False,
    ) -> tuple[RangeInnovations, FloatArray, FloatArray]:
        """Work rows into a joined covariance; return it and the error estimated."""
        x, sd, squared = np.empty(kernels.JOINED), np.empty(len(z)), np.empty(len(z))
        accepted = np.empty(len(z), np.bool_)
        kernels.update_kernel(J, z, H, R, self._range_limit, x, sd, squared, accepted)
        return RangeInnovations(z, sd, squared, accepted, recovered), J, x

    def _set_clock(self, z: FloatArray, n: int) -> FloatArray:
        """Start the clock, or follow its jumps; return innovations with it."""
        known = z[:n][np.isfinite(z[:n])]
        if not known.size:
            return z
        z, rates = z.copy(), z[n:][np.isfinite(z[n:])]
        if self._started:
            bias, drift = MILLISECOND * float(np.rint(np.median(known) / MILLISECOND)), 0.0
        else:
            self._started = True
            bias, drift = float(np.median(known)), float(np.median(rates)) if rates.size else 0.0
            for k, sd in enumerate((self.tight.clock_bias_sd, self.tight.clock_drift_sd)):
                self._B[CONSTANTS + k, CONSTANTS + k] = sd**2
        self._clock = self._clock - [bias, drift]
        z[:n] -= bias
        z[n:] -= drift
        return z

    def _complete(self) -> None:
        super()._complete()
        if self._clock_age > 0.0:
            if self._started:
                self._clock[0] += self._clock_age * self._clock[1]
                kernels.clock_kernel(
                    self._P, self._U, self._B, self._clock_age,
                    self.tight.clock_bias_noise, self.tight.clock_drift_noise,
                )  # fmt: skip
            self._clock_age = 0.0

    def _rate_sd(self) -> float:
        """Return the white noise of the angular rate [rad/s]."""
        interval = float(self._x[INTERVAL])
        return self.grade.gyros.walk / interval**0.5 if interval > 0.0 else 0.0

    def _air(self, ranges: Ranges) -> FloatArray:
        air = np.zeros(kernels.AIR_SIZE)
        if ranges.klobuchar is not None and self.tight.klobuchar:
            air[: kernels.TOW], air[kernels.IONOSPHERE_ON] = ranges.klobuchar, 1.0
        air[kernels.TOW], air[kernels.TROPOSPHERE_ON] = ranges.tow, self.tight.troposphere
        return air

    def _checked(self, ranges: Ranges) -> FloatArray:
        """Return the variances of ranges and range rates, shape (2 n,)."""
        n = len(ranges.pseudorange)
        arrays = ranges.range_rate, ranges.pseudorange_sd, ranges.range_rate_sd
        shapes = {np.shape(array) for array in (ranges.pseudorange, *arrays)}
        if shapes != {(n,)} or np.shape(ranges.satellites) != (n, STATE_COLUMNS):
            raise InputError("ranges", f"arrays differ: {sorted(shapes)} of {n} satellites")
        sds = np.hstack([ranges.pseudorange_sd, ranges.range_rate_sd])
        measured = np.isfinite(np.hstack([ranges.pseudorange, ranges.range_rate]))
        if not np.all(sds[measured] > 0.0) or not np.isfinite(sds[measured]).all():
            raise InputError("ranges", "have sigmas that are not positive", "m and m/s")
        return sds**2

    # The loose filter's own measurements, in the longer state.

    def _joined(self) -> FloatArray:
        """Return the covariance of states, clock and constants together, shape (38, 38)."""
        J = np.empty((kernels.JOINED, kernels.JOINED))
        kernels.join_kernel(self._P, self._U, self._B, J)
        return J

    def _joint_transition(self) -> FloatArray:
        T, inertial = np.eye(kernels.JOINED), np.arange(kernels.JOINED - 2)
        inertial[STATES:] += 2
        T[:STATES] = 0.0
        T[:STATES, inertial] = self._transition
        if self._started:
            T[STATES, STATES + 1] = self._clock_age
        return T

    def _part(self, P: FloatArray) -> None:
        kernels.part_kernel(P, self._P, self._U, self._B)

    def _sensitivity(self, m: Measurement) -> FloatArray:
        H = np.zeros((len(m.z), kernels.JOINED))
        H[:, :STATES] = m.H
        H[:, kernels.TIGHT_STATES : kernels.ESTIMATED] = m.D
        return H

    def _feed_back(self, x: FloatArray) -> None:
        self._clock = self._clock - x[STATES : kernels.TIGHT_STATES]
        self._reference_error += x[kernels.TIGHT_STATES : kernels.ESTIMATED]
        loose_kernels.feed_back_kernel(self._x, self._bias, x)
        loose_kernels.begin_kernel(self._x, self._pending)

    def snapshot(self) -> TightSnapshot:
        """Return all that the filter is now."""
        inner = super().snapshot()
        return TightSnapshot(
            **vars(inner),
            clock=self._clock.copy(),
            clock_age=self._clock_age,
            started=self._started,
            missed=self._missed,
        )

    def restore(self, snapshot: Snapshot) -> None:
        """Be again what the filter was."""
        if not isinstance(snapshot, TightSnapshot):
            raise InputError("tight filter", "was given a loose filter's snapshot")
        super().restore(snapshot)
        self._clock, self._clock_age = snapshot.clock.copy(), snapshot.clock_age
        self._started, self._missed = snapshot.started, snapshot.missed
