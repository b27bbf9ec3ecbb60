"""Loops under a jammer that rises while the antenna is shaken: where each of them gives way.

The Doppler-aided paper's rule takes a loop as lost at 15 deg. Here the error is the true one, in
simulated samples; beside it stands the same loop at correlator level (`loop_theory_simulation`)
under the C/N0 that the formula gives (D 8), with the discriminator's arctangent, which at 1 ms is
what counts: at 28.8 dB-Hz its slope is 0.53, so that a conventional loop shows twice the stress.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from deepseis_bringup.accept.figures import threshold_figure
from deepseis_bringup.accept.loop_measures import phase_errors
from deepseis_bringup.accept.scene import RATE_HZ, Loop, Outcome, Scene, Work, aided
from deepseis_bringup.accept.tables import Goal, Row
from deepseis_bringup.report.plot import Figure
from deepseis_core.types import FloatArray
from deepseis_tracking.loop_theory import THRESHOLD
from deepseis_tracking.loop_theory_discrete import DiscreteLoop
from deepseis_tracking.loop_theory_limits import jammed_cn0_dbhz
from deepseis_tracking.loop_theory_simulation import circle, simulate_loop

CN0: Final = 41.0
"""Of every satellite: with it the paper's formula gives its table 1 [dB-Hz]."""
EQUIVALENT: Final = ((28.8, 31.03, "conventional"), (22.3, 37.74, "aided"))
"""C/N0 [dB-Hz] of the paper's two loops, and its J/S [dB]."""
NARROW_HZ: Final = 0.2e6
RAMP_DB: Final = (20.0, 50.0)
"""J/S while the antenna moves: rises evenly over that time [dB]."""
WINDOW_S: Final = 1.0
MODELLED: Final = np.arange(24.0, 46.1, 0.25)
"""J/S of the loops at correlator level [dB]."""
TABLE: Final = "D table 1, J/S simulated"


def jammed_sky() -> Sequence[str]:
    """Return settings of a scenario whose satellites have one C/N0, with gain control."""
    return (
        *(f"sky.zenith_cn0_dbhz={CN0}", f"sky.low_cn0_dbhz={CN0}"),
        *("receiver.agc_s=0.05", "base=null"),
    )


def _loops() -> tuple[Loop, ...]:
    keep = {"loss_dbhz": 10.0, "code_lock_dbhz": 12.0, "relock_s": 0.0}
    third = {"pll_order": 3, "pll_bandwidth_hz": 25.0, "integration_ms": 1, **keep}
    narrow = aided(3.0)
    return (
        Loop("conventional 25 Hz order 3, 1 ms", "", 25.0, third),
        Loop("aided 3 Hz, 1 ms", "fusion", 3.0, {**narrow.tracker, "integration_ms": 1, **keep}),
        Loop("aided 3 Hz, 20 ms", "fusion", 3.0, {**narrow.tracker, **keep}),
    )


def thresholds(work: Work) -> tuple[list[Row], Figure]:
    """Raise the jammer while the antenna circles at 2 g: 12 g/s, the paper's 10 in sight."""
    names, reached, lost, expected, curves = [], [], [], [], []
    scene, ramp_s = _rising(work, "sine-1hz")
    for loop in _loops():
        level, error = _under_ramp(scene, work.run(scene, loop), ramp_s)
        names.append(f"circle of 2 g at 1 Hz, {loop.name}")
        curves.append((loop.name, level, error))
        reached.append(first_beyond(level, error, float(np.degrees(THRESHOLD))))
        lost.append(first_beyond(level, error, 90.0))
        expected.append(_expected(scene, loop))
    rows = _threshold_rows(names, reached, lost, expected)
    scene, ramp_s = _rising(work, "static")
    narrow = _loops()[-1]
    level, error = _under_ramp(scene, work.run(scene, narrow), ramp_s)
    still = first_beyond(level, error, float(np.degrees(THRESHOLD)))
    rows.append(
        Row(TABLE, f"at rest, {narrow.name}", "samples less correlator level, 15 deg", "dB",
            still - expected[-1], goal=Goal.near(0.0, 1.0))
    )  # fmt: skip
    return rows, threshold_figure(curves, [js for _, js, _ in EQUIVALENT])


def _rising(work: Work, name: str) -> tuple[Scene, tuple[float, float]]:
    """Simulate a scenario with a jammer that rises; return when it does [s]."""
    begin, end = (22.0, 40.0) if work.short else (32.0, 130.0)
    settings = [
        f"jammers=[{{kind: band, bandwidth_hz: {NARROW_HZ}, j_to_n0_dbhz: {CN0},"
        f" start_s: {begin - 0.5}, times_s: [{begin}, {end}], offsets_db: {list(RAMP_DB)}}}]",
        *jammed_sky(),
    ]
    if name == "static":
        settings.append(f"duration={end + 2.0}")
    work.say(f"{name}, rising jammer: simulating")
    scene = Scene(name, work.folder, short=work.short, settings=settings, label="rising")
    scene.still = (scene.still[0], begin - 2.5)
    return scene, (begin, end)


