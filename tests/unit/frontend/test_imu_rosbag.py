"""IMU samples of bags that others recorded: ROS 1, ROS 2 in SQLite and MCAP."""

import re

import numpy as np
import pytest
from others_bags import CLOCK, COUNT, STEP_NS, forces, write

from deepseis_bringup.inertial import installed_parameters
from deepseis_core.errors import InputError
from deepseis_frontend.imu_open import open_imu
from deepseis_frontend.imu_rosbag import ImuRosbag


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


def test_a_damaged_bag_is_refused_in_one_line(tmp_path):
    """Its reader stumbles over a date where it adds numbers."""
    path = write("db3", tmp_path)
    beside = path / "metadata.yaml"
    damaged = re.sub(r"(nanoseconds_since_epoch:) \d+", r"\1 2021-02-03", beside.read_text())
    assert "2021-02-03" in damaged
    beside.write_text(damaged)
    with pytest.raises(InputError, match="cannot be read as a bag"):
        open_imu(path, CLOCK)
