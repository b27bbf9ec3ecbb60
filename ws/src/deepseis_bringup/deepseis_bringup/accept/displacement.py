"""Acceptance of displacements: the thesis' tables, the benchmark of seismogeodesy, our goals.

Each scene is simulated once and worked through with a plain loop and with aided ones. Held against
the truth are displacements by phases alone, against a base (RTK), and fused. One module gives
one group of tables.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Final

from deepseis_bringup.accept.displacement_step import coseismic_step
from deepseis_bringup.accept.displacement_tables import benchmark_scenes, shaken_scenes
from deepseis_bringup.accept.scene import Say, Work
from deepseis_bringup.accept.tables import Acceptance

GROUPS: Final[tuple[Callable[[Work], None], ...]] = (
    shaken_scenes,
    benchmark_scenes,
    coseismic_step,
)


def accept_displacement(folder: Path, *, short: bool, say: Say = lambda _text: None) -> Acceptance:
    """Measure displacements of one station, alone and against a base.

    Parameters
    ----------
    folder : Path
        Gets ``displacement.csv`` and ``displacement.html``.
    short : bool
        Short forms of the scenarios.
    say : callable, optional
        Told what is done.
    """
    form = "short forms" if short else "full forms"
    acceptance = Acceptance("displacement", f"Displacement of one station, {form}")
    acceptance.remarks.append(
        "The benchmark's Wenchuan record is not at hand: our scenes stand in for it, MYG004 also "
        "scaled to its 0.5 to 2 g."
    )
    for group in GROUPS:
        with tempfile.TemporaryDirectory(dir=folder, prefix=".input.") as place:
            group(Work(Path(place), short, acceptance, say))
            acceptance.write(folder)
    return acceptance
