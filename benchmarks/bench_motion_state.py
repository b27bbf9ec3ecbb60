"""Delay of the fast motion test, false switches in a day of rest, and its speed, one core.

Delays are from the onset to the end of the sample that decided, over 400 draws of the noise and
of the onset within a sample: steps of acceleration (a cosine from its crest), and sines from zero.
Beside them the delay of a matched filter that knows the motion and has the same probability of a
false alarm in each of its comparisons: nothing is faster. STIM300 is that of the thesis, 0.18
m/s/sqrt(h), and beside it with its maker's 0.06.

    ./deepseis python benchmarks/bench_motion_state.py [--json FILE] [--hours 24]
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import norm

from deepseis_core.imu_errors import ImuErrors
from deepseis_core.imu_grades import GRADES, STANDARD_GRAVITY
from deepseis_core.types import FloatArray, MotionKind
from deepseis_ins.motion_limits import make_limits
from deepseis_ins.motion_noise import noise_of_grade
from deepseis_ins.motion_state import MotionConfig, MotionDetector

RATE_HZ = 200.0
UNITS = {name: GRADES[name] for name in ("span-fsas", "stim300", "mti-g")}
UNITS["maker's"] = replace(GRADES["stim300"], accel_walk_per_sqrt_h=0.06)
AMPLITUDES_G = (0.001, 0.002, 0.005, 0.01, 0.02, 0.1)
FREQUENCIES_HZ = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
DRAWS = 400
SETTLED = 2000
Wave = Callable[[FloatArray], FloatArray]


def rest(grade: str, seed: int) -> Callable[[int, int], tuple[FloatArray, FloatArray]]:
    """Return a still unit: from first sample and count to rates and specific forces."""
    unit = ImuErrors(UNITS[grade], RATE_HZ, seed)

    def read(first: int, count: int) -> tuple[FloatArray, FloatArray]:
        vel = np.tile([0.0, 0.0, STANDARD_GRAVITY / RATE_HZ], (count, 1))
        made = unit.apply(first, np.zeros((count, 3)), vel)
        return made.delta_theta * RATE_HZ, made.delta_vel * RATE_HZ

    return read


def step(amplitude: float) -> Wave:
    return lambda t: amplitude * t


def cosine(amplitude: float, frequency_hz: float) -> Wave:
    w = 2 * np.pi * frequency_hz
    return lambda t: amplitude * np.sin(w * t) / w


def sine(amplitude: float, frequency_hz: float) -> Wave:
    w = 2 * np.pi * frequency_hz
    return lambda t: amplitude * (1 - np.cos(w * t)) / w


def mean_acceleration(velocity: Wave, onset: float, count: int) -> FloatArray:
    """Return means over samples of a motion whose velocity is given from its onset on [s]."""
    edges = np.arange(count + 1) / RATE_HZ - onset
    return np.diff(velocity(np.maximum(edges, 0.0))) * RATE_HZ


def delays(grade: str, velocity: Wave, longest: float, draws: int = DRAWS) -> FloatArray:
    """Return delays, leads of the onset found [s], and speeds there [m/s], shape (draws, 3).

    Not noticed: not a number.
    """
    out = np.full((draws, 3), np.nan)
    count, rng = SETTLED + round(longest * RATE_HZ), np.random.default_rng(3)
    for k in range(draws):
        detector = MotionDetector(MotionConfig(), RATE_HZ, UNITS[grade])
        omega, force = rest(grade, 100 + k)(0, count)
        onset = (SETTLED + rng.random()) / RATE_HZ
        force[:, 0] += mean_acceleration(velocity, onset, count)
        for decision in detector.push(0, omega, force):
            if decision.state == MotionKind.MOVING and decision.decided >= SETTLED:
                lead = onset - decision.since / RATE_HZ
                speed = abs(float(velocity(np.array([max(-lead, 0.0)]))[0]))
                out[k] = (decision.decided + 1) / RATE_HZ - onset, lead, speed
                break
    return out


def matched_filter_delay(grade: str, velocity: Wave, power: float = 0.5) -> float:
    """Return the delay [s] at which a filter that knows the motion notices it."""
    noise = noise_of_grade(UNITS[grade], RATE_HZ)
    config = MotionConfig()
    limits = make_limits(
        noise, RATE_HZ, config.longest_window, config.quiet_time, config.false_switches_per_day
    )
    wave = mean_acceleration(velocity, 0.0, 10000) / noise.sigma[3]
    deflection = np.sqrt(np.cumsum(wave**2))
    needed = norm.isf(limits.probability[1] / 2) + norm.ppf(power)
    return float(np.searchsorted(deflection, needed) + 1) / RATE_HZ


def table(name: str, rows: list[tuple[str, str, Wave, float]]) -> dict[str, dict[str, float]]:
    """Measure and print one row a grade and motion."""
    print(f"\n{name}: delay [ms] median, 95 %, matched filter; onset found before the true one")
    results = {}
    for label, grade, wave, longest in rows:
        found = delays(grade, wave, longest)
        noticed = np.isfinite(found[:, 0])
        delay = np.where(noticed, found[:, 0], np.inf)
        median, most = np.quantile(delay, [0.5, 0.95], method="higher") * 1e3
        early = float(np.mean(found[noticed, 1] >= 0.0)) if noticed.any() else np.nan
        lead = 1e3 * float(np.median(found[noticed, 1])) if noticed.any() else np.nan
        speed = 1e3 * float(np.nanquantile(found[:, 2], 0.95)) if noticed.any() else np.nan
        best = 1e3 * matched_filter_delay(grade, wave)
        print(
            f"{grade:10s} {label:18s} {median:8.0f} {most:8.0f} {best:8.0f}   noticed "
            f"{noticed.mean():6.1%}  onset covered {early:6.1%}, lead {lead:5.0f} ms, "
            f"speed missed {speed:.2f} mm/s"
        )
        results[f"{grade} {label}"] = {"median_ms": median, "p95_ms": most, "matched_ms": best,
                                       "noticed": float(noticed.mean()), "covered": early,
                                       "missed_mm_per_s": speed}  # fmt: skip
    return results


def day_of_rest(grade: str, hours: float, seed: int = 5) -> tuple[int, float]:
    """Return false switches, and seconds that the detector took for them."""
    read = rest(grade, seed)
    detector = MotionDetector(MotionConfig(), RATE_HZ, UNITS[grade])
    switches, spent, chunk = 0, 0.0, 200_000
    for first in range(0, round(hours * 3600 * RATE_HZ), chunk):
        omega, force = read(first, chunk)
        started = time.process_time()
        decisions = detector.push(first, omega, force)
        spent += time.process_time() - started
        switches += sum(d.state == MotionKind.MOVING for d in decisions)
    return switches, spent


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--hours", type=float, default=24.0)
    chosen = parser.parse_args()
    g = STANDARD_GRAVITY
    results: dict[str, object] = {}
    results["steps"] = table(
        "steps", [(f"{a:g} g", n, step(a * g), 3.0) for n in UNITS for a in AMPLITUDES_G]
    )
    results["cosines"] = table(
        "0.01 g cosines from the crest",
        [(f"{f:g} Hz", n, cosine(0.01 * g, f), 4.0)
         for n in UNITS for f in FREQUENCIES_HZ if f >= 0.5],
    )  # fmt: skip
    results["sines"] = table(
        "0.01 g sines from zero",
        [(f"{f:g} Hz", n, sine(0.01 * g, f), 6.0) for n in UNITS for f in FREQUENCIES_HZ],
    )
    results["slow"] = table(
        "0.002 g sines from zero",
        [(f"{f:g} Hz", n, sine(0.002 * g, f), 20.0)
         for n in UNITS for f in FREQUENCIES_HZ if f <= 0.5],
    )  # fmt: skip
    print()
    for name in UNITS:
        switches, spent = day_of_rest(name, chosen.hours)
        rate = chosen.hours * 3600 * RATE_HZ / spent
        print(f"{name:10s} {chosen.hours:g} h of rest: {switches} false switches, "
              f"{rate / 1e6:.2f}e6 samples/s")  # fmt: skip
        results[f"rest {name}"] = {"switches": switches, "samples_per_s": rate}
    if chosen.json:
        chosen.json.write_text(json.dumps(results, indent=2))


if __name__ == "__main__":
    main()
