"""Gravity along the lines of a survey: from data of drives to profiles of every method.

Each drive is worked through as SINS/LDV and as SINS/GNSS, as far as it has the data. GNSS gives
two outside velocities: Doppler at its fixes, and carrier phases between them; both are shown.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from deepseis_bringup.survey.survey_data import SurveyData
from deepseis_core.errors import InputError
from deepseis_core.geodesy import ecef_from_geodetic, enu_from_ecef, geodetic_from_ecef
from deepseis_core.imu_grades import MGAL
from deepseis_core.rotation import quat_rotate
from deepseis_core.types import FloatArray
from deepseis_ins.alignment import gyro_bias, gyrocompassed, still_mean
from deepseis_ins.gravimetry import GravityFilter, GravitySeries, gravity_series, low_pass
from deepseis_ins.gravimetry_coupling import (
    Coupling,
    coupling_prior,
    find_coupling,
    without_coupling,
)
from deepseis_ins.gravimetry_lines import Line, LineConfig, Way, survey_lines
from deepseis_ins.ldv import LdvConfig, LdvInstallation
from deepseis_ins.ldv_calibration import LeverArm, calibrate
from deepseis_ins.loose import LooseConfig, LooseFilter
from deepseis_ins.strapdown import NavState
from deepseis_ins.survey import ALWAYS, Aids, Span, Survey
from deepseis_ins.survey_records import (
    ImuRecord,
    SurveyConfig,
    Track,
    still_samples,
    survey_grade,
)

LDV, DOPPLER, PHASE = "SINS/LDV", "SINS/GNSS, Doppler", "SINS/GNSS, phases"
METHODS: Final = (LDV, DOPPLER, PHASE)
LEAST_REST: Final = 20.0
"""At the start, to find north and the base's reading [s]."""
COVARIANCE_STEP: Final = 0.2
START_SD: Final = 1e-3
"""Of zero velocity at the start [m/s]."""

Say = Callable[[str], None]


def _quiet(_text: str) -> None:
    pass


@dataclass(frozen=True)
class GravimetryConfig:
    """All settings of a survey."""

    survey: SurveyConfig = field(default_factory=SurveyConfig)
    ldv: LdvConfig = field(default_factory=LdvConfig)
    filter: GravityFilter = field(default_factory=GravityFilter)
    lines: LineConfig = field(default_factory=LineConfig)


@dataclass(frozen=True)
class Solution:
    """One drive by one method.

    Attributes
    ----------
    method : str
        One of `METHODS`.
    track : Track
    series : GravitySeries
        The disturbance; level and tie: `base`.
    base : float
        Reading at the rest before the drive, taken off [m/s^2].
    force : ndarray, shape (m, 2)
        Specific force forward and right on the series' moments, the same low-pass [m/s^2].
    """

    method: str
    track: Track
    series: GravitySeries
    base: float
    force: FloatArray


@dataclass(frozen=True)
class Calibration:
    """An installation, what was wrong with the lever arm given, and the drive's track."""

    installation: LdvInstallation
    lever: LeverArm
    track: Track


