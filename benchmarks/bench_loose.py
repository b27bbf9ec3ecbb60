"""An hour of 200 Hz IMU with GNSS once a second through the loosely coupled filter, one core.

Position and velocity are two updates. Goal: below 2 s. The second figure is what one pays who
hands over one sample at a time, as a node in real time does.

    ./deepseis python benchmarks/bench_loose.py [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np

from deepseis_core.geodesy import ecef_from_geodetic
from deepseis_core.imu_grades import grade_named
from deepseis_core.rotation import flu_from_frd, ned_frd_from_enu_flu, quat_from_matrix
from deepseis_ins.loose import LooseConfig, LooseFilter
from deepseis_ins.measurements import gnss_position, gnss_velocity
from deepseis_ins.strapdown import NavState
from deepseis_sim.imu import ImuSynthesizer
from deepseis_sim.motions import Circle
from deepseis_sim.site import Site

GOAL = 2.0
SECONDS = 3600
RATE = 200
REPEATS = 3
SITE = Site([0.62, 2.44, 50.0])
LEVER = np.array([0.1, -0.2, -0.5])


def new_filter() -> LooseFilter:
    """Return a filter at the site's origin."""
    attitude = quat_from_matrix(ned_frd_from_enu_flu(np.eye(3)))
    latitude, longitude, height = SITE.origin_geodetic
    start = NavState(latitude, longitude, height, np.zeros(3), attitude)
    return LooseFilter(
        LooseConfig(),
        grade_named("span-fsas"),
        start,
        attitude_sd=[1e-3] * 3,
        position_sd=[1.0] * 3,
        velocity_sd=[0.01] * 3,
    )


def run(seconds: int, *, chunk: int) -> float:
    """Return the processor time of a run in chunks of so many samples [s]."""
    imu = ImuSynthesizer(Circle(start=0.0, duration=1e4), SITE, float(RATE))
    ideal = imu.increments(0, RATE * seconds)
    theta, vel = flu_from_frd(ideal.delta_theta), flu_from_frd(ideal.delta_vel)
    station, error = np.eye(3), ecef_from_geodetic(SITE.origin_geodetic)
    loose, begin = new_filter(), time.process_time()
    for second in range(seconds):
        for first in range(RATE * second, RATE * (second + 1), chunk):
            loose.propagate(theta[first : first + chunk], vel[first : first + chunk], ideal.dt)
        loose.update(gnss_position(loose.nav, error, station, LEVER))
        loose.update(gnss_velocity(loose.nav, loose.omega_ib_b, np.zeros(3), 9.0 * station, LEVER))
    return time.process_time() - begin


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    chosen = parser.parse_args()
    run(2, chunk=RATE)  # compiles
    hour = min(run(SECONDS, chunk=RATE) for _ in range(REPEATS))
    single = min(run(SECONDS // 60, chunk=1) for _ in range(REPEATS)) * 60
    print(f"an hour of {RATE} Hz IMU, updates at 1 Hz: {hour:.2f} s, goal {GOAL:g} s")
    print(f"the same sample by sample:             {single:.2f} s")
    if chosen.json:
        chosen.json.write_text(json.dumps({"hour": hour, "hour by samples": single}, indent=2))


if __name__ == "__main__":
    main()
