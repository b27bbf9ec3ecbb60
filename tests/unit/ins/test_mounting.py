"""Offset and lever arm found again where they are known."""

from dataclasses import replace

import numpy as np
import pytest

from deepseis_core.errors import InputError
from deepseis_core.geodesy import normal_gravity
from deepseis_core.rotation import matrix_from_euler, quat_from_euler
from deepseis_ins.alignment import earth_rate
from deepseis_ins.mounting import (
    AntennaSeries,
    ImuSeries,
    MountingConfig,
    estimate_mounting,
)

LATITUDE = np.radians(38.7)
LEVER = np.array([0.8, -0.3, 1.2])  # forward, left, up
FRD = np.array([1.0, -1.0, -1.0])
OFFSET = 0.0437
LENGTH, RATE = 40.0, 200.0


def euler(t, turning, heading):
    """Roll, pitch, heading while it shakes, from 5 s on."""
    on = np.clip((t - 5.0) / 2.0, 0.0, 1.0)
    return np.stack(
        [
            0.01 + turning * on * np.sin(2.2 * t),
            -0.02 + turning * on * np.sin(3.1 * t + 1.0),
            heading + 2.0 * turning * on * np.sin(1.3 * t),
        ],
        axis=-1,
    )


def place(t):
    """North, east, down of the IMU: some sines of 0.5 to 3 Hz, together about 0.5 g."""
    on = np.clip((t - 5.0) / 2.0, 0.0, 1.0) ** 3
    waves = [(0.10, 0.7, 0.0), (0.02, 1.9, 1.0), (0.008, 3.1, 2.0)]
    axes = [sum(a * np.sin(2 * np.pi * f * t + p + k) for a, f, p in waves) for k in range(3)]
    return on[..., None] * np.stack(axes, axis=-1)


def made(*, turning=0.03, heading=1.0, velocity=False, seed=1, rate_hz=50.0, sd=None):
    """IMU data by numeric differentiation on a grid 10 times as fine: no mechanisation of ours."""
    random, fine = np.random.default_rng(seed), 10
    n = round(LENGTH * RATE)
    t = np.arange(-2, n * fine + 3) / (RATE * fine)
    h = 1.0 / (RATE * fine)
    C = matrix_from_euler(euler(t, turning, heading))
    p = place(t)
    acceleration = (p[2:] - 2 * p[1:-1] + p[:-2]) / h**2
    gravity = np.array([0.0, 0.0, float(normal_gravity(LATITUDE, 10.0))])
    velocity_n = (p[2:] - p[:-2]) / (2 * h)
    coriolis = 2.0 * np.cross(earth_rate(LATITUDE), velocity_n)
    force = np.einsum("nji,nj->ni", C[1:-1], acceleration + coriolis - gravity)
    turn = np.einsum("nji,njk->nik", C[:-1], C[1:])
    rate = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1) - np.stack(
        [turn[:, 1, 2], turn[:, 2, 0], turn[:, 0, 1]], axis=1
    )
    rate = 0.25 * (rate[1:] + rate[:-1]) / h
    rate += np.einsum("nji,j->ni", C[1:-1], earth_rate(LATITUDE))

    def increments(values):
        middle = 0.5 * (values[1:] + values[:-1]) * h
        return middle[1 : n * fine + 1].reshape(n, fine, 3).sum(axis=1)

    dt = np.full(n, 1.0 / RATE)
    bias = np.array([2e-3, -1e-3, 5e-4]), np.array([0.05, -0.02, 0.03])
    theta = increments(rate) + bias[0] / RATE + random.normal(0, 3e-5, (n, 3)) / RATE**0.5
    vel = increments(force) + bias[1] / RATE + random.normal(0, 5e-4, (n, 3)) / RATE**0.5
    imu = ImuSeries(np.arange(1, n + 1) / RATE - OFFSET, dt, theta, vel)
    at = np.arange(0.013, LENGTH, 1.0 / rate_hz)  # no epoch is on a sample
    lever = LEVER * FRD

    def antenna(when):
        return place(when) + matrix_from_euler(euler(when, turning, heading)) @ lever

    if velocity:
        value, sd = (antenna(at + 1e-4) - antenna(at - 1e-4)) / 2e-4, sd or 0.03
    else:
        value, sd = antenna(at), sd or 1.5e-3
    value = value + random.normal(0.0, sd, value.shape)
    seen = AntennaSeries(at, value, np.full(3, sd), velocity, LATITUDE, 10.0)
    return imu, seen


CONFIG = MountingConfig(accel_walk=5e-4)


