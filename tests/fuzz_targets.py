"""Everything that reads what others wrote, with whole examples to damage; and the one property.

A reader of outside input either reads or raises `InputError` with one clear line. Nothing else:
no other exception, no hang (measured in processor time), no file of its own left behind.
"""

import contextlib
import json
import re
import signal
import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from itertools import islice
from pathlib import Path

import numpy as np
from hypothesis import strategies as st
from mcap.opcode import Opcode

from deepseis_bringup.bags.info import bag_info
from deepseis_bringup.bags.mcap_file import McapFile
from deepseis_bringup.bags.mcap_recording import read_messages
from deepseis_bringup.bags.recovery import recover_bag
from deepseis_bringup.bags.run_records import recorded_run
from deepseis_bringup.base import has_base, rinex_position
from deepseis_bringup.inertial import has_imu
from deepseis_bringup.station_config import read_station_config
from deepseis_bringup.survey.gravimetry_files import read_installation
from deepseis_core.errors import InputError
from deepseis_core.geodesy import ecef_from_text
from deepseis_core.if_format import PRESETS, IfFormat
from deepseis_core.imu_message import encode_imu
from deepseis_core.interface import INTERFACE_VERSION
from deepseis_core.mcap_scan import McapScan
from deepseis_core.rinex_nav import read_rinex_nav
from deepseis_core.sample_clock import SampleClock, utc_ns_from_iso
from deepseis_core.types import ImuSample
from deepseis_frontend.if_bag import FIELDS, IfBag, bag_files
from deepseis_frontend.if_descriptor import read_descriptor
from deepseis_frontend.if_file import open_if_file
from deepseis_frontend.imu_bag import ImuBag
from deepseis_frontend.imu_file import ImuFile
from deepseis_sim.accelerogram import read_accelerogram
from deepseis_sim.scenario import FOLDER, load_scenario

PROCESSOR_S = 20.0
"""Longer than any of these small files takes, ten times over [s of processor time]."""
LONGEST_LINE = 1200
CLOCK = SampleClock(10**18, 4e6)
IF_TYPE, IMU_TYPE = "deepseis_msgs/msg/IfBlock", "sensor_msgs/msg/Imu"


class HangError(Exception):
    """A reader took too long."""


@dataclass(frozen=True)
class Target:
    """One reader: examples that it reads, and how to call it on a file."""

    name: str
    seeds: tuple[bytes, ...]
    read: Callable[[Path], object]
    suffix: str = ".txt"
    keeps: bool = True
    """The file itself is left as it was."""


def check(target: Target, data: bytes, folder: Path) -> bool:
    """Run one example; returns whether it was read, raises where the property does not hold."""
    path = folder / f"input{target.suffix}"
    path.write_bytes(data)
    before = set(folder.iterdir())
    read = True
    try:
        with processor_limit(PROCESSOR_S):
            target.read(path)
    except InputError as error:
        read = False
        line = str(error)
        assert line.splitlines() == [line], f"not one line: {line!r}"
        assert len(line) < LONGEST_LINE, f"no clear line: {len(line)} characters"
    left = {item.name for item in set(folder.iterdir()) ^ before}
    assert not left, f"left behind: {left}"
    if target.keeps:
        assert path.read_bytes() == data, "the input was changed"
    return read


@contextlib.contextmanager
def processor_limit(seconds: float):
    """Raise `HangError` after so much processor time: a loaded machine does not matter."""

    def on_signal(_number, _frame):
        raise HangError(f"more than {seconds:g} s of processor time")

    before = signal.signal(signal.SIGPROF, on_signal)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


# --- Damage ----------------------------------------------------------------------------------

