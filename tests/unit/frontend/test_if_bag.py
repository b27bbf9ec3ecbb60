import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from deepseis_core.baseband import Baseband
from deepseis_core.errors import InputError
from deepseis_core.interface import INTERFACE_VERSION
from deepseis_frontend.if_bag import FIELDS, TYPE_NAME, IfBag, decode_if_block

RATE, COUNT = 1e6, 20_000
MESSAGES = Path(__file__).parents[3] / "ws" / "src" / "deepseis_msgs" / "msg"
TEXT = (MESSAGES / "IfBlock.msg").read_text()
HEADER = "builtin_interfaces/Time stamp\nstring frame_id\n"
SCHEMA = f"{TEXT}\n{'=' * 80}\nMSG: std_msgs/Header\n{HEADER}"
START_NS = 1_700_000_000_123_456_789

STORE = get_typestore(Stores.ROS2_JAZZY)
STORE.register(get_types_from_msg(TEXT, TYPE_NAME))
MessageType = STORE.types[TYPE_NAME]
HeaderType, TimeType = (
    STORE.types["std_msgs/msg/Header"],
    STORE.types["builtin_interfaces/msg/Time"],
)


def samples(index):
    return np.random.default_rng(index).integers(0, 256, 2 * COUNT, dtype=np.uint8)


