import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import NonSeekingReader, make_reader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from deepseis_bringup.bags.info import bag_info
from deepseis_bringup.bags.mcap_file import McapFile
from deepseis_bringup.bags.mcap_recording import BagWriter, read_messages
from deepseis_bringup.bags.recovery import recover_bag
from deepseis_bringup.bags.ros_definitions import Definitions, TopicQos
from deepseis_bringup.bags.whole_writes import WholeWrites
from deepseis_core.errors import InputError
from deepseis_core.interface import INTERFACE_VERSION
from deepseis_core.mcap_scan import McapScan
from deepseis_frontend.if_bag import IfBag, bag_files

IF_TYPE, TEST_TYPE = "deepseis_msgs/msg/IfBlock", "test_msgs/msg/Pair"
TEXTS = {
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec\n",
    "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "geometry_msgs/msg/Point": "float64 x\nfloat64 y\nfloat64 z\n",
    TEST_TYPE: "# a comment: Header no_field\nuint8 BIG=7\nPart[<=3] parts\nstring<=9 name\n",
    "test_msgs/msg/Part": "std_msgs/Header h # stamp\ngeometry_msgs/Point[2] p\nfloat64 x 1\n",
    IF_TYPE: "std_msgs/Header header\nint64 sample_index\nuint32 sample_count\n"
    "float64 sample_rate_hz\nfloat64 intermediate_frequency_hz\nstring format\nuint8[] data\n",
}
STORE = get_typestore(Stores.ROS2_JAZZY)
for name, text in TEXTS.items():
    if name.startswith(("deepseis", "test")):
        STORE.register(get_types_from_msg(text, name))
COUNT, RATE = 1000, 50_000.0


def definitions():
    return Definitions(TEXTS)


def samples(index):
    return np.random.default_rng(index).integers(0, 256, 2 * COUNT, dtype=np.uint8)


def if_message(index):
    time_type = STORE.types["builtin_interfaces/msg/Time"]
    header = STORE.types["std_msgs/msg/Header"](stamp=time_type(10**9, 0), frame_id="")
    value = STORE.types[IF_TYPE](header, index, COUNT, RATE, 0.0, "iq8", samples(index))
    return bytes(STORE.serialize_cdr(value, IF_TYPE))


def pair_message(number):
    value = STORE.types[TEST_TYPE](parts=[], name=f"n{number}")
    return bytes(STORE.serialize_cdr(value, TEST_TYPE))


def write_run(folder, blocks=50, skip=(), **options):
    records = {"parameters": {"tracker.pll_bandwidth_hz": 15.0}, "station": {"name": "A"}}
    with BagWriter(folder, records, definitions=definitions(), **options) as bag:
        bag.add_topic("/if/samples", IF_TYPE, TopicQos(depth=250))
        bag.add_attachment("graph.yaml", b"nodes: []\n")
        for k in range(blocks):
            if k not in skip:
                stamp = 10**18 + k * 20_000_000
                bag.write("/if/samples", IF_TYPE, if_message(k * COUNT), stamp, stamp + 5)
                bag.write("/pair", TEST_TYPE, pair_message(k), stamp + 10**7, stamp)
    return folder


@pytest.fixture
def bag(tmp_path):
    return write_run(tmp_path / "bag")


def test_rosbags_opens_the_folder_and_reads_every_field(bag):
    with AnyReader([bag], default_typestore=get_typestore(Stores.EMPTY)) as reader:
        counts = {c.topic: c.msgcount for c in reader.connections}
        assert counts == {"/if/samples": 50, "/pair": 50}
        assert reader.duration == 49 * 20_000_000 + 10**7 + 1  # rosbags counts the last tick
        names, indices = [], []
        for connection, stamp, raw in reader.messages():
            value = reader.deserialize(raw, connection.msgtype)
            if connection.msgtype == IF_TYPE:
                assert stamp == 10**18 + value.sample_index // COUNT * 20_000_000
                np.testing.assert_array_equal(value.data, samples(value.sample_index))
                indices.append(value.sample_index)
            else:
                names.append(value.name)
        assert indices == [k * COUNT for k in range(50)]
        assert names == [f"n{k}" for k in range(50)]


