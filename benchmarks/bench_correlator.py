"""Throughput of the correlator kernel: complex samples x channels a core-second.

Early, prompt and late at 8-bit I/Q, carrier wipe-off and choice of the code replica included, a
millisecond at a time as the channels do it. For comparison: PocketSDR's AVX2 kernel (mix + four
correlators) measured 2.17e9 on a machine of the same kind.

    ./deepseis python benchmarks/bench_correlator.py [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
from numba import njit

from deepseis_tracking.correlator import CARRIER_GROUP, correlate_period
from deepseis_tracking.replica import MARGIN, ReplicaBank

PEER = 2.17e9
REPEATS = 9


@njit(nogil=True)
def _periods(i, q, rows, chips_per_sample, offset, count, periods, cosine, sine, out):  # type: ignore[no-untyped-def]
    tap_rows, tap_columns = np.zeros(3, np.int64), np.zeros(3, np.int64)
    steps = rows.shape[0]
    code_phase, phase = 0.1, 0.0
    available = i.shape[0] // count
    for period in range(periods):
        step = round(code_phase / chips_per_sample * steps)
        for tap in range(3):
            tap_step = step + (1 - tap) * offset
            tap_rows[tap] = tap_step % steps
            tap_columns[tap] = MARGIN + tap_step // steps
        start = period % available * count
        correlate_period(
            i, q, start, count, rows, tap_rows, tap_columns, phase, 1e-3, cosine, sine, out
        )
        code_phase = (code_phase + 1e-4) % chips_per_sample
        phase += count * 1e-3


def measure(sample_rate_hz: float, dtype: type, periods: int = 4000) -> float:
    """Return complex samples a second, best of some runs (others share the machine)."""
    rng = np.random.default_rng(1)
    count = round(sample_rate_hz / 1000)
    i, q = (rng.integers(-40, 40, 20 * count).astype(dtype) for _ in range(2))
    bank = ReplicaBank("G07", sample_rate_hz)
    work = np.empty(CARRIER_GROUP, np.float32), np.empty(CARRIER_GROUP, np.float32)
    arguments = (i, q, bank.rows, bank.chips_per_sample, bank.tap_offset(0.5), count)
    out = np.zeros(6)
    _periods(*arguments, 10, *work, out)
    rates = []
    for _ in range(REPEATS):
        started = time.perf_counter()
        _periods(*arguments, periods, *work, out)
        rates.append(periods * count / (time.perf_counter() - started))
    rates.sort()
    print(
        f"{sample_rate_hz / 1e6:6.3f} MHz {np.dtype(dtype).name:5s}  "
        f"median {rates[REPEATS // 2] / 1e9:5.2f}e9  best {rates[-1] / 1e9:5.2f}e9 samples/s"
    )
    return rates[REPEATS // 2]


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    chosen = parser.parse_args()
    results = {
        f"{rate / 1e6:g}MHz_{np.dtype(kind).name}": measure(rate, kind)
        for rate in (4e6, 12e6, 24e6)
        for kind in (np.int8, np.int16)
    }
    print(f"4 MHz int8 against PocketSDR's 2.17e9: {results['4MHz_int8'] / PEER:.2f} x")
    if chosen.json:
        chosen.json.write_text(json.dumps(results, indent=2))


if __name__ == "__main__":
    main()
