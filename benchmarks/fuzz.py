"""Fuzzes every reader of outside input for a given time, and says what it found.

    ./deepseis python benchmarks/fuzz.py --minutes 30 [--seed 1] [reader ...]

Each failure is shrunk by hypothesis and printed with the bytes that cause it. Exit status 1 if
there was one.
"""

import argparse
import sys
import tempfile
import time
import traceback
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

from fuzz_outside import all_targets
from fuzz_targets import check, damaged, prepare
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import seed as seeded

ROUND = 500


def run_round(target, folder, seed, counts):
    """Run some hundred examples; returns what went wrong, or None."""
    last = [b""]

    @seeded(seed)
    @settings(
        max_examples=ROUND,
        deadline=None,
        database=None,
        phases=[Phase.generate, Phase.shrink],
        suppress_health_check=list(HealthCheck),
        print_blob=False,
        report_multiple_bugs=False,
    )
    @given(damaged(target))
    def holds(data):
        last[0] = data
        counts[target.name] += 1
        counts[target.name, "read"] += check(target, data, folder)

    try:
        holds()
    except Exception as error:
        places = traceback.extract_tb(error.__traceback__)
        ours = [f"{Path(p.filename).name}:{p.lineno}" for p in places if "deepseis_" in p.filename]
        return f"{type(error).__name__} at {ours[-1:]}: {str(error)[:200]}", last[0]
    return None


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("readers", nargs="*")
    options = parser.parse_args()
    chosen = {
        n: t for n, t in all_targets().items() if not options.readers or n in options.readers
    }
    counts, found = Counter(), {}
    began, seed = time.monotonic(), options.seed
    while time.monotonic() - began < 60 * options.minutes:
        for name, target in chosen.items():
            with tempfile.TemporaryDirectory() as folder:
                prepare(target, Path(folder))
                failure = run_round(target, Path(folder), seed, counts)
            key = (name, failure[0].partition("]")[0]) if failure else None
            if failure and key not in found:
                found[key] = failure[1]
                print(f"{name}: {failure[0]}\n    {failure[1][:400]!r}", flush=True)
        seed += 1
    for name in chosen:
        print(f"{name:16} {counts[name]:8d} examples, {counts[name, 'read']:8d} of them read")
    total = sum(counts[name] for name in chosen)
    print(f"{total} examples in {(time.monotonic() - began) / 60:.1f} min, {len(found)} failures")
    return bool(found)


if __name__ == "__main__":
    sys.exit(main())