@pytest.mark.parametrize("compression", ["zstd", "none"])
def test_mcap_readers_give_bytes_times_and_records_back(tmp_path, compression):
    folder = write_run(tmp_path / "run" / "bag", compression=compression)
    path = folder / "bag_0.mcap"
    for make in (lambda s: make_reader(s, validate_crcs=True), NonSeekingReader):
        with path.open("rb") as stream:
            got = [
                (c.topic, m.log_time, m.publish_time, m.sequence, m.data)
                for _, c, m in make(stream).iter_messages()
            ]
        stamps = [10**18 + k * 20_000_000 for k in range(50)]
        expected = []
        for k, stamp in enumerate(stamps):
            expected.append(("/if/samples", stamp, stamp + 5, k, if_message(k * COUNT)))
            expected.append(("/pair", stamp + 10**7, stamp, k, pair_message(k)))
        assert got == expected
    with path.open("rb") as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == "ros2"
        records = {record.name: record.metadata for record in reader.iter_metadata()}
        assert records["deepseis"] == {"interface_version": INTERFACE_VERSION}
        assert records["parameters"] == {"tracker.pll_bandwidth_hz": "15.0"}
        assert [item.data for item in reader.iter_attachments()] == [b"nodes: []\n"]
        assert reader.get_summary().statistics.message_count == 100


def test_metadata_yaml_is_that_of_version_nine(bag):
    facts = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert (facts["version"], facts["storage_identifier"]) == (9, "mcap")
    assert facts["message_count"] == 100
    assert facts["relative_file_paths"] == ["bag_0.mcap"]
    assert facts["custom_data"] == {"deepseis.interface_version": INTERFACE_VERSION}
    first = facts["topics_with_message_count"][0]["topic_metadata"]
    assert (first["name"], first["type"]) == ("/if/samples", IF_TYPE)
    assert first["offered_qos_profiles"][0]["reliability"] == "reliable"
    assert first["offered_qos_profiles"][0]["depth"] == 250


def test_a_schema_holds_every_type_it_uses_once():
    schema = definitions().schema(TEST_TYPE).decode()
    marks = [line for line in schema.splitlines() if line.startswith("MSG:")]
    assert marks == [
        "MSG: test_msgs/Part",
        "MSG: std_msgs/Header",
        "MSG: geometry_msgs/Point",
        "MSG: builtin_interfaces/Time",
    ]


def test_an_unknown_type_is_named():
    with pytest.raises(InputError, match="nowhere_msgs/msg/Thing"):
        Definitions().schema("nowhere_msgs/msg/Thing")


MESSAGES = Path(__file__).parents[3] / "ws" / "src" / "deepseis_msgs" / "msg"
OURS = sorted(f"deepseis_msgs/msg/{path.stem}" for path in MESSAGES.glob("*.msg"))


@pytest.mark.parametrize("type_name", [*OURS, "sensor_msgs/msg/Imu", "nav_msgs/msg/Odometry"])
def test_installed_types_have_the_definition_and_hash_that_rosbags_derives(type_name):
    installed = Definitions()
    try:
        schema = installed.schema(type_name).decode()
    except InputError:
        pytest.skip("no ROS messages are installed here")
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(schema, type_name))
    assert store.hash_rihs01(type_name) == installed.type_hash(type_name)


def test_a_folder_with_a_bag_is_not_overwritten(bag):
    before = (bag / "bag_0.mcap").read_bytes()
    with pytest.raises(InputError, match="holds a bag already"):
        BagWriter(bag, definitions=definitions())
    assert (bag / "bag_0.mcap").read_bytes() == before


class Fickle(WholeWrites):
    """Its guard is gone when it is looked at again: another thread closes the file."""

    looks = 0

    @property
    def guard(self):
        self.looks += 1
        return (lambda: None) if self.looks == 1 else None

    @guard.setter
    def guard(self, _guard):
        pass


def test_a_guard_may_be_taken_away_while_a_piece_is_written(tmp_path):
    file = Fickle(tmp_path / "a")
    file.put(b"piece")
    file.commit()
    file.close()
    assert (tmp_path / "a").read_bytes() == b"piece"


def test_a_full_disk_is_an_error_that_names_the_file(tmp_path):
    file = McapFile(tmp_path / "a.mcap")
    number = file.add_channel("/a", "a/msg/A", b"", {})
    file._out.close()  # what a failing device does to the writing thread
    megabytes = (file.write(number, 0, 0, bytes(1 << 20)) for _ in range(1000))
    with pytest.raises(InputError, match=r"a\.mcap: cannot be written"):
        list(megabytes)
    with pytest.raises(InputError, match="cannot be written"):
        file.close()


