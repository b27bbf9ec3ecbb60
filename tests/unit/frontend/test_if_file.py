import base64
import json
import os

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from deepseis_core.errors import InputError
from deepseis_core.if_format import IfFormat
from deepseis_frontend.if_descriptor import IfDescriptor, descriptor_path, write_descriptor
from deepseis_frontend.if_file import IfFile, open_if_file

RATE = 1e6


def noise(text, count, seed=0):
    packing = IfFormat.from_text(text)
    rng = np.random.default_rng(seed)
    rms = packing.max_level / 3
    parts = [rng.normal(0, rms, count) for _ in range(1 if packing.is_real else 2)]
    return packing.pack(*(np.clip(part, -packing.max_level, packing.max_level) for part in parts))


@pytest.fixture
def recording(tmp_path):
    path = tmp_path / "a.bin"
    noise("iq8", 50_000).tofile(path)
    return path


def joined(source):
    blocks = list(source.blocks())
    expected = blocks[0].sample_index
    for block in blocks:
        assert block.sample_index == expected
        assert block.data.size == source.format.bytes_for(block.sample_count)
        expected += block.sample_count
    return blocks, np.concatenate([block.data for block in blocks])


def test_blocks_are_the_file(recording):
    source = open_if_file(recording, format="iq8", sample_rate_hz=RATE)
    blocks, data = joined(source)
    assert [block.sample_count for block in blocks] == [20_000, 20_000, 10_000]
    assert source.total_samples == 50_000
    np.testing.assert_array_equal(data, np.fromfile(recording, np.uint8))


def test_blocks_can_be_asked_for_again(recording):
    source = open_if_file(recording, format="iq8", sample_rate_hz=RATE)
    np.testing.assert_array_equal(joined(source)[1], joined(source)[1])
    assert len(source.remarks) == 1


def test_a_short_last_block_is_delivered_exactly_and_remarked(recording):
    source = open_if_file(recording, format="iq8", sample_rate_hz=RATE)
    assert list(source.blocks())[-1].sample_count == 10_000
    [remark] = source.remarks
    assert (remark.kind, remark.sample_index) == ("short_end", 50_000)
    assert "10000 of 20000" in remark.text


def test_a_cut_last_sample_is_left_out_and_remarked(recording):
    os.truncate(recording, 80_001)
    source = open_if_file(recording, format="iq8", sample_rate_hz=RATE)
    assert joined(source)[1].size == 80_000
    assert [remark.kind for remark in source.remarks] == ["short_end"]
    assert "1 bytes at the end" in source.remarks[0].text


def test_a_file_of_whole_blocks_has_no_remarks(recording):
    os.truncate(recording, 80_000)
    source = open_if_file(recording, format="iq8", sample_rate_hz=RATE)
    joined(source)
    assert source.remarks == []


def test_a_file_that_shrinks_while_read_ends_short(recording):
    source = open_if_file(recording, format="iq8", sample_rate_hz=RATE)
    stream = source.blocks()
    next(stream)
    os.truncate(recording, 60_001)
    assert [block.sample_count for block in stream] == [10_000]
    assert source.remarks[0].missing_samples == 20_000


@pytest.mark.parametrize("text", ["real1", "iq1", "iq2 interleave=byte", "iq16", "real4"])
def test_start_and_length_select_samples_of_the_recording(tmp_path, text):
    path = tmp_path / "a.bin"
    packing = IfFormat.from_text(text)
    data = noise(text, 100_000)
    data.tofile(path)
    source = open_if_file(path, format=text, sample_rate_hz=RATE, start=0.030003, length=0.05)
    first = 30003 // packing.samples_per_unit * packing.samples_per_unit
    blocks, part = joined(source)
    assert blocks[0].sample_index == first
    assert sum(block.sample_count for block in blocks) == 50_000
    start = packing.bytes_for(first)
    np.testing.assert_array_equal(part, data[start : start + packing.bytes_for(50_000)])
    assert source.remarks == []


