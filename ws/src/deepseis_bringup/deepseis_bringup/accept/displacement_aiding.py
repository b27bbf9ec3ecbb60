"""What precise positions gain for the loops: narrow ones, aided by a fusion with and without them.

A loop of 3 Hz leaves to the aiding all that is faster. The same recording is worked through with
the fusion following carrier-phase positions at 50 Hz, and following single-point positions
at 1 Hz as the thesis' loose integration does.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from deepseis_bringup.accept.loop_measures import pooled
from deepseis_bringup.accept.scene import Loop, Outcome, Scene, Work, aided
from deepseis_bringup.accept.tables import Goal, Row

TABLE: Final = "Narrow loop (3 Hz): what precise positions gain"
SCENES: Final = ("sine-2hz", "quake", "shake-table")
LOOSE: Final = "aided from 1 Hz pseudoranges"
PRECISE: Final = "aided from precise positions"
LIMIT: Final = 1.10


def narrow_loops() -> tuple[Loop, Loop]:
    """Return the loops: aided by precise positions, and by pseudoranges once a second."""
    by_phases = replace(aided(3.0), name=PRECISE, fusion={"rtk": False})
    by_codes = replace(
        by_phases,
        name=LOOSE,
        fusion={"precise": False, "rtk": False},
        nodes={"pvt": {"pvt_rate_hz": 1.0}},
    )
    return by_phases, by_codes


def narrow_loop(work: Work, scene: Scene) -> None:
    """Give the table's lines of a scene that is among `SCENES`."""
    if scene.name not in SCENES or scene.scenario.imu is None:
        return
    precise, loose = (work.run(scene, loop) for loop in narrow_loops())
    where = f"{scene.name}, {scene.scenario.imu.grade}"
    for outcome in (precise, loose):
        work.acceptance.add(*_rows(where, outcome))
    gain = _error(precise) / _error(loose)
    work.acceptance.add(
        Row(TABLE, where, "true phase error, precise over pseudoranges", "-", gain, None,
            Goal.at_most(1.0))
    )  # fmt: skip


def _error(outcome: Outcome) -> float:
    return pooled(item.own_rms for item in outcome.moving)


def _rows(where: str, outcome: Outcome) -> list[Row]:
    scenario = f"{where}, {outcome.loop.name}"
    ratio = pooled(outcome.ratios())
    goal = Goal.at_most(LIMIT) if outcome.loop.name == PRECISE else None
    return [
        Row(TABLE, scenario, "true phase error, moving, all satellites", "deg", _error(outcome)),
        Row(TABLE, scenario, "the same, still", "deg",
            pooled(item.own_rms for item in outcome.still)),
        Row(TABLE, scenario, "true phase error / thermal limit", "-", ratio, None, goal, 1.0),
        Row(TABLE, scenario, "slips while moving", "-",
            float(sum(item.slips for item in outcome.moving)), None, Goal.at_most(0.0)),
    ]  # fmt: skip
