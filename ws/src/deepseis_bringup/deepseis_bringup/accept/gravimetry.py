"""Acceptance of gravimetry: tables 1 to 3 of the SINS/LDV paper, repeated.

A calibration drive under an open sky, on another road and with another draw of the IMU's biases,
gives the velocimeter's installation. The survey is driven six times through a forest; SINS/LDV
works without GNSS from its first movement on, SINS/GNSS without the velocimeter.

The paper prints no low-pass. Ours is that of `GravityFilter`, the same for all methods. Its GNSS
is differenced positions; ours is the better of what the receiver gives: Doppler, and carrier
phases between epochs. The gain is stated against the stronger.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from deepseis_bringup.accept.gravimetry_real import real_rows
from deepseis_bringup.accept.gravimetry_survey import (
    HONEST,
    OTHERS,
    TABLES,
    TOTALS,
    Survey,
    make_survey,
)
from deepseis_bringup.accept.tables import Acceptance, Goal, Row
from deepseis_bringup.survey.gravimetry import (
    DOPPLER,
    LDV,
    PHASE,
    Calibration,
    Drive,
    GravimetryConfig,
    SurveyResult,
)
from deepseis_bringup.survey.gravimetry_page import method_figures
from deepseis_bringup.survey.survey_data import data_of_bench
from deepseis_core.rotation import euler_from_matrix
from deepseis_ins.ldv import LdvInstallation
from deepseis_ins.survey import ALWAYS
from deepseis_sim.bench import Bench
from deepseis_sim.scenario import load_scenario

Say = Callable[[str], None]

CALIBRATION_SEED: Final = 2
OTHER_SEEDS: Final = (3, 4, 5, 6, 7)
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
    survey = make_survey(short, [], config, calibration.installation, say)
    bench, result = survey.bench, survey.result
    acceptance.add(*_calibration_rows(bench, calibration), *survey.index_rows())
    acceptance.add(*_sky_rows(result))
    for method in (LDV, PHASE, DOPPLER):
        if result.lines.get(method):
            acceptance.add(*survey.rows(method))
            figures = method_figures(method, result.lines[method], {0: survey.truth_mgal(method)})
            acceptance.figures.append((TABLES[method], figures))
    acceptance.add(*survey.gains())
    acceptance.add(*survey.position_rows())
    acceptance.add(*_other_rows(short, config, calibration, survey, say))
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


def _other_rows(
    short: bool,
    config: GravimetryConfig,
    calibration: Calibration,
    first: Survey,
    say: Say,
) -> list[Row]:
    """Repeat the survey on other roads with other draws of the instruments; one in short forms."""
    rows, surveys = [], [first]
    for seed in OTHER_SEEDS[: 1 if short else None]:
        say(f"gravity-lines, seed {seed}: simulating and working out the survey")
        survey = make_survey(short, [f"seed={seed}"], config, calibration.installation)
        rows += survey.summary_rows(f"gravity-lines, seed {seed}")
        surveys.append(survey)
    return [*rows, *_pooled_rows(surveys)]


def _pooled_rows(surveys: Sequence[Survey]) -> list[Row]:
    """Return means, spreads and what is pooled over all surveys."""
    where, rows, pooled = f"all {len(surveys)} surveys", [], {}
    for method, printed in TOTALS.items():
        totals = np.array([survey.total(method) for survey in surveys])
        pooled[method] = float(np.sqrt(np.mean(totals**2)))
        goal = Goal.at_most(TOTALS[LDV]) if method == LDV else None
        name = f"{method}: internal coincidence"
        rows += [
            Row(OTHERS, where, f"{name}, RMS", "mGal", pooled[method], printed, goal),
            Row(OTHERS, where, f"{name}, mean", "mGal", float(totals.mean())),
            Row(OTHERS, where, f"{name}, standard deviation of one", "mGal",
                float(totals.std(ddof=1))),
            Row(OTHERS, where, f"{name}, largest", "mGal", float(totals.max())),
        ]  # fmt: skip
    gain = 100.0 * (1.0 - pooled[LDV] / pooled[PHASE])
    errors = np.array([survey.errors(survey.solution(LDV)) for survey in surveys])
    honest = np.array([survey.honesty() for survey in surveys])
    horizontal, height = np.sqrt(np.mean(errors**2, axis=0))
    return [
        *rows,
        Row(OTHERS, where, "gain over carrier phases", "%", gain, 53.0, Goal.at_least(50.0)),
        Row(OTHERS, where, "largest horizontal error, RMS", "m", float(horizontal), 17.0),
        Row(OTHERS, where, "largest height error, RMS", "m", float(height), 2.0),
        *(
            Row(OTHERS, where, f"{name} error at the end over its sigma, RMS", "-", float(value),
                limit=1.0)
            for name, value in zip(HONEST, np.sqrt(np.mean(honest**2, axis=0)), strict=True)
        ),
    ]  # fmt: skip


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
