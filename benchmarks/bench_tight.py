"""An hour of 200 Hz IMU with ranges and range rates of ten satellites once a second, one core.

Twenty rows an epoch, worked in one by one with a gate each. Goal: below 3 s. The second figure is
with the Hatch filter and the selection of four satellites before it.

    ./deepseis python benchmarks/bench_tight.py [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np

from deepseis_core.constants import L1_HZ, NS_PER_S, SPEED_OF_LIGHT
from deepseis_core.ephemeris import pack, states_from_pseudoranges
from deepseis_core.gps_time import GpsTime
from deepseis_core.hatch import HatchConfig, new_state, smooth
from deepseis_core.imu_grades import grade_named
from deepseis_core.propagation import line_of_sight
from deepseis_core.rotation import flu_from_frd, ned_frd_from_enu_flu, quat_from_matrix
from deepseis_core.selection import HIGHEST, select
from deepseis_core.types import FloatArray
from deepseis_ins.loose import LooseConfig
from deepseis_ins.strapdown import NavState
from deepseis_ins.tight import Ranges, TightConfig, TightFilter
from deepseis_sim.imu import ImuSynthesizer
from deepseis_sim.motions import Circle
from deepseis_sim.site import Site
from deepseis_sim.sky import broadcast_ephemerides

GOAL = 3.0
SECONDS, RATE, SATELLITES, REPEATS = 3600, 200, 10, 3
SITE = Site([0.62, 2.44, 50.0])
START = GpsTime(2399, 415258 * NS_PER_S)


def new_filter() -> TightFilter:
    """Return a filter at the site's origin."""
    attitude = quat_from_matrix(ned_frd_from_enu_flu(np.eye(3)))
    latitude, longitude, height = SITE.origin_geodetic
    return TightFilter(
        LooseConfig(),
        grade_named("span-fsas"),
        NavState(latitude, longitude, height, np.zeros(3), attitude),
        tight=TightConfig(troposphere=False),
        lever_arm_b=[0.1, -0.2, -0.5],
        attitude_sd=[1e-3] * 3,
        position_sd=[1.0] * 3,
        velocity_sd=[0.01] * 3,
    )


def epochs(seconds: int) -> list[Ranges]:
    """Return ranges of the highest satellites over the site, noisy."""
    packed, rng = pack(broadcast_ephemerides("", START)), np.random.default_rng(1)
    here = np.hstack([SITE.origin_ecef, np.zeros(3)])
    sight = line_of_sight(packed, START.week, START.tow_ns, here)
    packed = packed[np.argsort(-sight.elevation)[:SATELLITES]]
    noise, out = (np.full(SATELLITES, 1.0), np.full(SATELLITES, 0.05)), []
    for second in range(1, seconds + 1):
        ns = START.tow_ns + second * NS_PER_S
        sight = line_of_sight(packed, START.week, ns, here)
        ranges = sight.range - SPEED_OF_LIGHT * sight.satellite_clock
        states = states_from_pseudoranges(packed, START.week, ns, ranges)
        measured = ranges + noise[0] * rng.standard_normal(SATELLITES)
        rates = -SPEED_OF_LIGHT / L1_HZ * sight.doppler_hz
        rates += noise[1] * rng.standard_normal(SATELLITES)
        out.append(Ranges(states, measured, rates, *noise))
    return out


def run(
    increments: tuple[FloatArray, FloatArray], seen: list[Ranges], *, smoothed: bool = False
) -> float:
    """Return the processor time of a run [s]."""
    theta, vel = increments
    tight, state, unit = new_filter(), new_state(SATELLITES), np.empty((1, SATELLITES, 3))
    up, unbroken = SITE.C_e_enu.T[2], np.zeros((1, SATELLITES), np.bool_)
    begin = time.process_time()
    for second, epoch in enumerate(seen):
        rows = slice(RATE * second, RATE * (second + 1))
        tight.propagate(theta[rows], vel[rows], 1.0 / RATE)
        if smoothed:
            code = epoch.pseudorange[None]
            got = smooth(code, code, unbroken, HatchConfig(), state=state)
            unit[0] = SITE.origin_ecef - epoch.satellites[:, :3]
            unit /= np.linalg.norm(unit, axis=2)[..., None]
            taken = select(unit, np.arcsin(-unit @ up), HIGHEST).chosen[0]
            epoch = Ranges(
                epoch.satellites[taken], got.pseudorange[0, taken], epoch.range_rate[taken],
                epoch.pseudorange_sd[taken], epoch.range_rate_sd[taken],
            )  # fmt: skip
        tight.update_ranges(epoch)
    return time.process_time() - begin


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    chosen = parser.parse_args()
    imu = ImuSynthesizer(Circle(start=SECONDS + 1.0, duration=1.0), SITE, float(RATE))
    ideal, seen = imu.increments(0, RATE * SECONDS), epochs(SECONDS)
    increments = flu_from_frd(ideal.delta_theta), flu_from_frd(ideal.delta_vel)
    for smoothed in (False, True):
        run(increments, seen[:3], smoothed=smoothed)  # compiles
    hour = min(run(increments, seen) for _ in range(REPEATS))
    whole = min(run(increments, seen, smoothed=True) for _ in range(REPEATS))
    what = f"an hour of {RATE} Hz IMU, {SATELLITES} satellites at 1 Hz"
    print(f"{what}: {hour:.2f} s, goal {GOAL:g} s")
    print(f"the same with smoothing, four selected:  {whole:.2f} s")
    if chosen.json:
        figures = {"hour": hour, "hour smoothed, selected": whole}
        chosen.json.write_text(json.dumps(figures, indent=2))


if __name__ == "__main__":
    main()
