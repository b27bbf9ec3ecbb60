"""Real drives through the tight coupling: errors, blockages, RTKLIB beside it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import numpy as np

from deepseis_bringup.accept.tables import Acceptance, Row
from deepseis_bringup.accept.tight_drive import Drive, Flags
from deepseis_bringup.accept.tight_figures import error_figure, map_figure
from deepseis_bringup.accept.tight_flight import (
    HATCH_ALL,
    MASK_DEG,
    RAW_ALL,
    WAYS,
    Flight,
    Way,
    fly,
    rms,
    without,
)
from deepseis_bringup.accept.tight_real import kingston, psins
from deepseis_bringup.accept.tight_rtklib import rtklib_positions
from deepseis_bringup.accept.tight_selection import selection_rows
from deepseis_core.errors import InputError
from deepseis_core.types import FloatArray

DATA: Final = Path("..") / "shared" / "data"
"""Beside the checkout, as the tests' fixture `shared_data` has it."""
BLOCKAGE_S: Final = 30.0
KEPT: Final = (0, 2)
"""Satellites left in a blockage."""


def real_drives(
    acceptance: Acceptance, *, short: bool, say: Callable[[str], None] = lambda _text: None
) -> None:
    """Add rows and pictures of the real drives; or say that they are not there."""
    folder = data_folder()
    if folder is None:
        acceptance.remarks.append(
            "Real drives (Kingston, PSINS) are not part of the project and not at hand: "
            "their lines are missing."
        )
        return
    say("Kingston: reading")
    town = kingston(folder)
    _kingston(acceptance, town.until(1200.0) if short else town, say)
    acceptance.remarks.append(
        "PSINS' receiver smooths its ranges itself: there is nothing left for a Hatch filter. "
        "In the blockages the limit is the error at the same moments without them."
    )
    say("PSINS")
    _psins(acceptance, psins(folder))


def data_folder() -> Path | None:
    """Return the folder of real drives, or None."""
    for base in (Path.cwd(), Path(__file__).resolve().parents[5]):
        folder = base / DATA / "gnss_ins"
        if folder.is_dir():
            return folder
    return None


def _kingston(acceptance: Acceptance, drive: Drive, say: Callable[[str], None]) -> None:
    table = "Kingston, town with canyons, against the maker's own INS/GNSS"
    points = rtklib_positions(drive, MASK_DEG)
    peer, flights = drive.errors_n(points), {}
    for way in WAYS:
        say(f"Kingston: {way.name}")
        flights[way] = fly(drive, way)
    moving = np.isfinite(flights[RAW_ALL].error[:, 0])
    some = moving & np.isfinite(peer[:, 0])
    acceptance.add(
        Row(table, "RTKLIB, single points", "epochs with a position", "%",
            100.0 * float(some.sum() / moving.sum())),
        *_error_rows(table, "RTKLIB, single points", peer[some]),
    )  # fmt: skip
    for way, flight in flights.items():
        acceptance.add(*_error_rows(table, way.name, flight.error[moving]))
        acceptance.add(
            Row(table, way.name, "horizontal RMS at RTKLIB's epochs over RTKLIB's", "-",
                _flat(flight.error[some]) / _flat(peer[some])),
        )  # fmt: skip
    acceptance.add(*_blockages(drive, flights, say))
    unit, elevation = drive.geometry()
    acceptance.add(*selection_rows("Kingston", unit[moving], elevation[moving]))
    shown = {
        "RTKLIB": peer,
        "raw": flights[RAW_ALL].error,
        "Hatch": flights[HATCH_ALL].error,
    }
    flat = np.where(some, np.hypot(peer[:, 0], peer[:, 1]), 0.0)
    worst = float(drive.observed.time[int(np.argmax(flat))])
    acceptance.figures.append((
        table,
        [
            error_figure("Position errors, all satellites", "RTKLIB: single points.",
                         drive.observed.time, shown, ("E", "N", "U")),
            map_figure("From above, two minutes about RTKLIB's greatest error",
                       "Tight coupling of all satellites, smoothed.", drive,
                       {"RTKLIB": points, "Hatch": flights[HATCH_ALL].position},
                       (worst - 60.0, worst + 60.0)),
        ],
    ))  # fmt: skip


