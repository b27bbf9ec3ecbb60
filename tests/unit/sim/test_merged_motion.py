"""An accelerogram with GNSS's displacement: the whole motion comes back, its step too."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from deepseis_bringup.export.quiet_obspy import obspy_modules
from deepseis_core.errors import InputError
from deepseis_core.types import FloatArray
from deepseis_sim.accelerogram import Accelerogram, read_accelerogram
from deepseis_sim.integration import band_pass
from deepseis_sim.merged_motion import below, delay_between
from deepseis_sim.motion import Surroundings
from deepseis_sim.recorded_motion import Recorded

STEP = np.array([2.5, -1.0, -0.2])
LATER_S = 7.0
"""The accelerogram begins so long after the displacement."""
K_NET = "strong_motion/knet_MYG004_tohoku2011/MYG0041103111446.NS"
GEONET = "displacement/tohoku2011_geonet_1hz/CI.0915.20.LY?.2011.070"


def whole(t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return displacement and acceleration: a step that takes 12 s, and 1.5 Hz meanwhile."""
    x = (t - 40.0) / 5.0
    shape = 0.5 * (1.0 + np.tanh(x))
    slope2 = -np.tanh(x) / np.cosh(x) ** 2 / 25.0
    w, envelope = 2.0 * np.pi * 1.5, np.exp(-(((t - 42.0) / 6.0) ** 2))
    u = (t - 42.0) / 6.0
    first, second = -2.0 * u / 6.0, (4.0 * u**2 - 2.0) / 36.0
    shaking = 0.02 * envelope * np.sin(w * t)
    curve = 0.02 * envelope * (
        second * np.sin(w * t) + 2.0 * first * w * np.cos(w * t) - w**2 * np.sin(w * t)
    )  # fmt: skip
    turned = np.array([1.0, 0.6, 0.3])
    return (
        shape[:, None] * STEP + shaking[:, None] * turned,
        slope2[:, None] * STEP + curve[:, None] * turned,
    )


@pytest.fixture(scope="module")
def around(tmp_path_factory: pytest.TempPathFactory) -> Surroundings:
    """Files as archives have them: accelerations with an offset, GNSS with its noise."""
    obspy_modules()
    from obspy import Stream, Trace, UTCDateTime

    folder = tmp_path_factory.mktemp("records")
    begin = UTCDateTime(2011, 3, 11, 5, 46, 0)

    def write(name: str, values: FloatArray, rate_hz: float, later_s: float, scale: float) -> None:
        rows = np.round(values / scale).astype(np.int32)
        traces = [
            Trace(rows[:, k].copy(), {"sampling_rate": rate_hz, "channel": f"HN{letter}",
                                      "station": "A", "starttime": begin + later_s})
            for k, letter in enumerate("ENZ")
        ]  # fmt: skip
        Stream(traces).write(str(folder / name), format="MSEED")

    acceleration = whole(np.arange(0.0, 100.0, 0.01))[1]
    write("acc.mseed", acceleration + np.array([0.01, -0.02, 0.015]), 100.0, LATER_S, 1e-5)
    t = np.arange(-LATER_S, 120.0, 1.0)
    noise = np.random.default_rng(3).normal(0.0, 2e-3, (len(t), 3))
    write("gnss.mseed", whole(t)[0] + noise + [10.0, -3.0, 1.0], 1.0, 0.0, 1e-5)
    return Surroundings((0.5, 2.0, 50.0), 130.0, folder=folder)


CONFIG = Recorded(
    file="acc.mseed", count_scale=1e-5, displacement="gnss.mseed", displacement_scale=1e-5,
    start=20.0, from_s=15.0, length_s=60.0, crossover_hz=0.1,
)  # fmt: skip