WORDS = tuple(
    text.encode()
    for text in (
        *("", "0", "-1", "nan", "inf", "-inf", "1e400", "1e308", "1e-320", "9" * 25, "4294967296"),
        *("-9223372036854775809", "0x10", "1_0", "٣", "²", "1.5", "1e2", "\n", "\r", "\t", " "),
        *("\0", "\x85", "\u2028", "é", "\ud7ff", "\U0001f600", ",", ";", ":", ": ", "- ", "#"),
        *(
            "[]",
            "{}",
            "[",
            "{",
            "}",
            "]",
            '"',
            "'",
            "&a [*a]",
            "*a",
            "<<: ",
            "!!binary a",
            "!!x y",
        ),
        *("~", "null", "true", "[1, 2]", "{a: 1}", "2021-99-99", "2021-02-03", "0001-01-01"),
        *("9999-12-31T23:59:59+23:59", "0001-01-01T00:00:00+14:00", "1:2:3", "G99", "../x"),
        *("[" * 2000, "{a: " * 500, "9" * 5000, "x" * 3000, "a\n" * 50),
        "a: &a [x,x,x,x,x,x,x,x,x]\nb: &b [*a,*a,*a,*a,*a,*a,*a,*a,*a]\n"
        "c: &c [*b,*b,*b,*b,*b,*b,*b,*b,*b]\nd: &d [*c,*c,*c,*c,*c,*c,*c,*c,*c]\n"
        "e: &e [*d,*d,*d,*d,*d,*d,*d,*d,*d]\nf: &f [*e,*e,*e,*e,*e,*e,*e,*e,*e]\n"
        "station: &g [*f,*f,*f,*f,*f,*f,*f,*f,*f]\n",
    )
)
TOKENS = (
    *WORDS,
    b"\xff\xff\xff\xff\xff\xff\xff\xff",
    b"\xff",
    b"\x80",
    b"\x00\x00\x00\x80",
    bytes(64),
)
KINDS = ("cut", "tail", "flip", "insert", "delete", "number", "value", "repeat", "swap", "word")
NUMBER = re.compile(rb"[-+]?\d[\d.]*(?:[eEdD][-+]?\d+)?")
VALUE = re.compile(rb"(?<=[:=])[ \t]*[^\n,}\]]+")
WORD = re.compile(rb"[A-Za-z_]\w*")


def edit(data: bytes, change: tuple[str, float, int, bytes]) -> bytes:
    """Damage bytes once: what, where (as a share), how much, and with what."""
    kind, place, size, token = change
    at = min(int(place * len(data)), max(len(data) - 1, 0))
    if kind == "cut":
        return data[:at]
    if kind == "tail":
        return data + token * (1 + size % 3)
    if kind == "flip":
        return data[:at] + bytes(b ^ (size or 1) for b in data[at : at + 1]) + data[at + 1 :]
    if kind == "insert":
        return data[:at] + token + data[at:]
    if kind == "delete":
        return data[:at] + data[at + 1 + size :]
    if kind == "repeat":
        return data[:at] + data[at : at + 1 + size] * 3 + data[at + 1 + size :]
    if kind == "swap":
        lines = data.split(b"\n")
        one, other = int(place * (len(lines) - 1)), size % len(lines)
        lines[one], lines[other] = lines[other], lines[one]
        return b"\n".join(lines)
    pattern = {"number": NUMBER, "value": VALUE, "word": WORD}[kind]
    found = list(pattern.finditer(data))
    if not found:
        return data + token
    match = found[min(int(place * len(found)), len(found) - 1)]
    return data[: match.start()] + token + data[match.end() :]


CHANGES = st.lists(
    st.tuples(
        st.sampled_from(KINDS),
        st.floats(0.0, 1.0),
        st.integers(0, 255),
        st.sampled_from(TOKENS) | st.binary(max_size=12),
    ),
    min_size=1,
    max_size=6,
)


def damaged(target: Target) -> st.SearchStrategy[bytes]:
    """Return the strategy for a target's input: an example, damaged a few times; or noise."""

    def apply(seed: bytes, changes: list[tuple[str, float, int, bytes]]) -> bytes:
        for change in changes:
            seed = edit(seed, change)
        return seed[: 1 << 20]

    whole = st.builds(apply, st.sampled_from(target.seeds), CHANGES)
    return whole | whole | whole | st.binary(max_size=200)


# --- Text ------------------------------------------------------------------------------------

