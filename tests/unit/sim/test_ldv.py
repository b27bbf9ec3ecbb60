"""The velocimeter: truth without errors, every error where it belongs, streaming."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad_vec

from deepseis_core.errors import InputError
from deepseis_sim.drive import Drive
from deepseis_sim.ldv import BLOCK, LdvConfig, LdvSynthesizer, ground_velocity
from deepseis_sim.motion import Surroundings
from deepseis_sim.motions import Still

PERFECT = LdvConfig(
    scale_error=(0.0, 0.0),
    misalignment_deg=(0.0, 0.0, 0.0),
    noise=0.0,
    relative_noise=0.0,
    dropouts_per_hour=0.0,
    lever_arm=(0.8, 0.2, -0.6),
)
ORIGIN = (np.radians(38.7), np.radians(141.0), 40.0)


@pytest.fixture(scope="module")
def motion():
    return Drive(duration=200.0).build(Surroundings(ORIGIN, 240.0))


@pytest.fixture(scope="module")
def truth(motion):
    """Samples of a perfect sensor: forward, vertical."""
    return LdvSynthesizer(PERFECT, motion, 1).chunk(0, 20000)


def changed(motion, **settings):
    return LdvSynthesizer(replace(PERFECT, **settings), motion, 1).chunk(0, 20000)


def test_without_errors_it_solves_the_mean_velocity_of_its_place(motion, truth):
    lever = np.array(PERFECT.lever_arm)
    for k in (2500, 4321, 9000, 15000):
        begin, end = k / 100.0, (k + 1) / 100.0
        mean = quad_vec(
            lambda t: ground_velocity(motion.at(np.array([t])), lever)[0] * 100.0, begin, end
        )[0]
        assert truth.forward_velocity[k] == pytest.approx(mean[0], abs=1e-9)
        assert truth.vertical_velocity[k] == pytest.approx(mean[2], abs=1e-9)
        assert truth.time[k] == pytest.approx(begin + 0.005)
        assert truth.time_end[k] == pytest.approx(end)


def test_lever_arm_turns_with_the_body(motion):
    """v + omega x l against the difference of the sensor's places."""
    lever, h = np.array([0.8, 0.2, -0.6]), 1e-4
    t = np.linspace(20.0, 200.0, 500)
    before, at, after = (motion.at(t + d) for d in (-h, 0.0, h))
    place = [k.position + k.C_enu_b @ lever for k in (before, after)]
    velocity = np.einsum("mji,mj->mi", at.C_enu_b, (place[1] - place[0]) / (2.0 * h))
    assert_allclose(ground_velocity(at, lever), velocity, atol=1e-6)


def test_beams_are_positive_when_the_ground_comes_nearer(motion):
    samples = changed(motion, elevation_deg=(-30.0, -90.0))
    fast = samples.forward_velocity > 5.0
    assert (samples.beam_velocity[fast, 0] > 0.0).all()
    assert_allclose(samples.beam_velocity[:, 1], -samples.vertical_velocity, atol=1e-12)


def test_scale_error_scales(motion, truth):
    samples = changed(motion, scale_error=(1e-3, 1e-3))
    assert_allclose(samples.forward_velocity, 1.001 * truth.forward_velocity, atol=1e-12)
    assert_allclose(samples.vertical_velocity, 1.001 * truth.vertical_velocity, atol=1e-12)


def test_unequal_scales_of_a_symmetric_pair_look_like_a_climb(motion, truth):
    # d1 - d2 = v_x, d1 + d2 = -sqrt(3) v_z at 60 deg forward and back
    samples = changed(motion, scale_error=(1e-3, -1e-3))
    climb = samples.vertical_velocity - truth.vertical_velocity
    assert_allclose(climb, -1e-3 * truth.forward_velocity / np.sqrt(3.0), atol=1e-12)


def test_pitched_sensor_sees_forward_speed_as_climb(motion, truth):
    samples = changed(motion, misalignment_deg=(0.0, 1.0, 0.0))
    turn = np.radians(1.0)  # beams lower: the forward axis points down, its up axis forward
    expected = truth.vertical_velocity * np.cos(turn) + truth.forward_velocity * np.sin(turn)
    assert_allclose(samples.vertical_velocity, expected, atol=1e-12)


