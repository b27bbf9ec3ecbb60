"""Simulated rover and base through RTKLIB: single-point and RTK positions against the truth.

RTKLIB's file loop takes observations less than 25 ms apart for one epoch (``DTTOL``), so above
40 Hz it would merge epochs: here epochs are taken apart by their exact times, given the last base
epoch not later, and solved one by one.
"""

from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np
import pyrtklib as rtk
import pytest
from numpy.testing import assert_allclose
from unit.pvt.rtklib_reference import epochs as single_point
from unit.pvt.rtklib_reference import exact_time
from unit.pvt.tracked_signals import doubles

from deepseis_core.geodesy import ecef_from_geodetic, geodetic_from_ecef, rotation_enu_ecef
from deepseis_core.gps_time import GpsTime
from deepseis_core.rinex_nav import write_rinex_nav
from deepseis_pvt.rinex_obs import RinexObsWriter, RinexStation
from deepseis_sim.base_station import BaseConfig, BaseStation
from deepseis_sim.constellation import visible_satellites
from deepseis_sim.nominal_constellation import nominal_constellation
from deepseis_sim.observation_model import ObservationConfig, ObservationModel
from deepseis_sim.signal_model import SignalModel, linear_clock, still

START = GpsTime(2399, 346258 * 10**9)
ORIGIN = np.array([*np.deg2rad([38.7292, 141.0217]), 40.0])
HERE = ecef_from_geodetic(ORIGIN)
ENU = rotation_enu_ecef(*ORIGIN[:2])
SATELLITES = visible_satellites(nominal_constellation(START), START, HERE)
CLOCK = linear_clock(3.2e-4, 8e-8)
QUIET = {"carrier_noise_scale": 0.0, "code_noise_scale": 0.0}


def circle(time):
    """12 cm at 2 Hz (2 g), entered within half a second from 5 s on [m]."""
    turn = 2 * np.pi * 2.0 * time
    share = np.clip((time - 5.0) / 0.5, 0.0, 1.0) ** 3
    flat = 0.12 * share[:, None] * np.stack([np.sin(turn), np.cos(turn), 0 * turn], axis=1)
    return HERE + flat @ ENU


class Bench:
    """A rover, a base, and their files."""

    def __init__(self, folder, antenna, seconds, rate_hz, quiet=False, seed=1, **atmosphere):
        levels = QUIET if quiet else {}
        self.antenna, self.folder = antenna, folder
        rover = SignalModel(SATELLITES, START, antenna, clock=CLOCK, seed=seed, **atmosphere)
        config = ObservationConfig(rate_hz=rate_hz, **levels)
        self.rover = ObservationModel(rover, config, seed=seed)
        self.base = BaseStation(rover, ORIGIN, BaseConfig(**levels), seed=seed, **atmosphere)
        self.rover_file = self._write("ROVR00XXX", self.rover, HERE, seconds)
        self.base_file = self._write("BASE00XXX", self.base, self.base.position_ecef, seconds)
        self.nav_file = folder / "brdc.rnx"
        first = SATELLITES[0].ephemeris
        ionosphere = {"iono_alpha": first.iono_alpha, "iono_beta": first.iono_beta}
        write_rinex_nav(self.nav_file, [item.ephemeris for item in SATELLITES], **ionosphere)

    def _write(self, name, receiver, position, seconds) -> Path:
        station = RinexStation(name=name, position_ecef=tuple(position))
        with RinexObsWriter(self.folder, station) as writer:
            for epoch in receiver.epochs(0, receiver.count(seconds)):
                writer.write(epoch)
        return writer.path

    def truth(self, time):
        """Antenna [m] at receiver seconds since the start."""
        return self.antenna(time - CLOCK(time))


@dataclass
class Rtk:
    """RTKLIB's solutions: receiver time [s], fixed or not, and error east, north, up [m]."""

    time: np.ndarray
    fixed: np.ndarray
    error: np.ndarray

    @property
    def spread(self):
        """Standard deviation of the fixed ones [mm]."""
        return 1e3 * self.error[self.fixed].std(axis=0)

    @property
    def mean(self):
        """Mean of the fixed ones [mm]."""
        return 1e3 * self.error[self.fixed].mean(axis=0)


