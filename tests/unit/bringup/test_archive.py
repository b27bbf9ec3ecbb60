"""The recording of months: files that come and go, a full disk, clocks that are set, kill -9."""

import errno
import os
import random
import signal
import struct
import subprocess
import sys
import textwrap
import threading
import time

import pytest
from rosbags.highlevel import AnyReader

from deepseis_bringup.bags import mcap_file
from deepseis_bringup.bags.archive import Archive, ArchiveConfig
from deepseis_bringup.bags.archive_report import ERROR, OK, WARN, disk_report
from deepseis_bringup.bags.info import bag_info
from deepseis_bringup.bags.mcap_recording import BagWriter, read_messages
from deepseis_bringup.bags.recording_queue import about_whom, event_span
from deepseis_bringup.bags.recovery import recover_bag
from deepseis_bringup.bags.ros_definitions import Definitions
from deepseis_bringup.run_folder import half_written_is_removed
from deepseis_core.errors import DiskError, InputError
from deepseis_core.mcap_scan import McapScan
from deepseis_frontend.if_bag import bag_files, first_messages, mcap_files

DATA, STATION = "test_msgs/msg/Data", "test_msgs/msg/Said"
DEFINITIONS = Definitions({DATA: "uint8[] data\n", STATION: "string text\n"})
START = 10**18
SECOND = 10**9
RNG = random.Random(7)


def payload(k, size=1000):
    """Return bytes that do not compress, numbered."""
    return b"\0\1\0\0" + struct.pack("<I", k) + random.Random(k).randbytes(size)


def archive(folder, free=10**12, **config):
    options = {
        name: config.pop(name)
        for name in ("patient", "compression", "flush_interval")
        if name in config
    }
    return Archive(
        folder,
        {"run": {"satellites": "G01"}},
        config=ArchiveConfig(**config),
        keys={"/said": lambda cdr: cdr[8:9].decode()},
        free=free if callable(free) else lambda _folder: free,
        definitions=DEFINITIONS,
        **options,
    )


def said(text, k):
    return b"\0\1\0\0" + struct.pack("<I", len(text)) + text.encode() + struct.pack("<I", k)


def fill(bag, seconds, *, begin=0, step=1, events=()):
    """Write one message a second, what lasts every tenth; the thread is given its time."""
    for k in range(begin, begin + seconds, step):
        stamp = START + k * SECOND
        if k in (0, 5):
            bag.write("/said", STATION, said("ab"[k > 0], k), stamp, stamp)
        bag.write("/data", DATA, payload(k), stamp, stamp)
        if k in events:
            bag.keep(stamp, stamp + 3 * SECOND)
        bag.settle()


def numbers(folder, topic="/data"):
    return [
        struct.unpack_from("<I", message.data, 4)[0]
        for message in read_messages(bag_files(folder), [topic])
    ]


def test_files_together_hold_what_one_file_would(tmp_path):
    with archive(tmp_path / "one") as one, archive(tmp_path / "many", split_s=10.0) as many:
        fill(one, 95)
        fill(many, 95)
    assert len(bag_files(tmp_path / "one")) == 1
    files = bag_files(tmp_path / "many")
    assert [file.name for file in files] == [f"many_{k}.mcap" for k in range(10)]
    assert numbers(tmp_path / "many") == numbers(tmp_path / "one") == list(range(95))
    info = bag_info(tmp_path / "many")
    assert info.is_whole
    assert info.metadata["run"] == {"satellites": "G01"}
    with AnyReader([tmp_path / "many"]) as reader:
        assert reader.message_count == 97
    for file in files:
        assert bag_info(file).metadata["run"] == {"satellites": "G01"}


def test_files_are_in_order_without_metadata_too(tmp_path):
    with archive(tmp_path / "bag", split_s=1.0) as bag:
        fill(bag, 12)
    (tmp_path / "bag" / "metadata.yaml").unlink()
    assert numbers(tmp_path / "bag") == list(range(12))
    (tmp_path / "bag" / "bag_12.mcap").touch()  # as a loss of power leaves it
    assert numbers(tmp_path / "bag") == list(range(12))


