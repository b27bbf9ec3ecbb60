"""The ground as recorded: at rest outside, derivatives that agree, scaled as asked."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from deepseis_core.errors import InputError
from deepseis_sim.motion import Surroundings
from deepseis_sim.recorded_motion import MOTION_KINDS, Recorded

RATE = 100.0


def write_record(folder: Path) -> np.ndarray:
    """Write 60 s of shaking in PEER's format; returns it, (m, 3) [m/s^2]."""
    t = np.arange(6000) / RATE
    envelope = np.exp(-(((t - 25.0) / 6.0) ** 2))
    shaking = envelope[:, None] * np.stack(
        [3.0 * np.sin(9.0 * t), 5.0 * np.sin(14.0 * t + 1.0), 2.0 * np.sin(25.0 * t)], axis=1
    )
    for axis, name in enumerate(("90", "360", "UP")):
        rows = "\n".join(f"{v / 9.80665:16.8E}" for v in shaking[:, axis])
        (folder / f"R_{name}.AT2").write_text(
            f"PEER\nEvent, date, place, {name}\nACCELERATION TIME SERIES IN UNITS OF G\n"
            f"NPTS= 6000, DT= .0100 SEC\n{rows}\n"
        )
    return shaking


@pytest.fixture(name="around")
def _around(tmp_path):
    write_record(tmp_path)
    return Surroundings((0.5, 2.0, 50.0), 100.0, folder=tmp_path)


CONFIG = Recorded(file="R_*.AT2", start=20.0, low_hz=0.05, from_s=5.0, length_s=45.0)


def test_the_body_shakes_as_recorded(around, tmp_path):
    shaking = write_record(tmp_path)
    motion = CONFIG.build(around)
    t = np.arange(1000, 4500) / RATE  # of the record
    found = motion.at(t - 5.0 + 20.0)
    # The band-pass leaves 1.4 to 4 Hz alone; the spline goes through the samples.
    assert_allclose(found.acceleration, shaking[1000:4500], atol=2e-3)
    assert MOTION_KINDS["recorded"] is Recorded
    assert not motion.rotates
    assert motion.span == (20.0, 65.0)
    assert_allclose(found.C_enu_b, np.eye(3))


def test_before_and_after_it_rests_where_it_began(around):
    motion = CONFIG.build(around)
    for value in vars(motion.at(np.array([-1e6, 0.0, 20.0, 65.0, 70.0, 1e6]))).values():
        assert_allclose(value, np.eye(3) if value.shape == (3, 3) else 0.0, atol=1e-300)


def test_velocity_and_acceleration_are_the_derivatives_also_where_it_fades(around):
    motion = replace(CONFIG, offset_enu=(2.0, -1.0, 0.3), offset_at_s=10.0).build(around)
    h = 1e-4
    time = np.linspace(19.0, 66.0, 5001)
    below, at, above = (motion.at(time + shift) for shift in (-h, 0.0, h))
    velocity = (above.position - below.position) / (2 * h)
    acceleration = (above.velocity - below.velocity) / (2 * h)
    # h^2/6 of the third derivatives: 5 * 14 and 5 * 14^2 in SI units.
    assert_allclose(velocity, at.velocity, atol=3e-7)
    assert_allclose(acceleration, at.acceleration, atol=1e-5)


def test_the_offset_comes_when_asked_and_stays(around):
    motion = replace(
        CONFIG, offset_enu=(2.66, -1.0, -0.16), offset_at_s=10.0, offset_over_s=15.0
    ).build(around)
    plain = CONFIG.build(around)
    time = np.array([20.0, 30.0, 37.5, 45.0, 64.0, 1e5])
    rest = motion.at(time).position - plain.at(time).position
    assert_allclose(rest[[0, 1]], 0.0, atol=1e-15)
    assert_allclose(rest[2], [1.33, -0.5, -0.08], rtol=1e-9)
    assert_allclose(rest[3:], np.broadcast_to([2.66, -1.0, -0.16], (3, 3)), rtol=1e-12)


