"""Acceptance of gravimetry: tables 1 to 3 of the SINS/LDV paper, repeated.

A calibration drive under an open sky, on another road and with another draw of the IMU's biases,
gives the velocimeter's installation. The survey is driven six times through a forest; SINS/LDV
works without GNSS from its first movement on, SINS/GNSS without the velocimeter.

The paper prints no low-pass. Ours is that of `GravityFilter`, the same for all methods. Its GNSS
is differenced positions; ours is the better of what the receiver gives: Doppler, and carrier
phases between epochs. The gain is stated against the stronger.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from deepseis_bringup.accept.gravimetry_real import real_rows
from deepseis_bringup.accept.tables import Acceptance, Goal, Row
from deepseis_bringup.survey.gravimetry import (
    DOPPLER,
    LDV,
    PHASE,
    Calibration,
    Drive,
    GravimetryConfig,
    Solution,
    SurveyResult,
    way_of,
    work_out,
)
from deepseis_bringup.survey.gravimetry_page import method_figures
from deepseis_bringup.survey.survey_data import data_of_bench
from deepseis_core.geodesy import ecef_from_geodetic, enu_from_ecef
from deepseis_core.imu_grades import MGAL, grade_named
from deepseis_core.rotation import euler_from_matrix
from deepseis_core.types import FloatArray
from deepseis_ins.gravimetry import low_pass, low_pass_taps
from deepseis_ins.gravimetry_lines import Coincidence, Line, Way, coincidence
from deepseis_ins.ldv import LdvInstallation
from deepseis_ins.survey import ALWAYS
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
FOREST: Final = (0.2, 0.8)
"""Part of every pass that lies in the forest."""
CANOPY_DEG: Final = 35.0
"""In it satellites below are hidden."""
SPELL_S: Final = 20.0
"""Of thick forest, once in three such times, with three satellites left."""
CALIBRATION_SEED: Final = 2
OTHER_SEEDS: Final = (3, 4, 5)
"""Of other roads and other draws of the instruments, for what one drive cannot tell."""
CALIBRATION_S: Final = 1520.0
"""Two lines and their rests."""


def accept_gravimetry(folder: Path, *, short: bool, say: Say = lambda _text: None) -> Acceptance:
    """Repeat the tables.

    Parameters
    ----------
    folder : Path
        Gets ``gravimetry.csv`` and ``gravimetry.html``.
    short : bool
        1.5 km driven there and back, in place of 11 km six times.
    say : callable, optional
        Told what is done.
    """
    form = "short form" if short else "full form"
    acceptance = Acceptance("gravimetry", f"Gravimetry with a laser velocimeter, {form}")
    config = GravimetryConfig()
    calibration = _calibrate(short, config, say)
    say("gravity-lines: simulating the survey")
    bench = Bench(load_scenario("gravity-lines", short=short, settings=forest(short)))
    data = data_of_bench(bench)
    drive = Drive(data, config)
    result = work_out([drive], config, calibration.installation, say=say)
    survey = _Survey(bench, result, config, short)
    acceptance.add(*_calibration_rows(bench, calibration))
    acceptance.add(*_sky_rows(result))
    for method in (LDV, PHASE, DOPPLER):
        if result.lines.get(method):
            acceptance.add(*survey.rows(method))
            figures = method_figures(method, result.lines[method], {0: survey.truth_mgal(method)})
            acceptance.figures.append((TABLES[method], figures))
    acceptance.add(*survey.gains())
    acceptance.add(*survey.position_rows())
    acceptance.add(*_other_rows(short, config, calibration, say))
    rows, figures = real_rows(say)
    acceptance.add(*rows)
    if figures:
        acceptance.figures.append(("Kingston: speed through outages", figures))
    else:
        acceptance.remarks.append("The Kingston drive is not at hand.")
    acceptance.write(folder)
    return acceptance


def _calibrate(short: bool, config: GravimetryConfig, say: Say) -> Calibration:
    say("gravity-lines: simulating the calibration drive")
    settings = [f"seed={CALIBRATION_SEED}"]
    if not short:
        settings += ["motion.0.passes=2", f"duration={CALIBRATION_S}"]
    bench = Bench(load_scenario("gravity-lines", short=short, settings=settings))
    drive = Drive(data_of_bench(bench), config)
    say("gravity-lines: calibrating the velocimeter")
    return drive.calibrate(LdvInstallation.nominal(config.ldv), ALWAYS)


def forest(short: bool) -> list[str]:
    """Return the setting that grows a forest along every pass."""
    motion = Bench(load_scenario("gravity-lines", short=short)).motion
    assert isinstance(motion, LinesMotion)
    grown = []
    for begin, end in motion.times:
        first, last = (begin + share * (end - begin) for share in FOREST)
        grown.append(f"{{elevation_to_deg: {CANOPY_DEG}, from_s: {first:.1f}, to_s: {last:.1f}}}")
        for spell in np.arange(first + SPELL_S, last - SPELL_S, 3.0 * SPELL_S):
            grown.append(f"{{keep: 3, from_s: {spell:.1f}, to_s: {spell + SPELL_S:.1f}}}")
    return [f"sky.obstructions=[{', '.join(grown)}]"]


@dataclass(frozen=True)
class _Survey:
    """What was worked out, beside the bench that knows better."""

    bench: Bench
    result: SurveyResult
    config: GravimetryConfig
    short: bool

    def rows(self, method: str) -> list[Row]:
        """Return the table of a method: every pass, the total, the error of the field."""
        line, table = self.result.lines[method][0], TABLES[method]
        agreed = coincidence(line.gravity)
        rows = []
        published = PUBLISHED.get(method, ()) if not self.short else ()
        for k in range(len(line.passes)):
            known = published[k] if k < len(published) else (None, None, None)
            scenario = f"gravity-lines, pass {k + 1}"
            values = agreed.greatest[k], agreed.least[k], agreed.rms[k]
            for name, value, printed in zip(
                ("greatest deviation", "least deviation", "RMS"), values, known, strict=True
            ):
                rows.append(Row(table, scenario, name, "mGal", float(value), printed))
        goal = Goal.at_most(TOTALS[LDV]) if method == LDV else None
        total = Row(
            table, "gravity-lines", f"internal coincidence of {len(line.passes)} passes", "mGal",
            agreed.total, TOTALS.get(method), goal, self.floor(method, len(line.passes)),
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
        own = _agreed(self.result, LDV)
        rows = []
        for method in (PHASE, DOPPLER):
            other = _agreed(self.result, method)
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

    def errors(self, solution: Solution) -> tuple[float, float]:
        """Return the largest horizontal and height error of a solution [m]."""
        track, bench = solution.track, self.bench
        at = bench.motion.at(track.time - bench.clock(track.time))
        enu = enu_from_ecef(ecef_from_geodetic(track.geodetic), bench.site.origin_ecef)
        error = enu - at.position
        return float(np.hypot(error[:, 0], error[:, 1]).max()), float(np.abs(error[:, 2]).max())


def _other_rows(
    short: bool, config: GravimetryConfig, calibration: Calibration, say: Say
) -> list[Row]:
    """Repeat SINS/LDV on other roads with other draws of the instruments; one in short forms."""
    table, rows = "L 2, figures 8, 9: other roads and instruments", []
    totals: list[float] = []
    for seed in OTHER_SEEDS[: 1 if short else None]:
        say(f"gravity-lines, seed {seed}: simulating and working out the survey")
        settings = [f"seed={seed}"]
        bench = Bench(load_scenario("gravity-lines", short=short, settings=settings))
        drive = Drive(data_of_bench(bench), config)
        result = work_out([drive], config, calibration.installation, gnss=False)
        survey, agreed = _Survey(bench, result, config, short), _agreed(result, LDV)
        total = np.nan if agreed is None else agreed.total
        totals.append(total)
        horizontal, height = survey.errors(result.solutions[LDV][0])
        where = f"gravity-lines, seed {seed}"
        rows += [
            Row(table, where, "internal coincidence", "mGal", total, TOTALS[LDV],
                Goal.at_most(TOTALS[LDV])),
            Row(table, where, "largest horizontal error", "m", horizontal, 17.0,
                Goal.at_most(17.0)),
            Row(table, where, "largest height error", "m", height, 2.0, Goal.at_most(2.0)),
        ]  # fmt: skip
    pooled = float(np.sqrt(np.mean(np.square(totals))))
    rows.append(Row(table, "all of these", "internal coincidence, RMS", "mGal", pooled,
                    TOTALS[LDV], Goal.at_most(TOTALS[LDV])))  # fmt: skip
    return rows


def _agreed(result: SurveyResult, method: str) -> Coincidence | None:
    lines = result.lines.get(method)
    return coincidence(lines[0].gravity) if lines else None


def _calibration_rows(bench: Bench, calibration: Calibration) -> list[Row]:
    """Return what the calibration found, true values as limits; indices of table 1."""
    found, ldv = calibration.installation, bench.scenario.ldv
    assert ldv is not None
    _, pitch, yaw = np.degrees(euler_from_matrix(found.C_bd))
    scale, angle = _true_scale_and_pitch(bench)
    arm = found.lever_arm_b * [1.0, -1.0, -1.0]
    table, scenario = "L 1 calibration", "calibration drive, open sky"
    error = 1e3 * abs(found.scale - scale)
    rows = [
        Row(table, scenario, "speed's error after calibration", "1e-3", error, 1.0,
            Goal.at_most(1.0)),
        Row(table, scenario, "scale; as limit the true one", "1e-3", 1e3 * found.scale,
            limit=1e3 * scale),
        Row(table, scenario, "pitch; as limit the true one", "deg", float(pitch), limit=angle),
        Row(table, scenario, "one sigma of the pitch", "deg", float(np.degrees(found.sd[1]))),
        Row(table, scenario, "yaw, of the vehicle's way in the IMU's axes", "deg", float(yaw),
            limit=0.0),
    ]  # fmt: skip
    for name, value, true in zip(("forward", "left", "up"), arm, ldv.lever_arm, strict=True):
        rows.append(Row(table, scenario, f"lever arm {name}", "m", float(value), limit=true))
    return rows


def _true_scale_and_pitch(bench: Bench) -> tuple[float, float]:
    """Return what scale [-] and pitch [deg] the two beams have for a vehicle that runs ahead."""
    ldv = bench.scenario.ldv
    assert ldv is not None
    _, pitch, yaw = np.radians(ldv.misalignment_deg)
    elevation = np.radians(np.array(ldv.elevation_deg))
    ahead = np.cos(yaw) * np.array([np.cos(pitch), np.sin(pitch)])  # forward, up in the sensor
    beams = np.stack([np.cos(elevation), np.sin(elevation)], axis=1)
    seen = np.linalg.solve(beams, (1.0 + np.array(ldv.scale_error)) * (beams @ ahead))
    return float(np.hypot(*seen)) - 1.0, -float(np.degrees(np.arctan2(seen[1], seen[0])))


def _sky_rows(result: SurveyResult) -> Sequence[Row]:
    """Return how blocked the sky was."""
    gnss = result.drives[0].data.gnss
    assert gnss is not None
    lost = 100.0 * float(np.mean(gnss.satellites < 4.0))
    steps = 100.0 * gnss.steps.end.size / max(gnss.satellites.size - 1, 1)
    return [
        Row("sky", "gravity-lines, forest", "epochs without a position", "%", lost),
        Row("sky", "gravity-lines, forest", "intervals with phases kept", "%", steps),
        Row("sky", "gravity-lines, forest", "satellites used, median", "-",
            float(np.median(gnss.satellites))),
    ]  # fmt: skip
