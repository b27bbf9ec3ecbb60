"""The index of a long recording waits on the disk, and stands in the file as if it had not."""

from functools import partial

from mcap.reader import make_reader

from deepseis_bringup.bags import mcap_file
from deepseis_bringup.bags.mcap_file import McapFile
from deepseis_bringup.bags.spilled_bytes import SpilledBytes

PARTS = [bytes([k % 256]) * (1 + k % 7) for k in range(2000)]
LIMIT = 5000


def gathered(folder, limit):
    bytes_ = SpilledBytes(folder, limit)
    for part in PARTS:
        bytes_.add(part)
        yield bytes_


def test_memory_is_bounded_and_all_comes_back_in_order(tmp_path):
    most = 0
    for whole in gathered(tmp_path, 100):
        most = max(most, whole.in_memory)
    assert most <= 100
    assert whole.take() == b"".join(PARTS)
    assert whole.take() == b""
    assert not list(tmp_path.iterdir())


def test_what_the_disk_refuses_stays_in_memory(tmp_path):
    (*_, whole) = gathered(tmp_path / "gone", 100)
    assert whole.in_memory == len(b"".join(PARTS))
    assert whole.take() == b"".join(PARTS)


def test_a_write_that_fails_half_way_is_made_good_by_the_next(tmp_path):
    """Of the second spill half comes through, and then the disk is full for once."""
    whole = SpilledBytes(tmp_path, 10)
    whole.add(b"0123456789a")
    file, tries = whole._file, []

    class Full:
        seek, read, close = file.seek, file.read, file.close

        @staticmethod
        def write(data):
            tries.append(len(data))
            if len(tries) == 2:
                raise OSError(28, "No space left on device")
            return file.write(data[:4])

    whole._file = Full()
    for part in (b"bcdefghijklm", b"n", b"o"):
        whole.add(part)
    assert whole.in_memory == 1
    assert whole.take() == b"0123456789abcdefghijklmno"


def recorded(path):
    """Record 400 messages, each in a chunk of its own; returns the most of the index in memory."""
    file, most = McapFile(path), 0
    number = file.add_channel("/a", "test_msgs/msg/Pair", b"int32 a", {})
    for k in range(400):
        file.write(number, 10**18 + k, 10**18 + k, b"x" * (k % 50))
        most = max(most, file._summary.chunks.in_memory)
    file.close()
    return most


def test_a_file_is_the_same_whether_its_index_was_spilled_or_not(tmp_path, monkeypatch):
    monkeypatch.setattr(mcap_file, "CHUNK_BYTES", 1)
    recorded(tmp_path / "kept.mcap")
    monkeypatch.setattr(mcap_file, "SpilledBytes", partial(SpilledBytes, largest=LIMIT))
    assert recorded(tmp_path / "spilled.mcap") <= LIMIT
    kept, spilled = ((tmp_path / f"{name}.mcap").read_bytes() for name in ("kept", "spilled"))
    assert spilled == kept
    with (tmp_path / "spilled.mcap").open("rb") as stream:
        reader = make_reader(stream)
        assert len(reader.get_summary().chunk_indexes) == 400
        times = [message.log_time for _, _, message in reader.iter_messages()]
    assert times == [10**18 + k for k in range(400)]
