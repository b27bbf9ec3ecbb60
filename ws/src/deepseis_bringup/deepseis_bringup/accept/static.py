"""A station that stands still for 900 s: what holds its inertial navigation (thesis 3.4.2).

Thesis figures 3.12 to 3.14: the loosely coupled filter with positions and velocities of GNSS, with
zero velocity in their place, and with zero velocity and zero angle. GNSS is the station's own
single-point solution; the attitude is given, as in the thesis, from a survey of `SURVEY_DEG`.
Figures of one unit are in the pictures; the tables are over several units of the grade, so that
"honest" means something: errors over the filter's own sigma.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from deepseis_bringup.accept.scene import Work
from deepseis_bringup.accept.tables import Goal
from deepseis_bringup.accept.tables import Row as Line
from deepseis_bringup.report.plot import PALETTE, Figure, Row, envelope, nice_span, rows_panel
from deepseis_core.ephemeris import pack, states_from_pseudoranges
from deepseis_core.geodesy import ecef_from_geodetic, geodetic_from_ecef, rotation_ned_ecef
from deepseis_core.imu_errors import ImuErrors
from deepseis_core.imu_grades import grade_named
from deepseis_core.rotation import (
    flu_from_frd,
    matrix_from_quat,
    matrix_from_rotvec,
    ned_frd_from_enu_flu,
    quat_from_matrix,
    rotvec_from_matrix,
)
from deepseis_core.types import Ephemeris, FloatArray, Observations
from deepseis_ins import measurements
from deepseis_ins.loose import LooseConfig, LooseFilter
from deepseis_ins.measurements import Measurement
from deepseis_ins.strapdown import NavState
from deepseis_pvt.spp import SppSolution, SppSolver
from deepseis_sim.bench import Bench
from deepseis_sim.bench_streams import ObservationStream
from deepseis_sim.imu import ImuSynthesizer
from deepseis_sim.scenario import load_scenario

TABLE: Final = "T figures 3.12 to 3.14, standing still for 900 s"
GRADE: Final = "span-fsas"
SECONDS: Final = 900
RATE: Final = 200
SURVEY_DEG: Final = 0.03
"""Of the attitude given, each axis."""
STILL_VELOCITY: Final = 1e-3
"""Of the zero velocity [m/s]."""
STILL_ANGLE_DEG: Final = 0.01
CONSTRAINTS: Final = ("loose", "zero velocity", "zero velocity and zero angle")
PUBLISHED: Final = {
    "loose": "picture: heading drifts",
    "zero velocity": "picture: position, velocity better; heading drifts",
    "zero velocity and zero angle": "picture: all converge",
}
AXES: Final = ("north", "east", "down")
LAST_S: Final = 60
"""The tables tell of the end of the run [s]."""


@dataclass(frozen=True)
class Still:
    """Errors and sigmas of a unit at every second: position, velocity, attitude, (n, 9).

    Metres, metres per second, degrees; north, east, down.
    """

    error: FloatArray
    sd: FloatArray


def standing_still(work: Work) -> None:
    """Give position, velocity and heading under every constraint."""
    work.say("standing still for 900 s: positions")
    station = Station()
    units = 5 if work.short else 24
    runs: dict[str, list[Still]] = {}
    for constraint in CONSTRAINTS:
        work.say(f"standing still for 900 s: {constraint}, {units} units")
        runs[constraint] = [station.run(constraint, seed) for seed in range(units)]
        work.acceptance.add(*_rows(constraint, runs[constraint]))
    work.acceptance.figures.append((TABLE, _figures(runs)))


class Station:
    """The bench's still station: its positions, and units of the IMU."""

    def __init__(self, seconds: int = SECONDS) -> None:
        settings = ["signal=false", "observations.rate_hz=1", "base=null", f"duration={seconds}"]
        self.seconds = seconds
        self.bench = Bench(load_scenario("static", short=False, settings=settings))
        self.grade = grade_named(GRADE)
        self.lever_b = flu_from_frd(np.asarray(self.bench.scenario.lever_arm))
        self.fixes = list(_fixes(self.bench))
        maker = ImuSynthesizer(self.bench.motion, self.bench.site, float(RATE))
        self.ideal = maker.increments(0, RATE * seconds)
        state = self.bench.motion.at(np.zeros(1))
        self.C_nb = ned_frd_from_enu_flu(state.C_enu_b.reshape(3, 3))
        self.place_ecef = self.bench.site.ecef(state).position[0]

    def run(self, constraint: str, seed: int) -> Still:
        """Run a unit under a constraint."""
        made = ImuErrors(self.grade, float(RATE), 100 + seed).apply(
            0, self.ideal.delta_theta, self.ideal.delta_vel
        )
        theta, vel = (flu_from_frd(part) for part in (made.delta_theta, made.delta_vel))
        loose = self._started(np.random.default_rng([seed, 91]))
        C_reference = matrix_from_quat(loose.nav.quat_nb)
        errors, sds = [], []
        for second in range(self.seconds):
            part = slice(second * RATE, (second + 1) * RATE)
            loose.propagate(theta[part], vel[part], 1.0 / RATE)
            for measurement in self._told(constraint, loose, second + 1, C_reference):
                loose.update(measurement())
            errors.append(self._error(loose))
            sds.append(loose.sd[:9] * np.repeat([1.0, 1.0, np.degrees(1.0)], 3))
        return Still(np.array(errors), np.array(sds))

    def _started(self, rng: np.random.Generator) -> LooseFilter:
        """Start where the first fix says, with a surveyed attitude."""
        fix = self.fixes[0]
        sd = np.radians(SURVEY_DEG)
        quat = quat_from_matrix(matrix_from_rotvec(-sd * rng.standard_normal(3)) @ self.C_nb)
        place = geodetic_from_ecef(fix.position_ecef)
        C_ne = rotation_ned_ecef(place[0], place[1])
        imu_ecef = fix.position_ecef - C_ne.T @ matrix_from_quat(quat) @ self.lever_b
        latitude, longitude, height = (float(value) for value in geodetic_from_ecef(imu_ecef))
        spread = np.sqrt(np.diag(C_ne @ fix.covariance[:3, :3] @ C_ne.T))
        return LooseFilter(
            LooseConfig(),
            self.grade,
            NavState(latitude, longitude, height, np.zeros(3), quat),
            attitude_sd=[sd] * 3,
            position_sd=spread,
            velocity_sd=[STILL_VELOCITY] * 3,
        )

    def _told(
        self, constraint: str, loose: LooseFilter, second: int, C_reference: FloatArray
    ) -> Iterator[Callable[[], Measurement]]:
        """Yield what the filter is told at a second, each to be made when its turn comes."""
        if constraint == "loose":
            if second < len(self.fixes):
                yield from self._gnss(loose, self.fixes[second])
            return
        yield lambda: measurements.zero_velocity(loose.nav, STILL_VELOCITY)
        if constraint.endswith("angle"):
            angle = np.radians(STILL_ANGLE_DEG)
            yield lambda: measurements.zero_angle(loose.nav, C_reference, angle)

    def _gnss(self, loose: LooseFilter, fix: SppSolution) -> Iterator[Callable[[], Measurement]]:
        yield lambda: measurements.gnss_position(
            loose.nav, fix.position_ecef, fix.covariance[:3, :3], self.lever_b
        )
        rate_sd = self.grade.gyros.walk * np.sqrt(RATE)
        yield lambda: measurements.gnss_velocity(
            loose.nav, loose.omega_ib_b, fix.velocity_ecef, fix.velocity_covariance[:3, :3],
            self.lever_b, rate_sd=rate_sd,
        )  # fmt: skip

    def _error(self, loose: LooseFilter) -> FloatArray:
        nav = loose.nav
        ours = ecef_from_geodetic([nav.latitude, nav.longitude, nav.height])
        C_ne = rotation_ned_ecef(nav.latitude, nav.longitude)
        turned = -rotvec_from_matrix(matrix_from_quat(nav.quat_nb) @ self.C_nb.T)
        return np.hstack([C_ne @ (ours - self.place_ecef), nav.vel_n, np.degrees(turned)])