def _error_rows(table: str, name: str, errors: FloatArray) -> list[Row]:
    flat = np.hypot(errors[:, 0], errors[:, 1])
    return [
        *(
            Row(table, name, f"RMS {axis}", "m", float(value))
            for axis, value in zip(("east", "north", "up"), rms(errors), strict=True)
        ),
        Row(table, name, "horizontal error, 95 %", "m", float(np.nanpercentile(flat, 95.0))),
        Row(table, name, "horizontal error, greatest", "m", float(np.nanmax(flat))),
    ]


def _flat(errors: FloatArray) -> float:
    """Return the horizontal RMS."""
    return float(np.sqrt(np.sum(rms(errors[:, :2]) ** 2)))


def blocked_spans(drive: Drive, first: float, every: float) -> list[tuple[float, float]]:
    """Return blockages over a drive [s]."""
    last = float(drive.observed.time[-1]) - BLOCKAGE_S
    return [(begin, begin + BLOCKAGE_S) for begin in np.arange(first, last, every)]


def _blockages(
    drive: Drive, flights: Mapping[Way, Flight], say: Callable[[str], None]
) -> list[Row]:
    spans = blocked_spans(drive, 720.0, 150.0)
    table = f"Kingston, {len(spans)} blockages of {BLOCKAGE_S:g} s made by removing satellites"
    rows, (_, elevation) = [], drive.geometry()
    for keep in KEPT:
        hidden: Flags = np.zeros(drive.observed.pseudorange.shape, np.bool_)
        for span in spans:
            hidden |= without(drive, span, keep, elevation)
        for way in WAYS:
            say(f"Kingston: {way.name}, {keep} satellites left")
            flight = fly(drive, way, hidden=hidden)
            ends = [_last(drive, flight, span) for span in spans]
            open_sky = [_last(drive, flights[way], span) for span in spans]
            rows += [
                Row(table, f"{way.name}, {keep} left", "horizontal error at the end, RMS", "m",
                    float(np.sqrt(np.nanmean(np.square(ends)))),
                    limit=float(np.sqrt(np.nanmean(np.square(open_sky))))),
                Row(table, f"{way.name}, {keep} left", "the same, greatest", "m",
                    float(np.nanmax(ends))),
            ]  # fmt: skip
    return rows


def _last(drive: Drive, flight: Flight, span: tuple[float, float]) -> float:
    """Return the horizontal error at the last epoch of a blockage [m]."""
    k = int(np.searchsorted(drive.observed.time, span[1] - 1e-6)) - 1
    return float(np.hypot(*flight.error[k, :2]))


def _psins(acceptance: Acceptance, drive: Drive) -> None:
    """Compare with RTKLIB, and a blockage with the same way without it: there is no reference."""
    table = "PSINS, 200 Hz, no reference: against RTKLIB and against itself"
    peer, (_, elevation) = rtklib_positions(drive, MASK_DEG), drive.geometry()
    span = (90.0, 90.0 + BLOCKAGE_S)
    for way in WAYS:
        flight = fly(drive, way)
        known = np.isfinite(flight.position[:, 0])
        if not known.any():
            raise InputError(drive.name, "gave no position")
        off = drive.differences_n(flight.position, peer)[known]
        acceptance.add(
            Row(table, way.name, "horizontal difference to RTKLIB's single points, RMS", "m",
                _flat(off)),
            Row(table, way.name, "height difference to them, RMS", "m", float(rms(off)[2])),
        )  # fmt: skip
        for keep in KEPT:
            hidden = without(drive, span, keep, elevation)
            other = fly(drive, way, hidden=hidden)
            moved = drive.differences_n(other.position, flight.position)
            k = int(np.searchsorted(drive.observed.time, span[1])) - 1
            acceptance.add(
                Row(table, f"{way.name}, {keep} satellites left for 30 s",
                    "horizontal change at the end", "m", float(np.hypot(*moved[k, :2]))),
            )  # fmt: skip