def test_a_file_ends_at_its_size(tmp_path):
    with archive(tmp_path / "bag", split_mb=0.02, flush_interval=0.0) as bag:
        for k in range(100):
            bag.write("/data", DATA, payload(k), START + k, START + k)
            while bag.file.unwritten:
                time.sleep(0.001)
    sizes = [file.stat().st_size for file in bag_files(tmp_path / "bag")]
    assert len(sizes) == pytest.approx(5, abs=1)
    assert max(sizes) < 0.02e6 + 4000
    assert numbers(tmp_path / "bag") == list(range(100))


def test_the_ring_keeps_the_last_hours_and_whole_files(tmp_path):
    with archive(tmp_path / "bag", split_s=10.0, keep_h=50 / 3600, pre_event_s=1.0) as bag:
        fill(bag, 200)
        state = bag.state()
    kept = numbers(tmp_path / "bag")
    assert kept == list(range(kept[0], 200))
    assert 50 <= 200 - kept[0] <= 70  # the hours asked for, and at most a file more at either end
    assert state.deleted == kept[0] // 10
    assert (200 - kept[0]) * 1000 < state.size < (200 - kept[0]) * 1400


def test_the_budget_holds_at_all_times(tmp_path):
    folder = tmp_path / "bag"
    largest = 0
    with archive(folder, split_s=10.0, budget_gb=50e-6) as bag:
        for k in range(0, 300, 10):
            fill(bag, 10, begin=k)
            largest = max(largest, sum(file.stat().st_size for file in folder.iterdir()))
    assert largest < 50e3 + 16e3  # a file in the making, and the head
    kept = numbers(folder)
    assert kept == list(range(kept[0], 300))
    assert len(kept) >= 30


def test_what_lies_around_an_event_is_kept_for_ever(tmp_path):
    limits = {"split_s": 10.0, "keep_h": 40 / 3600, "pre_event_s": 15.0, "post_event_s": 20.0}
    with archive(tmp_path / "bag", **limits) as bag:
        fill(bag, 300, events=(100,))
        assert bag.state().kept_for_events == 5  # 80-89 to 120-129
    kept = set(numbers(tmp_path / "bag"))
    assert kept >= set(range(85, 124))  # 15 s before the onset to 20 s after the last report
    assert not kept & set(range(80))
    assert not kept & set(range(130, 240))
    assert kept >= set(range(260, 300))


def test_what_is_said_once_outlives_the_file_that_it_was_said_in(tmp_path):
    limits = {"split_s": 10.0, "keep_h": 40 / 3600, "pre_event_s": 5.0, "post_event_s": 5.0}
    with archive(tmp_path / "bag", **limits) as bag:
        fill(bag, 100, events=(60,))
        bag.write("/said", STATION, said("a", 100), START + 100 * SECOND, START + 100 * SECOND)
        fill(bag, 300, begin=101)
    files = bag_files(tmp_path / "bag")
    assert files[0].name == "bag_head.mcap"
    found = [bytes(m.data) for m in read_messages(files, ["/said"])]
    assert found == [said("a", 0), said("b", 5), said("a", 100)]
    first = next(iter(first_messages(tmp_path / "bag", 1)))
    assert bytes(first.data) == said("a", 0)
    assert McapScan(files[0]).channels == {}  # not read yet
    assert bag_info(tmp_path / "bag").is_whole


def test_limits_that_would_delete_the_only_file_are_refused(tmp_path):
    with pytest.raises(InputError, match="split_s or split_mb has to be given"):
        archive(tmp_path / "bag", keep_h=1.0)
    with pytest.raises(InputError, match="keep_h is shorter than pre_event_s"):
        archive(tmp_path / "bag", split_s=1.0, keep_h=0.01)


# --- Clocks ----------------------------------------------------------------------------------


