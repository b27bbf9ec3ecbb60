"""Strapdown gravimetry of a moving vehicle: the gravity disturbance along its way.

The disturbance is gravity less normal gravity at the same point, along the vertical, positive
down. With velocities over ground, up positive [1]_ (equation 2, its signs corrected)::

    dg = f_U - d(v_U)/dt + E - gamma(L, h)
    E  = (2 w cos(L) + v_E / (R_N + h)) v_E + v_N^2 / (R_M + h)

Printed is ``v' - f - E - gamma``: of the sign of ``-dg`` in its first terms, and of the wrong one
in the others. At rest ``f_U = gamma + dg`` must hold.

Both accelerations are large (2 m/s^2 of a car's vibration against 1e-5) and nearly the same, so
they are not filtered one by one. What the IMU feels is integrated to a *free* velocity, whose
rate is ``f_U + E - gamma``; its difference to the velocity measured from outside is small and
slow, and the rate of that difference is dg. Where the outside velocity is missing the difference
is carried on by a straight line: dg is taken for constant there.

Low-pass: one symmetric FIR filter, a windowed ideal low-pass (Blackman by default), applied
forwards only: its phase is zero because it looks as far ahead as back. Its delay is half its
length; as much is needed before the first and after the last value. Where the record ends before,
it is extended by the mean of its first and last ``edge``: a vehicle that stands at its ends
measures one and the same gravity there.

References
----------
.. [1] Wei G. et al., "Strapdown vehicle autonomous gravimetry method based on two-dimensional
   laser Doppler velocimeter", Infrared and Laser Engineering 52(6), 2023.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.signal import fftconvolve, firwin

from deepseis_core.config import setting
from deepseis_core.constants import WGS84_EARTH_RATE
from deepseis_core.errors import InputError
from deepseis_core.geodesy import meridian_radius, normal_gravity, transverse_radius
from deepseis_core.types import FloatArray

WINDOWS = ("blackman", "hamming", "hann", "boxcar")


@dataclass(frozen=True)
class GravityFilter:
    """The low-pass of the disturbance."""

    cutoff_hz: float = setting(0.008, "cut-off, half amplitude if long [Hz]", low=1e-4, high=1.0)
    half_length: float = setting(150.0, "half of the filter's length [s]", low=1.0, high=3600.0)
    window: str = setting("blackman", "that shapes it", choices=WINDOWS)
    edge: float = setting(
        40.0, "whose mean extends a record at its ends [s]", low=1.0, high=3600.0
    )


def eotvos(geodetic: ArrayLike, vel_n: ArrayLike) -> FloatArray:
    """Return what moving over the Earth takes off gravity [m/s^2], shape (...).

    Parameters
    ----------
    geodetic : array_like, shape (..., 3)
        Latitude, longitude [rad], height [m].
    vel_n : array_like, shape (..., 3)
        Over ground, north, east, down [m/s].

    Examples
    --------
    Eastward at 20 m/s over the equator, 298 mGal:

    >>> round(1e5 * float(eotvos([0.0, 0.0, 0.0], [0.0, 20.0, 0.0])), 1)
    298.0
    """
    latitude, _, height = np.moveaxis(np.asarray(geodetic, np.float64), -1, 0)
    north, east, _ = np.moveaxis(np.asarray(vel_n, np.float64), -1, 0)
    turning = 2.0 * WGS84_EARTH_RATE * np.cos(latitude)
    by_east = (turning + east / (transverse_radius(latitude) + height)) * east
    return by_east + north**2 / (meridian_radius(latitude) + height)


def disturbance(
    force_up: ArrayLike, accel_up: ArrayLike, geodetic: ArrayLike, vel_n: ArrayLike
) -> FloatArray:
    """Return the disturbance of gravity [m/s^2], positive down, by the equation of the module.

    Parameters
    ----------
    force_up, accel_up : array_like, shape (...)
        Specific force and acceleration over ground, up [m/s^2].
    geodetic, vel_n : array_like
        As in `eotvos`.
    """
    latitude, _, height = np.moveaxis(np.asarray(geodetic, np.float64), -1, 0)
    balance = np.asarray(force_up) - np.asarray(accel_up) + eotvos(geodetic, vel_n)
    return balance - normal_gravity(latitude, height)


def low_pass_taps(config: GravityFilter, rate_hz: float) -> FloatArray:
    """Return the taps of the low-pass, an odd number, their sum 1.

    Raises
    ------
    InputError
        The rate is below twice the cut-off, or the filter too short to have one.
    """
    half = round(config.half_length * rate_hz)
    if config.cutoff_hz >= 0.5 * rate_hz:
        raise InputError("gravity filter", f"{config.cutoff_hz} Hz is beyond {rate_hz / 2} Hz")
    if half < 2:
        raise InputError(
            "gravity filter", f"{config.half_length} s are {half} values", "2 at least"
        )
    return np.asarray(firwin(2 * half + 1, config.cutoff_hz, window=config.window, fs=rate_hz))


def low_pass(values: ArrayLike, config: GravityFilter, rate_hz: float) -> FloatArray:
    """Filter an evenly spaced record, shape (m,), with zero phase; edges as in the module.

    A constant stays what it is:

    >>> np.ptp(low_pass(np.ones(50), GravityFilter(cutoff_hz=0.05, half_length=20.0), 1.0)) < 1e-9
    np.True_
    """
    record = np.asarray(values, np.float64)
    taps = low_pass_taps(config, rate_hz)
    half = taps.size // 2
    edge = min(max(round(config.edge * rate_hz), 1), record.size)
    before, after = record[:edge].mean(), record[-edge:].mean()
    padded = np.concatenate([np.full(half, before), record, np.full(half, after)])
    return np.asarray(fftconvolve(padded, taps, mode="valid"))


@dataclass(frozen=True)
class GravitySeries:
    """The disturbance at even steps of time.

    Attributes
    ----------
    time : ndarray, shape (m,)
        [s]
    raw, filtered : ndarray, shape (m,)
        [m/s^2], positive down.
    measured : ndarray of bool, shape (m,)
        Whether the outside velocity was measured at both ends of the step.
    """

    time: FloatArray
    raw: FloatArray
    filtered: FloatArray
    measured: NDArray[np.bool_]


def gravity_series(
    time: FloatArray,
    free_up: FloatArray,
    outside_up: FloatArray,
    config: GravityFilter,
    *,
    step: float = 1.0,
) -> GravitySeries:
    """Return the disturbance from the free vertical velocity and one measured from outside.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Ascending [s].
    free_up, outside_up : ndarray, shape (n,)
        Vertical velocities at the same moments [m/s]; not a number where there is none.
    config : GravityFilter
    step : float
        Of the result; the difference is averaged over it where there are more values [s].

    Raises
    ------
    InputError
        There are fewer than two values.
    """
    difference = free_up - outside_up
    good = np.isfinite(difference)
    if int(good.sum()) < 2:
        raise InputError("gravimetry", "there is no outside velocity to compare with")
    first = time[good][0]
    number = np.floor((time[good] - first) / step + 1e-6).astype(np.int64)
    count = np.bincount(number)
    present = np.flatnonzero(count)
    mean = np.bincount(number, difference[good])[present] / count[present]
    moment = np.bincount(number, time[good])[present] / count[present]
    if present.size < 2:
        raise InputError("gravimetry", f"all values lie within {step:g} s")
    grid = moment[0] + step * np.arange(int((moment[-1] - moment[0]) / step) + 1)
    slope = np.diff(np.interp(grid, moment, mean)) / step
    seen = np.isin(np.round((grid - first) / step - 0.5).astype(np.int64), present)
    return GravitySeries(
        grid[:-1] + 0.5 * step, slope, low_pass(slope, config, 1.0 / step), seen[:-1] & seen[1:]
    )
