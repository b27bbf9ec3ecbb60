"""Tables of displacement under the thesis' motions: against a base, alone, fused.

Thesis 5.7 to 5.10, 5.12 and 5.14 are positions by RTKLIB from the receiver's phases. For the
commercial receiver that stands beside them there, ours has a conventional loop.
The benchmark (Geophysical Research Letters 2020) splits the error of a station without a base
into a lag, found by shifting the truth, and what is left at that lag.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from deepseis_bringup.accept.displacement_aiding import narrow_loop
from deepseis_bringup.accept.displacement_figures import stream_figures
from deepseis_bringup.accept.displacement_streams import (
    BASED,
    FUSED,
    PHASES,
    RTK,
    Figures,
    Run,
    Shaken,
    shake,
)
from deepseis_bringup.accept.scene import Loop, Scene, Work, aided
from deepseis_bringup.accept.tables import Goal, Row
from deepseis_core.imu_grades import STANDARD_GRAVITY

AXES: Final = (("north", 1), ("east", 0), ("up", 2))
"""In the thesis' order; columns of ours."""
MEMS: Final = "mti-g"
WIDE, NARROW, PLAIN = "aided 8 Hz", "aided 5 Hz", "plain PLL 15 Hz"
AGILE = "plain PLL 50 Hz"
RTK_RMS: Final = {"north": 0.8, "east": 0.8, "up": 2.0}
"""Goal against a base while it moves [mm]."""
ALONE: Final = (3.0, 8.0)
"""Goal in real time without a base, RMS, horizontal and vertical [mm]."""

Six = tuple[float, float, float, float, float, float]
PUBLISHED: Final[Mapping[tuple[str, str], Six]] = {
    ("sine-1hz", WIDE): (1.37, 1.90, 8.29, 5.05, 6.36, 23.62),
    ("sine-1hz", NARROW): (1.37, 1.95, 9.31, 5.55, 6.49, 23.87),
    ("sine-1hz", PLAIN): (4.52, 4.43, 10.78, 11.40, 13.81, 32.72),
    ("sine-1hz", f"{WIDE}, {MEMS}"): (1.43, 1.95, 8.40, 6.42, 6.95, 25.22),
    ("sine-2hz", WIDE): (1.42, 2.00, 9.37, 5.59, 7.00, 26.34),
    ("sine-2hz", NARROW): (1.57, 2.08, 9.27, 6.19, 7.51, 25.81),
    ("sine-2hz", PLAIN): (11.85, 11.20, 11.08, 23.58, 23.82, 41.74),
    ("sine-2hz", f"{WIDE}, {MEMS}"): (1.53, 2.20, 10.77, 6.59, 8.58, 29.37),
    ("quake", WIDE): (1.38, 1.90, 9.14, 5.13, 6.50, 24.79),
    ("quake", NARROW): (1.40, 1.90, 9.10, 5.28, 6.80, 24.51),
    ("quake", PLAIN): (3.70, 3.25, 9.97, 25.95, 15.56, 38.40),
    ("quake", f"{WIDE}, {MEMS}"): (1.44, 2.08, 10.81, 5.61, 6.67, 27.36),
}
"""Thesis: RMS north, east, up, then the greatest [mm]; the plain one's are the Trimble R9's."""
SHAKEN: Final[Mapping[str, tuple[float, float]]] = {WIDE: (5.57, 17.36), PLAIN: (8.34, 25.30)}
"""Thesis 5.10, shake table: RMS and greatest along its axis [mm]."""
SHAKE_TABLE_GOAL: Final = (2.0, 6.0)
TABLES: Final = {
    "sine-1hz": "T 5.7, 5.12 circle 1 Hz, against a base",
    "sine-2hz": "T 5.8, 5.12 circle 2 Hz, against a base",
    "quake": "T 5.9, 5.14 earthquake, against a base",
    "shake-table": "T 5.10 shake table, against a base",
}
BENCHMARK: Final = {
    (PLAIN, PHASES): ("plain PLL as the thesis has it", 6.0, 56.5),
    (AGILE, PHASES): ("plain PLL, order 3 at 2 ms", 6.0, 56.5),
    (WIDE, PHASES): ("IMU-aided PLL", 1.9, 8.0),
    (WIDE, FUSED): ("fused, six degrees of freedom", 0.9, 3.5),
    (WIDE, BASED): ("fused with a base", 0.9, 3.5),
}
"""Our stream, its name there, amplitude error [mm] and lag [ms]; a record of 0.5 to 2 g."""
BENCHMARK_TABLE, ALONE_TABLE = "GRL 2020 benchmark", "real time, no base"
BENCHMARK_PGA_G: Final = (2.0, 1.0, 0.5)
"""The benchmark's record was shaken at 0.5 to 2 g."""
BASED_TABLE: Final = "real time, fused with a base"


