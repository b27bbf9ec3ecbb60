"""Parts of the acceptance of tight coupling: data in, the peer, blockages, what is missing."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from deepseis_bringup.accept import tight_roads as roads
from deepseis_bringup.accept.tables import Acceptance
from deepseis_bringup.accept.tight_drive import Imu, simulated
from deepseis_bringup.accept.tight_flight import HATCH_ALL, MASK_DEG, cut, fly, without
from deepseis_bringup.accept.tight_orbit import ephemeris_of
from deepseis_bringup.accept.tight_rtklib import rtklib_positions
from deepseis_core.constants import NS_PER_S
from deepseis_core.ephemeris import pack, satellite_states
from deepseis_core.errors import InputError
from deepseis_core.gps_time import GpsTime
from deepseis_sim.sky import broadcast_ephemerides

START = GpsTime(2399, 415258 * NS_PER_S)
QUIET = (
    *("observations.code_noise_scale=0.0", "observations.carrier_noise_scale=0.0"),
    *("sky.obstructions=[]", "duration=60.0"),
)


@pytest.fixture(scope="module")
def quiet():
    """Return the short drive of a receiver without noise."""
    return simulated("drive", short=True, settings=QUIET)


def states(ephemeris, tow):
    packed = np.repeat(pack([ephemeris]), len(tow), axis=0)
    return satellite_states(packed, ephemeris.week, 0, -tow)


@pytest.mark.parametrize("number", [0, 11])
def test_an_orbit_comes_back_from_positions(number):
    true = broadcast_ephemerides("", START)[number]
    tow = START.tow_ns / 1e9 + np.arange(0.0, 3600.0, 5.0)
    made = states(true, tow)
    clock = true.af0 + true.af1 * (tow - true.toc)
    got, rest = ephemeris_of(true.satellite, true.week, tow, made[:, :3], made[:, 3:6], clock)
    # Fifteen parameters of an hour are not told apart, but make the same positions.
    assert rest < 5e-3
    between = tow + 2.5
    assert_allclose(states(got, between)[:, :3], states(true, between)[:, :3], atol=0.02)
    assert_allclose(states(got, between)[:, 3:6], states(true, between)[:, 3:6], atol=1e-3)
    assert_allclose(
        states(got, between)[:, 9] + got.tgd, states(true, between)[:, 9] + true.tgd, atol=1e-11
    )


def test_an_orbit_wants_some_positions():
    with pytest.raises(InputError, match="10 moments"):
        ephemeris_of("G01", 2399, np.arange(10.0), np.ones((10, 3)), np.ones((10, 3)), np.ones(10))


def test_increments_are_cut_at_epochs_and_keep_their_sums():
    rng = np.random.default_rng(1)
    theta, vel = rng.normal(size=(2, 50, 3))
    whole = Imu(0.09 + 0.1 * np.arange(50), np.full(50, 0.1), theta, vel)
    got = cut(whole, np.array([1.0, 2.0, 2.09, 99.0]))
    assert got.time.size == 52  # 2.09 is an edge already
    assert {1.0, 2.0} <= set(got.time.tolist())
    assert_allclose(got.delta_theta.sum(axis=0), whole.delta_theta.sum(axis=0), atol=1e-12)
    assert_allclose(np.diff(got.time, prepend=-0.01), got.dt, atol=1e-12)
    k = int(np.argmin(np.abs(got.time - 1.0)))
    assert_allclose(got.delta_vel[k], 0.1 * whole.delta_vel[10], atol=1e-12)


def test_a_receiver_without_noise_is_where_rtklib_says(quiet):
    """The bench's orbits, clocks and air by RTKLIB: what its own models differ by."""
    off = rtklib_positions(quiet, MASK_DEG) - quiet.truth.position
    # RTKLIB's elevations of unturned satellites, 1e-7 rad; RINEX' 12 digits of the orbits.
    assert np.abs(off).max() < 0.01
    assert np.isfinite(off).all()


def test_the_tight_filter_stays_with_a_receiver_without_noise(quiet):
    told = replace(quiet.observed, pseudorange_sd=np.full_like(quiet.observed.phase, 0.8))
    got = fly(replace(quiet, observed=told), HATCH_ALL)
    moving = quiet.observed.time > quiet.still[1] + 5.0
    # It is told that code has noise of 0.8 m and the start is a fix without any: the IMU's errors
    # alone are left.
    assert np.nanmax(np.abs(got.error[moving])) < 0.1


def test_satellites_are_taken_away_from_below(quiet):
    _, elevation = quiet.geometry()
    time = quiet.observed.time
    hidden = without(quiet, (30.0, 40.0), 2, elevation)
    inside = (time >= 30.0) & (time < 40.0)
    assert not hidden[~inside].any()
    left = np.isfinite(quiet.hiding(hidden).observed.pseudorange)
    assert_array_equal(left[inside].sum(axis=1), 2)
    for row, up in zip(left[inside], elevation[inside], strict=True):
        assert up[row].min() > up[~row].max()


def test_missing_real_drives_are_said_to_be_missing(monkeypatch):
    monkeypatch.setattr(roads, "data_folder", lambda: None)
    acceptance = Acceptance("tight", "Tight coupling")
    roads.real_drives(acceptance, short=True)
    assert not acceptance.rows
    assert "not at hand" in acceptance.page()
