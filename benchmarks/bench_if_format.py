"""Throughput of unpacking, of conversion to baseband and of recording, one thread.

Run: ./deepseis python benchmarks/bench_if_format.py
"""

import shutil
import tempfile
import time
from pathlib import Path

import numpy as np

from deepseis_bringup.bags.mcap_recording import BagWriter
from deepseis_bringup.bags.ros_definitions import Definitions
from deepseis_core.baseband import Baseband
from deepseis_core.if_format import IfFormat
from deepseis_core.types import IfBlock

FORMATS = [
    "real1",
    "iq1",
    "real2",
    "iq2",
    "real4",
    "iq4",
    "real8",
    "iq8",
    "iq8 coding=offset_binary",
    "real16",
    "iq16",
]
RATE = 4e6
BLOCK = 80_000  # samples in 20 ms


def best_rate(work, *arguments, repeats=30):
    """Million samples a second of the quickest run on one block."""
    times = []
    for _ in range(repeats):
        started = time.perf_counter()
        work(*arguments)
        times.append(time.perf_counter() - started)
    return BLOCK / min(times) / 1e6


def block_of(packing, frequency):
    rng = np.random.default_rng(0)
    parts = [rng.normal(0, packing.max_level / 4, BLOCK) for _ in range(2)]
    data = packing.pack(*(parts[:1] if packing.is_real else parts))
    return IfBlock(0, BLOCK, RATE, frequency, packing.to_text(), data)


def bench_formats():
    print(f"{'10^6 samples/s':28s} {'unpack':>8s} {'pack':>8s} {'IF 0':>8s} {'IF 1.1 MHz':>10s}")
    for text in FORMATS:
        packing = IfFormat.from_text(text)
        i = np.empty(BLOCK, packing.dtype)
        q = None if packing.is_real else np.empty(BLOCK, packing.dtype)
        block = block_of(packing, 0.0)
        rates = [best_rate(packing.unpack, block.data, i, q)]
        rates.append(best_rate(packing.pack, i, q))
        for frequency in (0.0, 1.1e6):
            given = block_of(packing, frequency)
            converter = Baseband.for_block(given)
            converter.convert(given)
            rates.append(best_rate(converter.convert, given))
        print(f"{text:28s} " + " ".join(f"{rate:8.0f}" for rate in rates))


def bench_recording(compression, bits_in_byte, seconds=20):
    """Write IF at 16 MB/s as fast as it goes: times real time, and processor time."""
    rng = np.random.default_rng(0)
    noise = rng.normal(0, 2.2 if bits_in_byte == 2 else 20, (50, 320_000))
    levels = np.clip(2 * np.floor(noise / 2) + 1, -3, 3) if bits_in_byte == 2 else noise
    blocks = [block.tobytes() for block in levels.astype(np.int8)]
    small = rng.bytes(400)
    folder = Path(tempfile.mkdtemp())
    definitions = Definitions({"a/msg/A": "uint8[] data\n"})
    started, cpu = time.perf_counter(), time.process_time()
    with BagWriter(folder / "bag", definitions=definitions, compression=compression) as bag:
        for k in range(50 * seconds):
            bag.write("/if/samples", "a/msg/A", blocks[k % 50], k * 20_000_000, 0)
            for _ in range(20):
                bag.write("/epochs", "a/msg/A", small, k * 20_000_000, 0)
    elapsed, cpu = time.perf_counter() - started, time.process_time() - cpu
    size = (folder / "bag" / "bag_0.mcap").stat().st_size
    shutil.rmtree(folder)
    print(
        f"record 16 MB/s, {bits_in_byte} bits in a byte, {compression:4s}: "
        f"{seconds / elapsed:5.1f} x real time, {100 * cpu / seconds:4.1f} % of a core at 1 x, "
        f"{size / seconds / 1e6:5.1f} MB/s on disk"
    )


if __name__ == "__main__":
    bench_formats()
    for bits in (2, 8):
        for kind in ("zstd", "none"):
            bench_recording(kind, bits)