def test_turned_sensor_loses_the_cosine_and_sees_the_side(motion, truth):
    samples = changed(motion, misalignment_deg=(0.0, 0.0, 2.0), lever_arm=(0.0, 0.0, 0.0))
    straight = changed(motion, lever_arm=(0.0, 0.0, 0.0))
    assert_allclose(
        samples.forward_velocity,
        np.cos(np.radians(2.0)) * straight.forward_velocity,
        atol=2e-5,  # sin(2 deg) of the heave (10 mm/s) across the lean (1 deg)
    )


def test_noise_has_its_sigma_and_its_sigma_is_told(motion, truth):
    samples = changed(motion, noise=0.01, relative_noise=1e-3)
    moving = truth.forward_velocity > 3.0
    error = (samples.beam_velocity - truth.beam_velocity)[moving]
    sd = samples.beam_velocity_sd[moving]
    count = moving.sum()
    assert_allclose(np.std(error / sd, axis=0), 1.0, atol=4.0 / np.sqrt(2.0 * count))
    assert abs(np.mean(error[:, 0] * error[:, 1] / sd.prod(axis=1))) < 4.0 / np.sqrt(count)
    good = samples.quality[moving] > 100.0
    expected = np.hypot(0.01, 1e-3 * truth.beam_velocity[moving])
    assert_allclose(sd[good], expected[good])


def test_quality_is_usable_when_moving_and_not_at_rest(truth):
    moving = truth.forward_velocity > 2.0
    assert (truth.quality[moving] > 100.0).mean() > 0.99
    assert (truth.quality[np.abs(truth.forward_velocity) < 1e-3] < 100.0).all()


def test_dropouts_come_as_often_as_asked(motion, truth):
    samples = changed(motion, dropouts_per_hour=600.0, dropout=0.5)
    share = (samples.quality < 0.5 * truth.quality).mean()
    assert share == pytest.approx(600.0 * 0.5 / 3600.0, rel=0.6)  # 33 spells


@pytest.mark.parametrize("cuts", [[1], [997, BLOCK, BLOCK + 1, 2 * BLOCK + 7], [2500, 2500]])
def test_chunks_change_nothing(motion, cuts):
    synthesizer = LdvSynthesizer(LdvConfig(dropouts_per_hour=500.0), motion, 5)
    whole = synthesizer.chunk(2000, 4000)
    edges = [0, *cuts, 4000]
    parts = [synthesizer.chunk(2000 + a, b - a) for a, b in pairwise(edges)]
    for name in ("time", "beam_velocity", "beam_velocity_sd", "forward_velocity", "quality"):
        joined = np.concatenate([getattr(part, name) for part in parts])
        assert np.array_equal(joined, getattr(whole, name)), name


def test_seed_decides_the_noise(motion):
    a, b, c = (LdvSynthesizer(LdvConfig(), motion, seed).chunk(0, 100) for seed in (1, 1, 2))
    assert np.array_equal(a.beam_velocity, b.beam_velocity)
    assert not np.array_equal(a.beam_velocity, c.beam_velocity)


def test_receivers_clock_shifts_the_measurement(motion, truth):
    late = LdvSynthesizer(PERFECT, motion, 1, clock=lambda t: np.full(t.shape, 0.02))
    samples = late.chunk(2, 5000)
    assert_allclose(samples.forward_velocity, truth.forward_velocity[:5000], atol=1e-9)


def test_it_stands_still_on_a_still_body():
    samples = LdvSynthesizer(PERFECT, Still(), 1).chunk(0, 10)
    assert not samples.beam_velocity.any()


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        ({"elevation_deg": (-60.0, -60.5)}, "parallel"),
        ({"elevation_deg": (-60.0, 120.0)}, "parallel"),
        ({"noise": -1.0}, "noise"),
        ({"rate_hz": np.nan}, "rate_hz"),
    ],
)
def test_senseless_settings_are_refused(motion, settings, reason):
    with pytest.raises(InputError, match=reason):
        LdvSynthesizer(replace(LdvConfig(), **settings), motion, 1)


def test_negative_samples_are_refused(motion):
    with pytest.raises(InputError, match="samples"):
        LdvSynthesizer(LdvConfig(), motion, 1).chunk(-1, 10)
