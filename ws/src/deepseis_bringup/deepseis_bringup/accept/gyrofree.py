"""Acceptance without gyroscopes: table 3 of the accelerometer-PPP paper, repeated.

One artificial earthquake, many stations with errors of their own (`accept_gyrofree_runs`); each
record is worked through with nine states as the paper has them, with the drift of GNSS modelled,
and with the ground known to be still until it moved; forward and smoothed.

What is possible at best stands beside it (`deepseis_ins.gyrofree_limits`): it comes from spectra
alone, no filter is asked.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from deepseis_bringup.accept.gyrofree_figures import pictures
from deepseis_bringup.accept.gyrofree_runs import Stations, Way, Ways
from deepseis_bringup.accept.tables import Acceptance, Goal, Row
from deepseis_core.kalman import chi_square_band
from deepseis_core.types import FloatArray
from deepseis_ins import gyrofree_limits as limits
from deepseis_sim.scenario import load_scenario

Say = Callable[[str], None]

AXES: Final = ("east", "north", "up")
PAPERS_RUNS: Final = 10
RUNS: Final = 100
"""Ten leave the gains uncertain by 2 to 4 %, those of the motion's two minutes by 8; a hundred by
a third of that."""
SHORT_RUNS: Final = 40
PUBLISHED_GAIN: Final[Mapping[str, tuple[float, float, float]]] = {
    "forward": (12.9, 15.7, 10.5),
    "smoothed": (19.4, 31.5, 18.7),
}
"""Table 3 over GNSS [%], as its text repeats them."""
PUBLISHED_CM: Final = (0.6, 0.6, 1.5)
LARGEST_CM: Final = (0.4, 0.4, 1.0)
SHARE_OF_LIMIT: Final = 0.9
CHECKS_S: Final = (500.0, 950.0)
"""Far enough apart that errors are independent [s]."""

Pick = Callable[[Ways], Way]
NINE: Final = "9 states, drift as white (the paper)"
TWELVE: Final = "12 states, drift modelled"
HELD: Final = "12 states, known still until the onset"
WAYS: Final[Mapping[str, Pick]] = {
    NINE: lambda ways: ways.nine,
    TWELVE: lambda ways: ways.twelve,
    HELD: lambda ways: ways.held,
}


def accept_gyrofree(folder: Path, *, short: bool, say: Say = lambda _text: None) -> Acceptance:
    """Repeat the paper's table of position errors.

    Parameters
    ----------
    folder : Path
        Gets ``gyrofree.csv`` and ``gyrofree.html``.
    short : bool
        40 s of rest instead of 15 minutes, and fewer runs.
    say : callable, optional
        Told what is done.
    """
    say("artificial: the earthquake")
    stations = Stations(load_scenario("artificial", short=short))
    count = SHORT_RUNS if short else RUNS
    runs = []
    for seed in range(1, count + 1):
        runs.append(stations.run(seed))
        if seed % 10 == 0:
            say(f"artificial: {seed} of {count} runs")
    form = "short form" if short else "full form"
    acceptance = tables(stations, runs, f"Displacement without gyroscopes, {form}")
    acceptance.write(folder)
    return acceptance


def tables(stations: Stations, runs: Sequence[Ways], title: str) -> Acceptance:
    """Put what the runs showed into tables and pictures."""
    acceptance = Acceptance("gyrofree", title)
    acceptance.add(
        *paper_rows(stations, runs[:PAPERS_RUNS]),
        *drift_rows(stations, runs),
        *still_rows(stations, runs),
        *consistency_rows(stations, runs),
    )
    acceptance.remarks += remarks(stations, len(runs))
    acceptance.figures += pictures(stations, runs)
    return acceptance


def paper_rows(stations: Stations, runs: Sequence[Ways]) -> list[Row]:
    """Repeat the paper: nine states, its ten runs, from when it had converged."""
    table = "A table 3, ten runs"
    gnss = gnss_rms(stations, runs, stations.settled)
    rows = [Row(table, "GNSS", f"error, {axis}", "cm", 100.0 * gnss[k])
            for k, axis in enumerate(AXES)]  # fmt: skip
    for kind, published in PUBLISHED_GAIN.items():
        rms = track_rms(stations, runs, WAYS[NINE], kind, stations.settled)
        for k, axis in enumerate(AXES):
            rows.append(Row(table, f"{NINE}, {kind}", f"gain over GNSS, {axis}", "%",
                            _gain(rms[k], gnss[k]), published[k]))  # fmt: skip
        if kind == "smoothed":
            rows += [Row(table, f"{NINE}, {kind}", f"error, {axis}", "cm", 100.0 * rms[k],
                         PUBLISHED_CM[k]) for k, axis in enumerate(AXES)]  # fmt: skip
    return rows


def drift_rows(stations: Stations, runs: Sequence[Ways]) -> list[Row]:
    """Model the drift: more than the paper's, as far as its spectrum allows."""
    table = f"drift modelled, {len(runs)} runs"
    gnss = gnss_rms(stations, runs, stations.settled)
    rows = []
    for kind in ("forward", "smoothed"):
        rms = track_rms(stations, runs, WAYS[TWELVE], kind, stations.settled)
        for k, axis in enumerate(AXES):
            errors = stations.errors_of_axis(k)
            best = _gain(limits.best_sd(errors, stations.grade), errors.sd)
            goal = 30.0 if kind == "forward" else SHARE_OF_LIMIT * best
            rows.append(Row(table, f"{TWELVE}, {kind}", f"gain over GNSS, {axis}", "%",
                            _gain(rms[k], gnss[k]), PUBLISHED_GAIN[kind][k],
                            Goal.at_least(round(goal, 2)), best))  # fmt: skip
        rows += [Row(table, f"{TWELVE}, {kind}", f"error, {axis}", "cm", 100.0 * rms[k],
                     PUBLISHED_CM[k] if kind == "smoothed" else None)
                 for k, axis in enumerate(AXES)]  # fmt: skip
    for k, axis in enumerate(AXES):
        errors = stations.errors_of_axis(k)
        rows.append(Row(table, "theory", f"gain if all white noise went, drift left, {axis}", "%",
                        _gain(errors.drift_sd, errors.sd)))  # fmt: skip
        rows.append(Row(table, "theory", f"accelerometers blind to the drift below, {axis}", "Hz",
                        limits.crossing_hz(errors, stations.grade), 0.07))  # fmt: skip
    return rows