@pytest.mark.parametrize("velocity", [False, True])
def test_offset_and_lever_arm_come_back_within_their_sigmas(velocity):
    imu, seen = made(velocity=velocity, rate_hz=10.0 if velocity else 50.0)
    found = estimate_mounting(imu, seen, config=CONFIG)
    assert found.time_offset_sd < 1e-3
    assert abs(found.time_offset - OFFSET) < 3.5 * found.time_offset_sd + 2e-5
    assert found.lever_arm_shows.all()
    error = (found.imu_to_antenna - LEVER) / found.imu_to_antenna_sd
    assert np.abs(error).max() < 3.5
    assert np.max(found.imu_to_antenna_sd) < 0.05
    assert abs(found.roll_pitch_heading[2] - 1.0) < 0.02
    assert 0.9 < found.residual_ratio < 1.1


def test_sigmas_are_those_of_the_errors_over_many_seeds():
    errors = []
    for seed in range(6):
        imu, seen = made(seed=seed, velocity=True, rate_hz=10.0)
        found = estimate_mounting(imu, seen, config=CONFIG)
        errors.append(
            [
                (found.time_offset - OFFSET) / found.time_offset_sd,
                *((found.imu_to_antenna - LEVER) / found.imu_to_antenna_sd),
            ]
        )
    mean_square = float(np.mean(np.square(errors)))  # chi-square of 24
    assert 0.4 < mean_square < 1.9


def test_the_offset_has_the_sigma_that_theory_gives_it():
    """With nothing else unknown: sd(v) / (rms(a) sqrt(n)), here at least and at most twice it."""
    imu, seen = made(velocity=True, rate_hz=10.0)
    found = estimate_mounting(imu, seen, config=CONFIG)
    t = np.linspace(8.0, 38.0, 30_001)
    rms = np.sqrt(
        np.mean(np.sum(np.gradient(np.gradient(place(t), t, axis=0), t, axis=0) ** 2, 1))
    )
    least = seen.sd[0] / (rms * np.sqrt(300.0))
    assert least < found.time_offset_sd < 2.0 * least


@pytest.mark.parametrize("heading", [-3.0, 0.0, 2.0])
def test_any_heading_is_found(heading):
    imu, seen = made(heading=heading)
    found = estimate_mounting(imu, seen, config=CONFIG)
    assert abs((found.roll_pitch_heading[2] - heading + np.pi) % (2 * np.pi) - np.pi) < 0.02
    assert abs(found.time_offset - OFFSET) < 1e-3


def test_without_turning_the_lever_arm_is_said_not_to_show():
    imu, seen = made(turning=0.0)
    first = quat_from_euler(np.array([0.01, -0.02, 1.0]))
    found = estimate_mounting(imu, seen, quat_nb=first, config=CONFIG)
    assert abs(found.time_offset - OFFSET) < 3.5 * found.time_offset_sd + 2e-5
    assert not found.lever_arm_shows.any()
    assert (found.imu_to_antenna_sd > 0.5).all()


def test_an_offset_of_more_than_a_second_is_found():
    imu, seen = made()
    imu = replace(imu, time=imu.time + OFFSET - 1.6)
    assert abs(estimate_mounting(imu, seen, config=CONFIG).time_offset - 1.6) < 1e-3


def test_a_gap_of_the_imu_does_no_harm():
    imu, seen = made()
    keep = np.ones(len(imu.time), bool)
    keep[4000:4500] = False
    cut = ImuSeries(imu.time[keep], imu.dt[keep], imu.delta_theta_b[keep], imu.delta_vel_b[keep])
    found = estimate_mounting(cut, seen, config=CONFIG)
    assert abs(found.time_offset - OFFSET) < 3.5 * found.time_offset_sd + 2e-5


@pytest.mark.parametrize("turn", [[1, -1, 1], [-1, -1, 1]])
def test_mirrored_and_turned_axes_do_not_pass_where_the_attitude_is_surveyed(turn):
    imu, seen = made(turning=0.0)
    wrong = replace(
        imu, delta_theta_b=imu.delta_theta_b * turn, delta_vel_b=imu.delta_vel_b * turn
    )
    first = quat_from_euler(np.array([0.01, -0.02, 1.0]))
    with pytest.raises(InputError, match="agree by"):
        estimate_mounting(wrong, seen, quat_nb=first, config=CONFIG)


def test_recordings_of_different_times_are_refused():
    imu, seen = made()
    with pytest.raises(InputError, match="in common"):
        estimate_mounting(replace(imu, time=imu.time + 100.0), seen)