class Drive:
    """A drive, ready to be worked through.

    Raises
    ------
    InputError
        It has no rest at its start, or GNSS does not say where it starts.
    """

    def __init__(self, data: SurveyData, config: GravimetryConfig) -> None:
        self.data, self.config = data, config
        still = still_samples(
            data.delta_theta_b, data.delta_vel_b, data.dt, data.grade, config.survey.guard
        )
        self.imu = ImuRecord(
            data.imu_time_end, data.delta_theta_b, data.delta_vel_b, data.dt, still
        )
        self.rest = _first_rest(still) * data.dt
        if self.rest < LEAST_REST:
            reason = f"rests for {self.rest:.1f} s at its start"
            raise InputError(data.name, reason, f"{LEAST_REST:g} s to find north and a base")
        latitude, longitude, height, self._start_sd = self._place()
        count = int(self.rest / data.dt)
        mean = still_mean(data.delta_theta_b[:count], data.delta_vel_b[:count], data.dt)
        self.aligned = gyrocompassed(mean, latitude, height, data.grade)
        self.gyro_bias = gyro_bias(mean, self.aligned, latitude, data.grade)
        assert data.gnss is not None
        below = float((self.aligned.C_nb @ data.gnss.fixes.lever_arm_b)[2])
        self.start = NavState(
            latitude, longitude, height + below, np.zeros(3), self.aligned.quat_nb
        )
        self.survey = Survey(self.imu, data.ldv, data.gnss.fixes, config.survey, config.ldv)

    def filter(self, *, lasting: bool = False) -> LooseFilter:
        """Make the filter as it is at the start: position by GNSS, attitude by the rest.

        ``lasting``: as in `survey_grade`, for a drive of hours without GNSS.
        """
        covariance = self.aligned.covariance
        return LooseFilter(
            LooseConfig(covariance_step=COVARIANCE_STEP),
            survey_grade(self.data.grade, self.config.survey, lasting=lasting),
            self.start,
            attitude_sd=0.5 * (covariance + covariance.T),
            position_sd=[self._start_sd] * 3,
            velocity_sd=[START_SD] * 3,
            gyro_bias=self.gyro_bias.value,
            gyro_bias_sd=self.gyro_bias.sd,
        )

    def calibrate(self, installation: LdvInstallation, spans: tuple[Span, ...]) -> Calibration:
        """Calibrate the velocimeter with the GNSS of this drive."""
        aids = Aids(fixes=spans)
        return Calibration(*calibrate(self.survey, self.filter, installation, aids))

    def by_ldv(self, installation: LdvInstallation) -> Solution:
        """Work it through without GNSS from the first movement on."""
        aids = Aids(fixes=((-np.inf, self.rest),))
        track = self.survey.run(self.filter(lasting=True), installation, aids)
        return self._solution(LDV, track, track.time, track.free_up, track.aid_up)

    def by_gnss(self) -> list[Solution]:
        """Work it through without the velocimeter: Doppler, and phases."""
        track = self.survey.run(self.filter(), LdvInstallation(), Aids(ldv=()))
        found = [self._solution(DOPPLER, track, *_doppler(track))]
        phases = self._phases(track)
        if phases is not None:
            found.append(self._solution(PHASE, track, *phases))
        return found

    def _solution(
        self, method: str, track: Track, time: FloatArray, free: FloatArray, outside: FloatArray
    ) -> Solution:
        series = gravity_series(time, free, outside, self.config.filter)
        base = float(series.raw[series.time < self.rest].mean())
        return Solution(method, track, series, base, self._force(series.time))

    def _force(self, time: FloatArray) -> FloatArray:
        """Return the horizontal force through the low-pass; what it is at rest is bias."""
        count = max(round(1.0 / self.data.dt), 1)
        whole = self.data.delta_vel_b.shape[0] // count
        mean = self.data.delta_vel_b[: whole * count, :2].reshape(whole, count, 2).sum(axis=1)
        mean /= count * self.data.dt
        middle = (np.arange(whole) + 0.5) * count * self.data.dt
        columns = [np.interp(time, middle, mean[:, k]) for k in range(2)]
        return np.stack([low_pass(one, self.config.filter, 1.0) for one in columns], axis=1)

    def _phases(self, track: Track) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """Return mean velocities between epochs: time, free, by phase; at rest zero."""
        assert self.data.gnss is not None
        steps, arm = self.data.gnss.steps, self.data.gnss.fixes.lever_arm_b
        if steps.begin.size < 2:
            return None
        length = steps.end - steps.begin
        # The antenna's height over the IMU changes with the attitude.
        above = -quat_rotate(track.quat_nb, arm)[:, 2]
        rise = np.interp(steps.end, track.time, track.free_rise + above)
        rise -= np.interp(steps.begin, track.time, track.free_rise + above)
        return 0.5 * (steps.begin + steps.end), rise / length, steps.up / length

    def _place(self) -> tuple[float, float, float, float]:
        """Return where the antenna rests at the start [rad, rad, m], and how surely [m]."""
        if self.data.gnss is None:
            raise InputError(self.data.name, "has no GNSS to say where it starts")
        fixes = self.data.gnss.fixes
        first = fixes.time < self.rest
        if not first.any():
            raise InputError(self.data.name, "has no position during its first rest")
        place = geodetic_from_ecef(fixes.position_ecef[first].mean(axis=0))
        spread = np.trace(fixes.position_covariance_ecef[first].mean(axis=0)) / 3.0
        return float(place[0]), float(place[1]), float(place[2]), float(np.sqrt(spread))