def test_info_counts_rates_and_gaps(tmp_path):
    info = bag_info(write_run(tmp_path / "bag", skip=(10, 11)))
    topic = info.topics["/if/samples"]
    assert (topic.count, topic.type_name) == (48, IF_TYPE)
    assert topic.rate_hz == pytest.approx(47 / 0.98)
    assert info.duration == pytest.approx(0.99)
    assert info.interface_version == INTERFACE_VERSION
    assert info.metadata["station"] == {"name": "A"}
    assert info.attachments == ["graph.yaml"]
    assert [(r.sample_index, r.missing_samples) for r in info.if_remarks] == [(12_000, 2000)]
    assert info.is_whole
    info.require_interface()


def test_foreign_and_older_bags_are_refused_by_name(tmp_path):
    file = McapFile(tmp_path / "foreign.mcap")
    file.close()
    with pytest.raises(InputError, match=r"foreign\.mcap: has no DeepSeis interface version"):
        bag_info(tmp_path / "foreign.mcap").require_interface()
    file = McapFile(tmp_path / "old.mcap")
    file.add_metadata("deepseis", {"interface_version": "0"})
    file.close()
    with pytest.raises(InputError, match=r"old\.mcap: was recorded with interface version 0"):
        bag_info(tmp_path / "old.mcap").require_interface()


def test_messages_are_read_in_order_of_time(bag):
    messages = list(read_messages(bag_files(bag)))
    assert len(messages) == 100
    times = [message.log_time_ns for message in messages]
    assert times == sorted(times)
    only = list(read_messages(bag_files(bag), ["/pair"]))
    assert [bytes(message.data) for message in only] == [pair_message(k) for k in range(50)]


def test_reading_a_cut_file_in_order_says_how_to_recover(bag):
    path = bag / "bag_0.mcap"
    os.truncate(path, path.stat().st_size // 2)
    with pytest.raises(InputError, match="deepseis recover"):
        list(read_messages([path]))


@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(share=st.floats(0, 1))
def test_recovering_a_cut_bag_loses_only_the_tail(tmp_path_factory, many_chunks, share):
    whole, chunk_starts = many_chunks
    cut = round(share * len(whole))
    folder = tmp_path_factory.mktemp("cut")
    (folder / "bag_0.mcap").write_bytes(whole[:cut])
    kept = sum(end <= cut for end in chunk_starts) * 2
    try:
        [result] = recover_bag(folder)
    except InputError:
        assert kept == 0
        return
    assert result.messages == kept
    assert bag_info(folder).is_whole
    messages = list(read_messages(bag_files(folder)))
    assert [bytes(m.data) for m in messages[0::2]] == [
        if_message(k * COUNT) for k in range(kept // 2)
    ]
    with AnyReader([folder]) as reader:
        assert reader.message_count == kept


@pytest.fixture(scope="module")
def many_chunks(tmp_path_factory):
    """Bytes of a file of 20 chunks of two messages, and where its chunks end."""
    path = tmp_path_factory.mktemp("whole") / "bag_0.mcap"
    file = McapFile(path, flush_interval=0.0)
    both = [
        file.add_channel(topic, name, definitions().schema(name), {})
        for topic, name in (("/if/samples", IF_TYPE), ("/pair", TEST_TYPE))
    ]
    for k in range(20):
        with file._wake:  # both messages into one chunk
            file.write(both[0], 2 * k, 0, if_message(k * COUNT))
            file.write(both[1], 2 * k + 1, 0, pair_message(k))
            file._close_chunk()
    file.close()
    with path.open("rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    return path.read_bytes(), [c.chunk_start_offset + c.chunk_length for c in chunks]


@settings(max_examples=40, deadline=None)
@given(places=st.lists(st.floats(0, 1), min_size=1, max_size=5), value=st.integers(1, 255))
def test_recovering_a_damaged_bag_never_crashes_and_invents_nothing(
    tmp_path_factory, many_chunks, places, value
):
    data = bytearray(many_chunks[0])
    for place in places:
        data[round(place * (len(data) - 1))] ^= value
    folder = tmp_path_factory.mktemp("hurt")
    (folder / "bag_0.mcap").write_bytes(data)
    true = {if_message(k * COUNT) for k in range(20)} | {pair_message(k) for k in range(20)}
    try:
        recover_bag(folder)
        bag_info(folder)
        for message in read_messages(bag_files(folder)):
            assert bytes(message.data) in true
    except InputError:
        pass


def test_recovering_a_whole_bag_changes_nothing_but_a_missing_metadata_yaml(bag):
    path = bag / "bag_0.mcap"
    before, facts = path.read_bytes(), (bag / "metadata.yaml").read_text()
    (bag / "metadata.yaml").unlink()
    [result] = recover_bag(bag)
    assert result.was_whole
    assert path.read_bytes() == before
    assert (bag / "metadata.yaml").read_text() == facts


RECORDER = """
    import sys, time
    from pathlib import Path
    from deepseis_bringup.bags.mcap_recording import BagWriter
    from deepseis_bringup.bags.ros_definitions import Definitions
    bag = BagWriter(sys.argv[1], definitions=Definitions({"a/msg/A": "uint8[] data\\n"}))
    k = 0
    while True:
        bag.write("/a", "a/msg/A", b"\\0\\1\\0\\0" + k.to_bytes(8, "little"), time.time_ns(), 0)
        print(k, flush=True)
        k += 1
        time.sleep(0.02)
"""


def test_kill_9_loses_less_than_a_second_and_keeps_the_metadata(tmp_path):
    folder = tmp_path / "bag"
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join(p for p in sys.path if p))
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(RECORDER), str(folder)],
        stdout=subprocess.PIPE,
        env=environment,
    )
    try:
        for _ in range(60):
            process.stdout.readline()
    finally:
        killed_ns = time.time_ns()
        process.send_signal(signal.SIGKILL)
        written = 60 + len(process.stdout.read().splitlines())
        process.stdout.close()
        process.wait()
    [result] = recover_bag(folder)
    assert not result.was_whole
    messages = list(read_messages(bag_files(folder)))
    numbers = [int.from_bytes(m.data[4:], "little") for m in messages]
    assert numbers == list(range(len(numbers)))
    assert len(numbers) <= written
    assert killed_ns - messages[-1].log_time_ns < 1e9
    bag_info(folder).require_interface()