def test_the_descriptor_beside_the_recording_is_used(recording):
    written = IfDescriptor(IfFormat.from_text("iq8"), 4e6, 1.5e3, 1_638_434_820 * 10**9, 100)
    write_descriptor(recording, written)
    source = IfFile(recording)
    assert source.descriptor == written
    assert source.total_samples == 49_950
    assert source.start_utc_ns == 1_638_434_820 * 10**9
    np.testing.assert_array_equal(joined(source)[1], np.fromfile(recording, np.uint8)[100:])


def test_a_descriptor_written_by_hand_is_understood(recording):
    descriptor_path(recording).write_text(
        "format: iq8\nsample_rate_hz: 4e6\nstart_utc: 2021-12-02T08:47:00.25Z\n"
    )
    source = IfFile(recording)
    assert (source.sample_rate_hz, source.intermediate_frequency_hz) == (4e6, 0.0)
    assert source.start_utc_ns == 1_638_434_820_250_000_000


def test_arguments_win_over_the_descriptor(recording):
    write_descriptor(recording, IfDescriptor(IfFormat.from_text("real8"), 4e6))
    source = open_if_file(recording, format="iq8", sample_rate_hz=2e6)
    assert (source.format.to_text(), source.sample_rate_hz) == ("iq8", 2e6)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("format: iq8", "sample_rate_hz is not known"),
        ("sample_rate_hz: 4e6", "format is not known"),
        ("format: iq9\nsample_rate_hz: 4e6", "neither a descriptor nor a known name"),
        ("format: iq8\nsample_rate_hz: fast", "'fast', not a number"),
        ("format: iq8\nsample_rate_hz: -1", "sample_rate_hz is -1"),
        ("format: iq8\nsample_rate_hz: .nan", "not a number"),
        ("format: iq8\nsample_rate_hz: 4e6\nrate: 3", "unknown key 'rate'"),
        ("format: iq8\nsample_rate_hz: 4e6\nstart_utc: soon", "no date"),
        ("format: iq8\nsample_rate_hz: 4e6\nheader_bytes: -2", "header_bytes"),
        ("- a\n- b", "is not a descriptor"),
        ("a: [", "is not a descriptor: is not YAML"),
    ],
)
def test_a_wrong_descriptor_is_refused_with_its_reason(recording, text, reason):
    descriptor_path(recording).write_text(text)
    with pytest.raises(InputError, match=reason):
        IfFile(recording)


def test_what_is_no_recording_is_refused(tmp_path):
    given_format = {"format": "iq8", "sample_rate_hz": RATE}
    (tmp_path / "empty").touch()
    (tmp_path / "one").write_bytes(b"\1")
    os.mkfifo(tmp_path / "pipe")
    reasons = {
        ".": "is a directory",
        "absent": "No such file",
        "empty": "is empty",
        "one": "1 bytes hold no sample",
        "pipe": "not a regular file",
    }
    for name, reason in reasons.items():
        with pytest.raises(InputError, match=reason):
            open_if_file(tmp_path / name, **given_format)


def test_a_start_or_length_outside_the_recording_is_refused(recording):
    for part in ({"start": 0.05}, {"start": -1.0}, {"length": 0.0}, {"start": float("nan")}):
        with pytest.raises(InputError, match=r"outside|not positive"):
            open_if_file(recording, format="iq8", sample_rate_hz=RATE, **part)


@pytest.mark.parametrize("byte", [0, 1, 0x55, 255])
@pytest.mark.parametrize("text", ["iq8", "iq16", "real8"])
def test_a_constant_stream_is_refused(tmp_path, text, byte):
    path = tmp_path / "a.bin"
    path.write_bytes(bytes([byte]) * 100_000)
    with pytest.raises(InputError, match="are constant"):
        open_if_file(path, format=text, sample_rate_hz=RATE)
    source = open_if_file(path, format=text, sample_rate_hz=RATE, check_levels=False)
    assert joined(source)[1].size == 100_000


