from dataclasses import replace

import numpy as np
import pytest

from deepseis_bringup.inertial import has_imu
from deepseis_bringup.simulate import simulate
from deepseis_core.errors import InputError
from deepseis_core.sample_clock import SampleClock
from deepseis_frontend.if_bag import IfBag
from deepseis_frontend.imu_bag import ImuBag
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
