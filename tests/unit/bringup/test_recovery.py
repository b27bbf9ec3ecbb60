"""Bags that were cut, damaged, lost their metadata: everything that can be read comes back."""

import os
import struct

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from rosbags.highlevel import AnyReader

from deepseis_bringup.bags.archive import Archive, ArchiveConfig
from deepseis_bringup.bags.info import bag_info
from deepseis_bringup.bags.mcap_file import McapFile
from deepseis_bringup.bags.mcap_recording import read_messages
from deepseis_bringup.bags.recovery import Loss, recover_bag
from deepseis_bringup.bags.ros_definitions import Definitions
from deepseis_bringup.bags.text import damage_lines, recovery_lines
from deepseis_core.errors import InputError
from deepseis_core.mcap_scan import MAGIC, McapScan
from deepseis_frontend.if_bag import bag_files, mcap_files

TYPE = "test_msgs/msg/Data"
DEFINITIONS = Definitions({TYPE: "uint8[] data\n"})
START = 10**18
SECOND = 10**9
COUNT = 12


def stamp(k):
    return START + k * SECOND


def build(path, compression="zstd"):
    """Write a file of twelve chunks, each with two messages on ``/a`` and one on ``/b``."""
    file = McapFile(path, flush_interval=1e6, compression=compression)
    file.add_metadata("deepseis", {"interface_version": "1"})
    a, b = (file.add_channel(name, TYPE, DEFINITIONS.schema(TYPE), {}) for name in ("/a", "/b"))
    for k in range(COUNT):
        with file._wake:
            for channel, part in ((a, 0), (a, 1), (b, 0)):
                file.write(channel, stamp(k) + part, 0, struct.pack("<4xIII", k, channel, part))
            file._close_chunk()
    file.close()


@pytest.fixture(scope="module", params=["zstd", "none"])
def whole(request, tmp_path_factory):
    """A whole file's bytes, its records (opcode, begin, end), and its messages chunk by chunk."""
    path = tmp_path_factory.mktemp("whole") / "a.mcap"
    build(path, request.param)
    data = path.read_bytes()
    records, at = [], len(MAGIC)
    while at < len(data) - len(MAGIC):
        opcode, length = struct.unpack_from("<BQ", data, at)
        records.append((opcode, at, at + 9 + length))
        at += 9 + length
    return data, records


def chunks(records):
    return [(begin, end) for opcode, begin, end in records if opcode == Opcode.CHUNK]


def expected(numbers):
    """Stamps of the messages of some chunks, by topic."""
    return {
        "/a": [stamp(k) + part for k in numbers for part in (0, 1)],
        "/b": [stamp(k) for k in numbers],
    }


def found(path):
    out = {"/a": [], "/b": []}
    for message in McapScan(path).messages():
        out[message.channel.topic].append(message.log_time_ns)
    return out


def folder_with(tmp_path_factory, data, name="bag_0.mcap"):
    folder = tmp_path_factory.mktemp("bag")
    (folder / name).write_bytes(data)
    return folder


