"""How good the selections of four satellites are: counts, and GDOP against the best four."""

from __future__ import annotations

import numpy as np

from deepseis_bringup.accept.tables import Goal, Row
from deepseis_core import selection
from deepseis_core.constants import NS_PER_S
from deepseis_core.ephemeris import pack
from deepseis_core.gps_time import GpsTime
from deepseis_core.propagation import line_of_sight
from deepseis_core.types import FloatArray
from deepseis_sim.scenario import load_scenario
from deepseis_sim.sky import broadcast_ephemerides


def day_rows() -> list[Row]:
    """Count evaluations, and compare a day's GDOP at the scenario's place."""
    scenario = load_scenario("drive", short=False)
    start = GpsTime(scenario.start.week, 345600 * NS_PER_S)
    packed = pack(broadcast_ephemerides("", start))
    seconds = np.arange(0, 86400, 60) * NS_PER_S
    sight = line_of_sight(packed, start.week, start.tow_ns + seconds, scenario.place.ecef)
    return selection_rows("a day of GPS at 38.7 N", sight.unit, sight.elevation)


def selection_rows(where: str, unit: FloatArray, elevation: FloatArray) -> list[Row]:
    """Compare the rules on some epochs with five satellites and more."""
    table = "H 1.3, selection of four satellites"
    found = {rule: selection.select(unit, elevation, rule) for rule in selection.RULES}
    count = found[selection.ALL].chosen.sum(axis=1)
    ok = (count >= 5) & np.isfinite(found[selection.GDOP].gdop)
    best = found[selection.GDOP].gdop
    rows = []
    for rule, name, published, goal in (
        (selection.HIGHEST, "highest fixed", 56.0, 86.0),
        (selection.VOLUME, "any four by volume", 126.0, 95.0),
    ):
        got = found[rule]
        nine = got.evaluations[count == 9]
        if nine.size:
            rows.append(
                Row(table, f"{where}, {name}", "evaluations for 9 satellites", "-",
                    float(nine.max()), published, Goal.at_most(published))
            )  # fmt: skip
        near = 100.0 * float(np.mean(got.gdop[ok] <= 1.1 * best[ok]))
        rows += [
            Row(table, f"{where}, {name}", "epochs with GDOP within 10 % of the best four", "%",
                near, goal=Goal.at_least(goal)),
            Row(table, f"{where}, {name}", "median GDOP", "-", float(np.median(got.gdop[ok])),
                limit=float(np.median(best[ok]))),
        ]  # fmt: skip
    rows.append(
        Row(table, f"{where}, all in view", "median GDOP", "-",
            float(np.median(found[selection.ALL].gdop[ok])))
    )  # fmt: skip
    return rows
