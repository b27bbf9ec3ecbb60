"""Acceptance of the tracking loops: the thesis' and the Doppler-aided paper's tables, repeated.

Every scenario is simulated once; the receiver then works through it with each loop in one
process (`offline`), and once as a graph over DDS, whose payloads must be the same bytes. One
module gives one group of tables.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Final

from deepseis_bringup.accept.bandwidth import best_bandwidths
from deepseis_bringup.accept.dynamics import high_dynamics, shaken_oscillator
from deepseis_bringup.accept.independent import independent_signal
from deepseis_bringup.accept.jamming import jamming
from deepseis_bringup.accept.loops import thesis_tables
from deepseis_bringup.accept.scene import Say, Work
from deepseis_bringup.accept.static import standing_still
from deepseis_bringup.accept.tables import Acceptance

GROUPS: Final[tuple[Callable[[Work], None], ...]] = (
    thesis_tables,
    standing_still,
    independent_signal,
    jamming,
    high_dynamics,
    best_bandwidths,
    shaken_oscillator,
)


def accept_tracking(folder: Path, *, short: bool, say: Say = lambda _text: None) -> Acceptance:
    """Repeat the papers' tables of tracking.

    Parameters
    ----------
    folder : Path
        Gets ``tracking.csv`` and ``tracking.html``.
    short : bool
        Short forms of the scenarios.
    say : callable, optional
        Told what is done.
    """
    form = "short forms" if short else "full forms"
    acceptance = Acceptance("tracking", f"Tracking loops under earthquakes, {form}")
    for group in GROUPS:
        with tempfile.TemporaryDirectory(dir=folder, prefix=".input.") as place:
            group(Work(Path(place), short, acceptance, say))
    acceptance.write(folder)
    return acceptance