def test_a_recording_in_progress_can_be_read(tmp_path):
    with BagWriter(tmp_path / "bag", definitions=definitions()) as bag:
        for k in range(5):
            bag.write("/if/samples", IF_TYPE, if_message(k * COUNT), k, k)
        deadline = time.monotonic() + 10
        while time.monotonic() < deadline:
            try:
                if len(list(IfBag(tmp_path / "bag").blocks())) == 5:
                    break
            except InputError:
                time.sleep(0.02)
        else:
            pytest.fail("five blocks were not in the file within 10 s")


def test_what_was_logged_long_before_is_passed_over_unread(tmp_path, monkeypatch):
    monkeypatch.setattr("deepseis_bringup.bags.mcap_file.CHUNK_BYTES", 1 << 16)
    with BagWriter(tmp_path / "bag", {}, definitions=definitions(), compression="none") as bag:
        for k in range(500):  # 10 s; a chunk holds 32 blocks
            stamp = 10**18 + k * 20_000_000
            bag.write("/if/samples", IF_TYPE, if_message(k * COUNT), stamp, stamp)
            if k == 100:
                bag.write("/rare", TEST_TYPE, pair_message(k), stamp, stamp)
        for k in (480, 490):
            bag.write("/rare", TEST_TYPE, pair_message(k), 10**18 + k * 20_000_000, 0)
    (file,) = (tmp_path / "bag").glob("*.mcap")
    since_ns = 10**18 + 8 * 10**9

    def samples_of(channel):
        return channel.topic == "/if/samples"

    everything = [bytes(m.data) for m in McapScan(file).messages(samples_of)]
    late = [bytes(m.data) for m in McapScan(file).messages(samples_of, since_ns=since_ns)]
    assert late == everything[-len(late) :]
    assert 100 <= len(late) <= 100 + 33, "no more than a chunk too many"
    # A topic that was declared in a chunk passed over is known all the same.
    both = [m.channel.topic for m in McapScan(file).messages(since_ns=since_ns)]
    assert both.count("/rare") == 2
    # Damage in a chunk passed over is not met: it is not read.
    data = bytearray(file.read_bytes())
    place = data.find(samples(150 * COUNT).tobytes())
    data[place + 10] ^= 0xFF
    file.write_bytes(data)
    with pytest.raises(InputError, match="damaged"):
        list(McapScan(file).messages(samples_of))
    again = [bytes(m.data) for m in McapScan(file).messages(samples_of, since_ns=since_ns)]
    assert again == late