def test_a_wall_clock_that_is_set_changes_nothing(tmp_path, monkeypatch):
    def record(folder):
        with archive(folder, split_s=10.0, keep_h=60 / 3600, flush_interval=1e6) as bag:
            fill(bag, 150)
        return {file.name: file.read_bytes() for file in mcap_files(folder)}

    still = record(tmp_path / "a" / "bag")
    steps = iter(RNG.choice((-3600.0, 3600.0, -1e9)) * n for n in range(10**6))
    monkeypatch.setattr(time, "time", lambda: 1e9 + next(steps))
    monkeypatch.setattr(time, "time_ns", lambda: round(1e18 + 1e9 * next(steps)))
    assert record(tmp_path / "b" / "bag") == still
    assert len(still) >= 7


@pytest.mark.parametrize("jump", [-3600, -15, 15, 3600])
def test_stamps_that_jump_do_not_stop_the_splitting(tmp_path, jump):
    with archive(tmp_path / "bag", split_s=10.0) as bag:
        for k in range(100):
            stamp = START + (k + jump * (k >= 50)) * SECOND
            bag.write("/data", DATA, payload(k), stamp, stamp)
            bag.settle()
    files = mcap_files(tmp_path / "bag")
    found = [
        [struct.unpack_from("<I", m.data, 4)[0] for m in McapScan(f).messages()] for f in files
    ]
    assert [k for part in found for k in part] == list(range(100))
    assert max(map(len, found)) <= 30  # before, back to just short of a whole file, and after


def test_a_stamp_of_another_clock_or_one_that_leaps_deletes_nothing(tmp_path):
    """A diagnostic by the wall clock, years ahead; then the stream itself a day ahead."""
    day = 86_400 * SECOND
    with archive(tmp_path / "bag", split_s=10.0, keep_h=50 / 3600, pre_event_s=1.0) as bag:
        for k in range(80):
            stamp = START + k * SECOND + (day if k >= 60 else 0)
            bag.write("/data", DATA, payload(k), stamp, stamp)
            bag.write("/diagnostics", DATA, payload(k), START + 400 * day, START)
            bag.settle()
    kept = [k for f in mcap_files(tmp_path / "bag") for k in numbers_of(f, "/data")]
    assert kept == list(range(kept[0], 80))
    assert 50 <= 80 - kept[0] <= 75
    assert len(mcap_files(tmp_path / "bag")) >= 6


def numbers_of(file, topic):
    return [
        struct.unpack_from("<I", m.data, 4)[0]
        for m in McapScan(file).messages(lambda channel: channel.topic == topic)
    ]


# --- A full disk -----------------------------------------------------------------------------


class SmallDisk:
    """A raw file on a disk with so much room; writes in part, then says that it is full."""

    def __init__(self, file, room):
        self.file, self.room = file, room

    def write(self, data):
        if self.room[0] <= 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        part = self.file.write(data[: self.room[0]])
        self.room[0] -= part
        return part

    def truncate(self, size):
        self.room[0] += self.file.seek(0, os.SEEK_END) - size
        self.file.truncate(size)

    def __getattr__(self, name):
        return getattr(self.file, name)


@pytest.fixture
def small(monkeypatch):
    """Make files of bags think that the disk is full after so many bytes; a list of one number."""
    room = [10**9]
    make = mcap_file.McapFile.__init__

    def on_small_disk(self, path, **options):
        make(self, path, **options)
        self._out._file = SmallDisk(self._out._file, room)

    monkeypatch.setattr(mcap_file.McapFile, "__init__", on_small_disk)
    monkeypatch.setattr(mcap_file, "RETRY_SECONDS", 0.01)
    monkeypatch.setattr(mcap_file, "PENDING_BYTES", 50_000)
    monkeypatch.setattr(mcap_file, "CHUNK_BYTES", 5_000)
    return room


def wait_for(condition, what):
    deadline = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < deadline, what
        time.sleep(0.005)


def write(bag, first, last, pause=0.0):
    for k in range(first, last):
        bag.write("/data", DATA, payload(k), START + k * SECOND, START + k * SECOND)
        time.sleep(pause)


