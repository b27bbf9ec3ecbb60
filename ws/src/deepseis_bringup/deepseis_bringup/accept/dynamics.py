"""Acceptance beyond the thesis' tables: the oscillator on the shaken table, and 50 g."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from deepseis_bringup.accept.loop_measures import pooled
from deepseis_bringup.accept.scene import Loop, Scene, Work, aided
from deepseis_bringup.accept.tables import Goal, Row


def shaken_oscillator(work: Work) -> None:
    """Let the oscillator ride on the table; aid with what it feels, and without."""
    work.say("sine-1hz: simulating with the oscillator on the table")
    settings = [
        "receiver.oscillator.on_table=true",
        "receiver.oscillator.g_sensitivity=[1.0e-9, 0.0, 0.0]",
    ]
    scene = Scene("sine-1hz", work.folder, short=work.short, settings=settings, label="oscillator")
    for known, text in ((False, "without g-terms"), (True, "with g-terms")):
        loop = replace(aided(8.0), fusion={"oscillator_on_body": known})
        outcome = work.run(scene, loop)
        scenario = f"sine-1hz, oscillator-on-table, {loop.name}, {text}"
        common = [
            float(np.sqrt(np.maximum(item.error_rms**2 - item.own_rms**2, 0.0)))
            for item in outcome.moving
        ]
        of = float(len(outcome.moving))
        work.acceptance.add(
            Row("oscillator on the table", scenario, "satellites held without slip", "-",
                float(outcome.held()), goal=Goal.at_least(of) if known else None, limit=of),
            Row("oscillator on the table", scenario, "common phase error, all satellites", "deg",
                _or_lost(pooled(common))),
            Row("oscillator on the table", scenario, "true phase error / thermal limit", "-",
                _or_lost(pooled(outcome.ratios())), limit=1.0),
        )  # fmt: skip


def _or_lost(value: float) -> float | str:
    """Return a figure, or what not a number means: a satellite's phase was never locked."""
    return value if np.isfinite(value) else "lost"


def high_dynamics(work: Work) -> None:
    """Fly the Doppler-aided paper's profile: 25 g/s, 50 g, 2450 m/s at 35 dB-Hz."""
    work.say("high-g: simulating")
    scene = Scene("high-g", work.folder, short=work.short)
    third = {"pll_order": 3, "pll_bandwidth_hz": 25.0, "integration_ms": 1}
    narrow = aided(3.0)
    loops = (
        Loop("conventional 25 Hz order 3, 1 ms", "", 25.0, third),
        replace(narrow, name="aided 3 Hz, velocity form"),
        replace(
            narrow,
            name="aided 3 Hz, acceleration form",
            tracker={**narrow.tracker, "aiding_form": "acceleration"},
        ),
    )
    for loop in loops:
        outcome = work.run(scene, loop)
        of = float(len(outcome.moving))
        published = "holds" if loop.aiding else "loses lock near 40 g"
        goal = Goal.at_least(of) if loop.aiding else None
        work.acceptance.add(
            Row("D figures 9 to 13", f"high-g, {loop.name}", "satellites held without slip", "-",
                float(outcome.held()), published, goal, of)
        )  # fmt: skip
        if loop.aiding:
            work.acceptance.add(
                Row("D figures 9 to 13", f"high-g, {loop.name}",
                    "true phase error / thermal limit, all satellites", "-",
                    pooled(outcome.ratios()), goal=Goal.at_most(1.10), limit=1.0)
            )  # fmt: skip
