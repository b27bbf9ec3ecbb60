"""Our bytes are the middleware's: rmw reads what we write and we read what it writes."""

import dataclasses

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs the ROS environment")

from diagnostic_msgs.msg import DiagnosticArray
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import NavSatFix

from deepseis_core.ros import codecs, diagnostics
from deepseis_core.ros.cdr import CdrError, Codec, encode_message
from deepseis_core.types import Ephemeris, IfBlock, Observations, Pvt, TrackingEpochs

ALL = [
    codecs.IF_BLOCK,
    codecs.ACQUISITION_RESULT,
    codecs.TRACKING_EPOCHS,
    codecs.EPHEMERIS,
    codecs.OBSERVATIONS,
    codecs.PVT,
    codecs.DOPPLER_AIDING,
]


def example(codec: Codec, count: int, seed: int = 1):
    """A value of the codec's type with sequences of the given length."""
    rng = np.random.default_rng(seed)
    types = codec.msg_type.get_fields_and_field_types()
    values = {}
    for item in dataclasses.fields(codec.value_type):
        text = types[item.name]
        base = text.removeprefix("sequence<").split("[")[0].rstrip(">")
        if base == "string":
            names = tuple(f"G{k:02d}" for k in range(1, count + 1))
            values[item.name] = names if text.startswith("sequence") else "G17"
        elif text.startswith("sequence<") or "[" in text:
            size = int(text[:-1].split("[")[1]) if "[" in text else count
            kind = {"double": "f8", "float": "f4"}.get(base, base)
            array = (rng.random(size) * 100).astype(kind)
            is_tuple = str(item.type).startswith("tuple")
            values[item.name] = tuple(array.tolist()) if is_tuple else array
        elif base in ("double", "float"):
            values[item.name] = float(np.float32(rng.random()))
        elif base == "boolean":
            values[item.name] = True
        else:
            values[item.name] = int(rng.integers(0, 100))
    return codec.value_type(**values)


@pytest.mark.parametrize("count", [0, 1, 2, 3, 12])
@pytest.mark.parametrize("codec", ALL, ids=lambda c: c.msg_type.__name__)
def test_rmw_reads_what_we_write(codec, count):
    value = example(codec, count)
    data = codec.encode(value, 1_234_567_890_123_456_789, "antenna")
    msg = deserialize_message(data, codec.msg_type)
    assert (msg.header.stamp.sec, msg.header.stamp.nanosec) == (1_234_567_890, 123_456_789)
    assert msg.header.frame_id == "antenna"
    for name in codec.msg_type.get_fields_and_field_types():
        if name != "header":
            assert np.array_equal(np.asarray(getattr(msg, name)), np.asarray(getattr(value, name)))
    again, utc_ns = codec.decode(bytes(serialize_message(msg)))
    assert utc_ns == 1_234_567_890_123_456_789
    for item in dataclasses.fields(value):
        assert np.array_equal(getattr(again, item.name), getattr(value, item.name))


@pytest.mark.parametrize("count", [1, 600])
@pytest.mark.parametrize("codec", ALL[1:], ids=lambda c: c.msg_type.__name__)
def test_what_comes_from_a_message_is_of_one_type_for_kernels(codec, count):
    """Read-only or unaligned arrays are others: trackers once compiled when aiding came."""
    value, _ = codec.decode(codec.encode(example(codec, count), 5))
    arrays = [x for x in vars(value).values() if isinstance(x, np.ndarray)]
    for array in arrays:
        assert array.flags.writeable
        assert array.flags.aligned
        assert array.flags.c_contiguous


@pytest.mark.parametrize("codec", ALL, ids=lambda c: c.msg_type.__name__)
def test_equal_values_have_equal_bytes(codec):
    assert codec.encode(example(codec, 3), 5) == codec.encode(example(codec, 3), 5)


def test_standard_messages_survive_our_encoding():
    status = diagnostics.array("pvt", diagnostics.WARN, "two late", {"late": 2}, 1_000_000_005)
    assert deserialize_message(encode_message(status), DiagnosticArray) == status
    fix = NavSatFix(latitude=35.5, longitude=-3.25, altitude=12.0)
    fix.position_covariance[4] = 2.0
    assert deserialize_message(encode_message(fix), NavSatFix) == fix


@given(data=st.binary(max_size=300), which=st.sampled_from(ALL))
def test_garbage_is_refused_not_misread(data, which):
    try:
        which.decode(data)
    except CdrError:
        return


@pytest.mark.parametrize("value_type", [IfBlock, Observations, Pvt, Ephemeris, TrackingEpochs])
def test_every_field_of_a_message_is_in_its_value(value_type):
    codec = next(c for c in ALL if c.value_type is value_type)
    names = set(codec.msg_type.get_fields_and_field_types()) - {"header"}
    assert names == {item.name for item in dataclasses.fields(value_type)}