def test_a_disk_that_is_full_for_a_while_costs_nothing_that_memory_holds(tmp_path, small):
    with archive(tmp_path / "bag", patient=True, flush_interval=0.0) as bag:
        write(bag, 0, 20)
        wait_for(lambda: not bag.file.unwritten, "not written")
        small[0] = 7_000
        write(bag, 20, 50)
        wait_for(lambda: bag.file.trouble is not None, "no trouble on a full disk")
        report = disk_report(bag.config, bag.state(), START)
        assert report.level == ERROR
        assert "not recording: No space left on device" in report.text
        small[0] = 10**9
        wait_for(lambda: bag.file.trouble is None, "no recovery")
        write(bag, 50, 60)
    assert numbers(tmp_path / "bag") == list(range(60))
    assert bag_info(tmp_path / "bag").is_whole


def test_a_disk_that_stays_full_costs_the_middle_and_the_bag_says_so(tmp_path, small):
    with archive(tmp_path / "bag", patient=True, flush_interval=0.0, split_s=30.0) as bag:
        write(bag, 0, 20)
        wait_for(lambda: not bag.file.unwritten, "not written")
        small[0] = 3_000
        wait_for(lambda: write(bag, 20, 21) or bag.file.trouble is not None, "no trouble")
        write(bag, 100, 300)  # 200 kB, and memory holds 50
        readable = tmp_path / "bag" / "bag_0.mcap"
        found = [m.log_time_ns for m in McapScan(readable).messages()]  # while the disk is full
        assert len(found) >= 15
        small[0] = 10**9
        wait_for(lambda: bag.file.trouble is None, "no recovery")
        write(bag, 300, 310)
        lost = bag.state().lost
        report = disk_report(bag.config, bag.state(), START)
    assert report.level == WARN
    assert f"{lost} messages lost" in report.text
    kept = numbers(tmp_path / "bag")
    middle = [k for k in kept if 100 <= k < 300]
    assert middle == list(range(100, 300 - lost))
    assert 100 < lost < 200
    assert kept[-10:] == list(range(300, 310))
    info = bag_info(tmp_path / "bag")
    assert info.is_whole
    said_so = info.metadata["not recorded 1"]
    assert said_so["reason"] == "No space left on device"
    assert int(said_so["count"]) == lost
    assert int(said_so["start_ns"]) == START + (300 - lost) * SECOND
    assert int(said_so["end_ns"]) == START + 299 * SECOND


def test_what_was_lost_is_told_also_before_its_file_is_finished(tmp_path, small):
    goes_on = threading.Event()
    with archive(tmp_path / "bag", patient=True, flush_interval=0.0, split_s=30.0) as bag:
        bag._worker.submit(goes_on.wait, 20.0)  # whoever finishes files is busy
        write(bag, 0, 20)
        wait_for(lambda: not bag.file.unwritten, "not written")
        small[0] = 3_000
        wait_for(lambda: write(bag, 20, 21) or bag.file.trouble is not None, "no trouble")
        write(bag, 100, 300)
        lost, first = bag.state().lost, bag.file
        small[0] = 10**9
        wait_for(lambda: bag.file.trouble is None, "no recovery")
        write(bag, 300, 310)
        split, unfinished = bag.file is not first, bag.state().lost
        goes_on.set()
        bag.settle()
        assert split
        assert lost > 100
        assert [unfinished, bag.state().lost] == [lost, lost]


def test_a_disk_that_is_full_at_the_end_leaves_whole_chunks_and_an_error(tmp_path, small):
    bag = archive(tmp_path / "bag", patient=True, flush_interval=0.0)
    write(bag, 0, 20)
    wait_for(lambda: not bag.file.unwritten, "not written")
    small[0] = 3_000
    write(bag, 20, 40)
    wait_for(lambda: bag.file.trouble is not None, "no trouble")
    with pytest.raises(DiskError, match=r"No space left on device; \d+ messages lost$"):
        bag.close()
    left = [m.log_time_ns for m in McapScan(tmp_path / "bag" / "bag_0.mcap").messages()]
    assert left == [START + k * SECOND for k in range(len(left))]
    assert len(left) >= 20
    small[0] = 10**9
    [result] = recover_bag(tmp_path / "bag")
    assert (result.messages, result.lost_bytes) == (len(left), 0)
    assert bag_info(tmp_path / "bag").is_whole


