"""Tables 5.3 to 5.6, 5.11 and 5.13 of the thesis: loops in its scenarios, by true phase too.

The thesis' bandwidths are those of analog constants (docs/decisions/0006): its conventional loops
are repeated with them. Ours are what they say.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from deepseis_bringup.accept.figures import discriminator_figure, error_figure
from deepseis_bringup.accept.loop_measures import locked_without_signal, pooled, thermal_deg
from deepseis_bringup.accept.position import loose_positions
from deepseis_bringup.accept.scene import (
    QUANTISING_DB,
    RATE_HZ,
    Loop,
    Outcome,
    Scene,
    Work,
    aided,
    conventional,
)
from deepseis_bringup.accept.tables import Goal, Row
from deepseis_bringup.graph_payloads import run_graph
from deepseis_bringup.offline import Output, encode

LOOPS: Final = (conventional(15.0), conventional(8.0), aided(8.0), aided(5.0), aided(3.0))
MEMS: Final = aided(8.0, "mti-g")

PUBLISHED: Final[Mapping[tuple[str, str], tuple[float, float]]] = {
    ("sine-1hz", "conventional 15 Hz"): (28.96, 47.90),
    ("sine-1hz", "conventional 8 Hz"): (46.31, 89.96),
    ("sine-1hz", "aided 8 Hz"): (1.70, 8.25),
    ("sine-1hz", "aided 5 Hz"): (2.03, 8.82),
    ("sine-1hz", "aided 8 Hz, mti-g"): (1.89, 8.88),
    ("sine-2hz", "conventional 15 Hz"): (26.39, 44.46),
    ("sine-2hz", "conventional 8 Hz"): (51.73, 89.90),
    ("sine-2hz", "aided 8 Hz"): (1.81, 7.59),
    ("sine-2hz", "aided 5 Hz"): (2.30, 7.73),
    ("sine-2hz", "aided 8 Hz, mti-g"): (2.00, 7.96),
    ("quake", "conventional 15 Hz"): (3.21, 23.78),
    ("quake", "conventional 8 Hz"): (4.59, 29.51),
    ("quake", "aided 8 Hz"): (1.69, 7.10),
    ("quake", "aided 5 Hz"): (1.94, 8.14),
    ("quake", "aided 8 Hz, mti-g"): (1.76, 8.31),
    ("shake-table", "conventional 15 Hz"): (7.26, 24.92),
    ("shake-table", "conventional 8 Hz"): (18.44, 37.30),
    ("shake-table", "aided 8 Hz"): (4.59, 14.43),
    ("shake-table", "aided 5 Hz"): (5.90, 18.22),
}
"""Thesis: RMS and greatest discriminator output while moving [deg], scenario and loop."""

STILL: Final = ("motion.0.radius=0.0005",)
"""Moves by half a millimetre: enough to be called moving."""

TABLES: Final = {
    "sine-1hz": "T 5.3 circle 1 Hz",
    "sine-2hz": "T 5.4 circle 2 Hz",
    "quake": "T 5.5 earthquake",
    "shake-table": "T 5.6 shake table",
}


def thesis_tables(work: Work) -> None:
    """Repeat the tables of every scenario, and compare the graph over DDS with the chain."""
    rest = {} if work.short else _at_rest(work)
    for name in TABLES:
        work.say(f"{name}: simulating")
        scene = Scene(name, work.folder, short=work.short)
        outcomes = [work.run(scene, loop) for loop in LOOPS]
        if scene.stands_in:
            work.acceptance.remarks.append(f"{name}: an artificial motion stands in.")
        alike = list(outcomes)
        if name != "shake-table":
            outcomes.append(_with_mems(work, name))
        for outcome in outcomes:
            work.acceptance.add(*_rows(scene, outcome, work.short, rest))
        work.acceptance.add(*_mems_rows(scene, outcomes))
        work.acceptance.figures.append((TABLES[name], _figures(scene, outcomes)))
        if name in ("sine-1hz", "quake"):
            loose_positions(work, scene, alike)
        if name == "sine-2hz":
            work.say(f"{name}: over DDS")
            work.acceptance.add(_same_bytes(work, scene, aided(8.0)))


def _at_rest(work: Work) -> dict[float, float]:
    """Return true phase error over thermal limit by bandwidth, of a station under the same sky.

    What is above one there is the other satellites' cross-correlation: no loop can tell it from
    motion.
    """
    work.say("at rest: simulating")
    scene = Scene("sine-1hz", work.folder, short=False, settings=STILL, label=" at rest")
    rest = {}
    for loop in (aided(8.0), aided(5.0), aided(3.0)):
        outcome = work.run(scene, loop)
        rest[loop.bandwidth_hz] = pooled(outcome.ratios())
        work.acceptance.add(
            Row("The same sky at rest", loop.name,
                "true phase error / thermal limit, all satellites", "-",
                rest[loop.bandwidth_hz], limit=1.0)
        )  # fmt: skip
    return rest


def _with_mems(work: Work, name: str) -> Outcome:
    work.say(f"{name}: simulating with {MEMS.imu}")
    grade = [f"imu.grade={MEMS.imu}"]
    scene = Scene(name, work.folder, short=work.short, settings=grade, label=MEMS.imu)
    return work.run(scene, MEMS)


def _rows(scene: Scene, outcome: Outcome, short: bool, rest: Mapping[float, float]) -> list[Row]:
    table, loop = TABLES[scene.name], outcome.loop
    moving = outcome.satellite()
    scenario = f"{scene.name}, {loop.name}"
    published = PUBLISHED.get((scene.name, loop.name), (None, None))
    rms_goal = max_goal = None
    if loop.aiding == "" and scene.name.startswith("sine") and published[0] is not None:
        rms_goal = Goal.within(0.15, published[0])
        max_goal = Goal.within(0.15, published[1] or 0.0)
    if loop.aiding:
        max_goal = Goal.at_most(round(4.5 * moving.discriminator_rms, 2))
    rows = [
        Row(table, scenario, f"discriminator RMS, {moving.satellite}", "deg",
            moving.discriminator_rms, published[0], rms_goal),
        Row(table, scenario, f"discriminator greatest, {moving.satellite}", "deg",
            moving.discriminator_max, published[1], max_goal),
    ]  # fmt: skip
    if not loop.aiding:
        rows.append(
            Row(table, scenario, "satellites held without slip", "-", float(outcome.held()),
                limit=float(len(outcome.moving)))
        )  # fmt: skip
        return rows
    quiet = pooled(item.discriminator_rms for item in outcome.still)
    loud = pooled(item.discriminator_rms for item in outcome.moving)
    ratios = outcome.ratios()
    limit = thermal_deg(loop.bandwidth_hz, moving.cn0_dbhz - QUANTISING_DB)
    slips = sum(item.slips for item in outcome.moving)
    worst = max(outcome.moving, key=lambda item: item.own_rms)
    above = []
    if loop.bandwidth_hz in rest:
        over_rest = pooled(ratios) / rest[loop.bandwidth_hz]
        above.append(
            Row(table, scenario, "true phase error / that at rest under the same sky", "-",
                over_rest, goal=Goal.at_most(1.10), limit=1.0)
        )  # fmt: skip
    gone = locked_without_signal(outcome.tracks, scene.truth, RATE_HZ)
    if gone == gone:
        above.append(
            Row(table, scenario, "longest that a phase is called locked without signal", "s",
                gone, goal=Goal.at_most(0.5))
        )  # fmt: skip
    return [
        *rows,
        *above,
        Row(table, scenario, "discriminator RMS moving / still, all satellites", "-",
            loud / quiet, goal=Goal.at_most(1.12 if short else 1.05), limit=1.0),
        Row(table, scenario, f"true phase error, {moving.satellite}", "deg",
            moving.own_rms, limit=limit),
        Row(table, scenario, "true phase error / thermal limit, all satellites", "-",
            pooled(ratios), goal=Goal.at_most(1.10), limit=1.0),
        Row(table, scenario, f"the same, worst satellite, {worst.satellite}", "-",
            max(ratios), limit=1.0),
        Row(table, scenario, "true phase error with the common part, all satellites", "deg",
            pooled(item.error_rms for item in outcome.moving)),
        Row(table, scenario, "slips while moving", "-", float(slips), goal=Goal.at_most(0.0)),
    ]  # fmt: skip


def _mems_rows(scene: Scene, outcomes: list[Outcome]) -> list[Row]:
    by_name = {outcome.loop.name: outcome for outcome in outcomes}
    if MEMS.name not in by_name:
        return []
    ours = [
        pooled(item.discriminator_rms for item in by_name[name].moving)
        for name in (MEMS.name, aided(8.0).name)
    ]
    table = "T 5.13 IMU grade" if scene.name == "quake" else "T 5.11 IMU grade"
    printed = [PUBLISHED[scene.name, name][0] for name in (MEMS.name, aided(8.0).name)]
    return [
        Row(table, scene.name, "discriminator RMS, MTi-G less SPAN-FSAS, all satellites", "deg",
            ours[0] - ours[1], round(printed[0] - printed[1], 2), Goal.at_most(0.05)),
    ]  # fmt: skip


def _figures(scene: Scene, outcomes: list[Outcome]) -> list[Any]:
    satellite = outcomes[0].satellite().satellite
    tracks = {outcome.loop.name: outcome.tracks[satellite] for outcome in outcomes}
    return [
        discriminator_figure(scene.name, satellite, tracks, RATE_HZ, scene.moving),
        error_figure(scene.name, outcomes, scene.truth, RATE_HZ, scene.still, scene.moving),
    ]


def _same_bytes(work: Work, scene: Scene, loop: Loop) -> Row:
    """Run the graph over DDS and compare its payloads with the chain's, topic by topic."""
    payloads: dict[str, list[bytes]] = {}

    def listen(output: Output) -> None:
        if output.topic != "if/samples":
            payloads.setdefault(output.topic, []).append(encode(output))

    scene.run(loop, listen)
    recorded = run_graph(scene.config(loop), work.folder / "dds")
    differing = [
        topic
        for topic, messages in sorted(payloads.items())
        if sorted(recorded.get(topic, [])) != sorted(messages)
    ]
    quantity = "topics whose bytes over DDS differ from the chain's in one process"
    if differing:
        quantity += ": " + " ".join(differing)
    return Row(
        "DDS", f"{scene.name}, {loop.name}", quantity, "topics", float(len(differing)),
        goal=Goal.at_most(0.0),
    )  # fmt: skip