DESCRIPTOR = b"""format: iq8
sample_rate_hz: 4.0e6               # [Hz]
intermediate_frequency_hz: 0.0      # [Hz]
start_utc: 2021-12-02T08:47:00Z
header_bytes: 4
check_levels: true
"""
STATION = b"""station: DSEI
source: {file: a.bin, format: iq8, sample_rate_hz: 4.0e6, start_utc: 2021-12-02T08:47:00Z,
  start_s: 0.0, length_s: 1.0, pace: 1.0, window_blocks: 32}
satellites: [G01, G05]
mode: realtime
one_process: true
record: true
record_if: false
imu:
  file: imu.csv
  grade: span-fsas
  monument_ecef: [4000000.0, 1.0, 2.0]
  orientation_xyzw: [0.0, 0.0, 0.0, 1.0]
parameters:
  tracker: {pll_order: 2, pll_bandwidth_hz: 15.0}
  pvt: {nav_file: a.nav, rate_hz: 50}
"""
IMU_YAML = b"""accelerometer: {columns: [ax, ay, az], unit: m/s^2}
gyroscope: {columns: [gx, gy, gz], unit: deg/s}
time: {column: t, unit: s, zero_utc: "2001-09-09T01:46:40Z"}
axes: [x, -y, -z]
stamp: end
header_lines: 1
delimiter: ","
installation: {grade: fog, monument_ecef: [4e6, 1, 2], orientation_xyzw: [0, 0, 0, 1]}
"""
IMU_CSV = ("t,ax,ay,az,gx,gy,gz\n" + "".join(
    f"{k / 200},0.1,0.2,9.8,0.01,{k},0.03\n" for k in range(1, 30)
)).encode()  # fmt: skip
NAV_RECORD = b"""G02 2022 01 01 00 00 00-0.647393986583E-03-0.113686837722E-11 0.000000000000E+00
     0.410000000000E+02-0.142718750000E+03 0.455626121514E-08-0.453245129719E+00
    -0.748783349991E-05 0.206388905644E-01 0.423192977905E-05 0.515366817474E+04
     0.518400000000E+06-0.258907675743E-06-0.112496293255E+01 0.122934579849E-06
     0.964744088915E+00 0.303625000000E+03-0.146476911829E+01-0.868964767299E-08
    -0.262153776900E-09 0.100000000000E+01 0.219000000000E+04 0.000000000000E+00
     0.200000000000E+01 0.000000000000E+00-0.176951289177E-07 0.410000000000E+02
     0.512376000000E+06 0.400000000000E+01
"""


def nav(version: str, head: bytes = b"") -> bytes:
    kind = (
        f"{version:>9}{'':11}{'N: GNSS NAV DATA':20}{'G: GPS':20}RINEX VERSION / TYPE\n".encode()
    )
    leap = f"{18:6d}{'':54}LEAP SECONDS\n{'':60}END OF HEADER\n".encode()
    iono = (
        b"GPSA   1.1180E-08 -7.4510E-09 -5.9600E-08  1.1920E-07".ljust(60) + b"IONOSPHERIC CORR\n"
    )
    utc = b"GPUT  2.7939677238E-09 7.993605777E-15 147456 2191".ljust(60) + b"TIME SYSTEM CORR\n"
    return kind + iono + utc + leap + head + NAV_RECORD


NAV_2 = (
    (f"{2:6d}{'':14}{'NAVIGATION DATA':40}RINEX VERSION / TYPE\n{'':60}END OF HEADER\n").encode()
    + b" 2 22  1  1  0  0  0.0"
    + b"\n".join(line[1:] if k else line[23:] for k, line in enumerate(NAV_RECORD.split(b"\n")))
)
OBS = (
    f"{3.05:9.2f}{'':11}{'OBSERVATION DATA':20}{'G':20}RINEX VERSION / TYPE\n"
    f"{4027893.1:14.4f}{307045.2:14.4f}{4919475.3:14.4f}{'':18}APPROX POSITION XYZ\n"
    f"{'':60}END OF HEADER\n"
).encode()
GRAVITY = json.dumps({
    "roll_pitch_yaw_deg": [0.1, 0.2, 0.3], "scale": 1.001,
    "lever_arm_flu_m": [1.0, 0.0, -0.5], "sd_scale_pitch_yaw": [1e-4, 1e-5, 1e-5],
}).encode()  # fmt: skip