def test_below_the_watermark_recording_pauses_and_goes_on_by_itself(tmp_path, small):
    free = [10**9]
    bag = archive(
        tmp_path / "bag", free=lambda _: free[0], patient=True, flush_interval=0.0, min_free_mb=100
    )
    with bag:
        write(bag, 0, 10)
        wait_for(lambda: not bag.file.unwritten, "not written")
        free[0] = 50 * 10**6
        bag.guard._asked = -1e9
        write(bag, 10, 20)
        wait_for(lambda: bag.file.trouble is not None, "the watermark is ignored")
        before = bag.file.size
        text = disk_report(bag.config, bag.state(), START).text
        assert text == "not recording: less than 100 MB are free on the disk"
        assert bag.file.size == before
        free[0] = 10**9
        wait_for(lambda: bag.file.trouble is None, "no recovery")
    assert numbers(tmp_path / "bag") == list(range(20))


def test_in_lockstep_a_full_disk_ends_the_run(tmp_path, small):
    bag = archive(tmp_path / "bag", flush_interval=0.0)
    small[0] = 3_000
    with pytest.raises(DiskError, match="cannot be written: No space left on device"):
        write(bag, 0, 2000, pause=0.001)
    with pytest.raises(DiskError, match="cannot be written"):
        bag.close()


def test_a_run_that_a_full_disk_ended_is_kept(tmp_path):
    def run(folder, error):
        with half_written_is_removed(folder):
            (folder / "bag_0.mcap").write_bytes(b"what there was room for")
            raise error

    with pytest.raises(DiskError):
        run(tmp_path / "full", DiskError("bag_0.mcap", "cannot be written: No space left"))
    assert (tmp_path / "full" / "bag_0.mcap").exists()
    with pytest.raises(InputError):
        run(tmp_path / "bad", InputError("a.bin", "is empty"))
    assert not (tmp_path / "bad").exists()


def test_a_real_full_disk(tmp_path, monkeypatch):
    """On a file system of 4 MB in memory, where the system lets us mount one."""
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=4m", "tmpfs", str(tmp_path)], capture_output=True
    )
    if mounted.returncode:
        pytest.skip("may not mount a file system here")
    monkeypatch.setattr(mcap_file, "RETRY_SECONDS", 0.01)
    try:
        ballast = tmp_path / "ballast"
        ballast.write_bytes(bytes(2_000_000))
        bag = Archive(
            tmp_path / "bag",
            config=ArchiveConfig(min_free_mb=0.0),
            definitions=DEFINITIONS,
            patient=True,
            flush_interval=0.0,
        )
        with bag:
            write(bag, 0, 1000)
            wait_for(lambda: not bag.file.unwritten, "not written")
            for k in range(1000, 3000):
                bag.write("/data", DATA, payload(k), START + k * SECOND, 0)
            wait_for(lambda: bag.file.trouble is not None, "no trouble on a full disk")
            assert bag.file.trouble.errno == errno.ENOSPC
            assert len(list(McapScan(bag.file.path).messages())) >= 1000
            ballast.unlink()
            wait_for(lambda: bag.file.trouble is None, "no recovery")
        assert numbers(tmp_path / "bag") == list(range(3000))
        assert bag_info(tmp_path / "bag").is_whole
    finally:
        subprocess.run(["umount", str(tmp_path)], check=True)


# --- kill -9 ---------------------------------------------------------------------------------

