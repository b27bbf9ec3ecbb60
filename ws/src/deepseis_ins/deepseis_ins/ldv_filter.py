"""The filter of a vehicle with a velocimeter: slow errors of GNSS and a lever arm as states.

Behind the 15 of `deepseis_ins.error_state` stand nine states more, random walks::

    [dr dv phi bg ba | dp du dl]

dp and du are by what positions [m] and velocities [m/s] of GNSS are off, north, east, down:
atmosphere, orbits, reflections, which change over minutes. Taken for white noise, however large,
they become as good as one wants by repetition; across the way that is heading. A station learns
them against its monument (`deepseis_ins.gnss_offset`); a vehicle that has driven on has none, its
place is as uncertain as before when it rests. Estimated together with the place both are right.

dl is the lever arm from the IMU to the velocimeter [m], forward-right-down, which swings as the
vehicle turns: 5 cm not known are 0.15 m after half a turn.

All are errors, estimate minus truth, as the others: a measurement is ``z = H x + D e + E y + v``.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from deepseis_core.imu_grades import ImuGrade
from deepseis_core.types import FloatArray
from deepseis_ins import loose_kernels
from deepseis_ins.error_state import CONSTANTS, STATES
from deepseis_ins.loose import Innovation, LooseConfig, LooseFilter, Snapshot
from deepseis_ins.measurements import Measurement
from deepseis_ins.strapdown import NavState, Trajectory

BEYOND: Final = 9
"""States behind the 15."""
POSITION_OFF, VELOCITY_OFF, LEVER = slice(0, 3), slice(3, 6), slice(6, 9)
"""Of these."""
_ESTIMATED: Final = STATES + BEYOND + 3
_ORDER: Final = np.hstack(
    [
        np.arange(STATES),
        np.arange(STATES + CONSTANTS, STATES + CONSTANTS + BEYOND),
        np.arange(STATES, STATES + CONSTANTS),
    ]
)
"""Of states, constants and what is beyond: behind the states what is beyond, then constants."""
_BACK: Final = np.argsort(_ORDER)


def _zeros() -> FloatArray:
    return np.zeros((3, BEYOND))


@dataclass(frozen=True)
class BeyondMeasurement(Measurement):
    """A measurement with ``E``, shape (3, 9): sensitivity to the errors beyond the 15."""

    E: FloatArray = field(default_factory=_zeros)


def sensitive(measurement: Measurement, part: slice, to: ArrayLike) -> BeyondMeasurement:
    """Return a measurement with a sensitivity, shape (3, 3), to three states beyond the 15."""
    E = np.zeros((3, BEYOND))
    E[:, part] = to
    return BeyondMeasurement(**vars(measurement), E=E)


def of_gnss(measurement: Measurement, part: slice) -> BeyondMeasurement:
    """Return a measurement of GNSS that is off by a slow error.

    Many of a kind that are refused prove that error wrong, as when satellites come and go, and
    not the filter.

    Parameters
    ----------
    measurement : Measurement
        Of `gnss_position` or `gnss_velocity`.
    part : slice
        `POSITION_OFF` or `VELOCITY_OFF`.
    """
    states = slice(STATES + part.start, STATES + part.stop)
    return replace(sensitive(measurement, part, np.eye(3)), states=states)


@dataclass(frozen=True)
class Unknowns:
    """Standard deviations at the start, and growth.

    Attributes
    ----------
    sd : tuple of float
        Of positions, velocities, lever arm, each axis [m, m/s, m].
    growth : tuple of float
        Random walks of positions and velocities [m/sqrt(s), m/s/sqrt(s)].
    """

    sd: tuple[float, float, float]
    growth: tuple[float, float]


@dataclass(frozen=True)
class LdvSnapshot(Snapshot):
    """The loose filter's, and what is beyond."""

    beyond: FloatArray = field(default_factory=lambda: np.zeros(BEYOND))
    age: float = 0.0