@pytest.mark.parametrize(
    ("written", "read"),
    [
        ("iq8 coding=offset_binary", "iq8"),
        ("real8", "real8 coding=offset_binary"),
        ("real16", "real16 order=msb_first"),
        ("real16", "iq8"),
        ("real8", "real1"),
        ("real8", "real2"),
        ("iq4", "iq1"),
    ],
)
def test_levels_that_the_format_cannot_give_are_refused(tmp_path, written, read):
    path = tmp_path / "a.bin"
    packing = IfFormat.from_text(written)
    samples = np.random.default_rng(1).normal(0, packing.max_level / 8, (2, 100_000))
    packing.pack(*samples[: 1 if packing.is_real else 2]).tofile(path)
    open_if_file(path, format=written, sample_rate_hz=RATE)
    with pytest.raises(InputError, match="cannot be"):
        open_if_file(path, format=read, sample_rate_hz=RATE)


def test_text_is_no_recording(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("The quick brown fox jumps over the lazy dog.\n" * 1000)
    for text in ("real8", "real16", "iq1", "real2"):
        with pytest.raises(InputError, match="cannot be"):
            open_if_file(path, format=text, sample_rate_hz=RATE)


def test_a_scale_is_written_into_the_format_where_baseband_needs_one(tmp_path):
    path = tmp_path / "a.bin"
    noise("iq16", 50_000).tofile(path)
    source = open_if_file(path, format="iq16", sample_rate_hz=RATE)
    assert source.format.scale == 2.0**-9  # 16 <= 10923 * 2**-9 < 32
    assert next(source.blocks()).format == "iq16 scale=0.001953125"


@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    data=st.binary(max_size=3000),
    text=st.sampled_from(["iq8", "real1", "iq2 interleave=byte", "iq16", "qi4", "real2"]),
    start=st.floats(0, 0.003),
)
def test_garbage_is_delivered_as_it_is_or_refused(tmp_path, data, text, start):
    path = tmp_path / "garbage.bin"
    path.write_bytes(data)
    try:
        source = open_if_file(path, format=text, sample_rate_hz=RATE, start=start)
    except InputError:
        return
    _, part = joined(source)
    first = source.format.bytes_for(source.first_sample)
    assert part.tobytes() == data[first : first + part.size]


REAL = [
    ("pocketsdr/L1_20211202_084700_4MHz_IQ.bin", "pocketsdr_iq8", 4e6, 0.5),
    ("pocketsdr/L1_20211125_004000_12MHz_I.bin", "pocketsdr_i8", 12e6, 0.1),
    ("pocketsdr/L1_20211201_054600_24MHz_I.bin", "pocketsdr_i8", 24e6, 0.1),
    ("sxnsr_flight/sxnsr_test_data_flight.stream", "sxnsr", 20.48e6, 0.10703125),
    ("independent_sim/still_40s_4MHz_1bit_iq.bin", "independent_sim", 4e6, 40.0),
]


@pytest.mark.parametrize(("file", "text", "rate", "duration"), REAL)
def test_real_recordings_open_in_their_format(shared_data, file, text, rate, duration):
    path = shared_data / "if_captures" / file
    source = open_if_file(path, format=text, sample_rate_hz=rate)
    assert source.total_samples == round(duration * rate)
    assert next(source.blocks()).sample_count == round(0.02 * rate)


@pytest.mark.parametrize(("file", "text", "rate", "duration"), REAL)
def test_real_recordings_are_refused_in_formats_of_other_widths(
    shared_data, file, text, rate, duration
):
    path = shared_data / "if_captures" / file
    others = ["real1", "real2", "real16 order=msb_first"] if "8" in text else ["real8", "real16"]
    for other in others:
        with pytest.raises(InputError, match="cannot be"):
            open_if_file(path, format=other, sample_rate_hz=rate)


def test_a_snapshot_opens_once_decoded(shared_data, tmp_path):
    folder = shared_data / "if_captures" / "snappergps"
    snapshots = json.loads((folder / "snapshots_w00.json").read_text())["snapshots"]
    path = tmp_path / "snapshot.bin"
    for snapshot in snapshots[:5]:
        path.write_bytes(base64.b64decode(snapshot["data"]))
        source = open_if_file(
            path, format="snappergps", sample_rate_hz=4.092e6, intermediate_frequency_hz=4.092e6
        )
        assert source.total_samples == 49104
