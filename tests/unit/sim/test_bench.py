from dataclasses import replace

import numpy as np
import pytest

from deepseis_core.constants import L1_WAVELENGTH, SPEED_OF_LIGHT
from deepseis_core.errors import InputError
from deepseis_sim.base_station import BaseConfig
from deepseis_sim.bench import Bench
from deepseis_sim.bench_streams import Ticks
from deepseis_sim.ldv import LdvConfig
from deepseis_sim.motions import Circle
from deepseis_sim.position_errors import PositionErrorConfig
from deepseis_sim.scenario import ImuConfig, ReceiverConfig, Scenario, load_scenario


def scenario(**changes):
    given = {"name": "test", "duration": 1.0, "receiver": ReceiverConfig(if_format="iq2")}
    return Scenario(**{**given, **changes})


def everything(bench, spans=None):
    return [item for span in spans or bench.spans() for item in bench.items(*span)]


def of(items, topic):
    return [item for item in items if item.topic == topic]


FULL = {
    "motion": (Circle(radius=0.1, frequency_hz=2.0, start=0.1, duration=0.8, ramp=0.2),),
    "base": BaseConfig(),
    "ldv": LdvConfig(),
    "positions": PositionErrorConfig(),
}


@pytest.fixture(scope="module")
def items():
    return everything(Bench(scenario(**FULL)))


def test_every_stream_has_its_rate(items):
    counts = {name: len(of(items, name)) for name in {item.topic for item in items}}
    assert counts == {
        "truth": 5,
        "if/samples": 50,
        "imu/data_raw": 199,  # the 200th becomes valid with sample 4,000,000
        "base/observations": 10,
        "ldv/velocity": 99,
        "gnss/pvt": 1,
    }


def test_a_value_lies_in_the_span_of_its_validity():
    bench = Bench(scenario(**FULL))
    for begin, end in bench.spans():
        for item in bench.items(begin, end):
            assert begin * 250 <= item.offset_ns < end * 250


@pytest.mark.parametrize("rate", [3.333e6, 16.367667e6])
def test_truth_is_that_of_the_very_samples_it_names(rate):
    config = ReceiverConfig(sample_rate_hz=rate)
    bench = Bench(scenario(receiver=config, signal=False, imu=None, motion=FULL["motion"]))
    truth = of(bench.items(0, round(0.2 * rate)), "truth")[0].value
    time = truth.satellite_sample_index / rate
    phase = bench.model.delays(time).carrier_phase_cycles + bench.model.initial_phase_cycles
    np.testing.assert_allclose(truth.carrier_phase_cycles, phase, rtol=0.0, atol=1e-7)
    time = truth.sample_index / rate
    np.testing.assert_allclose(
        truth.position_ecef, bench.model.antenna(time - bench.clock(time)), rtol=0.0, atol=1e-8
    )


def test_how_the_run_is_cut_changes_nothing(items):
    bench = Bench(scenario(**FULL))
    pieces = [(k * 400_000, (k + 1) * 400_000) for k in range(10)]
    again = everything(bench, pieces)
    for topic in ("if/samples", "imu/data_raw", "ldv/velocity", "base/observations", "gnss/pvt"):
        first, second = of(items, topic), of(again, topic)
        assert len(first) == len(second)
        for one, other in zip(first, second, strict=True):
            assert one.offset_ns == other.offset_ns
            for name, value in vars(one.value).items():
                np.testing.assert_array_equal(value, getattr(other.value, name))
    whole, parts = (
        np.concatenate([item.value.carrier_phase_cycles for item in of(given, "truth")])
        for given in (items, again)
    )
    np.testing.assert_array_equal(whole, parts)


def test_truth_phase_follows_truth_motion(items):
    truth = [item.value for item in of(items, "truth")]
    phase = np.concatenate([value.carrier_phase_cycles for value in truth])
    path = np.concatenate([value.range for value in truth])
    clock = np.concatenate([value.clock_bias for value in truth])
    # Satellite clocks and atmosphere change by less than 3 cm in this second.
    change = -(path - path[0]) - SPEED_OF_LIGHT * (clock - clock[0])[:, None]
    np.testing.assert_allclose((phase - phase[0]) * L1_WAVELENGTH, change, atol=0.03)


def test_the_imu_at_rest_feels_gravity_upwards():
    bench = Bench(scenario(signal=False, imu=ImuConfig(grade="perfect")))
    samples = [item.value for item in of(everything(bench), "imu/data_raw")]
    force = np.array([sample.linear_acceleration for sample in samples])
    np.testing.assert_allclose(force[:, :2], 0.0, atol=1e-9)
    np.testing.assert_allclose(force[:, 2], 9.8003, atol=2e-3)  # normal gravity at 38.7 deg


def test_accelerometers_alone_say_so_in_the_variance():
    bench = Bench(scenario(signal=False, imu=ImuConfig(grade="accelerometers")))
    sample = of(everything(bench), "imu/data_raw")[0].value
    assert sample.angular_velocity_variance == -1.0
    assert sample.linear_acceleration_variance > 0.0
    assert not sample.angular_velocity.any()


def test_without_signal_orbits_come_as_messages():
    bench = Bench(scenario(signal=False))
    names = [item.topic for item in bench.opening()]
    assert names[0] == "station"
    assert names.count("gnss/ephemeris") == len(bench.model.satellites) == 12
    assert of(everything(bench), "gnss/observations")


def test_a_stand_in_moves_where_the_record_is_not_at_hand(tmp_path, monkeypatch):
    monkeypatch.setenv("DEEPSEIS_DATA", str(tmp_path))
    quake = load_scenario("quake", short=True)
    assert Bench(quake).stands_in
    with pytest.raises(InputError, match="MYG004"):
        Bench(replace(quake, stand_in=()))


@pytest.mark.parametrize("rate_hz", [200.0, 125.0, 99.999, 1000.0 / 7.0])
def test_ticks_never_drift(rate_hz):
    ticks = Ticks(rate_hz, 4e6)
    spans = [ticks.between(n, n + 80_000) for n in range(0, 80_000_000, 80_000)]
    joined = [number for span in spans for number in span]
    assert joined == list(range(len(joined)))
    late = ticks.between(0, 10**13)[-1]
    assert 0 <= ticks.sample_index(late) < 10**13 <= ticks.sample_index(late + 1)
    np.testing.assert_allclose(ticks.offset_ns(late) / 1e9, late / round(rate_hz * 1e3) * 1e3)
