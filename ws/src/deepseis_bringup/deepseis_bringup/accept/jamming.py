"""Jammers: the Doppler-aided paper's table 1, and the same with a jammer in the samples.

A jammer of J/S raises the noise's density: ``1 / CN0eq = 1 / CN0 + J/S / (P fc)``, P = 1 for a
narrow band, 2 for a wide one (D 8). Here noise of 0.2 MHz, or of the code's 2.046 MHz from null to
null, is added to the simulated samples, level after level; the receiver tells what it sees.

What the formula leaves out is known: the part of the code's own spectrum that the jammer meets
(`code_overlap_db`), line by line. Gain control and the quantiser of 4 bits take 0.05 dB more.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from deepseis_bringup.accept.bandwidth import jamming_formula
from deepseis_bringup.accept.figures import jamming_figure
from deepseis_bringup.accept.jammed_loops import (
    CN0,
    EQUIVALENT,
    NARROW_HZ,
    TABLE,
    jammed_sky,
    thresholds,
)
from deepseis_bringup.accept.scene import RATE_HZ, Loop, Outcome, Scene, Work
from deepseis_bringup.accept.tables import Goal, Row
from deepseis_bringup.report.plot import Figure
from deepseis_core.ca_code import ca_code
from deepseis_core.constants import CA_RATE_CPS
from deepseis_core.types import FloatArray
from deepseis_tracking.loop_theory import linear
from deepseis_tracking.loop_theory_limits import (
    jammed_cn0_dbhz,
    jammer_to_signal_db,
)

LEVELS: Final = np.arange(25.0, 43.1, 2.0)
"""J/S of the steps [dB]."""
QUIET_S: Final = 10.0
WIDE_HZ: Final = 2.0 * CA_RATE_CPS

MEASURING: Final = Loop(
    "conventional 5 Hz",
    "",
    5.0,
    {"pll_bandwidth_hz": 5.0, "relock_s": 0.0, "loss_dbhz": 10.0, "code_lock_dbhz": 12.0},
)
"""Still antenna: narrow enough that the phase holds while C/N0 is measured; nothing gives up."""


@dataclass(frozen=True)
class Kind:
    """A kind of jammer; ``factor`` is the formula's P."""

    name: str
    settings: str
    factor: float
    bandwidth_hz: float


KINDS: Final = (
    Kind("noise of 0.2 MHz", f"kind: band, bandwidth_hz: {NARROW_HZ}", 1.0, NARROW_HZ),
    Kind("noise of 2.046 MHz", f"kind: band, bandwidth_hz: {WIDE_HZ}", 2.0, WIDE_HZ),
)


def jamming(work: Work) -> None:
    """Give table 1 by formula and by simulation, and what aiding gains."""
    work.acceptance.add(*jamming_formula())
    figures: list[Figure] = []
    for kind in KINDS:
        rows, figure = _measured(work, kind)
        work.acceptance.add(*rows)
        figures.append(figure)
    rows, figure = thresholds(work)
    work.acceptance.add(*rows)
    work.acceptance.figures.append((TABLE, [*figures, figure]))


def code_overlap_db(prn: int, bandwidth_hz: float) -> float:
    """Return how the code meets noise in a band, over ``1 / fc`` [dB].

    ``10 lg(fc sum |c_k|^2 S(k kHz))`` with the lines of the code's spectrum, chips included, and
    ``S = 1 / B`` within the band, the jammer's normalised density.

    Parameters
    ----------
    prn : int
    bandwidth_hz : float
        Of the noise, in the middle of the code's spectrum.

    Examples
    --------
    The whole main lobe holds 90 % of the code's power, spread over twice the chip rate:

    >>> round(code_overlap_db(1, 2.046e6), 1)
    -3.5
    """
    chips = ca_code(prn).astype(np.float64)
    top = int(bandwidth_hz / 2.0 // 1e3)
    k = np.arange(-top, top + 1)
    lines = np.abs(np.fft.fft(chips)[k % chips.size] / chips.size * np.sinc(k / chips.size)) ** 2
    return float(10.0 * np.log10(CA_RATE_CPS * lines.sum() / bandwidth_hz))


def crossing(levels: FloatArray, seen: FloatArray, value: float) -> float:
    """Return the level at which a falling measurement passes a value; NaN if it does not.

    Examples
    --------
    >>> float(crossing(np.array([1.0, 2.0, 3.0]), np.array([9.0, 7.0, 5.0]), 6.0))
    2.5
    """
    if not (np.isfinite(seen).all() and seen.min() <= value <= seen.max()):
        return float("nan")
    return float(np.interp(-value, -seen, levels))


def _measured(work: Work, kind: Kind) -> tuple[list[Row], Figure]:
    """Let the receiver measure C/N0 at every level."""
    step_s = 4.0 if work.short else 15.0
    starts: FloatArray = QUIET_S + step_s * np.arange(LEVELS.size, dtype=np.float64)
    times = np.column_stack([starts, starts + step_s - 0.02]).ravel().round(3).tolist()
    offsets = np.repeat(LEVELS, 2).tolist()
    settings = [
        f"jammers=[{{{kind.settings}, j_to_n0_dbhz: {CN0}, start_s: {QUIET_S},"
        f" times_s: {times}, offsets_db: {offsets}}}]",
        f"duration={QUIET_S + step_s * LEVELS.size}",
        *jammed_sky(),
    ]
    work.say(f"static, {kind.name}: simulating")
    scene = Scene("static", work.folder, short=True, settings=settings, label=kind.name)
    outcome = work.run(scene, MEASURING)
    seen = _seen(outcome, starts, step_s)
    theory = jammed_cn0_dbhz(LEVELS, CN0, factor=kind.factor)
    overlap = [code_overlap_db(int(name[1:]), kind.bandwidth_hz) for name in outcome.tracks]
    share_db = 10.0 * np.log10(np.mean(linear(overlap)))
    rows = []
    for cn0, printed, whose in EQUIVALENT:
        ours = crossing(LEVELS, seen, cn0)
        formula = float(jammer_to_signal_db(cn0, CN0, factor=kind.factor))
        exact = float(jammer_to_signal_db(cn0, CN0)) - share_db
        scenario = f"{kind.name}, P = {kind.factor:g}, static, {len(outcome.tracks)} satellites"
        rows += [
            Row(TABLE, scenario, f"J/S at which C/N0 is measured as {cn0} dB-Hz ({whose})", "dB",
                ours, printed if kind.factor == 1.0 else None,
                Goal.near(round(formula, 2), 1.0)),
            Row(TABLE, scenario, f"the same, less theory by the code's own lines, {cn0} dB-Hz",
                "dB", ours - exact, None, Goal.near(0.0, 1.0)),
        ]  # fmt: skip
    return rows, jamming_figure(kind.name, LEVELS, seen, theory, [c for c, _, _ in EQUIVALENT])


def _seen(outcome: Outcome, starts: FloatArray, step_s: float) -> FloatArray:
    """Return what the receiver says of C/N0 in the last quarter of every step [dB-Hz]."""
    means = []
    for start in starts:
        low, high = start + 0.75 * step_s, start + step_s - 0.02
        values = []
        for track in outcome.tracks.values():
            t = (track["sample_index"] + track["sample_count"] / 2) / RATE_HZ
            values.append(linear(track["cn0_dbhz"][(t >= low) & (t < high)]).mean())
        means.append(np.mean(values))
    return np.asarray(10.0 * np.log10(means))
