"""Fixes and phase steps of a survey's GNSS, from its observations and orbits."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from deepseis_core.constants import NS_PER_S
from deepseis_core.ephemeris import states_from_pseudoranges
from deepseis_core.geodesy import geodetic_from_ecef, rotation_enu_ecef
from deepseis_core.gps_time import GpsTime
from deepseis_core.types import Ephemeris, FloatArray, Observations
from deepseis_ins.survey_records import FixRecord
from deepseis_pvt.ephemeris_book import EphemerisBook
from deepseis_pvt.phase_velocity import PhaseEpoch, phase_epoch, phase_step
from deepseis_pvt.spp import SppSolution, SppSolver

ALL_SAMPLES = 1 << 62
MAX_AGE = 7200.0
"""Of an ephemeris [s]."""


@dataclass(frozen=True)
class PhaseSteps:
    """Displacements of the antenna between epochs, by carrier phase, m of them.

    Attributes
    ----------
    begin, end : ndarray, shape (m,)
        [s]
    up : ndarray, shape (m,)
        Upward [m].
    """

    begin: FloatArray
    end: FloatArray
    up: FloatArray


@dataclass(frozen=True)
class SurveyGnss:
    """What GNSS has to say of a drive; ``satellites`` used at every epoch."""

    fixes: FixRecord
    steps: PhaseSteps
    satellites: FloatArray


class _Solver:
    """Works epochs through one by one."""

    def __init__(self, ephemerides: Iterable[Ephemeris]) -> None:
        self.book, self.solver = EphemerisBook(MAX_AGE), SppSolver()
        for item in ephemerides:
            self.book.add(item)
        self.start: FloatArray | None = None

    def solve(self, o: Observations) -> tuple[SppSolution, PhaseEpoch] | None:
        """Return position, velocity, and what the phases need; None without a position."""
        gps_ns = GpsTime(o.week, o.tow_ns).total_ns
        found = [self.book.find(name, ALL_SAMPLES, gps_ns) for name in o.satellites]
        chosen = [k for k, item in enumerate(found) if item is not None]
        if len(chosen) < 4:
            return None
        items = [item for item in found if item is not None]
        pseudorange = o.pseudorange[chosen]
        states = states_from_pseudoranges(
            np.stack([item[1] for item in items]), o.week, o.tow_ns, pseudorange
        )
        solution = self.solver.solve(
            states,
            pseudorange,
            o.carrier_doppler_hz[chosen],
            o.cn0_dbhz[chosen].astype(np.float64),
            tow=o.tow_ns / NS_PER_S,
            accuracy=np.array([item[0].accuracy for item in items]),
            klobuchar=self.book.klobuchar(ALL_SAMPLES),
            start=self.start,
        )
        if solution is None:
            return None
        self.start = np.append(solution.position_ecef, solution.clock_bias)
        return solution, phase_epoch(o, chosen, states[:, :3], solution)


def survey_gnss(
    observations: Iterable[tuple[float, Observations]],
    ephemerides: Iterable[Ephemeris],
    lever_arm_b: FloatArray,
) -> SurveyGnss:
    """Solve all epochs of a drive.

    Parameters
    ----------
    observations : iterable of (float, Observations)
        Each with its time on the drive's scale [s].
    ephemerides : iterable of Ephemeris
    lever_arm_b : ndarray, shape (3,)
        From the IMU to the antenna, forward-right-down [m].
    """
    solver = _Solver(ephemerides)
    rows, steps, seen = [], [], []
    before: tuple[float, PhaseEpoch] | None = None
    for time, epoch in observations:
        found = solver.solve(epoch)
        if found is None:
            before = None
            seen.append(0.0)
            continue
        solution, phases = found
        rows.append((time, solution))
        seen.append(float(solution.used.sum()))
        moved = phase_step(before[1], phases) if before is not None else None
        if before is not None and moved is not None:
            steps.append((before[0], time, float(_up(phases.position_ecef) @ moved[0])))
        before = time, phases
    return SurveyGnss(
        _fixes(rows, lever_arm_b),
        PhaseSteps(*np.array(steps).reshape(-1, 3).T),
        np.array(seen),
    )


def _up(position_ecef: FloatArray) -> FloatArray:
    latitude, longitude, _ = geodetic_from_ecef(position_ecef)
    return rotation_enu_ecef(latitude, longitude)[2]


def _fixes(rows: list[tuple[float, SppSolution]], lever_arm_b: FloatArray) -> FixRecord:
    return FixRecord(
        np.array([time for time, _ in rows]),
        np.array([s.position_ecef for _, s in rows]).reshape(-1, 3),
        np.array([s.velocity_ecef for _, s in rows]).reshape(-1, 3),
        np.array([s.covariance[:3, :3] for _, s in rows]).reshape(-1, 3, 3),
        np.array([s.velocity_covariance[:3, :3] for _, s in rows]).reshape(-1, 3, 3),
        lever_arm_b,
    )