def _fixes(bench: Bench) -> Iterator[SppSolution]:
    """Solve the observations of the bench, as the pvt node does."""
    solver = SppSolver()
    packed = {item.satellite: item.ephemeris for item in bench.model.satellites}
    (receiver,) = (
        stream
        for stream in bench.streams
        if isinstance(stream, ObservationStream) and stream.topic == "gnss/observations"
    )
    for begin, end in bench.spans():
        for item in receiver.between(begin, end):
            found = _solved(solver, item.value, packed)
            if found is not None:
                yield found


def _solved(
    solver: SppSolver, epoch: Observations, ephemerides: Mapping[str, Ephemeris]
) -> SppSolution | None:
    orbits = pack([ephemerides[name] for name in epoch.satellites])
    states = states_from_pseudoranges(orbits, epoch.week, epoch.tow_ns, epoch.pseudorange)
    return solver.solve(
        states, epoch.pseudorange, epoch.carrier_doppler_hz, epoch.cn0_dbhz.astype(np.float64),
        tow=epoch.tow_ns * 1e-9,
    )  # fmt: skip


def _rows(constraint: str, runs: Sequence[Still]) -> list[Line]:
    error = np.array([run.error[-LAST_S:] for run in runs])
    sd = np.array([run.sd[-LAST_S:] for run in runs])
    rms, sigma = (np.sqrt(np.mean(part**2, axis=(0, 1))) for part in (error, sd))
    scenario = f"{GRADE}, {len(runs)} units, {constraint}"
    text = PUBLISHED[constraint]
    rows = []
    for name, unit, part in (("position", "m", 0), ("velocity", "mm/s", 3)):
        scale = 1e3 if unit == "mm/s" else 1.0
        for axes, columns in (("horizontal", [part, part + 1]), ("vertical", [part + 2])):
            for quantity, values in (("RMS error", rms), ("1 sigma", sigma)):
                size = scale * float(np.linalg.norm(values[columns]))
                name_of = f"{name}, {axes}, {quantity}, last minute"
                rows.append(Line(TABLE, scenario, name_of, unit, size, text))
    heading = float(rms[8])
    bound = Goal.at_most(0.05) if constraint.endswith("angle") else None
    # n units tell an RMS to 1 / sqrt(2 n): three sigma of that and no more is chance.
    chance = 1.0 + 3.0 / np.sqrt(2.0 * len(runs))
    rows += [
        Line(TABLE, scenario, "level, RMS error of the worse axis, last minute", "deg",
             float(rms[6:8].max()), text),
        Line(TABLE, scenario, "heading, RMS error, last minute", "deg", heading, text, bound),
        Line(TABLE, scenario, "heading, 1 sigma, last minute", "deg", float(sigma[8]), text,
             bound),
        Line(TABLE, scenario, "heading, RMS error over 1 sigma", "-", heading / float(sigma[8]),
             goal=Goal.at_most(round(chance, 2)), limit=1.0),
    ]  # fmt: skip
    return rows