class LdvFilter(LooseFilter):
    """`LooseFilter` with nine states more; it takes all that the loose one takes.

    Parameters
    ----------
    config, grade, nav
        As `LooseFilter`'s, and so are further keywords.
    unknowns : Unknowns
    """

    _joint = STATES + BEYOND + CONSTANTS
    _estimated = _ESTIMATED

    def __init__(
        self,
        config: LooseConfig,
        grade: ImuGrade,
        nav: NavState,
        *,
        unknowns: Unknowns,
        **given: Any,
    ) -> None:
        self._beyond, self._age = np.zeros(BEYOND), 0.0
        self._growth2 = np.repeat(np.square([*unknowns.growth, 0.0]), 3)
        super().__init__(config, grade, nav, **given)
        self._U = np.hstack([self._U, np.zeros((STATES, BEYOND))])
        B = np.diag(np.hstack([np.zeros(CONSTANTS), np.repeat(np.square(unknowns.sd), 3)]))
        B[:CONSTANTS, :CONSTANTS] = self._B
        self._B = B

    @property
    def gnss_errors(self) -> FloatArray:
        """By what positions, then velocities of GNSS are off, shape (6,) [m, m/s]."""
        return -self._beyond[: LEVER.start]

    @property
    def whole_P(self) -> FloatArray:  # noqa: N802
        """Covariance of all 24 errors, shape (24, 24)."""
        n, other = STATES + BEYOND, self.snapshot()
        self._complete()
        J = self._joined()[:n, :n]
        self.restore(other)
        return J

    @property
    def lever_sd(self) -> FloatArray:
        """Standard deviations of the lever arm, shape (3,) [m]."""
        return np.sqrt(np.diag(self._B)[CONSTANTS + LEVER.start :])

    def take_lever(self) -> FloatArray:
        """Return by what the lever arm is wrong, shape (3,) [m]; the caller corrects it."""
        error = self._beyond[LEVER].copy()
        self._beyond[LEVER] = 0.0
        return error

    def propagate(
        self, delta_theta_b: ArrayLike, delta_vel_b: ArrayLike, dt: ArrayLike
    ) -> Trajectory:
        """Carry everything over m intervals; as `LooseFilter.propagate`."""
        trajectory = super().propagate(delta_theta_b, delta_vel_b, dt)
        count = len(trajectory.geodetic)
        self._age += float(np.sum(np.broadcast_to(np.asarray(dt, np.float64), (count,))))
        return trajectory

    def update(self, measurement: Measurement) -> Innovation:
        """Work a measurement in; as `LooseFilter.update`."""
        m = measurement
        if isinstance(m, BeyondMeasurement):
            m = replace(m, z=m.z - m.E @ self._beyond)
        return super().update(m)

    def snapshot(self) -> LdvSnapshot:
        """Return all that the filter is now."""
        return LdvSnapshot(**vars(super().snapshot()), beyond=self._beyond.copy(), age=self._age)

    def restore(self, snapshot: Snapshot) -> None:
        """Be again what the filter was."""
        assert isinstance(snapshot, LdvSnapshot)
        super().restore(snapshot)
        self._beyond, self._age = snapshot.beyond.copy(), snapshot.age

    def _complete(self) -> None:
        super()._complete()
        if self._age > 0.0:
            k = np.arange(CONSTANTS, CONSTANTS + BEYOND)
            self._B[k, k] += self._age * self._growth2
            self._age = 0.0

    def _joint_transition(self) -> FloatArray:
        T, known = np.eye(self._joint), STATES + CONSTANTS
        T[:STATES, :known] = self._transition
        return np.ascontiguousarray(T[np.ix_(_ORDER, _ORDER)])

    def _joined(self) -> FloatArray:
        """Return the covariance of states, what is beyond, and constants, shape (45, 45)."""
        return np.ascontiguousarray(super()._joined()[np.ix_(_ORDER, _ORDER)])

    def _part(self, P: FloatArray) -> None:
        super()._part(P[np.ix_(_BACK, _BACK)])

    def _sensitivity(self, m: Measurement) -> FloatArray:
        H = np.zeros((len(m.z), self._joint))
        H[:, :STATES] = m.H
        H[:, STATES + BEYOND : _ESTIMATED] = m.D
        if isinstance(m, BeyondMeasurement):
            H[:, STATES : STATES + BEYOND] = m.E
        return H

    def _feed_back(self, x: FloatArray) -> None:
        self._beyond = self._beyond + x[STATES : STATES + BEYOND]
        self._reference_error += x[STATES + BEYOND : _ESTIMATED]
        loose_kernels.feed_back_kernel(self._x, self._bias, x)
        loose_kernels.begin_kernel(self._x, self._pending)
