"""Tohoku 2011 without gyroscopes: K-NET MYG004 with GEONET 0915, five kilometres apart.

They are not one site, so this shows what the filter holds and adds, not what a station reaches.
What the ground does differently at the two goes into the velocity random walk that the filter is
told: 3 m/s/sqrt(h), a hundred times a tactical sensor's.
"""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from deepseis_core.geodesy import normal_gravity
from deepseis_core.imu_grades import grade_named
from deepseis_ins.gyrofree import GyroFreeConfig, GyroFreeFilter
from deepseis_ins.gyrofree_offline import StationRecord, track
from deepseis_sim.accelerogram import read_accelerogram

BEFORE_S = 15
"""Of the record, before the trigger."""
LENGTH_S = 300
GRADE = replace(grade_named("accelerometers"), accel_walk_per_sqrt_h=3.0)
WHITE = np.diag(np.square([0.01, 0.01, 0.02]))


@pytest.fixture(scope="module")
def tohoku(shared_data):
    """Return increments without the sensors' offset, GNSS at their seconds, and the latitude."""
    record = read_accelerogram(shared_data / "strong_motion/knet_MYG004_tohoku2011")
    latitude = np.radians(record.latitude_deg)
    force = record.acceleration - record.acceleration[: BEFORE_S * 100].mean(axis=0)
    force[:, 2] += normal_gravity(latitude, 40.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import obspy

        folder = shared_data / "displacement/tohoku2011_geonet_1hz"
        traces = [obspy.read(str(folder / f"CI.0915.20.LY{c}.2011.070"))[0] for c in "ENZ"]
    gnss = np.stack([trace.data for trace in traces], axis=1) / 1e6
    first = round((record.start_utc_ns - traces[0].stats.starttime.ns) * 1e-9)
    return force / 100.0, (gnss - gnss[:first].mean(axis=0))[first : first + LENGTH_S], latitude


def tracked(tohoku, every_s):
    increments, gnss, latitude = tohoku
    filter_ = GyroFreeFilter(
        GyroFreeConfig(position_sd=0.1), GRADE, np.eye(3), latitude=latitude, height=40.0,
        smoothing=True,
    )  # fmt: skip
    used = np.arange(0, LENGTH_S, every_s)
    return used, track(filter_, StationRecord(increments, 100.0, 100 * used, gnss[used], WHITE))


def test_the_coseismic_step_is_held_where_accelerometers_alone_are_lost(tohoku):
    """2.7 m east, 1.0 m south; GNSS only every 5 s. The last 30 s against all of GNSS."""
    increments, gnss, latitude = tohoku
    alone = GyroFreeFilter(GyroFreeConfig(), GRADE, np.eye(3), latitude=latitude, height=40.0)
    lost = alone.propagate(increments, 0.01).position[-1]
    assert np.abs(lost).min() > 10.0
    _, got = tracked(tohoku, 5)
    end = got.smoothed.position[27_000::100].mean(axis=0)
    assert_allclose(end, gnss[270:].mean(axis=0), atol=0.01)
    assert np.all(np.abs(end[:2]) > [2.5, 0.9])


def test_between_positions_accelerometers_know_more_than_interpolation(tohoku):
    """GNSS every 10 s; compared where it was withheld, while the ground moves."""
    _, gnss, _ = tohoku
    used, got = tracked(tohoku, 10)
    withheld = np.setdiff1d(np.arange(1, 200), used)
    straight = np.stack([np.interp(withheld, used, gnss[used, k]) for k in range(3)], axis=1)
    rms = [
        np.sqrt(np.mean(np.sum(np.square(each - gnss[withheld]), axis=1)))
        for each in (got.smoothed.position[100 * withheld - 1], straight)
    ]
    assert rms[0] < 0.75 * rms[1]
