"""Position against a base station by RTKLIB's RTK, one epoch at a time.

RTKLIB's file loop takes observations less than 25 ms apart for one epoch (``DTTOL``), and so
merges epochs above 40 Hz. Here each epoch is given to ``rtkpos`` by itself, with the base's last
one that is not later: RTKLIB differences residuals against geometry, each at its own time, so
that a base once a second serves a rover of 50 Hz; what is left of its age is published. A base
later than the rover's epoch is never used: in real time there is none.

T. Takasu and A. Yasuda, "Development of the low-cost RTK-GPS receiver with an open source program
package RTKLIB", Int. Symp. on GPS/GNSS, Jeju, 2009.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyrtklib as rtklib

from deepseis_core.config import check, setting
from deepseis_core.errors import InputError
from deepseis_core.types import FloatArray, Lli, PreciseStatus
from deepseis_pvt.rtklib_values import (
    BASE,
    ROVER,
    exact_time,
    read_navigation,
    read_observations,
    satellite_name,
)

MAX_OBSERVATIONS: Final = 2 * 64


@dataclass(frozen=True)
class RtkConfig:
    """Settings of RTK.

    RTKLIB's arithmetic bears no phase noise far below its usual 3 mm (its covariance loses its
    sign); positions are the same, and their covariance is worked out elsewhere.
    """

    rtk_mask_deg: float = setting(10.0, "elevation mask [deg]", low=0.0, high=60.0)
    rtk_frequencies: int = setting(1, "carriers used: 1 L1, 2 L1 and L2", low=1, high=2)
    rtk_ratio: float = setting(3.0, "least ratio of a fixed solution [-]", low=1.0, high=100.0)
    rtk_carrier_sd: float = setting(
        0.003, "phase noise of one receiver at any elevation, for weights [m]", low=1e-5, high=0.1
    )
    rtk_carrier_low_sd: float = setting(
        0.003, "and of it what grows with 1 / sin(elevation) [m]", low=0.0, high=0.1
    )
    rtk_code_ratio: float = setting(500.0, "code noise over phase noise [-]", low=10.0, high=1e5)
    rtk_bandwidth_hz: float = setting(
        8.0, "noise bandwidth of the carrier loops, for the covariance of fixed positions [Hz]",
        low=0.1,
    )  # fmt: skip
    rtk_hold: bool = setting(False, "fix and hold; otherwise integers are found anew each epoch")
    rtk_max_age_s: float = setting(30.0, "oldest base of a solution [s]", low=0.1, high=600.0)


GEODETIC: Final = RtkConfig(
    rtk_mask_deg=15.0,
    rtk_frequencies=2,
    rtk_code_ratio=100.0,
)
"""RTKLIB's own defaults, for geodetic receivers' files."""


@dataclass(frozen=True)
class RtkSolution:
    """One epoch: antenna in ECEF [m] with its covariance [m^2]; arrays aligned on satellites.

    ``status`` is FIX or FLOAT, ``ratio`` that of the ambiguities' test, ``age`` [s] how much the
    base's observations are older. ``residual`` [m] is that of the phase (L1), ``direction`` (n, 2)
    azimuth and elevation [rad].
    """

    status: PreciseStatus
    position_ecef: FloatArray
    covariance_ecef: FloatArray
    ratio: float
    age: float
    satellites: tuple[str, ...]
    residual: FloatArray
    direction: FloatArray


class RtkSolver:
    """RTKLIB's kinematic RTK, with its state of ambiguities, from epoch to epoch.

    Parameters
    ----------
    config : RtkConfig
        Settings.
    base_position : ndarray, shape (3,)
        ECEF [m]. Errors of it are errors of every position.
    """

    def __init__(self, config: RtkConfig, base_position: FloatArray) -> None:
        check(config)
        self.config = config
        self._state = rtklib.rtk_t()
        rtklib.rtkinit(self._state, _options(config, base_position))
        self._both = rtklib.Arr1Dobsd_t(MAX_OBSERVATIONS)
        self._half: dict[tuple[int, int, int], int] = {}
        self._base_time = 0

    def tie(self, position: FloatArray | None) -> None:
        """From the next epoch on, take the antenna to be known [m ECEF] (None: unknown again).

        Known, it gives the ambiguities at once; they stay as it becomes unknown.
        """
        options = self._state.opt
        options.mode = rtklib.PMODE_KINEMA if position is None else rtklib.PMODE_FIXED
        if position is not None:
            for i in range(3):
                options.ru[i] = float(position[i])

    def close(self) -> None:
        """Give RTKLIB's memory back; nothing can be solved afterwards."""
        if self._state is not None:
            rtklib.rtkfree(self._state)
            self._state = None

    @property
    def room(self) -> Any:
        """RTKLIB array for an epoch: the rover's observations, then the base's."""
        return self._both

    def solve(self, rover: int, base: int, nav: Any) -> RtkSolution | None:
        """Solve the epoch that has been put into `room`.

        Parameters
        ----------
        rover, base : int
            How many observations there are of each.
        nav : nav_t
            Orbits.

        Returns
        -------
        RtkSolution or None
            None without relative position, whatever else RTKLIB has to say.
        """
        if rover < 4 or base < 4:
            return None
        self._break_arcs(0, rover)
        base_time = exact_time(self._both[rover].time)
        if base_time != self._base_time:
            self._break_arcs(rover, rover + base)
            self._base_time = base_time
        rtklib.rtkpos(self._state, self._both[0], rover + base, nav)
        s = self._state.sol
        status = {rtklib.SOLQ_FIX: PreciseStatus.FIX, rtklib.SOLQ_FLOAT: PreciseStatus.FLOAT}
        if s.stat not in status:
            return None
        q = [float(s.qr[i]) for i in range(6)]
        covariance = np.array([[q[0], q[3], q[5]], [q[3], q[1], q[4]], [q[5], q[4], q[2]]])
        used = [self._both[i].sat for i in range(rover)]
        used = [number for number in used if self._state.ssat[number - 1].vsat[0]]
        return RtkSolution(
            status=status[s.stat],
            position_ecef=np.array([s.rr[0], s.rr[1], s.rr[2]]),
            covariance_ecef=covariance,
            ratio=float(s.ratio),
            age=float(s.age),
            satellites=tuple(satellite_name(number) for number in used),
            residual=np.array([self._state.ssat[number - 1].resc[0] for number in used]),
            direction=np.array([self._direction(number) for number in used]).reshape(-1, 2),
        )

    def _direction(self, number: int) -> tuple[float, float]:
        azel = self._state.ssat[number - 1].azel
        return float(azel[0]), float(azel[1])

    def _break_arcs(self, first: int, end: int) -> None:
        """Begin ambiguities anew where phases have slipped or half cycles have been settled.

        RTKLIB does not look at these marks where epochs are less than ``DTTOL`` apart. A zero in
        its state is what it takes for no ambiguity yet.
        """
        state = self._state
        for place in range(first, end):
            d = self._both[place]
            for f in range(self.config.rtk_frequencies):
                key, half = (d.rcv, d.sat, f), d.LLI[f] & Lli.HALF_CYCLE
                turned = self._half.get(key, half) != half
                self._half[key] = half
                if turned or d.LLI[f] & Lli.SLIP:
                    state.x[state.na + rtklib.MAXSAT * f + d.sat - 1] = 0.0


