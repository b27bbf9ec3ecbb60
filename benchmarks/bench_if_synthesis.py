"""Speed of the IF synthesis: seconds of signal per second of one core.

    python benchmarks/bench_if_synthesis.py [--json FILE]

The work: 10 satellites with Gaussian noise, quantised and packed, phases laid out from orbits. The
best of five runs is reported, in processor time: other load on the machine does not count as ours.
"""

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from deepseis_core.geodesy import ecef_from_geodetic
from deepseis_core.gps_time import GpsTime
from deepseis_core.if_format import IfFormat
from deepseis_sim.if_synthesis import IfSynthesizer
from deepseis_sim.jammer import JammerConfig
from deepseis_sim.multipath import MultipathConfig
from deepseis_sim.nominal_constellation import nominal_constellation
from deepseis_sim.recording import FrontEnd, IfStream, truth_rows
from deepseis_sim.signal_model import SignalModel, still
from deepseis_sim.sky import Sky, SkyConfig

GOAL = 10.0
RUNS = 5
RATE_HZ = 4.0e6
FAST_HZ = 20.0e6
SECONDS = 1.0
SATELLITES = 10
FORMATS = ("iq2", "iq4", "iq8", "iq16", "real2", "real16")
START = GpsTime(2399, 415258 * 10**9)
PLACE = ecef_from_geodetic([np.deg2rad(38.7292), np.deg2rad(141.0217), 40.0])


def best_of(work: Callable[[], object]) -> float:
    """Return the least processor time of some runs, after one that compiles."""
    work()
    times = []
    for _ in range(RUNS):
        begin = time.process_time()
        work()
        times.append(time.process_time() - begin)
    return min(times)


def model_of(count: int) -> SignalModel:
    antenna = still(PLACE)
    sky = Sky(SkyConfig(satellites=count), nominal_constellation(START), START, antenna, SECONDS)
    assert len(sky.satellites) == count
    return SignalModel(sky.satellites, START, antenna, cn0=sky.cn0_dbhz)


def packed(model: SignalModel, text: str, rate_hz: float, **air: object) -> float:
    """Return the speed of all that makes a recording's bytes."""
    intermediate_hz = rate_hz / 4.0 if text.startswith("real") else 0.0
    stream = IfStream(model, FrontEnd(IfFormat.from_text(text), rate_hz, intermediate_hz), **air)
    count, chunk = int(SECONDS * rate_hz), int(0.2 * rate_hz)

    def work() -> None:
        for start in range(0, count, chunk):
            stream.packed(start, chunk)

    return SECONDS / best_of(work)


def kernel(model: SignalModel, *, noise: bool = True, satellites: bool = True) -> float:
    synthesizer = IfSynthesizer(
        IfFormat.from_text("iq2"), RATE_HZ, 0.0, model.signal_prn(), noise=noise
    )
    span = synthesizer.segment_span
    segments = model.segments(0, int(SECONDS / span) + 1, span)
    if not satellites:
        segments.cn0_dbhz[:] = -np.inf
    count = int(SECONDS * RATE_HZ)
    return SECONDS / best_of(lambda: synthesizer.levels(segments, 0, count))


def measure() -> dict[str, float]:
    ten, twelve = model_of(SATELLITES), model_of(12)
    results = {}
    for rate in (RATE_HZ, FAST_HZ):
        for text in FORMATS:
            name = f"packed, 10 satellites + noise, {text}, {rate / 1e6:g} MHz"
            results[name] = packed(ten, text, rate)
    results["packed, 12 satellites + noise, iq4, 4 MHz"] = packed(twelve, "iq4", RATE_HZ)
    for name, air in {
        "a following gain": {"agc_s": 0.1},
        "a CW jammer": {"jammers": [JammerConfig()]},
        "a jammer of 1 MHz": {"jammers": [JammerConfig(kind="band")]},
        "a reflection each": {"multipath": MultipathConfig()},
    }.items():
        results[f"the same with {name}"] = packed(twelve, "iq4", RATE_HZ, **air)
    results["kernel alone, 10 satellites + noise"] = kernel(ten)
    results["kernel alone, 10 satellites, no noise"] = kernel(ten, noise=False)
    results["kernel alone, noise"] = kernel(ten, satellites=False)
    layout = best_of(lambda: ten.segments(0, 100, 0.01))
    results["phases and data of 10 satellites"] = SECONDS / layout
    for rate in (100, 1000):
        rows = best_of(lambda rate=rate: truth_rows(twelve, np.arange(rate) / rate))
        results[f"truth of 12 satellites, {rate} Hz"] = SECONDS / rows
    return results


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, help="file for the numbers")
    arguments = parser.parse_args()
    results = measure()
    print("IF synthesis, x real time on one core")
    for name, factor in results.items():
        print(f"  {name:52} {factor:9.1f}")
    slowest = min(value for name, value in results.items() if "10" in name and ", 4 MHz" in name)
    print(f"  goal at 4 MHz: {GOAL:g} x real time: {'met' if slowest >= GOAL else 'missed'}")
    table = {"benchmark": "if_synthesis", "unit": "x real time, one core", "results": results}
    text = json.dumps(table, indent=2)
    if arguments.json:
        arguments.json.write_text(text + "\n", encoding="utf-8")
    else:
        print(text)


if __name__ == "__main__":
    main()