def read_text(parse: Callable[[str], object], path: Path) -> None:
    parse(path.read_bytes().decode("latin-1"))


def read_if_descriptor(path: Path) -> None:
    """Read a recording beside the descriptor, with what the descriptor says of it."""
    recording = path.with_name(path.name.removesuffix(".yaml"))
    read_descriptor(recording)
    for block in islice(open_if_file(recording).blocks(), 20):
        assert block.data.size


def read_imu(path: Path) -> None:
    data = path if path.suffix == ".csv" else path.with_name(path.name.removesuffix(".yaml"))
    for sample in ImuFile(data, CLOCK).samples():
        assert np.isfinite(sample.linear_acceleration).all()


def read_quake(path: Path) -> None:
    record = read_accelerogram(path, scale=1e-6)
    assert np.isfinite(record.acceleration).all()
    assert record.rate_hz > 0


# --- Bags ------------------------------------------------------------------------------------


def if_payload(k: int = 0, count: int = 8) -> bytes:
    """Return the bytes of an ``IfBlock``."""
    index = k * count
    text = b"iq8\0"
    head = struct.pack("<4siII1s3x", b"\0\1\0\0", 10**9, 0, 1, b"\0")
    head += bytes((4 - len(head)) % 8)
    head += struct.pack("<qI4xddI", index, count, 4e6, 0.0, len(text)) + text
    return head + struct.pack("<I", 2 * count) + bytes(range(2 * count))


def imu_payload(k: int = 1) -> bytes:
    values = np.array([0.0, 0.1, 0.2]), np.array([0.1, 0.2, 9.8])
    return encode_imu(ImuSample(0, *values, 1e-6, 1e-4), CLOCK.start_utc_ns + k * 5_000_000)


SCHEMA = "\n".join(FIELDS).encode()
TOPICS = {
    "/if/samples": (IF_TYPE, SCHEMA, if_payload),
    "/imu/data_raw": (IMU_TYPE, b"", imu_payload),
    "/station": ("deepseis_msgs/msg/Station", b"", lambda _: station_payload()),
    "/base/observations": ("deepseis_msgs/msg/Observations", b"", lambda k: base_payload(k)),
}


@cache
def station_payload() -> bytes:
    from deepseis_core.ros import codecs
    from deepseis_core.types import Station

    zeros = np.zeros(3)
    station = Station("A", "XX", zeros + 4e6, zeros, zeros, np.zeros(4), imu="fog")
    return bytes(codecs.STATION.encode(station, CLOCK.start_utc_ns))


@cache
def base_payload(k: int) -> bytes:
    from deepseis_core.ros.cdr import encode_message
    from deepseis_msgs.msg import Observations

    epoch = Observations(sample_index=100 * k, satellites=["G01", "G02"])
    return bytes(encode_message(epoch))


def make_bag(path: Path, payloads: dict[str, list[bytes]], records=None, schema=SCHEMA) -> None:
    """Write an MCAP file with right checksums around whatever the messages hold."""
    path.unlink(missing_ok=True)
    file = McapFile(path, flush_interval=1e6)
    for name, values in (records or RECORDS).items():
        file.add_metadata(name, values)
    for topic, messages in payloads.items():
        type_name, own, _ = TOPICS[topic]
        number = file.add_channel(topic, type_name, schema if own else own, {})
        for k, data in enumerate(messages):
            file.write(number, 10**18 + k, 10**18 + k, data)
    file.close()


RECORDS = {
    "deepseis": {"interface_version": INTERFACE_VERSION},
    "run": {"satellites": "G01", "parameters": json.dumps({"tracker": {"pll_order": 2}})},
}


