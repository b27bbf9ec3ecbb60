"""IMU samples of bags that others recorded: ROS 1, ROS 2 in SQLite and MCAP."""

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from deepseis_bringup.inertial import installed_parameters
from deepseis_core.errors import InputError
from deepseis_core.sample_clock import SampleClock
from deepseis_frontend.imu_open import open_imu
from deepseis_frontend.imu_rosbag import ImuRosbag

CLOCK = SampleClock(1_700_000_000_000_000_000, 4e6)
STEP_NS = 10_000_000
COUNT = 50


def forces():
    return 9.8 * np.array([0.0, 0.0, 1.0]) + 0.01 * np.arange(COUNT)[:, None]


def imu_message(store, stamp_ns, force, first):
    types = store.types
    vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    time = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 1_000_000_000))
    header = types["std_msgs/msg/Header"](*first, stamp=time, frame_id="imu")
    nothing = np.zeros(9)
    return types["sensor_msgs/msg/Imu"](
        header, quaternion(0.0, 0.0, 0.0, 1.0), nothing, vector(0.1, 0.2, 0.3), nothing,
        vector(*map(float, force)), nothing,
    )  # fmt: skip


def write(kind, folder, topics=("/imu/data",), late_ns=0):
    """Write a bag; stamps in headers, logged ``late_ns`` after."""
    is_ros1 = kind == "bag"
    store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    path = folder / ("a.bag" if is_ros1 else "a")
    if is_ros1:
        writer = Writer1(path)
    else:
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        writer = Writer2(path, version=9, storage_plugin=plugin)
    with writer:
        known = [writer.add_connection(t, "sensor_msgs/msg/Imu", typestore=store) for t in topics]
        for k, force in enumerate(forces()):
            stamp = CLOCK.start_utc_ns + (k + 1) * STEP_NS
            message = imu_message(store, stamp, force, (k,) if is_ros1 else ())
            serialise = store.serialize_ros1 if is_ros1 else store.serialize_cdr
            raw = serialise(message, "sensor_msgs/msg/Imu")
            for connection in known:
                writer.write(connection, stamp + late_ns, raw)
    return path


@pytest.fixture(params=["bag", "db3", "mcap"])
def kind(request):
    return request.param


def describe(path, text):
    path.with_name(path.name + ".yaml").write_text(text)


def test_every_kind_gives_the_samples_that_were_written(kind, tmp_path):
    path = write(kind, tmp_path)
    describe(path, "stamp: end")
    imu = open_imu(path, CLOCK)
    assert isinstance(imu, ImuRosbag)
    assert imu.rate_hz == 100.0
    samples = list(imu.samples())
    assert [s.sample_index for s in samples] == [40_000 * (k + 1) for k in range(COUNT)]
    np.testing.assert_allclose([s.linear_acceleration for s in samples], forces())
    np.testing.assert_allclose(samples[0].angular_velocity, [0.1, 0.2, 0.3])


def test_the_description_turns_shifts_and_installs(kind, tmp_path):
    path = write(kind, tmp_path, ("/imu/data", "/other"))
    describe(
        path,
        "topic: /other\ntime: {offset: 0.25}\naxes: [y, x, -z]\nstamp: middle\n"
        "installation: {grade: mti-g, imu_to_antenna: [1, 2, 3]}\n",
    )
    first = next(open_imu(path, CLOCK).samples())
    assert first.sample_index == 40_000 + 1_000_000 + 20_000
    np.testing.assert_allclose(first.angular_velocity, [0.2, 0.1, -0.3])

    class Source:
        start_utc_ns, sample_rate_hz = CLOCK.start_utc_ns, CLOCK.sample_rate_hz

    found = installed_parameters(path, Source(), None, [3.9e6, 3.1e6, 3.9e6])
    assert found["imu_source"]["imu_grade"] == "mti-g"
    assert found["fusion"]["imu_to_antenna"] == [1.0, 2.0, 3.0]


def test_log_times_can_be_taken(kind, tmp_path):
    path = write(kind, tmp_path, late_ns=STEP_NS)
    describe(path, "time: {stamp: log}")
    assert next(open_imu(path, CLOCK).samples()).sample_index == 80_000


def test_several_imus_are_named(kind, tmp_path):
    path = write(kind, tmp_path, ("/a", "/b"))
    describe(path, "stamp: end")
    with pytest.raises(InputError, match="several IMUs: /a, /b"):
        open_imu(path, CLOCK)


@pytest.mark.parametrize("content", [b"", b"#ROSBAG V2.0\n", b"#ROSBAG V2.0\n" + bytes(500)])
def test_what_is_no_bag_is_said_in_a_line(tmp_path, content):
    path = tmp_path / "a.bag"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"a\.bag"):
        open_imu(path, CLOCK)


def test_a_cut_bag_is_said_in_a_line(tmp_path):
    path = write("bag", tmp_path)
    path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(InputError, match=r"a\.bag"):
        list(open_imu(path, CLOCK).samples())


def test_accelerations_without_gravity_are_refused(tmp_path, monkeypatch):
    path = write("bag", tmp_path)
    describe(path, "topic: /imu/data")
    monkeypatch.setattr("deepseis_frontend.imu_file.PLAUSIBLE", (20.0, 60.0))
    with pytest.raises(InputError, match="specific force of"):
        open_imu(path, CLOCK)
