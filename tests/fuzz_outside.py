"""What other programs and stations send, damaged: RTCM 3, RINEX of a base, bags of others."""

import tempfile
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

import numpy as np
import others_bags
from fuzz_targets import CLOCK, Target, targets

from deepseis_bringup.export.rtcm_msm import msm7
from deepseis_bringup.export.rtcm_station import reference_point
from deepseis_core.gps_time import GpsTime
from deepseis_core.rtcm_frame import Bits, Deframer, frame
from deepseis_core.sample_clock import SampleClock
from deepseis_frontend.base_events import Arcs, Row
from deepseis_frontend.base_rtklib import RtcmDecoder, rinex_events
from deepseis_frontend.imu_file import ImuFile
from deepseis_frontend.imu_open import open_imu

START = GpsTime(2400, 100_000 * 10**9)
AT_BASE = SampleClock(START.to_utc_ns(), 4e6)
BETWEEN = b"\0next\0"
"""Between the messages of a stream, whose frames are made anew: a checksum would tell all."""
SATELLITES = (("G03", 2.1e7), ("G08", 2.2e7), ("G17", 2.3e7), ("G31", 2.5e7))


def rtcm_messages() -> bytes:
    """Return a base's place and some epochs, without their frames."""
    arcs, stream = Arcs(), reference_point(7, np.array([-3959403.8, 3385705.9, 3667525.9]))
    for k in range(5):
        time = START.add_ns(k * 10**9)
        rows = [Row(name, r, r / 0.19029367, -1576.0, 45.0, 0) for name, r in SATELLITES]
        stream += msm7(7, arcs.epoch(time, AT_BASE.sample_at(time.to_utc_ns()), rows))
    return BETWEEN.join(whole[3:-3] for whole in Deframer().push(stream))


def read_rtcm(path: Path) -> None:
    """Decode messages whatever they say: each in a frame with a checksum that fits."""
    decoder = RtcmDecoder(AT_BASE)
    for part in path.read_bytes().split(BETWEEN):
        bits = Bits()
        for byte in part[:1023]:
            bits.unsigned(byte, 8)
        decoder.push(frame(bits))
    decoder.finish()
    decoder.close()


def line(text: str, label: str) -> str:
    return f"{text:60}{label}\n"


def rinex_observations(version: str) -> bytes:
    """Return a base's file of two epochs."""
    place = line(f"{4027893.1:14.4f}{307045.2:14.4f}{4919475.3:14.4f}", "APPROX POSITION XYZ")
    kind = f"{version:>9}{'':11}{'OBSERVATION DATA':20}G"
    row = "".join(f"{v:14.3f}  " for v in (21234563.123, 111580323.567, -1234.567, 45.0))
    head, names = line(kind, "RINEX VERSION / TYPE") + place, [name for name, _ in SATELLITES]
    if version < "3":
        head += line(f"{4:6d}    C1    L1    D1    S1", "# / TYPES OF OBSERV")
        epochs = [
            f" 22  1  1  2  0{s:11.7f}  0{4:3d}{''.join(names)}\n" + f"{row}\n" * 4 for s in (0, 1)
        ]
    else:
        head += line("G    4 C1C L1C D1C S1C", "SYS / # / OBS TYPES")
        epochs = [
            f"> 2022 01 01 02 00{s:11.7f}  0{4:3d}\n" + "".join(f"{name}{row}\n" for name in names)
            for s in (0, 1)
        ]
    return (head + line("", "END OF HEADER") + "".join(epochs)).encode()


@cache
def bag_of_others(kind: str) -> dict[str, bytes]:
    """Return the files of a bag by their names."""
    with tempfile.TemporaryDirectory() as folder:
        path = others_bags.write(kind, Path(folder))
        files = [path] if path.is_file() else sorted(path.iterdir())
        return {file.name: file.read_bytes() for file in files}


def read_bag_of_others(kind: str, damaged: str, path: Path) -> None:
    """Read a bag, one file of which is damaged."""
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "a"
        bag.mkdir()
        bag.with_name("a.yaml").write_text("stamp: end\n")
        for name, content in bag_of_others(kind).items():
            hurt = name.endswith(damaged)
            (bag / name).write_bytes(path.read_bytes() if hurt else content)
        single = bag / "a.bag"
        for _ in open_imu(single if single.exists() else bag, others_bags.CLOCK).samples():
            pass


def bag_target(name: str, kind: str, damaged: str) -> Target:
    (seed,) = (data for file, data in bag_of_others(kind).items() if file.endswith(damaged))
    return Target(name, (seed,), partial(read_bag_of_others, kind, damaged), ".bin")


LATCHES = [f"{200 * k},{4_000_000 * k}" for k in range(9)]
TRIGGERS = "\n".join(["# IMU count, IF sample", *LATCHES, ""]).encode()
COUNTED = """time: {column: n, unit: count, triggers: triggers.csv}
accelerometer: {columns: [ax, ay, az], unit: m/s^2}
gyroscope: {columns: [gx, gy, gz], unit: deg/s}
header_lines: 1
"""


def read_triggers(path: Path) -> None:
    """Put an IMU on the clock by pairs of counts."""
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "imu.csv"
        log.with_name("triggers.csv").write_bytes(path.read_bytes())
        log.with_name("imu.csv.yaml").write_text(COUNTED)
        rows = "".join(f"{k},0.1,0.0,9.8,0,0,0\n" for k in range(200))
        log.write_text("n,ax,ay,az,gx,gy,gz\n" + rows)
        for _ in ImuFile(log, CLOCK).samples():
            pass


def listed(read: Callable[[Path], object]) -> Callable[[Path], object]:
    """Return a reader that goes to the end of what a generator gives."""
    return lambda path: list(read(path))  # type: ignore[call-overload]


def all_targets() -> dict[str, Target]:
    """Return all readers by name, those of `fuzz_targets` too."""
    files = tuple(rinex_observations(version) for version in ("2.11", "3.05"))
    ours = (
        Target("rtcm", (rtcm_messages(),), read_rtcm, ".bin"),
        Target("base_rinex", files, listed(lambda path: rinex_events(path, AT_BASE)), ".22o"),
        Target("imu_triggers", (TRIGGERS,), read_triggers, ".csv"),
        bag_target("bag_ros1", "bag", ".bag"),
        bag_target("bag_sqlite", "db3", ".db3"),
        bag_target("bag_mcap", "mcap", ".mcap"),
        bag_target("bag_metadata", "db3", ".yaml"),
    )
    return targets() | {target.name: target for target in ours}