def by_epoch(path, receiver, nav):
    """Return RTKLIB's observations, and the numbers of each epoch's by its time [100 ns]."""
    obs = rtk.obs_t()
    assert rtk.readrnx(str(path), receiver, "", obs, nav, rtk.sta_t()) > 0
    groups = groupby(range(obs.n), key=lambda i: exact_time(obs.data[i]))
    return obs, {time: list(group) for time, group in groups}


def settings(mode, base_position):
    """Return RTKLIB's options: GPS L1, integers fixed anew at each epoch."""
    options = rtk.prcopt_default
    options.mode, options.navsys, options.nf = mode, rtk.SYS_GPS, 1
    options.modear, options.thresar[0] = 1, 3.0
    options.ionoopt, options.tropopt = rtk.IONOOPT_BRDC, rtk.TROPOPT_SAAS
    options.elmin = np.radians(10.0)
    # Carrier 3 mm as usual; the code of a loop of 1 Hz without smoothing is 0.8 to 1.4 m off,
    # and so for many epochs on end.
    options.eratio[0], options.err[1], options.err[2] = 500.0, 0.003, 0.003
    for i in range(3):
        options.std[i] = (30.0, 0.03, 0.3)[i]  # the defaults: options are one object for all tests
        options.rb[i] = float(base_position[i])
    return options


def solve(bench, mode=rtk.PMODE_KINEMA):
    """Run RTKLIB's RTK over all epochs of the rover."""
    nav = rtk.nav_t()
    assert rtk.readrnx(str(bench.nav_file), 0, "", rtk.obs_t(), nav, rtk.sta_t()) > 0
    rtk.uniqnav(nav)
    rover, rover_epochs = by_epoch(bench.rover_file, 1, nav)
    base, base_epochs = by_epoch(bench.base_file, 2, nav)
    state, base_times = rtk.rtk_t(), np.array(sorted(base_epochs))
    rtk.rtkinit(state, settings(mode, bench.base.position_ecef))
    first, rows = min(rover_epochs), []
    for time, mine in rover_epochs.items():
        theirs = base_epochs[base_times[np.searchsorted(base_times, time, side="right") - 1]]
        both = rtk.Arr1Dobsd_t(len(mine) + len(theirs))
        for place, item in enumerate(
            [rover.data[i] for i in mine] + [base.data[i] for i in theirs]
        ):
            both[place] = item
        rtk.rtkpos(state, both[0], len(mine) + len(theirs), nav)
        rows.append([(time - first) / 1e7, state.sol.stat, *(state.sol.rr[i] for i in range(3))])
    rtk.rtkfree(state)
    table = np.array(rows)
    error = (table[:, 2:] - bench.truth(table[:, 0])) @ ENU.T
    return Rtk(table[:, 0], table[:, 1] == rtk.SOLQ_FIX, error)


def left_by_rtklib(bench):
    """Return the error [mm] that differences of the atmosphere leave which RTKLIB does not model.

    Between receivers it corrects the dry troposphere alone, with Niell's mapping, and no
    ionosphere.
    """
    zero = np.zeros(1)
    at = [bench.rover.signals, bench.base.signals]
    delays = [model.delays(zero) for model in at]
    rest = []
    for model, delay in zip(at, delays, strict=True):
        position = geodetic_from_ecef(model.antenna(zero)[0])
        when = rtk.gpst2time(START.week, START.tow_s())
        pos, zenith = doubles(position), doubles([0.0, np.pi / 2])
        dry = rtk.tropmodel(when, pos, zenith, 0.0)
        mapped = [
            dry * rtk.tropmapf(when, pos, doubles([azimuth, elevation]), doubles([0.0]))
            for azimuth, elevation in zip(delay.azimuth[0], delay.elevation[0], strict=True)
        ]
        rest.append(delay.troposphere[0] - delay.ionosphere[0] - mapped)
    elevation, azimuth = delays[0].elevation[0], delays[0].azimuth[0]
    flat = np.cos(elevation)
    up = np.sin(elevation)
    design = np.stack(
        [-flat * np.sin(azimuth), -flat * np.cos(azimuth), -up, np.ones(up.size)], axis=1
    )
    weight = 1.0 / np.sqrt(1.0 + 1.0 / up**2)
    return 1e3 * np.linalg.lstsq(design * weight[:, None], (rest[0] - rest[1]) * weight)[0][:3]


@pytest.fixture(scope="module")
def shaken(tmp_path_factory):
    """A rover on the shake table, 50 Hz, 60 s."""
    bench = Bench(tmp_path_factory.mktemp("shaken"), circle, 60.0, 50)
    return bench, solve(bench)


