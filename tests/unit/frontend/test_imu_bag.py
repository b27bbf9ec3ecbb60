from dataclasses import replace

import numpy as np
import pytest

from deepseis_bringup.inertial import has_imu, inertial_parameters, installed_parameters
from deepseis_bringup.simulation.simulate import simulate
from deepseis_core.errors import InputError
from deepseis_core.sample_clock import SampleClock
from deepseis_frontend.if_bag import IfBag
from deepseis_frontend.imu_bag import ImuBag
from deepseis_frontend.imu_file import Installation
from deepseis_frontend.imu_open import open_imu
from deepseis_frontend.nodes.station_bag import read_station
from deepseis_sim.bench import Bench
from deepseis_sim.scenario import ImuConfig, load_scenario

SCENARIO = replace(load_scenario("static", short=True), duration=1.0)


def bag(folder, **changes):
    simulate(replace(SCENARIO, **changes), folder, progress=False)
    signal = IfBag(folder / "bag")
    return folder / "bag", SampleClock(signal.start_utc_ns, signal.sample_rate_hz)


@pytest.mark.parametrize("rate_hz", [100.0, 200.0, 125.0])
def test_samples_are_those_of_the_bench_on_the_signal_s_clock(tmp_path, rate_hz):
    imu = ImuConfig(rate_hz=rate_hz)
    path, clock = bag(tmp_path / "a", imu=imu)
    read = ImuBag(path, clock)
    assert read.rate_hz == rate_hz
    bench = Bench(replace(SCENARIO, imu=imu))
    made = [
        item.value
        for span in bench.spans()
        for item in bench.items(*span)
        if item.topic == "imu/data_raw"
    ]
    found = list(read.samples())
    assert [s.sample_index for s in found] == [s.sample_index for s in made]
    np.testing.assert_array_equal(
        [s.linear_acceleration for s in found], [s.linear_acceleration for s in made]
    )


def test_a_source_that_joins_gets_the_samples_from_now_on(tmp_path):
    path, clock = bag(tmp_path / "a")
    read = ImuBag(path, clock)
    everything = [s.sample_index for s in read.samples()]
    since = everything[120] + 1
    assert [s.sample_index for s in read.samples(since)] == everything[121:]


def test_a_bag_without_imu_is_refused(tmp_path):
    path, clock = bag(tmp_path / "a", imu=None)
    with pytest.raises(InputError, match="no IMU samples"):
        ImuBag(path, clock)


def test_the_station_of_a_bag_is_found(tmp_path):
    path, clock = bag(tmp_path / "a")
    station, utc_ns = read_station(path)
    assert utc_ns == clock.start_utc_ns
    assert station.imu == "span-fsas"


@pytest.mark.parametrize(
    ("imu", "found"),
    [(ImuConfig(), True), (ImuConfig(grade="accelerometers"), False), (None, False)],
)
def test_an_imu_with_gyroscopes_is_noticed(tmp_path, imu, found):
    path, _ = bag(tmp_path / "a", imu=imu)
    assert has_imu(path) == found


def test_a_text_of_the_same_samples_gives_the_same_samples(tmp_path):
    path, clock = bag(tmp_path / "a")
    in_bag = list(ImuBag(path, clock).samples())
    text = tmp_path / "imu.csv"
    with text.open("w") as file:
        file.write("t,ax,ay,az,gx,gy,gz\n")
        for item in in_bag:
            numbers = [*item.linear_acceleration, *item.angular_velocity]
            t = clock.offset_ns(item.sample_index)
            file.write(",".join([str(t), *(repr(float(n)) for n in numbers)]) + "\n")
    (tmp_path / "imu.csv.yaml").write_text(
        "time: {unit: ns}\naccelerometer: {columns: [ax, ay, az]}\n"
        "gyroscope: {columns: [gx, gy, gz]}\n"
    )
    read = open_imu(text, clock)
    assert read.rate_hz == ImuBag(path, clock).rate_hz
    for one, other in zip(read.samples(), in_bag, strict=True):
        assert one.sample_index == other.sample_index
        assert one.linear_acceleration.tolist() == other.linear_acceleration.tolist()
        assert one.angular_velocity.tolist() == other.angular_velocity.tolist()


def test_parameters_follow_from_the_file_and_how_it_stands(tmp_path):
    folder = tmp_path / "a"
    path, _ = bag(folder)
    signal, bagged = IfBag(path), inertial_parameters(path, IfBag(path))
    antenna = np.load(folder / "truth.npz")["antenna_ecef_m"][0]
    fusion = bagged["fusion"]
    stands = Installation(
        fusion["imu_grade"],
        antenna_lever_arm=tuple(fusion["antenna_lever_arm"]),
        imu_to_antenna=tuple(fusion["imu_to_antenna"]),
        orientation_xyzw=tuple(fusion["imu_orientation_xyzw"]),
    )
    found = installed_parameters(path, signal, stands, antenna.tolist())
    monument = found["fusion"].pop("monument_ecef")
    np.testing.assert_allclose(monument, fusion.pop("monument_ecef"), atol=1e-3)
    assert found["fusion"] == fusion
    assert found["imu_source"]["monument_ecef"] == monument
    with pytest.raises(InputError, match="the station's place is not known"):
        installed_parameters(path, signal, stands, ())
    with pytest.raises(InputError, match="IMU grade 'tactical' is not known"):
        installed_parameters(path, signal, replace(stands, grade="tactical"), ())