def still_rows(stations: Stations, runs: Sequence[Ways]) -> list[Row]:
    """Know that the ground was still: GNSS calibrated until the onset, errors in the motion."""
    table = f"the station's case, during the motion, {len(runs)} runs"
    gnss = gnss_rms(stations, runs, stations.moving)
    length = stations.moving[1] - stations.moving[0]
    rows = []
    for kind in ("forward", "smoothed"):
        rms = track_rms(stations, runs, WAYS[HELD], kind, stations.moving)
        for k, axis in enumerate(AXES):
            errors = stations.errors_of_axis(k)
            left = limits.regrown_rms(errors.drift_sd, errors.correlation_time, length)
            goal = 30.0 if kind == "forward" else 50.0
            rows.append(Row(table, f"{HELD}, {kind}", f"gain over GNSS, {axis}", "%",
                            _gain(rms[k], gnss[k]), PUBLISHED_GAIN[kind][k],
                            Goal.at_least(goal), _gain(left, errors.sd)))  # fmt: skip
            largest = Goal.at_most(LARGEST_CM[k]) if kind == "smoothed" else None
            rows.append(Row(table, f"{HELD}, {kind}", f"error, {axis}", "cm", 100.0 * rms[k],
                            PUBLISHED_CM[k] if kind == "smoothed" else None, largest,
                            100.0 * left))  # fmt: skip
            rows.append(Row(table, f"{HELD}, {kind}", f"gain by its covariance, {axis}", "%",
                            _gain(_expected(stations, runs[0].held.P(kind))[k], errors.sd),
                            limit=_gain(left, errors.sd)))  # fmt: skip
    noticed = np.array([ways.noticed - stations.moving[0] for ways in runs])
    rows += [
        Row(table, "onset", "motion seen while there was none", "runs",
            float((noticed <= 0.0).sum()), goal=Goal.at_most(0.0)),
        Row(table, "onset", "noticed after the first movement, median", "s",
            float(np.median(noticed))),
        Row(table, "onset", "displacement where it is said to begin, greatest", "cm",
            100.0 * max(_moved_by(stations, ways.onset) for ways in runs)),
    ]  # fmt: skip
    return rows