def plain() -> Loop:
    """Return a conventional loop as a receiver has it: found again when it is lost."""
    settings = {"pll_order": 2, "pll_bandwidth_hz": 15.0}
    return replace(aided(15.0), name=PLAIN, aiding="", tracker=settings)


def agile() -> Loop:
    """Return a conventional loop for strong motion: that of a station without an IMU."""
    settings = {"pll_order": 3, "pll_bandwidth_hz": 50.0, "integration_ms": 2}
    return replace(aided(50.0), name=AGILE, aiding="", tracker=settings)


def shaken_scenes(work: Work) -> None:
    """Give the tables of every scene."""
    for name in TABLES:
        work.say(f"{name}: simulating")
        scene = Scene(name, work.folder, short=work.short, base=True)
        if scene.stands_in:
            work.acceptance.remarks.append(f"{name}: an artificial motion stands in.")
        shaken = shake(scene, (plain(), agile(), aided(8.0), aided(5.0)), work.say)
        runs = list(shaken.runs)
        if name != "shake-table":
            runs.append(_with_mems(work, name))
        work.acceptance.add(*_base_rows(shaken, runs))
        work.acceptance.add(*_benchmark_rows(shaken), *_alone_rows(shaken, runs))
        shown = {
            f"{run.loop.name}, {stream}": run.streams[stream]
            for run in shaken.runs
            for stream in (PHASES, RTK, FUSED, BASED)
            if run.loop.name != NARROW and len(run.streams[stream].t)
        }
        figures = stream_figures(name, shown, shaken.truth, scene.still, scene.moving)
        work.acceptance.figures.append((TABLES[name], figures))
        narrow_loop(work, scene)


def _with_mems(work: Work, name: str) -> Run:
    work.say(f"{name}: simulating with {MEMS}")
    grade = [f"imu.grade={MEMS}"]
    scene = Scene(name, work.folder, short=work.short, settings=grade, label=MEMS, base=True)
    (run,) = shake(scene, (aided(8.0, MEMS),), work.say).runs
    return run


def _base_rows(shaken: Shaken, runs: Sequence[Run]) -> list[Row]:
    """Return the thesis' table: RTK of every loop."""
    scene, rows = shaken.scene.name, []
    of = {run.loop.name: shaken.figures(run, RTK) for run in runs}
    for run in runs:
        found, loop = of[run.loop.name], run.loop
        rows += _fix_rows(shaken, run) + (
            _table_rows(scene, loop, found)
            if scene != "shake-table"
            else _axis_rows(scene, loop, found)
        )
        ratio = found.horizontal / float(np.hypot(*found.still[:2]))
        quiet = Goal.at_most(1.1) if loop.aiding else None
        where = f"{scene}, {loop.name}"
        rows.append(
            Row(
                TABLES[scene], where, "horizontal RMS moving / still", "-", ratio, None, quiet, 1.0
            )
        )
    if (mems := f"{WIDE}, {MEMS}") in of:
        rows += _mems_rows(scene, of[WIDE], of[mems])
    return rows


def _fix_rows(shaken: Shaken, run: Run) -> list[Row]:
    begin, end = shaken.scene.moving
    share = len(run.streams[RTK].between(begin, end).t) / (50.0 * (end - begin))
    where = f"{shaken.scene.name}, {run.loop.name}"
    goal = Goal.at_least(99.0) if run.loop.aiding else None
    table = TABLES[shaken.scene.name]
    return [Row(table, where, "epochs fixed while it moves", "%", 100.0 * share, None, goal)]


def _table_rows(scene: str, loop: Loop, found: Figures) -> list[Row]:
    printed = PUBLISHED.get((scene, loop.name))
    where, rows = f"{scene}, {loop.name}", []
    for k, (axis, column) in enumerate(AXES):
        ours = 1e3 * float(found.rms[column])
        goal = Goal.at_most(RTK_RMS[axis]) if loop.name.startswith(WIDE) else None
        published = printed[k] if printed else None
        rows.append(Row(TABLES[scene], where, f"RMS {axis}", "mm", ours, published, goal))
    for k, (axis, column) in enumerate(AXES):
        ours = 1e3 * float(found.greatest[column])
        published = printed[3 + k] if printed else None
        rows.append(Row(TABLES[scene], where, f"greatest {axis}", "mm", ours, published))
    ratio = found.greatest_horizontal / found.horizontal
    bound = Goal.at_most(4.5) if loop.aiding else None
    rows.append(
        Row(TABLES[scene], where, "greatest horizontal / its RMS", "-", ratio, None, bound)
    )
    return rows