def message(index, data=None, count=COUNT, text="iq8", rate=RATE, frame="antenna"):
    """Serialise an IfBlock with rosbags: an implementation of CDR that is not ours."""
    stamp = START_NS + round(index / RATE * 1e9)
    header = HeaderType(stamp=TimeType(stamp // 10**9, stamp % 10**9), frame_id=frame)
    data = samples(index) if data is None else data
    value = MessageType(
        header=header,
        sample_index=index,
        sample_count=count,
        sample_rate_hz=rate,
        intermediate_frequency_hz=0.0,
        format=text,
        data=data,
    )
    return bytes(STORE.serialize_cdr(value, TYPE_NAME))


def write_bag(path, messages, *, version=INTERFACE_VERSION, schema=SCHEMA, type_name=TYPE_NAME):
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD, chunk_size=100_000)
        writer.start("ros2")
        if version:
            writer.add_metadata("deepseis", {"interface_version": version})
        channels = {}
        for k, (topic, data) in enumerate(messages):
            if topic not in channels:
                number = writer.register_schema(type_name, "ros2msg", schema.encode())
                channels[topic] = writer.register_channel(topic, "cdr", number)
            writer.add_message(channels[topic], k, data, k)
        writer.finish()


@pytest.fixture
def bag(tmp_path):
    path = tmp_path / "run_0.mcap"
    write_bag(path, [("/station/if/samples", message(k * COUNT)) for k in range(10)])
    return path


@pytest.mark.parametrize("frame", ["", "a", "ab", "abc", "abcd"])
@pytest.mark.parametrize("text", ["iq8", "real16", "iq1 positive=1 order=msb_first"])
def test_decoding_agrees_with_an_outside_serialiser_at_any_alignment(frame, text):
    data = np.arange(7, dtype=np.uint8)
    stamp, block = decode_if_block(message(10**12, data, 3, text, 4.092e6, frame))
    assert stamp == START_NS + 10**15  # 10**12 samples at 1 MHz
    assert (block.sample_index, block.sample_count, block.sample_rate_hz) == (10**12, 3, 4.092e6)
    assert (block.format, block.data.tolist()) == (text, data.tolist())


def test_the_expected_fields_are_those_of_the_message_file():
    lines = [" ".join(line.partition("#")[0].split()) for line in TEXT.splitlines()]
    assert tuple(line for line in lines if line) == FIELDS


def test_blocks_are_those_recorded(bag):
    source = IfBag(bag)
    blocks = list(source.blocks())
    assert [block.sample_index for block in blocks] == [k * COUNT for k in range(10)]
    for block in blocks:
        np.testing.assert_array_equal(block.data, samples(block.sample_index))
        Baseband.for_block(block).convert(block)
    assert source.remarks == []
    assert (source.topic, source.sample_rate_hz) == ("/station/if/samples", RATE)
    assert source.start_utc_ns == START_NS


def test_a_bag_that_starts_late_knows_the_time_of_sample_zero(tmp_path):
    path = tmp_path / "a.mcap"
    write_bag(path, [("if/samples", message(50 * COUNT))])
    assert IfBag(path).start_utc_ns == START_NS


def test_gaps_are_remarked_and_left_open(tmp_path):
    path = tmp_path / "a.mcap"
    write_bag(path, [("/if/samples", message(k * COUNT)) for k in (0, 1, 4, 5, 7)])
    source = IfBag(path)
    assert [b.sample_index // COUNT for b in source.blocks()] == [0, 1, 4, 5, 7]
    gaps = [(r.kind, r.sample_index, r.missing_samples) for r in source.remarks]
    assert gaps == [("gap", 4 * COUNT, 2 * COUNT), ("gap", 7 * COUNT, COUNT)]


def test_a_folder_with_metadata_is_a_bag(tmp_path):
    for k in range(2):
        path = tmp_path / f"run_{k}.mcap"
        write_bag(path, [("/if/samples", message((5 * k + n) * COUNT)) for n in range(5)])
    facts = {"storage_identifier": "mcap", "relative_file_paths": ["run_0.mcap", "run_1.mcap"]}
    text = yaml.safe_dump({"rosbag2_bagfile_information": facts})
    (tmp_path / "metadata.yaml").write_text(text)
    assert len(list(IfBag(tmp_path).blocks())) == 10


def test_a_cut_bag_is_read_as_far_as_it_goes(bag):
    whole = bag.read_bytes()
    bag.write_bytes(whole[: len(whole) // 2])
    source = IfBag(bag)
    blocks = list(source.blocks())
    assert 2 <= len(blocks) < 6
    [remark] = source.remarks
    assert remark.kind == "short_end"
    assert remark.sample_index == blocks[-1].sample_index + COUNT


@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(cut=st.integers(0, 440_000), flip=st.none() | st.integers(0, 439_999))
def test_a_cut_or_damaged_bag_gives_true_blocks_or_an_input_error(bag, tmp_path, cut, flip):
    data = bytearray(bag.read_bytes()[:cut])
    if flip is not None and flip < len(data):
        data[flip] ^= 0xFF
    path = tmp_path / "hurt.mcap"
    path.write_bytes(data)
    expected = 0
    try:
        for block in IfBag(path).blocks():
            assert block.sample_index == expected
            np.testing.assert_array_equal(block.data, samples(block.sample_index))
            expected += COUNT
    except InputError:
        pass


def test_damage_is_an_error_that_names_the_place(bag):
    data = bytearray(bag.read_bytes())
    data[len(data) // 2] ^= 0xFF
    bag.write_bytes(data)
    with pytest.raises(InputError, match="damaged at byte"):
        list(IfBag(bag).blocks())


def test_what_is_no_bag_with_if_is_refused(tmp_path, bag):
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "text.mcap").write_text("no bag at all")
    (tmp_path / "folder").mkdir()
    (tmp_path / "sqlite").mkdir()
    facts = {"storage_identifier": "sqlite3", "relative_file_paths": ["a.db3"]}
    text = yaml.safe_dump({"rosbag2_bagfile_information": facts})
    (tmp_path / "sqlite" / "metadata.yaml").write_text(text)
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "metadata.yaml").write_text("a: [")
    write_bag(tmp_path / "other.mcap", [("/imu/data_raw", b"\0\1\0\0")])
    reasons = {
        "absent.mcap": "No such file",
        "empty.mcap": "is empty",
        "text.mcap": "is not an MCAP file",
        "folder": "holds no bag",
        "sqlite": "'sqlite3' storage",
        "broken": "not a bag's metadata",
        "other.mcap": "holds no IF samples",
    }
    for name, reason in reasons.items():
        with pytest.raises(InputError, match=reason):
            IfBag(tmp_path / name)


def test_another_interface_version_is_refused_by_name(tmp_path):
    path = tmp_path / "a.mcap"
    write_bag(path, [("/if/samples", message(0))], version="0")
    with pytest.raises(InputError, match="version 0, this is version"):
        IfBag(path)


def test_another_definition_or_type_is_refused(tmp_path):
    path = tmp_path / "a.mcap"
    write_bag(path, [("/if/samples", message(0))], schema=SCHEMA.replace("int64", "uint64"))
    with pytest.raises(InputError, match="another definition"):
        IfBag(path)
    write_bag(path, [("/if/samples", message(0))], type_name="other_msgs/msg/IfBlock")
    with pytest.raises(InputError, match="other_msgs"):
        IfBag(path)


def test_two_stations_need_a_name(tmp_path):
    path = tmp_path / "a.mcap"
    write_bag(path, [(f"/{name}/if/samples", message(0)) for name in "ab"])
    with pytest.raises(InputError, match="several stations: /a/if/samples, /b/if/samples"):
        list(IfBag(path).blocks())
    assert len(list(IfBag(path, "/b/if/samples").blocks())) == 1


@pytest.mark.parametrize(
    ("second", "reason"),
    [
        (message(0), "comes after sample"),
        (message(COUNT, rate=2e6), "changes at sample 20000"),
        (message(COUNT, text="real8"), "changes at sample 20000"),
        (message(COUNT, count=COUNT - 1), "40000 bytes for 19999 samples"),
        (message(COUNT)[:-1], "unreadable message"),
        (b"", "unreadable message"),
    ],
)
def test_a_stream_that_contradicts_itself_is_refused(tmp_path, second, reason):
    path = tmp_path / "a.mcap"
    write_bag(path, [("/if/samples", message(0)), ("/if/samples", second)])
    with pytest.raises(InputError, match=reason):
        list(IfBag(path).blocks())


def test_a_bag_of_plain_rosbag2_without_our_metadata_is_accepted(tmp_path, bag):
    path = tmp_path / "plain.mcap"
    write_bag(path, [("/if/samples", message(0))], version="")
    assert len(list(IfBag(path).blocks())) == 1
    shutil.copy(bag, path)
    assert len(list(IfBag(path).blocks())) == 10