def _figures(runs: dict[str, list[Still]]) -> list[Figure]:
    """Draw the first unit under every constraint: heading, velocity, position."""
    t = np.arange(1.0, SECONDS + 1.0)
    figures = []
    for title, unit, columns, scale in (
        ("Heading", "deg", (8,), 1.0),
        ("Velocity", "mm/s", (3, 4, 5), 1e3),
        ("Position", "m", (0, 1, 2), 1.0),
    ):
        rows = []
        for number, (name, units) in enumerate(runs.items()):
            for column in columns:
                error, sd = (scale * part[:, column] for part in (units[0].error, units[0].sd))
                axis = f", {AXES[column % 3]}" if len(columns) > 1 else ""
                rms = float(np.sqrt(np.mean(error**2)))
                shown = envelope(t, error)
                near = np.interp(shown[0], t, sd)
                rows.append(
                    Row(name + axis, PALETTE[number], *shown, f"{rms:.2g}", "", near)
                )  # fmt: skip
        span = nice_span([1.2 * max(float(np.nanmax(np.abs(row.y))) for row in rows)])
        caption = (
            f"Error of one unit [{unit}]; rows span {span:g} {unit} either way; shaded: the "
            "filter's own sigma."
        )
        figures.append(
            Figure(
                f"{title}, standing still", caption, [rows_panel(rows, float(SECONDS), span, unit)]
            )
        )
    return figures