def consistency_rows(stations: Stations, runs: Sequence[Ways]) -> list[Row]:
    """Compare errors with the covariances, and the covariance with the limit from spectra."""
    table, rows = "consistency", []
    times = [t for t in CHECKS_S if t < stations.duration] or [0.75 * stations.duration]
    for name in (TWELVE, HELD):
        for kind in ("forward", "smoothed"):
            squares = []
            for ways in runs:
                got = WAYS[name](ways)
                for time in times:
                    if name == HELD and time < ways.onset:
                        continue
                    k = round(time * stations.gnss_hz)
                    error = got.error(kind)[stations.looks_at(k)]
                    squares.append(error @ np.linalg.solve(got.P(kind)[k], error))
            low, high = chi_square_band(3, len(squares))
            band = round(0.5 * (high - low) / 3.0, 3)
            rows.append(Row(table, f"{name}, {kind}", "normalised squared error of position", "-",
                            float(np.mean(squares)), goal=Goal.within(band, 3.0),
                            limit=3.0))  # fmt: skip
    middle = round(0.5 * stations.moving[0] * stations.gnss_hz)
    if middle < 300:
        return rows
    sd = np.sqrt(np.diag(runs[0].twelve.P_smoothed[middle]))
    for k, axis in enumerate(AXES):
        errors = stations.errors_of_axis(k)
        best = _gain(limits.best_sd(errors, stations.grade), errors.sd)
        rows.append(Row(table, f"{TWELVE}, smoothed", f"gain by its covariance, {axis}", "%",
                        _gain(sd[k], errors.sd), goal=Goal.at_least(round(0.9 * best, 2)),
                        limit=best))  # fmt: skip
    return rows


def remarks(stations: Stations, count: int) -> list[str]:
    """Say what the numbers mean, and why a goal cannot be reached."""
    east = stations.errors_of_axis(0)
    best = [_gain(limits.best_sd(e, stations.grade), e.sd)
            for e in map(stations.errors_of_axis, range(3))]  # fmt: skip
    return [
        f"Errors of GNSS: {east.correlation_time:g} s of drift under white noise, chosen so that "
        "the paper's gains come out (its tables of them are lost in print).",
        "An accelerometer integrated twice errs by the inverse fourth power of the frequency: "
        f"below {limits.crossing_hz(east, stations.grade):.2f} Hz it knows less of a displacement "
        "than the drift takes away. No use of the same data, past and future, gains more than "
        f"{best[0]:.0f}, {best[1]:.0f} and {best[2]:.0f} %, east, north, up: 30 % is out of reach "
        "of any filter that does not know where the ground was, and the drift modelled or not "
        "makes little difference to it.",
        "Who knows that the ground was still knows the drift, and loses it again only as fast as "
        "it wanders: that is the station's case.",
        f"{count} runs; the limits are expectations, so single runs lie on both sides.",
    ]


def gnss_rms(stations: Stations, runs: Sequence[Ways], span: tuple[float, float]) -> FloatArray:
    """Return the RMS of GNSS errors in a span, all runs together, shape (3,) [m]."""
    time = stations.epochs / stations.rate_hz
    inside = (time >= span[0]) & (time < span[1])
    return _rms([ways.gnss[inside] for ways in runs])


def track_rms(
    stations: Stations, runs: Sequence[Ways], pick: Pick, kind: str, span: tuple[float, float]
) -> FloatArray:
    """Return the RMS of errors of the displacement in a span, shape (3,) [m]."""
    inside = (stations.time > span[0]) & (stations.time <= span[1])
    return _rms([pick(ways).error(kind)[inside] for ways in runs])


def _expected(stations: Stations, P: FloatArray) -> FloatArray:
    """Return what the RMS during the motion should be by covariances at the epochs, (3,) [m]."""
    time = stations.epochs / stations.rate_hz
    inside = (time >= stations.moving[0]) & (time < stations.moving[1])
    return np.asarray(np.sqrt(np.diagonal(P[inside], axis1=1, axis2=2).mean(axis=0)))


def _rms(errors: Sequence[FloatArray]) -> FloatArray:
    mean = np.mean([np.mean(np.square(each), axis=0) for each in errors], axis=0)
    return np.asarray(np.sqrt(mean))


def _gain(rms: float, of: float) -> float:
    """Return by how much an error is smaller than another [%]."""
    return float(100.0 * (1.0 - rms / of))


def _moved_by(stations: Stations, time: float) -> float:
    """Return the displacement at a time [m]."""
    k = min(int(np.searchsorted(stations.time, time)), len(stations.truth) - 1)
    return float(np.linalg.norm(stations.truth[k]))