def test_times_may_come_in_any_order_and_grouping(around):
    motion = CONFIG.build(around)
    time = np.random.default_rng(1).uniform(15.0, 70.0, 1000)
    whole = motion.at(time)
    parts = [motion.at(part) for part in np.array_split(time, 9)]
    assert np.array_equal(whole.position, np.concatenate([p.position for p in parts]))
    assert np.array_equal(whole.acceleration, np.concatenate([p.acceleration for p in parts]))


def test_pga_is_the_larger_horizontal_peak(around):
    motion = replace(CONFIG, pga=26.0).build(around)
    time = np.arange(20.0, 65.0, 1e-3)
    peaks = np.abs(motion.at(time).acceleration).max(axis=0)
    # Peaks between the sampled moments (2.5 ms) are higher by up to (14 * 0.00125)^2 / 2.
    assert peaks[:2].max() == pytest.approx(26.0, rel=2e-4)
    doubled, plain = replace(CONFIG, scale=-2.0).build(around), CONFIG.build(around)
    assert_allclose(doubled.at(time).position, -2.0 * plain.at(time).position, rtol=1e-12)


def test_the_thesis_record_shakes_at_2_7_g_for_150_seconds(shared_data):
    around = Surroundings((0.5, 2.0, 50.0), 190.0, folder=shared_data)
    name = "strong_motion/knet_MYG004_tohoku2011/MYG0041103111446.NS"
    motion = Recorded(file=name, start=30.0, from_s=10.0, length_s=150.0).build(around)
    time = np.arange(30.0, 180.0, 0.01)
    found = motion.at(time)
    peaks = np.abs(found.acceleration).max(axis=0)
    # NIED's peaks; above 45 Hz there is little left to lose.
    assert_allclose(peaks, [12.685, 26.999, 18.799], rtol=0.02)
    assert 0.3 < np.abs(found.position).max() < 3.0
    assert np.abs(found.velocity).max() < 2.0
    assert_allclose(motion.at(np.array([181.0])).position, 0.0, atol=1e-300)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"file": ""}, "file is not set"),
        ({"from_s": 50.0}, r"R_\*.AT2: the record is 59.99 s long"),
        ({"from_s": 80.0, "length_s": 0.0}, "the record is 59.99 s long"),
        ({"length_s": 3.0}, "fade_s = 2"),
        ({"fade_s": 0.0}, "fade_s = 0.0 is outside"),
        ({"low_hz": 1e-4}, "low_hz = 0.0001 is below"),
        ({"high_hz": 0.01}, "high_hz = 0.01 is not above low_hz"),
        ({"pga": 5.0, "scale": 2.0}, "both"),
        ({"offset_enu": (1.0,)}, "east, north, up"),
        ({"offset_enu": (1.0, 0.0, 0.0), "offset_at_s": 50.0}, "later than"),
        ({"offset_enu": (1.0, 0.0, 0.0), "offset_over_s": 46.0}, "later than"),
        ({"start": float("nan")}, "start = nan"),
        ({"count_scale": float("inf")}, "count_scale = inf"),
    ],
)
def test_settings_that_make_no_motion_are_refused(around, changes, words):
    with pytest.raises(InputError, match=words):
        replace(CONFIG, **changes).build(around)


def test_an_absent_record_says_where_to_get_it(around):
    config = replace(CONFIG, file="MYG004.NS", hint="download it from kyoshin.bosai.go.jp")
    with pytest.raises(InputError, match=r"no such file \(download it from kyoshin") as caught:
        config.build(around)
    assert str(around.folder / "MYG004.NS") in str(caught.value)
    with pytest.raises(InputError) as caught:
        replace(config, file="R_UP.AT2").build(around)
    assert "download" not in str(caught.value)


def test_a_record_without_movement_cannot_be_scaled(around):
    for path in around.folder.iterdir():
        head = path.read_text().splitlines()[:4]
        path.write_text("\n".join(head) + "\n" + " 0.0" * 6000)
    assert not replace(CONFIG).build(around).at(np.array([40.0])).position.any()
    with pytest.raises(InputError, match="does not move"):
        replace(CONFIG, pga=1.0).build(around)