def test_step_and_shaking_come_back(around: Surroundings) -> None:
    motion = CONFIG.build(around)
    time = np.arange(22.5, 77.5, 0.05)
    found, truth = motion.at(time), whole(time - 5.0)
    moved = truth[0] - whole(np.array([15.0]))[0]
    # GNSS: 2 mm in samples of 1 s below 0.1 Hz, 2 mm sqrt(0.2); its zero: 2 mm / sqrt(10).
    assert np.abs(found.position - moved).max() < 0.006
    # The low part adds to accelerations (2 pi 0.1)^2 of its noise.
    assert np.abs(found.acceleration - truth[1]).max() < 0.005
    assert_allclose(motion.at(np.array([10.0])).position, 0.0, atol=1e-12)
    assert_allclose(motion.at(np.array([200.0])).position[0], STEP, atol=0.006)
    assert np.abs(motion.at(np.array([200.0])).velocity).max() < 1e-9


def test_velocity_and_acceleration_are_the_derivatives(around: Surroundings) -> None:
    motion = CONFIG.build(around)
    h = 1e-4
    time = np.linspace(19.0, 81.0, 3001)
    below_, at, above = (motion.at(time + shift) for shift in (-h, 0.0, h))
    assert_allclose((above.position - below_.position) / (2 * h), at.velocity, atol=1e-6)
    assert_allclose((above.velocity - below_.velocity) / (2 * h), at.acceleration, atol=1e-5)


def test_the_two_halves_are_the_whole() -> None:
    t = np.arange(0.0, 200.0, 0.01)
    signal = np.stack([np.sin(0.3 * t) + 1.0, np.sin(6.0 * t), np.where(t > 90.0, 1.0, 0.0)], 1)
    low = below(signal, 100.0, 0.2, 4)
    middle = slice(5000, 15000)
    high = band_pass(signal, 100.0, 0.2, 0.0)
    assert_allclose((low + high)[middle], signal[middle], atol=1e-6)
    # 0.048 Hz passes, 0.95 Hz does not: order 8 (both ways) of a factor of 4 and more.
    assert np.abs(low[middle, 0] - signal[middle, 0]).max() < 1e-4
    assert np.abs(low[middle, 1]).max() < 1e-4


def test_times_that_the_files_do_not_tell_are_given() -> None:
    record = Accelerogram(np.zeros((9, 3)), 100.0, "AT2")
    assert delay_between(record, record) == 0.0


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"displacement": "none.mseed"}, "no such file"),
        ({"displacement_delay_s": 60.0}, "the displacement covers"),
        ({"pga": 5.0}, "no scale, pga or offset"),
        ({"offset_enu": (1.0, 0.0, 0.0)}, "no scale, pga or offset"),
        ({"displacement_scale": 0.0}, "is in counts"),
    ],
)
def test_what_makes_no_motion_is_refused(
    around: Surroundings, changes: dict[str, object], words: str
) -> None:
    with pytest.raises(InputError, match=words):
        replace(CONFIG, **changes).build(around)  # type: ignore[arg-type]


def test_tohoku_as_gnss_and_accelerometer_saw_it(shared_data: Path) -> None:
    around = Surroundings((0.5, 2.0, 50.0), 240.0, folder=shared_data)
    motion = Recorded(
        file=K_NET, displacement=GEONET, displacement_scale=1e-6, start=30.0, from_s=10.0,
        length_s=190.0, fade_s=4.0,
    ).build(around)  # fmt: skip
    seen = read_accelerogram(shared_data / GEONET, scale=1e-6).acceleration
    seconds = np.arange(15.0, 195.0)
    moved = seen[71 + seconds.astype(int)] - seen[72:82].mean(axis=0)
    off = motion.at(seconds + 20.0).position - moved
    # 5 km apart: above 0.15 Hz they move differently, by some centimetres.
    assert (np.sqrt(np.mean(off**2, axis=0)) < [0.06, 0.06, 0.03]).all()
    # Published with the data: the step of 0915 is E 2.66, N -1.00, U -0.16 m.
    assert_allclose(motion.at(np.array([239.0])).position[0], [2.66, -1.0, -0.16], atol=0.06)
    peaks = np.abs(motion.at(np.arange(30.0, 220.0, 0.01)).acceleration).max(axis=0)
    assert_allclose(peaks, [12.685, 26.999, 18.799], rtol=0.02)  # NIED's
