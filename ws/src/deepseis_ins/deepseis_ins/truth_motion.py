"""The antenna's true motion, for the test bench: a smooth trajectory from a truth file.

Two layouts of ``.npz`` are read, by the arrays they hold:

======================= =========================================================
``antenna_ecef_m``      ECEF [m] at ``motion_t_s`` [s] since sample 0; shape (m, 3)
``antenna_ecef``        ECEF [m] at ``t_s``; shape (m, 3) (`deepseis_sim.recording`)
======================= =========================================================

and of both ``start_week`` and ``start_tow_ns``, GPS time of sample 0, if they are there. A file
without motion needs the position of the antenna from elsewhere.
"""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BSpline, make_interp_spline

from deepseis_core.errors import InputError
from deepseis_core.gps_time import GpsTime
from deepseis_core.types import FloatArray

LAYOUTS = (("motion_t_s", "antenna_ecef_m"), ("t_s", "antenna_ecef"))
DEGREE = 5
"""Of the spline: its second derivative is smooth."""


class Trajectory:
    """Position, velocity and acceleration in ECEF by time since sample 0.

    Before its first and after its last point the antenna stands still there.

    Parameters
    ----------
    time : array_like, shape (m,)
        Increasing [s].
    position_ecef : array_like, shape (m, 3)
        [m]; one point, or all the same, stands still.

    Examples
    --------
    >>> still = Trajectory([0.0], [[6.4e6, 0.0, 0.0]])
    >>> still.states([1.0, 2.0])[:, 0].tolist()
    [6400000.0, 6400000.0]
    """

    def __init__(self, time: ArrayLike, position_ecef: ArrayLike) -> None:
        self.time = np.asarray(time, np.float64)
        position = np.asarray(position_ecef, np.float64)
        self.origin: FloatArray = position[0].copy()
        offset = position - self.origin
        self._splines: tuple[BSpline, ...] = ()
        if len(self.time) > DEGREE and np.any(offset):
            position_spline = make_interp_spline(self.time, offset, k=DEGREE)
            velocity_spline = position_spline.derivative()
            self._splines = position_spline, velocity_spline, velocity_spline.derivative()

    @property
    def moves(self) -> bool:
        """Whether the antenna ever moves."""
        return bool(self._splines)

    def states(self, time: ArrayLike, *, scale: float = 1.0) -> FloatArray:
        """Return position [m], velocity [m/s], acceleration [m/s^2], shape (k, 9).

        Parameters
        ----------
        time : array_like, shape (k,)
            Since sample 0 [s].
        scale : float, optional
            Exaggerates the motion about the first point: 1 is the truth.
        """
        t = np.atleast_1d(np.asarray(time, np.float64))
        out = np.zeros((len(t), 9))
        if self._splines:
            inside = (t >= self.time[0]) & (t <= self.time[-1])
            near = np.clip(t, self.time[0], self.time[-1])
            out[:, 0:3] = scale * self._splines[0](near)
            for k in (1, 2):
                out[inside, 3 * k : 3 * k + 3] = scale * self._splines[k](t[inside])
        out[:, 0:3] += self.origin
        return out


class TruthMotion:
    """What a truth file tells about the antenna.

    Parameters
    ----------
    path : path
        The ``.npz``.
    position_ecef : array_like, shape (3,), optional
        Where the antenna stands if the file has no motion [m].

    Attributes
    ----------
    trajectory : Trajectory
    start : GpsTime or None
        GPS time of sample 0, if the file has it.

    Raises
    ------
    InputError
        The file cannot be read or makes no sense.
    """

    def __init__(self, path: str | Path, position_ecef: ArrayLike | None = None) -> None:
        self.path = Path(path)
        arrays = _read(self.path)
        self.start = self._start(arrays)
        for time_name, position_name in LAYOUTS:
            if position_name in arrays:
                time, position = self._motion(arrays, time_name, position_name)
                break
        else:
            if position_ecef is None:
                raise InputError(
                    self.path,
                    "holds no motion of the antenna (antenna_ecef_m or antenna_ecef)",
                    "give the position of the still antenna",
                )
            time, position = np.zeros(1), np.asarray(position_ecef, np.float64).reshape(1, 3)
        self.trajectory = Trajectory(time, position)

    def _motion(
        self, arrays: Mapping[str, NDArray[np.generic]], time_name: str, position_name: str
    ) -> tuple[FloatArray, FloatArray]:
        if time_name not in arrays:
            raise InputError(self.path, f"has {position_name} but not its times {time_name}")
        try:
            time = np.asarray(arrays[time_name], np.float64)
            position = np.asarray(arrays[position_name], np.float64)
        except (TypeError, ValueError):
            raise InputError(self.path, f"{position_name} is not made of numbers") from None
        reason = _fault(time, position)
        if reason:
            raise InputError(self.path, f"{time_name}, {position_name}: {reason}")
        return time, position

    def _start(self, arrays: Mapping[str, NDArray[np.generic]]) -> GpsTime | None:
        if "start_week" not in arrays or "start_tow_ns" not in arrays:
            return None
        try:
            return GpsTime(int(arrays["start_week"]), int(arrays["start_tow_ns"]))
        except (TypeError, ValueError):
            raise InputError(self.path, "start_week or start_tow_ns is not one number") from None


def _fault(time: FloatArray, position: FloatArray) -> str:
    """Say why times and positions are no trajectory; empty if they are one."""
    if time.ndim != 1 or position.shape != (len(time), 3) or not len(time):
        return f"shapes {time.shape} and {position.shape} are not (m,) and (m, 3)"
    if not (np.isfinite(time).all() and np.isfinite(position).all()):
        return "not all numbers are finite"
    if np.any(np.diff(time) <= 0):
        return "times do not increase"
    radius = np.linalg.norm(position, axis=1)
    if radius.min() < 6.3e6 or radius.max() > 7e6:
        return f"a point {radius.min():.4g} m from the Earth's centre is not on the ground"
    return ""


def _read(path: Path) -> dict[str, NDArray[np.generic]]:
    """Return the arrays of an ``.npz``."""
    if path.is_dir():
        raise InputError(path, "is a directory", "name a truth file (.npz)")
    wanted = {name for pair in LAYOUTS for name in pair} | {"start_week", "start_tow_ns"}
    try:
        with path.open("rb") as file:
            if not zipfile.is_zipfile(file):
                raise InputError(path, "is not an .npz, or cut short", "name a truth file")
            file.seek(0)
            with np.load(file, allow_pickle=False) as archive:
                return {name: archive[name] for name in archive.files if name in wanted}
    except OSError as error:
        raise InputError(path, error.strerror or str(error)) from None
    except (ValueError, EOFError, zipfile.BadZipFile, KeyError) as error:
        raise InputError(path, f"is not a readable .npz: {error}") from None