def _first_rest(still: NDArray[np.bool_]) -> int:
    moving = np.flatnonzero(~still)
    return int(moving[0]) if moving.size else still.size


def _doppler(track: Track) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return time, free and Doppler's velocity; at rest zero."""
    rest = track.still
    time = np.concatenate([track.time[rest], track.fix_time])
    free = np.concatenate([track.free_up[rest], track.fix_free_up])
    outside = np.concatenate([track.aid_up[rest], track.fix_up])
    order = np.argsort(time, kind="stable")
    return time[order], free[order], outside[order]


def way_of(solution: Solution, origin_ecef: FloatArray) -> Way:
    """Return a drive on the series' moments, about an origin common to all drives."""
    track, series = solution.track, solution.series
    enu = enu_from_ecef(ecef_from_geodetic(track.geodetic), origin_ecef)
    position = np.stack([np.interp(series.time, track.time, enu[:, k]) for k in range(3)], 1)
    # The ellipsoid's height, not the tangent plane's.
    position[:, 2] = np.interp(series.time, track.time, track.geodetic[:, 2])
    still = np.interp(series.time, track.time, track.still.astype(np.float64)) > 0.5
    gravity = (series.filtered - solution.base) / MGAL
    return Way(series.time, position, still, gravity, solution.force)


@dataclass(frozen=True)
class SurveyResult:
    """What came out: solutions of every drive and method, and lines of every method [mGal].

    ``lines`` are rid of the cross-coupling that was found, ``found`` are as they were.
    """

    drives: tuple[Drive, ...]
    solutions: dict[str, list[Solution]]
    lines: dict[str, list[Line]]
    found: dict[str, list[Line]]
    coupling: dict[str, Coupling]
    calibration: Calibration | None


def work_out(
    drives: Sequence[Drive],
    config: GravimetryConfig,
    installation: LdvInstallation | None,
    *,
    gnss: bool = True,
    say: Say = _quiet,
) -> SurveyResult:
    """Work drives out by all methods that their data allow.

    Parameters
    ----------
    drives : sequence of Drive
    config : GravimetryConfig
    installation : LdvInstallation or None
        Of the velocimeter; without, the first drive that has one calibrates it with its GNSS.
    gnss : bool, optional
        By GNSS too, where there is any.
    say : callable, optional
        Told what is done.
    """
    calibration = None
    with_ldv = [drive for drive in drives if drive.data.ldv is not None]
    if with_ldv and installation is None:
        say(f"{with_ldv[0].data.name}: calibrating the velocimeter")
        calibration = with_ldv[0].calibrate(LdvInstallation.nominal(config.ldv), ALWAYS)
        installation = calibration.installation
    solutions: dict[str, list[Solution]] = {}
    for drive in drives:
        own: list[Solution] = []
        if drive.data.ldv is not None and installation is not None:
            say(f"{drive.data.name}: {LDV}")
            own.append(drive.by_ldv(installation))
        if gnss and drive.data.gnss is not None and drive.data.gnss.fixes.time.size > 1:
            say(f"{drive.data.name}: {DOPPLER}")
            own += drive.by_gnss()
        for solution in own:
            solutions.setdefault(solution.method, []).append(solution)
    start = drives[0].start
    origin = ecef_from_geodetic(np.array([start.latitude, start.longitude, start.height]))
    ways = {name: [way_of(item, origin) for item in items] for name, items in solutions.items()}
    found = {name: survey_lines(items, config.lines) for name, items in ways.items()}
    prior, step = coupling_prior(drives[0].data.grade), 0.5 / config.filter.cutoff_hz
    coupling = {name: find_coupling(items, prior, step) for name, items in found.items()}
    lines = {name: without_coupling(items, coupling[name]) for name, items in found.items()}
    return SurveyResult(tuple(drives), solutions, lines, found, coupling, calibration)