@pytest.fixture(scope="module")
def resting(tmp_path_factory):
    """A rover that stands still, 10 Hz, 60 s."""
    bench = Bench(tmp_path_factory.mktemp("resting"), still(HERE), 60.0, 10)
    return bench, solve(bench)


def test_without_noise_rtklib_finds_rover_and_base_by_their_codes(tmp_path):
    bench = Bench(tmp_path, circle, 8.0, 10, quiet=True)
    for path, truth in (
        (bench.rover_file, bench.truth),
        (bench.base_file, lambda time: np.broadcast_to(bench.base.position_ecef, (time.size, 3))),
    ):
        solved = list(single_point(path, bench.nav_file))
        assert len(solved) == 80
        error = np.array([e.position_ecef for e in solved]) - truth(np.arange(80) / 10)
        # RINEX rounds to half a millimetre (x PDOP 2.5); RTKLIB's Sagnac term is of first order.
        assert np.abs(error @ ENU.T).max() < 0.01


def test_with_noise_single_points_scatter_by_the_codes_noise(resting):
    bench, _ = resting
    for path, truth in ((bench.rover_file, HERE), (bench.base_file, bench.base.position_ecef)):
        found = np.array([e.position_ecef for e in single_point(path, bench.nav_file)])
        error = (found - truth) @ ENU.T
        # 0.8 to 1.4 m of code noise times HDOP 1.0 and VDOP 1.5; 60 s average 240 loop times.
        assert np.linalg.norm(error.mean(axis=0)) < 0.6
        assert (error.std(axis=0) < [1.5, 1.5, 3.0]).all()
        assert (error.std(axis=0) > 0.3).all()


def test_rtk_is_fixed_in_most_epochs_and_never_to_wrong_integers(shaken, resting):
    for bench, solution in (shaken, resting):
        assert solution.fixed.mean() > 0.95
        # A wrong integer of one satellite moves the position by some centimetres at least.
        residual = solution.error[solution.fixed] - solution.mean / 1e3
        assert np.abs(residual[:, :2]).max() < 0.006
        assert np.abs(residual[:, 2]).max() < 0.015
        assert len(solution.time) == bench.rover.count(60.0)


def test_motion_of_2_g_costs_no_accuracy(shaken, resting):
    # Noise of two receivers, 8 Hz at 41 to 45 dB-Hz: 0.7 mm each, times DOP.
    assert (shaken[1].spread < [0.8, 0.9, 2.5]).all()
    assert_allclose(shaken[1].spread, resting[1].spread, rtol=0.15)
    moving = shaken[1].fixed & (shaken[1].time > 6.0)
    assert (1e3 * shaken[1].error[moving].std(axis=0) < [0.8, 0.9, 2.5]).all()


def test_what_remains_is_the_atmosphere_that_rtklib_leaves(shaken, resting, tmp_path):
    for bench, solution in (shaken, resting):
        # Noise of the means over 60 s: 0.05 mm, in height 0.2 mm.
        off = np.abs(solution.mean - left_by_rtklib(bench))
        assert (off < [0.15, 0.15, 0.6]).all()
    assert np.abs(shaken[1].mean).max() < 6.0  # 2 ppm of the 2.9 km
    quiet = Bench(tmp_path, circle, 8.0, 50, quiet=True)
    solution = solve(quiet)
    assert solution.fixed.all()
    # RINEX rounds phases to 0.2 mm.
    assert np.abs(1e3 * solution.error - left_by_rtklib(quiet)).max() < 0.6


def test_the_static_mode_fixes_as_well(tmp_path):
    bench = Bench(tmp_path, still(HERE), 30.0, 10, seed=4)
    solution = solve(bench, rtk.PMODE_STATIC)
    assert solution.fixed[-100:].all()
    late = 1e3 * solution.error[-100:] - left_by_rtklib(bench)
    assert np.abs(late).max() < 2.0


def test_whole_cycles_are_what_fixes_it(tmp_path):
    bench = Bench(tmp_path, still(HERE), 20.0, 10)
    base = bench.base.signals
    base.initial_phase_cycles = base.initial_phase_cycles + np.linspace(0.0, 0.5, len(SATELLITES))
    bench.base_file = bench._write("BASF00XXX", bench.base, bench.base.position_ecef, 20.0)
    assert solve(bench).fixed[50:].mean() < 0.2
