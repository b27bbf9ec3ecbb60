"""Acceptance of the tight coupling: tables 3 and 4 of the Hatch-filter paper, and real drives.

The paper ("H": Hu and Shi, Navigation Positioning & Timing 5(5), 2018) drove a car for 20 min
with a fibre-optic IMU, twice, once with 210 s under fewer than four satellites. Here it is the
scenario `drive` with the receiver of H table 2, several seeds pooled: one drive's RMS, of errors
that last for minutes, is a matter of luck. Real drives follow where they are at hand.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from deepseis_bringup.accept.tables import Acceptance, Goal, Row
from deepseis_bringup.accept.tight_drive import Drive, simulated
from deepseis_bringup.accept.tight_figures import error_figure, running_figure
from deepseis_bringup.accept.tight_flight import (
    HATCH_ALL,
    HATCH_FOUR,
    RAW_ALL,
    RAW_FOUR,
    WAYS,
    Flight,
    Way,
    fly,
    rms,
)
from deepseis_bringup.accept.tight_roads import real_drives
from deepseis_bringup.accept.tight_selection import day_rows
from deepseis_bringup.report.plot import Figure
from deepseis_core.types import FloatArray

Say = Callable[[str], None]

SEEDS: Final = (11, 12, 13, 14)
TABLE_2: Final = (
    *("observations.pseudorange_mean=2.0", "observations.pseudorange_sd=5.0"),
    *("observations.range_rate_mean=0.1", "observations.range_rate_sd=0.5"),
)
"""The paper's receiver."""
OPEN: Final = ("sky.obstructions=[]",)

TABLE3, TABLE4 = "H table 3, drive under open sky", "H table 4, drive under open sky"
BLOCKED: Final = "H figures 9 to 11, drive under fewer than four satellites"

H_STD: Final = {False: (0.55, 0.76, 0.93), True: (0.19, 0.34, 0.39)}
"""H table 3: standard deviations X, Y, Z, raw and smoothed [m]."""
H_RMS: Final = {False: (0.56, 1.71, 1.17), True: (0.27, 1.16, 0.58)}
"""H table 4."""
SETTLED_S: Final = 60.0
"""After the start, which is a single-point position with the receiver's 5 m [s]."""

PAIRS: Final = ((RAW_FOUR, HATCH_FOUR), (RAW_ALL, HATCH_ALL))


@dataclass(frozen=True)
class Group:
    """The same drive with several seeds, flown in all ways."""

    drives: tuple[Drive, ...]
    flights: Mapping[Way, tuple[Flight, ...]]

    def errors(self, way: Way, spans: Callable[[Drive], list[tuple[float, float]]]) -> FloatArray:
        """Return ECEF errors within spans of time, all seeds, shape (n, 3)."""
        parts = []
        for drive, flight in zip(self.drives, self.flights[way], strict=True):
            error, time = flight.position - drive.truth.position, drive.observed.time
            for begin, end in spans(drive):
                inside = (time >= begin) & (time < end) & np.isfinite(error[:, 0])
                parts.append(error[inside])
        return np.concatenate(parts)


def accept_tight(folder: Path, *, short: bool, say: Say = lambda _text: None) -> Acceptance:
    """Repeat the tables of the Hatch-filter paper, and drive on real roads.

    Parameters
    ----------
    folder : Path
        Gets ``tight.csv`` and ``tight.html``.
    short : bool
        Short forms of the scenario, two seeds, the beginning of the real drive.
    say : callable, optional
        Told what is done.
    """
    form = "short forms" if short else "full forms"
    acceptance = Acceptance("tight", f"Tight coupling with smoothed pseudoranges, {form}")
    say("drive, open sky, receiver of H table 2")
    paper = _group((*TABLE_2, *OPEN), short)
    acceptance.add(*_paper_rows(paper))
    acceptance.figures.append((TABLE4, _paper_figures(paper)))
    say("drive, under fewer than four satellites")
    blocked = _group(TABLE_2, short)
    acceptance.add(*_blocked_rows(blocked))
    acceptance.figures.append((BLOCKED, _blocked_figures(blocked)))
    say("drive, receiver of the scenario")
    acceptance.add(*_own_rows(_group(OPEN, short, SEEDS[:2])))
    say("selection over a day")
    acceptance.add(*day_rows())
    real_drives(acceptance, short=short, say=say)
    acceptance.write(folder)
    return acceptance


def _group(settings: tuple[str, ...], short: bool, seeds: tuple[int, ...] = SEEDS) -> Group:
    drives = tuple(
        simulated("drive", short=short, settings=[*settings, f"seed={seed}"])
        for seed in (seeds[:2] if short else seeds)
    )
    return Group(drives, {way: tuple(fly(drive, way) for drive in drives) for way in WAYS})


