"""Time offset of a recorded log: hand-carried MEMS IMU beside a u-blox F9P with RTK, 4 Hz."""

import numpy as np
import pytest
from pipeline.ins_logs import walk
from scipy.interpolate import CubicSpline

from deepseis_core import geodesy
from deepseis_ins.mounting import AntennaSeries, ImuSeries, MountingConfig, estimate_mounting

CONFIG = MountingConfig(accel_walk=3e-3)


@pytest.fixture(scope="module")
def log(shared_data):
    return walk(shared_data / "gnss_ins")


def seen(log, velocity):
    first = log.fixes[0].position
    latitude, longitude, height = geodesy.geodetic_from_ecef(first)
    C_ne = geodesy.rotation_ned_ecef(latitude, longitude)
    time = np.array([f.time for f in log.fixes])
    value = [C_ne @ (f.velocity if velocity else f.position - first) for f in log.fixes]
    sd = np.median([f.velocity_sd if velocity else f.position_sd for f in log.fixes], axis=0)
    return AntennaSeries(time, np.array(value), np.maximum(sd, 0.01), velocity, latitude, height)


def found(log, velocity=False, part=slice(None)):
    imu = ImuSeries(log.time[part], log.dt[part], log.delta_theta[part], log.delta_vel[part])
    return estimate_mounting(imu, seen(log, velocity), config=CONFIG)


def test_both_halves_of_the_log_have_one_offset(log):
    middle = len(log.time) // 2
    halves = [found(log, part=part) for part in (slice(0, middle), slice(middle, None))]
    sd = np.hypot(*(half.time_offset_sd for half in halves))
    assert sd < 0.012
    assert abs(halves[0].time_offset - halves[1].time_offset) < 3.0 * sd


def test_the_log_s_velocities_are_late_by_as_much_as_its_positions_say(log):
    """Without the IMU: the shift at which derived positions fit the velocities best."""
    by_position, by_velocity = found(log), found(log, velocity=True)
    sd = np.hypot(by_position.time_offset_sd, by_velocity.time_offset_sd)
    assert sd < 0.006
    position, velocity = seen(log, False), seen(log, True)
    path, inner = CubicSpline(position.time, position.value[:, :2]), slice(8, -8)
    lags = np.arange(0.0, 0.3, 0.01)
    level = velocity.value[inner, :2]
    left = [np.mean((path(velocity.time[inner] - lag, 1) - level) ** 2) for lag in lags]
    late = by_velocity.time_offset - by_position.time_offset
    assert abs(late - lags[np.argmin(left)]) < 3.0 * sd


def test_the_antenna_was_carried_beside_the_imu(log):
    result = found(log)
    assert result.lever_arm_shows.all()
    assert np.linalg.norm(result.imu_to_antenna) < 0.15 + 3.0 * np.max(result.imu_to_antenna_sd)