def offsets(records, size):
    """Every kind of place: in a record's opcode, length, head, middle, at its end, and beside."""
    places = {0, 1, len(MAGIC) - 1, len(MAGIC), size - 1, size - len(MAGIC), size - len(MAGIC) - 1}
    later = {opcode: (begin, end) for opcode, begin, end in records}  # the last of each kind
    chosen = [*records[:9], *((0, begin, end) for begin, end in later.values())]
    for _, begin, end in chosen:
        places |= {begin, begin + 1, begin + 5, begin + 9, begin + 10, (begin + end) // 2, end - 1}
    return sorted(place for place in places if place < size)


def test_a_cut_at_every_kind_of_place_keeps_all_whole_chunks_before(whole, tmp_path_factory):
    data, records = whole
    tried = 0
    for cut in offsets(records, len(data)):
        folder = folder_with(tmp_path_factory, data[:cut])
        kept = [k for k, (_, end) in enumerate(chunks(records)) if end <= cut]
        if not kept:
            with pytest.raises(InputError):
                recover_bag(folder)
            assert [item.read_bytes() for item in folder.iterdir()] == [data[:cut]]
            continue
        [result] = recover_bag(folder)
        assert found(folder / "bag_0.mcap") == expected(kept)
        assert result.messages == 3 * len(kept)
        assert bag_info(folder).is_whole
        assert (folder / "metadata.yaml").is_file()
        assert result.was_whole or result.kept_as.read_bytes() == data[:cut]
        tried += 1
    assert tried > 60


@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
@given(place=st.floats(0.0, 1.0), size=st.integers(1, 400), junk=st.binary(max_size=400))
@example(place=0.5, size=1, junk=b"")
@example(place=0.0, size=1, junk=b"\x02")  # the file's end, by its type
@example(place=0.625, size=176, junk=b"\0\0")  # its length leads into the next, between messages
def test_damage_in_the_middle_costs_the_chunks_that_it_touches(
    whole, tmp_path_factory, place, size, junk
):
    """Bytes replaced by others, more or fewer: what is before and behind comes back."""
    data, records = whole
    spans = chunks(records)
    first, last = spans[0][0], spans[-1][1]
    at = first + round(place * (last - first - 1))
    folder = folder_with(tmp_path_factory, data[:at] + junk + data[at + size :])
    untouched = [k for k, (begin, end) in enumerate(spans) if end <= at or begin >= at + size]
    recover_bag(folder)
    kept = found(folder / "bag_0.mcap")
    for topic, stamps in expected(untouched).items():
        assert set(kept[topic]) >= set(stamps)
        assert set(kept[topic]) <= set(expected(range(COUNT))[topic])  # nothing is invented
        assert kept[topic] == sorted(kept[topic])


@pytest.mark.parametrize("hurt", [0, 5, COUNT - 1])
@pytest.mark.parametrize("opcode", [*range(1, 17), 0x80, 0xFF])
def test_a_chunk_that_calls_itself_another_record_is_lost_alone_and_said(
    whole, tmp_path_factory, opcode, hurt
):
    """As the file's end (2, 15) it hid all behind it; as an index (7, 8) it was passed over."""
    if opcode == Opcode.CHUNK:
        return
    data, records = whole
    spoilt = bytearray(data)
    spoilt[chunks(records)[hurt][0]] = opcode
    folder = folder_with(tmp_path_factory, spoilt)
    info = bag_info(folder)
    assert not info.is_whole
    assert damage_lines(info) != damage_lines(bag_info(folder_with(tmp_path_factory, data)))
    [result] = recover_bag(folder)
    assert not result.was_whole
    assert found(folder / "bag_0.mcap") == expected([k for k in range(COUNT) if k != hurt])
    assert bag_info(folder).is_whole
    told = {loss.topic: loss.count for loss in result.losses}
    assert told == ({"/a": -1, "/b": -1} if hurt == COUNT - 1 else {"/a": 2, "/b": 1})


@pytest.mark.parametrize("kind", [Opcode.CHUNK_INDEX, Opcode.STATISTICS, Opcode.FOOTER])
def test_a_damaged_index_is_made_anew(whole, tmp_path_factory, kind):
    """All messages are there, but whoever goes by the index is led astray."""
    data, records = whole
    (begin, end) = next((begin, end) for opcode, begin, end in records if opcode == kind)
    spoilt = bytearray(data)
    spoilt[(begin + 9 + end) // 2] ^= 0x82
    folder = folder_with(tmp_path_factory, spoilt)
    assert not bag_info(folder).is_whole
    [result] = recover_bag(folder)
    assert (result.was_whole, result.losses) == (False, ())
    assert bag_info(folder).is_whole
    times = [m.log_time_ns for m in read_messages(bag_files(folder))]
    assert sorted(times) == sorted(t for stamps in expected(range(COUNT)).values() for t in stamps)


@pytest.mark.parametrize("opcode", [Opcode.FOOTER, Opcode.DATA_END])
def test_who_reads_no_damage_is_told_of_an_end_that_is_none(whole, tmp_path_factory, opcode):
    data, records = whole
    spoilt = bytearray(data)
    spoilt[chunks(records)[5][0]] = opcode
    folder = folder_with(tmp_path_factory, spoilt)
    with pytest.raises(InputError, match="is damaged at byte"):
        found(folder / "bag_0.mcap")


@pytest.mark.parametrize("hurt", [[0], [5], [COUNT - 1], [0, 1, 2], range(1, COUNT)])
def test_a_checksum_that_became_zero_is_damage(whole, tmp_path_factory, hurt):
    data, records = whole
    spans, spoilt = chunks(records), bytearray(data)
    for k in hurt:
        begin, end = spans[k]
        spoilt[begin + 33 : begin + 37] = bytes(4)  # opcode, length, two times, size: the checksum
        if data[begin + 37]:  # zstd: then what is packed can be read, and is refused all the same
            continue
        spoilt[end - 4] ^= 0xFF
    folder = folder_with(tmp_path_factory, spoilt)
    recover_bag(folder)
    assert found(folder / "bag_0.mcap") == expected([k for k in range(COUNT) if k not in hurt])


def test_a_file_whose_writer_gives_no_checksums_is_believed(whole, tmp_path_factory):
    data, records = whole
    bare = bytearray(data)
    for begin, _ in chunks(records):
        bare[begin + 33 : begin + 37] = bytes(4)
    path = folder_with(tmp_path_factory, bare) / "bag_0.mcap"
    assert found(path) == expected(range(COUNT))
    # Also where damage has made a checksum out of none: it fits nothing.
    begin, _ = chunks(records)[4]
    bare[begin + 33 : begin + 37] = b"abcd"
    folder = folder_with(tmp_path_factory, bare)
    recover_bag(folder)
    assert found(folder / "bag_0.mcap") == expected([k for k in range(COUNT) if k != 4])


def test_garbage_and_zeros_behind_the_end_are_left_behind(whole, tmp_path_factory):
    data, records = whole
    end = chunks(records)[-1][1]
    for tail in (bytes(100_000), b"\x07" * 5000, os.urandom(3000), b"\x06" + bytes(60), data):
        folder = folder_with(tmp_path_factory, data[:end] + tail)
        recover_bag(folder)
        kept = found(folder / "bag_0.mcap")
        assert kept["/a"][: 2 * COUNT] == expected(range(COUNT))["/a"]


def test_what_is_lost_is_told_by_topic_and_time(whole, tmp_path_factory):
    data, records = whole
    spans = chunks(records)
    hurt = bytearray(data[: spans[8][0] + 40])  # cut in chunk 8
    for k in (3, 4):
        hurt[spans[k][1] - 20] ^= 0xFF
    folder = folder_with(tmp_path_factory, hurt)
    [result] = recover_bag(folder)
    assert (result.messages, result.damaged_chunks) == (18, 2)
    assert result.losses == (
        Loss("/a", 4, stamp(2) + 1, stamp(5)),
        Loss("/b", 2, stamp(2), stamp(5)),
        Loss("/a", -1, stamp(7) + 1, 0),
        Loss("/b", -1, stamp(7), 0),
    )
    text = "\n".join(recovery_lines([result]))
    assert "/a: 4 lost between 2001-09-09 01:46:42.000 UTC and 2001-09-09 01:46:45.000 UTC" in text
    assert "/b: nothing after 2001-09-09 01:46:47.000 UTC" in text


def test_damaged_files_stay_unless_told_otherwise(whole, tmp_path_factory):
    data, _ = whole
    cut = data[: len(data) // 2]
    kept = folder_with(tmp_path_factory, cut)
    [result] = recover_bag(kept)
    assert result.kept_as == kept / "bag_0.mcap.damaged"
    assert result.kept_as.read_bytes() == cut
    (kept / "bag_0.mcap").write_bytes(cut)
    [again] = recover_bag(kept)
    assert again.kept_as == kept / "bag_0.mcap.damaged1"
    replaced = folder_with(tmp_path_factory, cut)
    [result] = recover_bag(replaced, replace=True)
    assert result.kept_as is None
    assert {item.name for item in replaced.iterdir()} == {"bag_0.mcap", "metadata.yaml"}


def test_a_bag_is_made_whole_in_another_place(whole, tmp_path_factory):
    data, _ = whole
    folder = folder_with(tmp_path_factory, data[: len(data) // 2])
    (folder / "bag_1.mcap").write_bytes(data)
    before = {item.name: item.read_bytes() for item in folder.iterdir()}
    target = tmp_path_factory.mktemp("elsewhere") / "whole"
    recover_bag(folder, target=target)
    assert {item.name: item.read_bytes() for item in folder.iterdir()} == before
    assert bag_info(target).is_whole
    assert found(target / "bag_1.mcap") == expected(range(COUNT))
    with pytest.raises(InputError, match="is not empty"):
        recover_bag(folder, target=target)


def test_another_name_of_the_file_keeps_what_was_in_it(whole, tmp_path_factory):
    data, _ = whole
    folder = folder_with(tmp_path_factory, data[:-500])
    other = tmp_path_factory.mktemp("other") / "copy.mcap"
    os.link(folder / "bag_0.mcap", other)
    recover_bag(folder, replace=True)
    assert other.read_bytes() == data[:-500]


def test_several_files_of_which_some_are_lost(tmp_path):
    """One cut, one empty, one no MCAP at all, metadata that name files that are gone."""
    folder = tmp_path / "bag"
    config = ArchiveConfig(split_s=10.0)
    with Archive(folder, config=config, definitions=DEFINITIONS, flush_interval=0.0) as bag:
        for k in range(60):
            bag.write("/a", TYPE, struct.pack("<4xI", k), stamp(k), 0)
    files = bag_files(folder)
    assert len(files) == 6
    os.truncate(files[1], files[1].stat().st_size - 1)
    os.truncate(files[2], 0)
    files[3].write_bytes(b"no bag, but two hundred bytes of something else" * 5)
    files[4].unlink()
    results = recover_bag(folder)
    assert [(r.path.name, r.was_whole, r.messages) for r in sorted(results, key=str)] == [
        ("bag_0.mcap", True, 10),
        ("bag_1.mcap", False, 10),
        ("bag_2.mcap", False, 0),
        ("bag_3.mcap", False, 0),
        ("bag_5.mcap", True, 10),
    ]
    stamps = [m.log_time_ns for m in read_messages(bag_files(folder))]
    assert stamps == [stamp(k) for k in (*range(20), *range(50, 60))]
    with AnyReader([folder]) as reader:
        assert reader.message_count == 30


def test_metadata_come_back_with_every_file(tmp_path):
    folder = tmp_path / "bag"
    config = ArchiveConfig(split_s=1.0)
    with Archive(folder, config=config, definitions=DEFINITIONS) as bag:
        for k in range(12):
            bag.write("/a", TYPE, struct.pack("<4xI", k), stamp(k), 0)
    facts = (folder / "metadata.yaml").read_text()
    (folder / "metadata.yaml").unlink()
    assert all(result.was_whole for result in recover_bag(folder))
    assert (folder / "metadata.yaml").read_text() == facts
    assert bag_files(folder) == mcap_files(folder)


def test_a_file_that_may_not_be_written_is_named(whole, tmp_path_factory, monkeypatch):
    data, _ = whole
    folder = folder_with(tmp_path_factory, data[:-500])

    def refuse(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(InputError, match=r"bag_0\.mcap: cannot be recovered: Permission denied"):
        recover_bag(folder, replace=True)
    assert [item.name for item in folder.iterdir()] == ["bag_0.mcap"]
    assert (folder / "bag_0.mcap").read_bytes() == data[:-500]


@pytest.mark.parametrize("content", [b"", MAGIC, b"x" * 100])
def test_nothing_to_recover_is_said_and_nothing_changed(tmp_path, content):
    (tmp_path / "bag_0.mcap").write_bytes(content)
    with pytest.raises(InputError):
        recover_bag(tmp_path)
    assert [item.read_bytes() for item in tmp_path.iterdir()] == [content]
    with pytest.raises(InputError, match="holds no bag"):
        recover_bag(tmp_path.parent)
