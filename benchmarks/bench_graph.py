"""Real-time factor of the whole graph over DDS: 7 satellites, 4 MHz 8-bit I/Q, 50 Hz observables.

GNSS-SDR does 6.9 on such work in one process on a machine of the same kind. The signal is made
first (not timed); a run is timed from the first block to the end of the last node.

    ./deepseis python benchmarks/bench_graph.py [--seconds S] [--runs N] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

from deepseis_bringup import runs
from deepseis_sim.still_recording import StillConfig, simulate_still


def measure(recording: Any, satellites: tuple[str, ...], record: bool, count: int) -> list[float]:
    """Return the real-time factors of some runs."""
    factors = []
    for _ in range(count):
        with tempfile.TemporaryDirectory() as folder:
            options = runs.RunOptions(satellites=satellites, record=record)
            selection = runs.Selection(str(recording.if_path))
            figures = runs.run_recording(selection, Path(folder), options, progress=False)
            factors.append(float(figures["real_time_factor"]))
    return factors


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--satellites", type=int, default=7)
    parser.add_argument("--json", type=Path)
    chosen = parser.parse_args()
    results: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        config = replace(StillConfig(), duration=chosen.seconds, if_format="iq8")
        recording = simulate_still(config, folder)
        satellites = tuple(recording.satellites[: chosen.satellites])
        for name, record in (("without recorder", False), ("with recorder (IF too)", True)):
            factors = measure(recording, satellites, record, chosen.runs)
            results[name] = factors
            text = ", ".join(f"{factor:.2f}" for factor in factors)
            print(f"{name}: median {statistics.median(factors):.2f} x real time ({text})")
    if chosen.json:
        chosen.json.write_text(json.dumps(results, indent=2))


if __name__ == "__main__":
    main()