def read_payload(topic: str, path: Path) -> None:
    """Wrap a damaged message between whole ones, and read the bag."""
    bag = path.with_suffix(".mcap")
    try:
        others = {t: [make(k) for k in (1, 3)] for t, (_, _, make) in TOPICS.items()}
        others[topic].insert(1, path.read_bytes())
        make_bag(bag, others)
        use_bag(bag)
    finally:
        bag.unlink(missing_ok=True)


def read_record(path: Path) -> None:
    """Read a bag whose record of the run is damaged."""
    bag = path.with_suffix(".mcap")
    text = path.read_bytes().decode("latin-1")
    try:
        make_bag(bag, {}, {**RECORDS, "run": {"satellites": "G01", "parameters": text}})
        found = recorded_run(bag)
        assert all(isinstance(values, dict) for values in found.parameters.values())
    finally:
        bag.unlink(missing_ok=True)


def read_chunk(path: Path) -> None:
    """Read a file whose one chunk, damaged within, has the right checksum."""
    import zlib

    bag = path.with_suffix(".mcap")
    content = path.read_bytes()
    head = struct.pack("<QQQII", 0, 1, len(content), zlib.crc32(content), 0)
    body = head + struct.pack("<Q", len(content)) + content
    chunk = struct.pack("<BQ", Opcode.CHUNK, len(body)) + body
    try:
        header = struct.pack("<BQIII", Opcode.HEADER, 8, 0, 0, 0)[:17]
        bag.write_bytes(
            small_bag()[:8] + header + chunk + struct.pack("<BQI", Opcode.DATA_END, 4, 0)
        )
        use_bag(bag)
    finally:
        bag.unlink(missing_ok=True)


def use_bag(path: Path) -> None:
    """Read a bag in every way there is; each may refuse it."""
    ways = (
        lambda: list(IfBag(path).blocks()),
        lambda: list(ImuBag(path, CLOCK).samples()),
        lambda: read_station_of(path),
        lambda: list(base_epochs(path)),
        lambda: (has_base(path), has_imu(path)),
        lambda: recorded_run(path),
        lambda: list(read_messages([path])),
        lambda: list(McapScan(path).messages()),
        lambda: bag_info(path),
    )
    refused = None
    for way in ways:
        try:
            way()
        except InputError as error:
            refused = refused or error
    if refused is not None:
        raise refused


def read_station_of(path: Path) -> None:
    from deepseis_frontend.nodes.station_bag import read_station

    read_station(path)


def base_epochs(path: Path):
    from deepseis_frontend.nodes.base_bag import BaseBag

    return BaseBag(path).epochs()


def recover(path: Path) -> None:
    recover_bag(path, replace=True)
    assert bag_info(path).is_whole
    list(read_messages([path]))


def read_metadata_yaml(path: Path) -> None:
    folder = path.with_name("bag")
    folder.mkdir()
    try:
        (folder / "metadata.yaml").write_bytes(path.read_bytes())
        (folder / "bag_0.mcap").write_bytes(small_bag())
        bag_files(folder)
        bag_info(folder)
    finally:
        for item in folder.iterdir():
            item.unlink()
        folder.rmdir()


@cache
def small_bag() -> bytes:
    """Return a bag of two chunks that holds a little of everything."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.mcap"
        counts = {"/if/samples": 3, "/imu/data_raw": 3}
        payloads = {t: [if_payload(k) if "if" in t else imu_payload(k) for k in range(n)]
                    for t, n in counts.items()}  # fmt: skip
        make_bag(path, {**payloads, "/station": [station_payload()]})
        return path.read_bytes()


@cache
def chunk_content() -> bytes:
    """Return what is in a chunk: a schema, a channel, messages."""
    from mcap import records

    from deepseis_bringup.bags.mcap_layout import record_bytes

    out = record_bytes(records.Schema(1, SCHEMA, "ros2msg", IF_TYPE))
    out += record_bytes(records.Channel(1, "/if/samples", "cdr", {"a": "b"}, 1))
    out += record_bytes(records.Schema(2, b"", "ros2msg", IMU_TYPE))
    out += record_bytes(records.Channel(2, "/imu/data_raw", "cdr", {}, 2))
    for k in range(3):
        out += record_bytes(records.Message(1, k, if_payload(k), k, k))
        out += record_bytes(records.Message(2, k, imu_payload(k), k, k))
    return out


METADATA = b"""rosbag2_bagfile_information:
  version: 9
  storage_identifier: mcap
  relative_file_paths: [bag_0.mcap]
  custom_data: {deepseis.interface_version: "1"}
