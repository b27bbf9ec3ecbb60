"""Throughput of IMU synthesis and of the mechanisation, one core.

A sample is one epoch of six axes; chunks of 10 s at 200 Hz, as the bench makes them. Figure of
merit: samples synthesised a second on a circle, goal 1e6.

    ./deepseis python benchmarks/bench_imu.py [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deepseis_core.rotation import flu_from_frd, ned_frd_from_enu_flu, quat_from_matrix
from deepseis_core.types import FloatArray
from deepseis_ins.strapdown import NavState, propagate
from deepseis_sim.imu import ImuSynthesizer
from deepseis_sim.motion import Kinematics, Motion
from deepseis_sim.motions import Circle, Still, Tilt
from deepseis_sim.site import Site
from deepseis_sim.uniform_spline import UniformSpline

GOAL = 1e6
RATE_HZ = 200.0
CHUNK = 2000
REPEATS = 9
SITE = Site([0.62, 2.44, 50.0])


@dataclass(frozen=True)
class Tabulated:
    """Translation along a spline, such as a recorded earthquake's."""

    spline: UniformSpline
    rotates: bool = False

    @property
    def span(self) -> tuple[float, float]:
        return self.spline.start, self.spline.end

    def at(self, time: FloatArray) -> Kinematics:
        return Kinematics(*self.spline.evaluate(time))


def motions() -> dict[str, Motion]:
    """Return what is timed, by name."""
    shaking = np.random.default_rng(1).normal(0.0, 1.0, (30_000, 3))
    return {
        "still": Still(),
        "circle": Circle(start=0.0, duration=1e4),
        "tabulated spline": Tabulated(UniformSpline.from_acceleration(0.0, 0.01, shaking)),
        "turning (tilt)": Tilt(pitch_deg=20.0, start=0.0, rise=1e4),
    }


def best_rate(work: Callable[[int], object], samples: int) -> float:
    """Return samples a second of processor time, best of some runs after one that compiles."""
    work(0)
    times = []
    for k in range(REPEATS):
        started = time.process_time()
        work(k)
        times.append(time.process_time() - started)
    return samples / min(times)


def synthesis_rate(motion: Motion) -> float:
    """Return samples a second, ten chunks at a time."""
    imu = ImuSynthesizer(motion, SITE, RATE_HZ)

    def work(k: int) -> None:
        for chunk in range(10 * k, 10 * k + 10):
            imu.increments(chunk * CHUNK, CHUNK)

    return best_rate(work, 10 * CHUNK)


def mechanisation_rate(seconds: int = 1000) -> float:
    """Return steps a second along a circle."""
    count = round(seconds * RATE_HZ)
    ideal = ImuSynthesizer(Circle(start=0.0, duration=1e4), SITE, RATE_HZ).increments(0, count)
    theta, vel = flu_from_frd(ideal.delta_theta), flu_from_frd(ideal.delta_vel)
    attitude = quat_from_matrix(ned_frd_from_enu_flu(np.eye(3)))
    latitude, longitude, height = SITE.origin_geodetic
    start = NavState(latitude, longitude, height, np.zeros(3), attitude)
    return best_rate(lambda _: propagate(start, theta, vel, ideal.dt), count)


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    chosen = parser.parse_args()
    results = {}
    for name, motion in motions().items():
        results[name] = synthesis_rate(motion)
        print(f"synthesis, {name:17s} {results[name] / 1e6:6.2f}e6 samples/s")
    results["mechanisation"] = mechanisation_rate()
    hour = 3600 * RATE_HZ / results["mechanisation"]
    print(f"mechanisation              {results['mechanisation'] / 1e6:6.2f}e6 steps/s", end="")
    print(f", an hour of {RATE_HZ:g} Hz in {hour:.2f} s")
    print(f"circle against the goal of 1e6: {results['circle'] / GOAL:.2f} x")
    if chosen.json:
        chosen.json.write_text(json.dumps(results, indent=2))


if __name__ == "__main__":
    main()
