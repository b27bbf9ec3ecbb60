"""Best bandwidths and sensitivity of the Doppler-aided paper: its formulas, and loops simulated.

The paper's case: order 3, 1 ms, 35 dB-Hz, jerk of 10 g/s, an oscillator that is not shaken. The
simulation is at correlator level (`loop_theory_simulation`): the loop as it is, with arctangent
and noise, against the formulas of `loop_theory`.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from deepseis_bringup.accept.scene import Work
from deepseis_bringup.accept.tables import Goal, Row
from deepseis_bringup.theory.doppler import AIDED as NARROW
from deepseis_bringup.theory.doppler import (
    ALONE,
    CN0,
    GRADES,
    JERK,
    PERIOD,
    UNJAMMED,
    aided,
    alone,
    imu_error,
)
from deepseis_core.constants import SPEED_OF_LIGHT
from deepseis_core.types import FloatArray
from deepseis_sim.oscillator import Oscillator, OscillatorConfig
from deepseis_tracking.loop_filter import design_loop
from deepseis_tracking.loop_theory import (
    aided_total,
    conventional_total,
    dynamic_stress,
    linear,
    thermal_noise,
)
from deepseis_tracking.loop_theory_discrete import DiscreteLoop
from deepseis_tracking.loop_theory_limits import (
    best_bandwidth,
    jammer_range,
    jammer_to_signal_db,
    sensitivity,
)
from deepseis_tracking.loop_theory_simulation import simulate_loop

ORDER: Final = 3
PARTS: Final = 4
SETTLING_S: Final = 2.0
GRID_HZ: Final = (15.0, 20.0, 25.0, 28.0, 31.0, 34.0, 40.0, 48.0)
TABLE: Final = "D figures 2, 5, best bandwidth"


def best_bandwidths(work: Work) -> None:
    """Give the paper's optimum, theory beside simulation, and its sensitivities."""
    work.say("best bandwidth at 35 dB-Hz and 10 g/s")
    seconds = 20.0 if work.short else 200.0
    work.acceptance.add(*_alone(seconds), *_aided(seconds), *_sensitivities())
    work.acceptance.remarks += [
        "The Doppler-aided paper reads 24 and 32 dB-Hz off its figure 6 and prints 22.3 and 28.8 "
        "in its table 1; its formulas give the latter, for thermal noise alone when aided.",
    ]


def simulated(
    bandwidth_hz: float, range_m: FloatArray, cn0_dbhz: float, seed: int
) -> tuple[float, float]:
    """Return noise and mean of a simulated loop's true phase error [rad], once settled.

    ``range_m`` has a value for each of `PARTS` parts of every integration, flat.
    """
    gains = design_loop(ORDER, bandwidth_hz, PERIOD)
    run = simulate_loop(gains, PERIOD, range_m.reshape(-1, PARTS), cn0_dbhz, seed)
    error = run.error[round(SETTLING_S / PERIOD) :]
    slipped = np.abs(error).max(initial=0.0) > np.pi
    return (np.inf, np.inf) if slipped else (float(error.std()), float(error.mean()))


def arctangent_slope(cn0_dbhz: float) -> float:
    """Return the slope of the mean of ``atan(Q / I)`` at no error, ``1 - exp(-CN0 T)``.

    Noise turns some phases beyond +-90 deg, where the discriminator folds them back: the slope is
    1 less pi times the density there.

    Examples
    --------
    >>> round(arctangent_slope(35.0), 3)
    0.958
    """
    return float(-np.expm1(-linear(cn0_dbhz) * PERIOD))


def _times(seconds: float) -> FloatArray:
    count = round(seconds / PERIOD) * PARTS
    return np.asarray((np.arange(count) + 0.5) * PERIOD / PARTS)


def _alone(seconds: float) -> list[Row]:
    t = _times(seconds + SETTLING_S)
    totals = {}
    for bandwidth in GRID_HZ:
        noise, mean = simulated(bandwidth, JERK * t**3 / 6.0, CN0, seed=1)
        totals[bandwidth] = float(conventional_total(noise, 0.0, 0.0, abs(mean)))
    best, least = best_bandwidth(lambda b: float(alone(b, CN0)))
    found = min(totals, key=lambda b: totals[b])
    formula = np.degrees(float(alone(ALONE, CN0)))
    stress = np.degrees(float(dynamic_stress(ORDER, ALONE, JERK)))
    discrete = np.degrees(DiscreteLoop.design(ORDER, ALONE, PERIOD).steady_error(JERK))
    real = discrete / arctangent_slope(CN0)
    stressed = simulated(ALONE, JERK * t**3 / 6.0, CN0, seed=1)
    scenario = f"{CN0:g} dB-Hz, 10 g/s, 1 ms, without aiding"
    return [
        Row(TABLE, scenario, "best bandwidth, formulas", "Hz", best, "about 25"),
        Row(TABLE, scenario, "error there, formulas", "deg", np.degrees(least), "about 7"),
        Row(TABLE, scenario, "best bandwidth, simulated, of " + _texts(GRID_HZ), "Hz", found,
            "about 25", Goal.within(0.20, round(best, 1))),
        Row(TABLE, scenario, "error at 25 Hz, formulas", "deg", formula, "about 7"),
        Row(TABLE, scenario, "error at 25 Hz, simulated", "deg",
            np.degrees(totals[ALONE]), "about 7", Goal.within(0.20, round(formula, 2))),
        Row(TABLE, scenario, "mean error by the jerk at 25 Hz, formula of the analog loop", "deg",
            stress),
        Row(TABLE, scenario, "the same, discrete loop of 25 Hz and the arctangent's slope", "deg",
            real),
        Row(TABLE, scenario, "the same, simulated", "deg", np.degrees(abs(stressed[1])), None,
            Goal.within(0.05, round(real, 2))),
        Row(TABLE, scenario, "noise at 25 Hz, simulated", "deg", np.degrees(stressed[0]), None,
            Goal.within(0.20, round(np.degrees(float(thermal_noise(ALONE, CN0, PERIOD))), 2))),
    ]  # fmt: skip


