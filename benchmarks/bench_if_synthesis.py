"""Speed of the IF synthesis: seconds of signal per second of one core.

    python benchmarks/bench_if_synthesis.py [--json FILE]

The work: 10 satellites at 4 MHz complex with Gaussian noise. The best of
five runs is reported, in processor time: other load on the machine does not count as ours.
"""

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from deepseis_core.if_format import IfFormat
from deepseis_sim.if_synthesis import IfSynthesizer
from deepseis_sim.scenario import StillConfig, simulate_still, still_model
from deepseis_sim.signal_model import SignalModel

GOAL = 10.0
RUNS = 5
RATE_HZ = 4.0e6
SECONDS = 1.0
SATELLITES = 10


def best_of(work: Callable[[], object]) -> float:
    """Return the least processor time of some runs, after one that compiles."""
    work()
    times = []
    for _ in range(RUNS):
        begin = time.process_time()
        work()
        times.append(time.process_time() - begin)
    return min(times)


def ten_satellites() -> SignalModel:
    config = StillConfig(elevation_mask_deg=0.0)
    model = still_model(config)
    return SignalModel(
        model.satellites[:SATELLITES], model.start, model.antenna, clock=model.clock
    )


def measure() -> dict[str, float]:
    model = ten_satellites()
    prn = [item.prn for item in model.satellites]
    assert len(prn) == SATELLITES
    results = {}
    count = int(SECONDS * RATE_HZ)

    def synthesise(text: str, *, noise: bool = True, satellites: bool = True) -> float:
        synthesizer = IfSynthesizer(IfFormat.from_text(text), RATE_HZ, 0.0, prn, noise=noise)
        span = synthesizer.segment_samples / RATE_HZ
        segments = model.segments(0, int(SECONDS / span) + 1, span)
        if not satellites:
            segments.cn0_dbhz[:] = -np.inf
        return SECONDS / best_of(lambda: synthesizer.levels(segments, 0, count))

    results["kernel, 10 satellites + noise, 2-bit levels"] = synthesise("iq2")
    results["kernel, 10 satellites + noise, 8-bit levels"] = synthesise("iq8")
    results["kernel, 10 satellites, no noise"] = synthesise("iq2", noise=False)
    results["kernel, noise alone"] = synthesise("iq2", satellites=False)
    results["phases and data of 10 satellites"] = SECONDS / best_of(
        lambda: model.segments(0, 100, 0.01)
    )
    config = StillConfig(duration=2.0)
    with tempfile.TemporaryDirectory() as folder:
        for text in ("iq2", "iq8"):
            case = StillConfig(duration=config.duration, if_format=text)
            seconds = best_of(lambda case=case: simulate_still(case, folder))
            results[f"files of the demo's sky (9 satellites), {text}"] = case.duration / seconds
    return results


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, help="file for the numbers")
    arguments = parser.parse_args()
    results = measure()
    print(f"IF synthesis at {RATE_HZ / 1e6:g} MHz complex, x real time on one core")
    for name, factor in results.items():
        print(f"  {name:52} {factor:9.1f}")
    met = results["kernel, 10 satellites + noise, 2-bit levels"] >= GOAL
    print(f"  goal: {GOAL:g} x real time with noise: {'met' if met else 'missed'}")
    table = {"benchmark": "if_synthesis", "unit": "x real time, one core", "results": results}
    text = json.dumps(table, indent=2)
    if arguments.json:
        arguments.json.write_text(text + "\n", encoding="utf-8")
    else:
        print(text)


if __name__ == "__main__":
    main()
