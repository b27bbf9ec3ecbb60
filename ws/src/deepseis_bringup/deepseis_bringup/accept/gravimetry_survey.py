"""A survey of the SINS/LDV paper on the bench: what came of it, beside what the bench knows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from deepseis_bringup.accept.tables import Goal, Row
from deepseis_bringup.survey.gravimetry import (
    DOPPLER,
    LDV,
    PHASE,
    Drive,
    GravimetryConfig,
    Solution,
    SurveyResult,
    way_of,
    work_out,
)
from deepseis_bringup.survey.survey_data import data_of_bench
from deepseis_core.geodesy import (
    ecef_from_enu,
    ecef_from_geodetic,
    enu_from_ecef,
    geodetic_from_ecef,
)
from deepseis_core.imu_grades import MGAL, grade_named
from deepseis_core.rotation import matrix_from_quat, ned_frd_from_enu_flu, rotvec_from_matrix
from deepseis_core.types import FloatArray
from deepseis_ins.gravimetry import gravity_series, low_pass, low_pass_taps
from deepseis_ins.gravimetry_lines import Coincidence, Line, Way, coincidence
from deepseis_ins.ldv import LdvInstallation
from deepseis_sim.bench import Bench
from deepseis_sim.gravity_lines import LinesMotion
from deepseis_sim.scenario import load_scenario

Say = Callable[[str], None]

PUBLISHED: Final[Mapping[str, tuple[tuple[float, float, float], ...]]] = {
    LDV: (
        *((1.08, -1.46, 0.73), (0.98, -1.00, 0.47), (1.18, -2.47, 0.66)),
        *((2.37, -1.78, 1.05), (0.83, -1.24, 0.53), (1.26, -1.04, 0.59)),
    ),
    PHASE: (
        *((2.22, -1.57, 1.03), (1.82, -3.05, 1.30), (3.36, -2.92, 1.75)),
        *((1.38, -2.77, 1.02), (2.58, -4.73, 2.46), (1.62, -2.59, 1.05)),
    ),
}
"""Tables 2 and 3: greatest, least deviation and RMS of each pass [mGal]."""
TOTALS: Final[Mapping[str, float]] = {LDV: 0.70, PHASE: 1.53}
TABLES: Final[Mapping[str, str]] = {
    LDV: "L 2 SINS/LDV",
    PHASE: "L 3 SINS/GNSS, carrier phases",
    DOPPLER: "L 3 SINS/GNSS, Doppler",
}
OTHERS: Final = "L 2 and 3, figures 8, 9: other roads and instruments"
HONEST: Final = ("north", "east", "height", "heading")
FOREST: Final = (0.2, 0.8)
"""Part of every pass that lies in the forest."""
CANOPY_DEG: Final = 35.0
"""In it satellites below are hidden."""
SPELL_S: Final = 20.0
"""Of thick forest, once in three such times, with three satellites left."""
LINE_HOURS, HORIZONTAL, HEIGHT = 1.7, 10.0, 3.0
"""Table 1: time of a line [h], accuracy of positions [m]."""


def forest(short: bool, settings: Sequence[str] = ()) -> list[str]:
    """Return the setting that grows a forest along every pass of a road."""
    motion = Bench(load_scenario("gravity-lines", short=short, settings=settings)).motion
    assert isinstance(motion, LinesMotion)
    grown = []
    for begin, end in motion.times:
        first, last = (begin + share * (end - begin) for share in FOREST)
        grown.append(f"{{elevation_to_deg: {CANOPY_DEG}, from_s: {first:.1f}, to_s: {last:.1f}}}")
        for spell in np.arange(first + SPELL_S, last - SPELL_S, 3.0 * SPELL_S):
            grown.append(f"{{keep: 3, from_s: {spell:.1f}, to_s: {spell + SPELL_S:.1f}}}")
    return [f"sky.obstructions=[{', '.join(grown)}]"]


def make_survey(
    short: bool,
    settings: list[str],
    config: GravimetryConfig,
    installation: LdvInstallation,
    say: Say = lambda _text: None,
) -> Survey:
    """Simulate a survey and work it out."""
    grown = [*settings, *forest(short, settings)]
    bench = Bench(load_scenario("gravity-lines", short=short, settings=grown))
    drive = Drive(data_of_bench(bench), config)
    result = work_out([drive], config, installation, say=say)
    return Survey(bench, result, config, short)


@dataclass(frozen=True)
class Survey:
    """What was worked out, beside the bench that knows better."""

    bench: Bench
    result: SurveyResult
    config: GravimetryConfig
    short: bool

    def rows(self, method: str) -> list[Row]:
        """Return the table of a method: every pass, the total, the error of the field."""
        line, table = self.result.lines[method][0], TABLES[method]
        found = coincidence(line.gravity)
        rows = []
        published = PUBLISHED.get(method, ()) if not self.short else ()
        for k in range(len(line.passes)):
            known = published[k] if k < len(published) else (None, None, None)
            scenario = f"gravity-lines, pass {k + 1}"
            values = found.greatest[k], found.least[k], found.rms[k]
            for name, value, printed in zip(
                ("greatest deviation", "least deviation", "RMS"), values, known, strict=True
            ):
                rows.append(Row(table, scenario, name, "mGal", float(value), printed))
        goal = Goal.at_most(TOTALS[LDV]) if method == LDV else None
        total = Row(
            table, "gravity-lines", f"internal coincidence of {len(line.passes)} passes", "mGal",
            found.total, TOTALS.get(method), goal, self.floor(method, len(line.passes)),
        )  # fmt: skip
        before = coincidence(self.result.found[method][0].gravity).total
        coupling = self.result.coupling[method]
        more = [
            Row(table, "gravity-lines", "the same before the cross-coupling is taken off", "mGal",
                before),
            Row(table, "gravity-lines", "cross-coupling of the force to the right",
                "mGal/(m/s^2)", float(coupling.coefficient[1])),
        ]  # fmt: skip
        return [*rows, total, *more, *self._field_rows(method, line)]

    def floor(self, method: str, passes: int) -> float | None:
        """Return what white noise of accelerometers and velocimeter alone would leave [mGal]."""
        if method != LDV:
            return None
        taps = low_pass_taps(self.config.filter, 1.0)
        steps = np.diff(np.concatenate([[0.0], taps, [0.0]]))
        scenario = self.bench.scenario
        assert scenario.imu is not None
        assert scenario.ldv is not None
        walk = grade_named(scenario.imu.grade).accelerometers.walk
        # Two beams at 60 degrees: down is (d1 + d2) / (2 sin 60), a second averages them.
        speed = float(np.median(np.linalg.norm(self.result.solutions[LDV][0].track.vel_n, axis=1)))
        ldv = scenario.ldv
        beam = np.hypot(ldv.noise, ldv.relative_noise * 0.5 * speed)
        down = beam * np.sqrt(2.0) / np.sqrt(3.0) / np.sqrt(ldv.rate_hz)
        noise = np.hypot(walk * np.linalg.norm(taps), down * np.linalg.norm(steps))
        return float(np.sqrt((passes - 1.0) / passes) * noise / MGAL)

    def truth(self, solution: Solution) -> Way:
        """Return the true field along the true way, through the same low-pass, as a way."""
        time = solution.series.time
        values = low_pass(self.bench.gravity_disturbance(time), self.config.filter, 1.0)
        start = self.result.drives[0].start
        origin = ecef_from_geodetic(np.array([start.latitude, start.longitude, start.height]))
        own = way_of(solution, origin)
        first = self.bench.gravity_disturbance(np.zeros(1))[0]
        return Way(time, own.position, own.still, (values - first) / MGAL, own.force)

    def truth_mgal(self, method: str) -> FloatArray:
        """Return the filtered true field at the line's stations, mean of all passes [mGal]."""
        return np.asarray(np.mean(self._true_passes(method), axis=0))

    def _true_passes(self, method: str) -> FloatArray:
        """Return what every pass should have seen, at the stations it was brought to."""
        solution, line = self.result.solutions[method][0], self.result.lines[method][0]
        way = self.truth(solution)
        rows = []
        for item in line.passes:
            part = (way.time >= item.begin) & (way.time <= item.end)
            gap = np.linalg.norm(
                way.position[part][:, None, :2] - line.position[None, :, :2], axis=2
            )
            rows.append(way.gravity[part][gap.argmin(axis=0)])
        return np.array(rows)

    def _field_rows(self, method: str, line: Line) -> list[Row]:
        truth, table = self._true_passes(method), TABLES[method]
        error = line.gravity - truth
        level = float(np.nanmean(error))
        spread = float(np.sqrt(np.nanmean((error - level) ** 2)))
        return [
            Row(table, "gravity-lines", "RMS against the true field, same low-pass, level free",
                "mGal", spread),
            Row(table, "gravity-lines", "level against the rest at the start", "mGal", level),
            Row(table, "gravity-lines", "internal coincidence of the true field, same low-pass",
                "mGal", coincidence(truth).total),
        ]  # fmt: skip

    def gains(self) -> list[Row]:
        """Return what SINS/LDV gains over SINS/GNSS."""
        own = agreed(self.result, LDV)
        rows = []
        for method in (PHASE, DOPPLER):
            other = agreed(self.result, method)
            if own is None or other is None:
                continue
            gain = 100.0 * (1.0 - own.total / other.total)
            goal = Goal.at_least(50.0) if method == PHASE else None
            printed = 53.0 if method == PHASE else None
            rows.append(
                Row("L 2 and 3", "gravity-lines", f"gain of SINS/LDV over {method}", "%", gain,
                    printed, goal)
            )  # fmt: skip
        return rows

    def position_rows(self) -> list[Row]:
        """Return the largest position errors, figures 8 and 9; limit: the filter's own sigma."""
        rows = []
        for method, printed in ((LDV, (17.0, 2.0)), (DOPPLER, (None, None))):
            if method not in self.result.solutions:
                continue
            solution = self.result.solutions[method][0]
            track, rest = solution.track, self.result.drives[0].rest
            sd = track.sd[np.isfinite(track.sd[:, 0]) & (track.time > rest)]
            limits = float(np.hypot(sd[:, 0], sd[:, 1]).max()), float(sd[:, 2].max())
            names = "horizontal", "height"
            errors = self.errors(solution)
            for name, value, known, limit in zip(names, errors, printed, limits, strict=True):
                goal = None if known is None else Goal.at_most(known)
                quantity = f"largest {name} error; as limit its sigma"
                rows.append(
                    Row("L figures 8, 9", f"gravity-lines, {method}", quantity, "m", value, known,
                        goal, limit)
                )  # fmt: skip
        return rows

    def index_rows(self) -> list[Row]:
        """Return the other indices of table 1."""
        table, scenario = "L 1 indices", "gravity-lines, SINS/LDV"
        horizontal, height = self.errors(self.solution(LDV))
        line = self.result.lines[LDV][0]
        hours = max(item.end - item.begin for item in line.passes) / 3600.0
        return [
            Row(table, scenario, "acceleration by the velocimeter, same low-pass, RMS", "mGal",
                self.acceleration_error(), 1.0, Goal.at_most(1.0)),
            Row(table, scenario, "longest time of a line", "h", float(hours), LINE_HOURS,
                Goal.at_most(LINE_HOURS)),
            Row(table, scenario, "largest horizontal error", "m", horizontal, HORIZONTAL,
                Goal.at_most(HORIZONTAL)),
            Row(table, scenario, "largest height error", "m", height, HEIGHT,
                Goal.at_most(HEIGHT)),
        ]  # fmt: skip

    def summary_rows(self, where: str) -> list[Row]:
        """Return the totals of a survey beside others."""
        horizontal, height = self.errors(self.solution(LDV))
        own, other = self.total(LDV), self.total(PHASE)
        limit = TOTALS[LDV]
        return [
            Row(OTHERS, where, f"{LDV}: internal coincidence", "mGal", own, limit,
                Goal.at_most(limit)),
            Row(OTHERS, where, f"{PHASE}: internal coincidence", "mGal", other, TOTALS[PHASE]),
            Row(OTHERS, where, "gain over carrier phases", "%", 100.0 * (1.0 - own / other), 53.0,
                Goal.at_least(50.0)),
            Row(OTHERS, where, "largest horizontal error", "m", horizontal, 17.0,
                Goal.at_most(17.0)),
            Row(OTHERS, where, "largest height error", "m", height, 2.0, Goal.at_most(2.0)),
        ]  # fmt: skip

    def solution(self, method: str) -> Solution:
        """Return the only drive by a method."""
        return self.result.solutions[method][0]

    def total(self, method: str) -> float:
        """Return the internal coincidence [mGal]; not a number where there is none."""
        found = agreed(self.result, method)
        return np.nan if found is None else found.total

    def acceleration_error(self) -> float:
        """Return the RMS error of the acceleration by the velocimeter, on all passes [mGal]."""
        track, line = self.solution(LDV).track, self.result.lines[LDV][0]
        edges = np.append(2.0 * track.time[0] - track.time[1], track.time)
        place = self.bench.motion.at(edges - self.bench.clock(edges)).position
        geodetic = geodetic_from_ecef(ecef_from_enu(place, self.bench.site.origin_ecef))
        rise = np.diff(geodetic[:, 2]) / np.diff(edges)
        series = gravity_series(track.time, track.aid_up, rise, self.config.filter)
        on_line = np.zeros(series.time.size, np.bool_)
        for item in line.passes:
            on_line |= (series.time >= item.begin) & (series.time <= item.end)
        return float(np.sqrt(np.mean(series.filtered[on_line] ** 2))) / MGAL

    def honesty(self) -> FloatArray:
        """Return errors over sigmas of the place and the heading at the end, shape (4,)."""
        track = self.solution(LDV).track
        last = np.flatnonzero(np.isfinite(track.sd[:, 0]))[-1:]
        time = track.time[last]
        at = self.bench.motion.at(time - self.bench.clock(time))
        ours = ecef_from_geodetic(track.geodetic[last])
        off = (enu_from_ecef(ours, self.bench.site.origin_ecef) - at.position)[0]
        C_true = ned_frd_from_enu_flu(at.C_enu_b.reshape(-1, 3, 3)[0])
        phi = -rotvec_from_matrix(matrix_from_quat(track.quat_nb[last[0]]) @ C_true.T)
        sd = track.sd[last[0]]
        return np.array([*(off[[1, 0, 2]] / sd[:3]), phi[2] / sd[8]])

    def errors(self, solution: Solution) -> tuple[float, float]:
        """Return the largest horizontal and height error of a solution [m]."""
        track, bench = solution.track, self.bench
        at = bench.motion.at(track.time - bench.clock(track.time))
        enu = enu_from_ecef(ecef_from_geodetic(track.geodetic), bench.site.origin_ecef)
        error = enu - at.position
        return float(np.hypot(error[:, 0], error[:, 1]).max()), float(np.abs(error[:, 2]).max())


def agreed(result: SurveyResult, method: str) -> Coincidence | None:
    """Return how the passes of the first line agree; None where there is no line."""
    lines = result.lines.get(method)
    return coincidence(lines[0].gravity) if lines else None