def _whole(drive: Drive) -> list[tuple[float, float]]:
    """Return the drive without what a start with 5 m of noise needs."""
    return [(drive.still[1] + SETTLED_S, float(drive.observed.time[-1]) + 1.0)]


def _through(drive: Drive) -> list[tuple[float, float]]:
    return list(drive.blocked)


def size(errors: FloatArray) -> float:
    """Return the RMS in three dimensions."""
    return float(np.sqrt(np.sum(rms(errors) ** 2)))


def _paper_rows(group: Group) -> list[Row]:
    rows = []
    for pair in PAIRS:
        errors = [group.errors(way, _whole) for way in pair]
        for way, error in zip(pair, errors, strict=True):
            std, root = error.std(axis=0), rms(error)
            for k, axis in enumerate("XYZ"):
                rows += [
                    Row(TABLE3, way.name, f"standard deviation {axis}", "m", float(std[k]),
                        H_STD[way.smoothed][k]),
                    Row(TABLE4, way.name, f"RMS {axis}", "m", float(root[k]),
                        H_RMS[way.smoothed][k]),
                ]  # fmt: skip
        cut = 100.0 * (1.0 - size(errors[1]) / size(errors[0]))
        published = 100.0 * (1.0 - np.linalg.norm(H_RMS[True]) / np.linalg.norm(H_RMS[False]))
        where = pair[0].name.split(", ")[1]
        rows += [
            Row(TABLE4, where, "RMS in 3-D cut by smoothing", "%", cut,
                round(float(published), 1), Goal.at_least(40.0)),
            *(Row(TABLE4, way.name, "position error over what the filter says, RMS of three axes",
                  "-", _honesty(group, way), limit=1.0) for way in pair),
        ]  # fmt: skip
    return rows


def _honesty(group: Group, way: Way) -> float:
    """Return the RMS of normalised errors."""
    ratios = [
        (flight.error / flight.sd)[drive.observed.time >= _whole(drive)[0][0]]
        for drive, flight in zip(group.drives, group.flights[way], strict=True)
    ]
    return float(np.sqrt(np.nanmean(np.concatenate(ratios) ** 2)))


def _blocked_rows(group: Group) -> list[Row]:
    rows = []
    for pair in PAIRS:
        inside = [size(group.errors(way, _through)) for way in pair]
        whole = [size(group.errors(way, _whole)) for way in pair]
        for k, way in enumerate(pair):
            rows += [
                Row(BLOCKED, way.name, "RMS in 3-D through the blockage", "m", inside[k],
                    "larger than outside (picture)"),
                Row(BLOCKED, way.name, "RMS in 3-D of the whole drive", "m", whole[k]),
            ]  # fmt: skip
        where = pair[0].name.split(", ")[1]
        rows.append(
            Row(BLOCKED, where, "RMS through the blockage, Hatch / raw", "-",
                inside[1] / inside[0], goal=Goal.at_most(1.0))
        )  # fmt: skip
    return rows


def _own_rows(group: Group) -> list[Row]:
    table = "the same drive, code noise of 0.8 to 1.3 m and Doppler of 8 Hz loops (C/N0)"
    rows = [
        Row(table, way.name, "RMS in 3-D", "m", size(group.errors(way, _whole))) for way in WAYS
    ]
    for pair in PAIRS:
        raw, smoothed = (size(group.errors(way, _whole)) for way in pair)
        where = pair[0].name.split(", ")[1]
        rows.append(Row(table, where, "RMS in 3-D cut by smoothing", "%",
                        100.0 * (1.0 - smoothed / raw)))  # fmt: skip
    return rows


def _first(group: Group, ways: tuple[Way, ...]) -> dict[str, FloatArray]:
    """Return ECEF errors of the first seed."""
    drive = group.drives[0]
    return {way.name: group.flights[way][0].position - drive.truth.position for way in ways}


def _paper_figures(group: Group) -> list[Figure]:
    time, four = group.drives[0].observed.time, _first(group, PAIRS[0])
    return [
        error_figure(
            "Position errors, four satellites selected, open sky",
            "First seed; H figures 6 to 8 show the same for one of the paper's drives.",
            time, four, ("X", "Y", "Z"),
        ),
        running_figure(
            "RMS of X since the start", "As H figure 12.", time,
            {name: error[:, 0] for name, error in four.items()},
        ),
        running_figure(
            "The same, all satellites", "", time,
            {name: error[:, 0] for name, error in _first(group, PAIRS[1]).items()},
        ),
    ]  # fmt: skip


def _blocked_figures(group: Group) -> list[Figure]:
    drive = group.drives[0]
    return [
        error_figure(
            "Position errors, four satellites selected, three left between the marks",
            "First seed.", drive.observed.time, _first(group, PAIRS[0]), ("X", "Y", "Z"),
            drive.blocked,
        )
    ]  # fmt: skip