def _axis_rows(scene: str, loop: Loop, found: Figures) -> list[Row]:
    """Return the shake table's, which moves to the east alone."""
    printed = SHAKEN.get(loop.name, (None, None))
    goals = [Goal.at_most(value) for value in SHAKE_TABLE_GOAL] if loop.aiding else [None, None]
    where, table = f"{scene}, {loop.name}", TABLES[scene]
    rms, greatest = 1e3 * float(found.rms[0]), 1e3 * float(found.greatest[0])
    return [
        Row(table, where, "RMS along its axis", "mm", rms, printed[0], goals[0]),
        Row(table, where, "greatest along its axis", "mm", greatest, printed[1], goals[1]),
    ]


def _mems_rows(scene: str, tactical: Figures, mems: Figures) -> list[Row]:
    where, rows = f"{scene}, {WIDE}", []
    for k, (axis, column) in enumerate(AXES):
        ours = 1e3 * float(mems.rms[column] - tactical.rms[column])
        printed = PUBLISHED[scene, f"{WIDE}, {MEMS}"][k] - PUBLISHED[scene, WIDE][k]
        rows.append(
            Row(TABLES[scene], where, f"RMS {axis}, MTi-G less SPAN-FSAS", "mm", ours,
                round(printed, 2), Goal.at_most(0.1), 0.0)
        )  # fmt: skip
    return rows


def _benchmark_rows(shaken: Shaken, name: str = "") -> list[Row]:
    rows = []
    for (loop, stream), (there, amplitude, lag) in BENCHMARK.items():
        found = shaken.figures(shaken.of(loop), stream)
        where = f"{name or shaken.scene.name}, {there}"
        ours = (1e3 * found.left, 1e3 * abs(found.lag))
        rows += [
            Row(BENCHMARK_TABLE, where, "amplitude error, horizontal", "mm", ours[0], amplitude,
                Goal.at_most(amplitude)),
            Row(BENCHMARK_TABLE, where, "lag", "ms", ours[1], lag, Goal.at_most(lag)),
        ]  # fmt: skip
    return rows


def benchmark_scenes(work: Work) -> None:
    """Give the benchmark's lines for the record scaled to the accelerations of the benchmark's."""
    for pga in BENCHMARK_PGA_G:
        name = f"quake scaled to {pga:g} g"
        work.say(f"{name}: simulating")
        most = pga * STANDARD_GRAVITY
        settings = [f"motion.0.pga={most}", f"stand_in.0.pga={most}"]
        scene = Scene(
            "quake", work.folder, short=work.short, settings=settings, label=f"{pga:g}", base=True
        )
        shaken = shake(scene, (plain(), agile(), aided(8.0)), work.say)
        work.acceptance.add(*_benchmark_rows(shaken, name))


def _alone_rows(shaken: Shaken, runs: Sequence[Run]) -> list[Row]:
    kinds = [(run, stream) for run in runs for stream in (PHASES, FUSED, BASED)]
    return [
        row
        for run, stream in kinds
        if len(run.streams[stream].t)
        for row in _live_rows(shaken, run, stream)
    ]


def _live_rows(shaken: Shaken, run: Run, stream: str) -> list[Row]:
    found = shaken.figures(run, stream)
    where, table = f"{shaken.scene.name}, {run.loop.name}", BASED_TABLE
    goals: list[Goal | None] = [None, None]
    if stream != BASED:
        where, table = f"{where}, {stream}", ALONE_TABLE
        goals = [Goal.at_most(value) for value in ALONE] if run.loop.aiding else goals
    values = 1e3 * found.horizontal, 1e3 * float(found.rms[2])
    return [
        Row(table, where, "horizontal error RMS", "mm", values[0], None, goals[0]),
        Row(table, where, "vertical error RMS", "mm", values[1], None, goals[1]),
        Row(table, where, "greatest error, any axis", "mm", 1e3 * float(found.greatest.max())),
        Row(table, where, "stated sigma / true error, horizontal", "-",
            _stated(shaken, run, stream, found)),
    ]  # fmt: skip


def _stated(shaken: Shaken, run: Run, stream: str, found: Figures) -> float:
    """Return what a stream says of its horizontal error over what it is."""
    said = run.streams[stream].between(*shaken.scene.moving).sd[:, :2]
    return float(np.sqrt((said**2).sum(axis=1).mean()) / found.horizontal)