RECORDER = """
    import sys, time
    from deepseis_bringup.bags.archive import Archive, ArchiveConfig
    from deepseis_bringup.bags.ros_definitions import Definitions
    config = ArchiveConfig(split_s=0.15, keep_h=0.5 / 3600, pre_event_s=0)
    definitions = Definitions({"a/msg/A": "uint8[] data\\n"})
    bag = Archive(sys.argv[1], config=config, definitions=definitions, patient=True)
    k = 0
    while True:
        cdr = b"\\0\\1\\0\\0" + k.to_bytes(4, "little")
        bag.write("/a", "a/msg/A", cdr, time.monotonic_ns(), 0)
        if k % 20 == 0:
            print(k, flush=True)
        k += 1
        time.sleep(0.001)
"""


def test_kill_9_at_any_moment_loses_less_than_a_second(tmp_path):
    """In the middle of chunks, splits, deletions and heads: what is left is gapless to the end."""
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join(p for p in sys.path if p))
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", textwrap.dedent(RECORDER), str(tmp_path / f"{n}" / "bag")],
            stdout=subprocess.PIPE,
            env=environment,
        )
        for n in range(4)
    ]
    killed = []
    for process in processes:
        process.stdout.readline()
    for process in processes:
        time.sleep(RNG.uniform(0.1, 0.7))
        process.send_signal(signal.SIGKILL)
        killed.append(time.monotonic_ns())
        process.stdout.read()
        process.stdout.close()
        process.wait()
    for n, killed_ns in enumerate(killed):
        folder = tmp_path / f"{n}" / "bag"
        recover_bag(folder)
        messages = list(read_messages(bag_files(folder)))
        found = [int.from_bytes(m.data[4:8], "little") for m in messages]
        assert found == list(range(found[0], found[0] + len(found)))
        assert killed_ns - messages[-1].log_time_ns < SECOND
        assert bag_info(folder).is_whole


def test_a_bag_that_is_being_recorded_is_not_recovered(tmp_path):
    with BagWriter(tmp_path / "bag", definitions=DEFINITIONS, flush_interval=0.0) as bag:
        write(bag, 0, 3)
        wait_for(lambda: not bag.file.unwritten, "not written")
        with pytest.raises(InputError, match="is being recorded"):
            recover_bag(tmp_path / "bag")
    [result] = recover_bag(tmp_path / "bag")
    assert result.was_whole


# --- What is said ----------------------------------------------------------------------------


def test_an_hour_before_the_disk_is_full_there_is_a_warning(tmp_path):
    free = [10**12]
    with archive(tmp_path / "bag", free=lambda _: free[0], min_free_mb=0.0) as bag:
        fill(bag, 100)
        wait_for(lambda: not bag.file.unwritten, "not written")
        state = bag.state()
        rate = state.size / 99
        assert disk_report(bag.config, state, START).level == OK
        free[0], bag.guard._asked = round(rate * 3000), -1e9
        report = disk_report(bag.config, bag.state(), START)
        assert report.level == WARN
        assert report.text.startswith("disk full in 50 min: ")
        assert float(report.values["full_in_h"]) == pytest.approx(3000 / 3600, abs=0.02)


def test_messages_tell_whom_they_are_about_and_when_an_event_was():
    cdr = pytest.importorskip("deepseis_core.ros.cdr")
    msg = pytest.importorskip("deepseis_msgs.msg")
    time_msg = pytest.importorskip("builtin_interfaces.msg").Time
    ephemeris = msg.Ephemeris(satellite="G07")
    assert about_whom(cdr.encode_message(ephemeris)) == "G07"
    assert about_whom(cdr.encode_message(msg.Station(name="DSEI"))) == ""
    assert about_whom(cdr.encode_message(msg.MotionState())) == ""
    for name in ("DSEI-1", "", "a"):
        event = msg.SeismicEvent(event_id=name, onset=time_msg(sec=7, nanosec=5))
        event.header.stamp = time_msg(sec=9, nanosec=1)
        assert event_span(cdr.encode_message(event)) == (7 * SECOND + 5, 9 * SECOND + 1)