"""


def quake_seeds() -> tuple[bytes, ...]:
    from unit.sim.test_accelerogram import TEXTS

    return tuple(text.encode() for text in TEXTS)


def miniseed_seed() -> bytes:
    import io
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import obspy

    traces = [
        obspy.Trace(np.arange(200, dtype=np.int32) + k, {"channel": name, "sampling_rate": 100.0})
        for k, name in enumerate(("HNE", "HNN", "HNZ"))
    ]
    out = io.BytesIO()
    obspy.Stream(traces).write(out, format="MSEED", reclen=512)
    return out.getvalue()


def targets() -> dict[str, Target]:
    """Return all readers by name."""
    bag = (small_bag(),)
    formats = (b"iq2 order=msb_first", b"real8", b"iq1 positive=0 inverted", b"iq16 scale=0.01",
               *(name.encode() for name in PRESETS))  # fmt: skip
    scenarios = tuple(path.read_bytes() for path in sorted(FOLDER.glob("*.yaml")))
    listed = (
        Target("if_format", formats, partial(read_text, IfFormat.from_text)),
        Target(
            "utc", (b"2022-01-01T02:00:00Z", b"2022-01-01"), partial(read_text, utc_ns_from_iso)
        ),
        Target(
            "position",
            (b"0 90 100", b"35.681298,139.766247,10"),
            partial(read_text, ecef_from_text),
        ),
        Target("if_descriptor", (DESCRIPTOR,), read_if_descriptor, ".bin.yaml"),
        Target("station_yaml", (STATION,), read_station_config, ".yaml"),
        Target("scenario_yaml", scenarios, lambda path: load_scenario(str(path)), ".yaml"),
        Target("imu_yaml", (IMU_YAML,), read_imu, ".dat.yaml"),
        Target("imu_csv", (IMU_CSV,), read_imu, ".csv"),
        Target(
            "rinex_nav", (nav("3.05"), nav("4.00", b"> EPH G02 LNAV\n"), NAV_2), read_rinex_nav
        ),
        Target("rinex_position", (OBS,), rinex_position),
        Target("installation", (GRAVITY,), read_installation, ".json"),
        Target("accelerogram", quake_seeds(), read_quake),
        Target("miniseed", (miniseed_seed(),), read_quake, ".mseed"),
        Target("metadata_yaml", (METADATA,), read_metadata_yaml, ".yaml"),
        Target("run_record", (RECORDS["run"]["parameters"].encode(),), read_record, ".json"),
        Target("bag", bag, use_bag, ".mcap"),
        Target("chunk", (chunk_content(),), read_chunk, ".bin"),
        Target("recover", bag, recover, ".mcap", keeps=False),
        Target("if_message", (if_payload(2),), partial(read_payload, "/if/samples")),
        Target("imu_message", (imu_payload(2),), partial(read_payload, "/imu/data_raw")),
        Target("base_message", (base_payload(2),), partial(read_payload, "/base/observations")),
        Target("station_message", (station_payload(),), partial(read_payload, "/station")),
    )
    return {target.name: target for target in listed}


COMPANIONS = {
    "if_descriptor": {"input.bin": bytes(range(256)) * 40},
    "imu_yaml": {"input.dat": IMU_CSV},
    "imu_csv": {"input.csv.yaml": IMU_YAML},
}
"""Files that lie beside the damaged one."""


def prepare(target: Target, folder: Path) -> None:
    """Lay what belongs beside a target's file."""
    for name, content in COMPANIONS.get(target.name, {}).items():
        (folder / name).write_bytes(content)