def _options(config: RtkConfig, base_position: FloatArray) -> Any:
    """Return RTKLIB's options; a structure of our own, for its defaults are one for all."""
    c, options, default = config, rtklib.prcopt_t(), rtklib.prcopt_default
    options.mode, options.navsys, options.nf = rtklib.PMODE_KINEMA, rtklib.SYS_GPS, 1
    options.nf = c.rtk_frequencies
    options.elmin, options.modear = np.radians(c.rtk_mask_deg), 3 if c.rtk_hold else 1
    options.ionoopt, options.tropopt = rtklib.IONOOPT_BRDC, rtklib.TROPOPT_SAAS
    options.err[0], options.err[4] = 100.0, 1.0
    options.err[1], options.err[2] = c.rtk_carrier_sd, c.rtk_carrier_low_sd
    for i in range(3):
        options.eratio[i] = c.rtk_code_ratio
        options.std[i], options.rb[i] = default.std[i], float(base_position[i])
        options.ru[i] = 0.0
    for i in range(6):
        options.prn[i] = default.prn[i]
    options.thresar[0] = c.rtk_ratio
    for i in range(1, 8):
        options.thresar[i] = default.thresar[i]
    options.maxtdiff = c.rtk_max_age_s
    for name in (
        *("sclkstab", "maxinno", "maxgdop", "minlock", "minfix", "maxout", "niter"),
        *("armaxiter", "thresslip", "elmaskar", "elmaskhold", "glomodear", "bdsmodear"),
    ):
        setattr(options, name, getattr(default, name))
    return options


@dataclass(frozen=True)
class RtkEpoch:
    """One of the rover's epochs in a file: GPS week, seconds of week, solution or None."""

    week: int
    tow: float
    solution: RtkSolution | None


def solve_files(
    rover: str | Path,
    base: str | Path,
    navigation: Sequence[str | Path],
    config: RtkConfig | None = None,
    base_position: FloatArray | None = None,
) -> Iterator[RtkEpoch]:
    """Solve every epoch of a rover's RINEX file against a base's.

    Parameters
    ----------
    rover, base : path
        Observations, RINEX 2 or 3, of any rate each.
    navigation : sequence of path
        Orbits.
    config : RtkConfig, optional
        Settings; default `GEODETIC`.
    base_position : ndarray, shape (3,), optional
        ECEF [m]; default that of the base's file.

    Raises
    ------
    InputError
        A file cannot be used, or does not say where the base is.
    """
    nav, station = rtklib.nav_t(), rtklib.sta_t()
    for path in navigation:
        read_navigation(path, nav)
    mine, epochs = read_observations(rover, ROVER, nav)
    theirs, base_epochs = read_observations(base, BASE, nav)
    if base_position is None:
        base_position = _position_in(base, nav, station)
    solver = RtkSolver(config or GEODETIC, base_position)
    base_times = np.array(sorted(base_epochs))
    try:
        for time, places in epochs.items():
            before = int(np.searchsorted(base_times, time, side="right")) - 1
            others = base_epochs[int(base_times[before])] if before >= 0 else []
            rows = [mine.data[i] for i in places] + [theirs.data[i] for i in others]
            for place, row in enumerate(rows):
                solver.room[place] = row
            week = rtklib.Arr1Dint(1)
            tow = rtklib.time2gpst(mine.data[places[0]].time, week)
            solution = solver.solve(len(places), len(others), nav)
            yield RtkEpoch(int(week[0]), float(tow), solution)
    finally:
        solver.close()


def _position_in(path: str | Path, nav: Any, station: Any) -> FloatArray:
    rtklib.readrnx(str(path), BASE, "", rtklib.obs_t(), nav, station)
    position = np.array([station.pos[i] for i in range(3)])
    if np.linalg.norm(position) < 1e6:
        raise InputError(path, "does not say where its antenna is", "give the base's position")
    return position