def _aided(seconds: float) -> list[Row]:
    """Give thermal noise, and with the OCXO, of the narrow loop whose motion is taken away."""
    t = _times(seconds + SETTLING_S)
    thermal = float(thermal_noise(NARROW, CN0, PERIOD))
    clock = Oscillator(OscillatorConfig(drift=0.0), seed=3)
    wander = SPEED_OF_LIGHT * clock(t)
    loop = DiscreteLoop.design(ORDER, NARROW, PERIOD)
    total = float(aided_total(thermal, 0.0, loop.oscillator_noise(), imu_error(NARROW, "high-g")))
    quiet, _ = simulated(NARROW, np.zeros(t.size), CN0, seed=2)
    shown, _ = simulated(NARROW, wander - wander[0], CN0, seed=2)
    scenario = f"{CN0:g} dB-Hz, 10 g/s, 1 ms, aided 3 Hz"
    best, least = best_bandwidth(lambda b: float(aided(b, CN0)), least=0.3)
    return [
        Row(TABLE, scenario, "best bandwidth, formulas", "Hz", best, "3"),
        Row(TABLE, scenario, "error there, formulas (thermal, OCXO by D 4, IMU)", "deg",
            np.degrees(least), "about 3"),
        Row(TABLE, scenario, "thermal noise, formula", "deg", np.degrees(thermal), "about 3"),
        Row(TABLE, scenario, "thermal noise, simulated", "deg", np.degrees(quiet), None,
            Goal.within(0.20, round(np.degrees(thermal), 2))),
        Row(TABLE, scenario, "thermal noise, OCXO and IMU, theory of the discrete loop", "deg",
            np.degrees(total), "about 3"),
        Row(TABLE, scenario, "thermal noise and OCXO, simulated", "deg", np.degrees(shown),
            "about 3", Goal.within(0.20, round(np.degrees(total), 2))),
    ]  # fmt: skip


def _sensitivities() -> list[Row]:
    table = "D figures 4, 6, sensitivity at 15 deg"
    free = sensitivity(lambda c: float(alone(ALONE, c)))
    noise = sensitivity(lambda c: float(thermal_noise(NARROW, c, PERIOD)))
    rows = [
        Row(table, "without aiding, 25 Hz", "least C/N0; figure 6 reads 32", "dB-Hz", free,
            28.8),
        Row(table, "aided, 3 Hz, thermal noise alone", "least C/N0; figure 6 reads 24", "dB-Hz",
            noise, 22.3),
    ]  # fmt: skip
    for grade, text in GRADES.items():

        def total(cn0: float, grade: str = grade) -> float:
            return float(aided(NARROW, cn0, grade))

        rows.append(
            Row(table, f"aided, 3 Hz, OCXO, IMU {grade} ({text})", "least C/N0", "dB-Hz",
                sensitivity(total), "picture lost", limit=noise)
        )  # fmt: skip
    return rows


def jamming_formula() -> list[Row]:
    """Table 1 of the paper by its formula, from its own C/N0."""
    table = "D table 1, J/S by the formula"
    rows = []
    for name, cn0, printed, reach in (
        ("aided, 3 Hz", 22.3, 37.74, 621.61),
        ("without aiding, 25 Hz", 28.8, 31.03, 1345.91),
    ):
        ours = float(jammer_to_signal_db(cn0, UNJAMMED))
        away = float(jammer_range(ours)) / 1e3
        scenario = f"{name}: {cn0:g} dB-Hz of {UNJAMMED:g}, P = 1"
        rows += [
            Row(table, scenario, "J/S", "dB", ours, printed, Goal.near(printed, 0.05)),
            Row(table, scenario, "range of 100 W", "km", away, reach, Goal.within(0.005, reach)),
        ]
    gain = float(jammer_to_signal_db(22.3, UNJAMMED) - jammer_to_signal_db(28.8, UNJAMMED))
    rows.append(Row(table, "gain of aiding", "J/S", "dB", gain, 6.7, Goal.near(6.7, 0.05)))
    return rows


def _texts(values: tuple[float, ...]) -> str:
    return " ".join(f"{value:g}" for value in values)
