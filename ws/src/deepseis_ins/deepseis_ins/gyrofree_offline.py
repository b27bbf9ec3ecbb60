"""A whole record without gyroscopes: filtered forward, then smoothed (`deepseis_ins.gyrofree`)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deepseis_core.errors import InputError
from deepseis_core.types import FloatArray
from deepseis_ins.gyrofree import GyroFreeFilter, Motion
from deepseis_ins.gyrofree_model import BIAS, DRIFT, POS, VEL
from deepseis_ins.loose import Innovation
from deepseis_ins.smoother import FilterStep, Smoothed, between, smooth


@dataclass(frozen=True)
class StationRecord:
    """What accelerometers and GNSS of a station recorded.

    Attributes
    ----------
    delta_vel_b : ndarray, shape (m, 3)
        Increments of the accelerometers, body [m/s].
    rate_hz : float
        How many a second.
    epochs : ndarray of int, shape (k,)
        Of GNSS, ascending: how many increments end at or before each.
    positions : ndarray, shape (k, 3)
        Displacements east, north, up from GNSS [m].
    covariance : ndarray, shape (3, 3) or (k, 3, 3)
        Of what the filter takes for white [m^2].
    still_until : float
        The ground is known not to have moved so long [s]; 0: nothing is known.
    """

    delta_vel_b: FloatArray
    rate_hz: float
    epochs: NDArray[np.int64]
    positions: FloatArray
    covariance: FloatArray
    still_until: float = 0.0


@dataclass(frozen=True)
class Track:
    """The record's motion.

    Attributes
    ----------
    time : ndarray, shape (m,)
        Ends of the increments' intervals since the beginning [s].
    forward, smoothed : Motion
        At these times: with what was measured until then, and with everything.
    steps : list of FilterStep
        One for each epoch of GNSS.
    smoothed_errors : Smoothed
        Of these steps.
    innovations : list of Innovation
    drift : ndarray, shape (k, 3)
        Smoothed drift of GNSS at its epochs [m]; zero with nine states.
    """

    time: FloatArray
    forward: Motion
    smoothed: Motion
    steps: list[FilterStep]
    smoothed_errors: Smoothed
    innovations: list[Innovation]
    drift: FloatArray

    def sd(self, part: slice, *, smoothed: bool) -> FloatArray:
        """Return the standard deviations of states at the epochs, shape (k, 3)."""
        P = self.smoothed_errors.P if smoothed else np.array([step.after for step in self.steps])
        return np.sqrt(np.diagonal(P, axis1=1, axis2=2)[:, part])


def track(filter_: GyroFreeFilter, record: StationRecord) -> Track:
    """Work through a record with a filter fresh from its start, made with ``smoothing=True``.

    While the ground is known to be still that is said once a second, at an epoch of GNSS.
    """
    record = _checked(record)
    count, dt = len(record.delta_vel_b), 1.0 / record.rate_hz
    covariance = np.broadcast_to(record.covariance, (len(record.epochs), 3, 3))
    forward = _empty(count)
    steps: list[FilterStep] = []
    innovations: list[Innovation] = []
    drift, fixed, held, done = [], [], -np.inf, 0
    for k, epoch in enumerate(record.epochs):
        _carry(filter_, record, slice(done, epoch), forward)
        time, done = epoch * dt, int(epoch)
        if time < record.still_until and time - held > 1.0 - 0.5 * dt:
            filter_.hold_still()
            held = time
        innovations.append(filter_.update_position(record.positions[k], covariance[k]))
        steps += filter_.take_steps()
        drift.append(filter_.drift)
        fixed.append((filter_.position, filter_.velocity))
    _carry(filter_, record, slice(done, count), forward)
    got = smooth(steps)
    smoothed = _smoothed(forward, record.epochs, got, dt)
    for epoch, (position, velocity) in zip(record.epochs, fixed, strict=True):
        if epoch:
            forward.position[epoch - 1], forward.velocity[epoch - 1] = position, velocity
    drifts = np.array(drift, np.float64)
    if filter_.config.states == 12:
        drifts += got.error[:, DRIFT]
    time = dt * np.arange(1.0, count + 1.0)
    return Track(time, forward, smoothed, steps, got, innovations, drifts)


def _carry(filter_: GyroFreeFilter, record: StationRecord, part: slice, out: Motion) -> None:
    got = filter_.propagate(record.delta_vel_b[part], 1.0 / record.rate_hz)
    out.position[part], out.velocity[part] = got.position, got.velocity
    out.acceleration[part] = got.acceleration


def _smoothed(forward: Motion, epochs: NDArray[np.int64], got: Smoothed, dt: float) -> Motion:
    """Take the errors off what was carried between the epochs; the ends stay as they are."""
    out = Motion(forward.position.copy(), forward.velocity.copy(), forward.acceleration.copy())
    for k in range(len(epochs) - 1):
        first, last = int(epochs[k]), int(epochs[k + 1])
        share = np.arange(1, last - first + 1) / (last - first)
        error = between(
            got.error[k], got.error_before[k + 1], POS, VEL, share, dt * (last - first)
        )
        out.position[first:last] -= error[:, POS]
        out.velocity[first:last] -= error[:, VEL]
        out.acceleration[first:last] -= error[:, BIAS]
    # Before the first epoch the start's errors are unknown; behind the last there is no later.
    return out


def _empty(count: int) -> Motion:
    return Motion(np.empty((count, 3)), np.empty((count, 3)), np.empty((count, 3)))


def _checked(record: StationRecord) -> StationRecord:
    epochs = np.asarray(record.epochs, np.int64)
    count = len(record.delta_vel_b)
    if not len(epochs):
        raise InputError("station record", "has no epoch of GNSS")
    if np.any(np.diff(epochs) <= 0) or epochs[0] < 0 or epochs[-1] > count:
        raise InputError("epochs of GNSS", "are not in order within the record", f"0 to {count}")
    if np.shape(record.positions) != (len(epochs), 3):
        raise InputError("positions of GNSS", f"have shape {np.shape(record.positions)}", "(k, 3)")
    return record