def _under_ramp(
    scene: Scene, outcome: Outcome, span: tuple[float, float]
) -> tuple[FloatArray, FloatArray]:
    """Return J/S [dB] and the median satellite's running error [deg] while the jammer rises."""
    t, error = running_error(scene, outcome, span)
    share = (t - span[0]) / (span[1] - span[0])
    return RAMP_DB[0] + (RAMP_DB[1] - RAMP_DB[0]) * share, np.median(error, axis=1)


def _threshold_rows(
    names: Sequence[str], reached: Sequence[float], lost: Sequence[float],
    expected: Sequence[float],
) -> list[Row]:  # fmt: skip
    at, gone = (
        f"J/S at which the true phase error of the median satellite {text}"
        for text in ("reaches 15 deg RMS", "passes 90 deg RMS: lost")
    )
    rows = []
    published = (*(js for _, js, _ in EQUIVALENT), None)
    for scenario, ours, late, model, js in zip(
        names, reached, lost, expected, published, strict=True
    ):
        goal = None if js is None else Goal.near(js, 1.0)
        rows += [
            Row(TABLE, scenario, at, "dB", ours, js, goal),
            Row(TABLE, scenario, "the same, this loop simulated at correlator level under the "
                "C/N0 of the formula", "dB", model),
            Row(TABLE, scenario, "samples less correlator level", "dB", ours - model,
                goal=Goal.near(0.0, 1.0)),
            Row(TABLE, scenario, gone, "dB", late),
        ]  # fmt: skip
        if scenario != names[0]:
            rows.append(
                Row(TABLE, scenario, "gain over the conventional loop, 15 deg", "dB",
                    ours - reached[0], 6.7, Goal.at_least(6.7))
            )  # fmt: skip
    return rows


def modelled(loop: DiscreteLoop, range_m: FloatArray, seed: int) -> FloatArray:
    """Return RMS phase errors [deg] of a loop at correlator level, at every level of `MODELLED`.

    Parameters
    ----------
    loop : DiscreteLoop
    range_m : ndarray, shape (n, parts)
        Motion that the loop sees, for `simulate_loop`; the last half of it counts.
    seed : int
        Of the noise.
    """
    cn0 = jammed_cn0_dbhz(MODELLED, CN0)
    found = [
        simulate_loop(loop.gains, loop.period, range_m, float(value), seed + 100 * k)
        for k, value in enumerate(cn0)
    ]
    kept = len(range_m) // 2
    return np.degrees([np.sqrt(np.mean(run.error[kept:] ** 2)) for run in found])


def _expected(scene: Scene, loop: Loop) -> float:
    """Return the level at which the median satellite's error is 15 deg, by `modelled`."""
    own = loop.tracker
    period = 1e-3 * own.get("integration_ms", 20)
    order = own["aided_order"] if loop.aiding else own["pll_order"]
    discrete = DiscreteLoop.design(order, loop.bandwidth_hz, period)
    errors = []
    for k, elevation in enumerate(scene.truth.elevation):
        seconds, parts = 4.0, 4
        count = round(seconds / period)
        range_m = np.zeros((count, parts))
        if not loop.aiding:
            range_m = circle(0.5, 1.0, float(elevation), seconds, period, parts=parts)
        errors.append(modelled(discrete, range_m, 1000 * (k + 1)))
    middle = np.median(errors, axis=0)
    return first_beyond(MODELLED, middle, float(np.degrees(THRESHOLD)))


def first_beyond(level: FloatArray, error: FloatArray, limit: float) -> float:
    """Return the level at which a noisy rising error passes a limit; NaN if it does not.

    Halfway between where it first lies above and where it last lies below.

    Examples
    --------
    >>> first_beyond(np.arange(6.0), np.array([1.0, 4.0, 2.0, 6.0, 4.0, 9.0]), 5.0)
    3.5
    """
    above = error > limit
    if not above.any() or above.all():
        return float("nan")
    return float(level[np.argmax(above)] + level[np.flatnonzero(~above)[-1]]) / 2.0


def running_error(
    scene: Scene, outcome: Outcome, span: tuple[float, float]
) -> tuple[FloatArray, FloatArray]:
    """Return times (m,) and every satellite's true phase error [deg], RMS over `WINDOW_S`.

    Locked or not: the NCO's phase less the truth. What is not tracked any more is infinite.
    """
    truth = scene.truth
    error = 360.0 * phase_errors(outcome.tracks, truth, RATE_HZ, locked=False)
    still = (truth.t >= scene.still[0]) & (truth.t < scene.still[1])
    seen = np.isfinite(error[still]).all(axis=0)
    error = error[:, seen] - error[still][:, seen].mean(axis=0)
    square = np.nan_to_num(error, nan=np.inf) ** 2
    width = round(WINDOW_S / float(truth.t[1] - truth.t[0]))
    mean = np.lib.stride_tricks.sliding_window_view(square, width, axis=0).mean(axis=-1)
    t = truth.t[width // 2 :][: len(mean)]
    ramp = (t >= span[0]) & (t < span[1])
    return t[ramp], np.sqrt(mean[ramp])
