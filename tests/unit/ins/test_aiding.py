"""Aiding Doppler: an independent simulator's phase, signs, knots, speed."""

import time

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from phase_truth import MOVING, NAV, RATE, STATION

from deepseis_core.constants import L1_WAVELENGTH
from deepseis_core.ephemeris import pack, select_ephemerides
from deepseis_core.gps_time import GpsTime
from deepseis_core.propagation import line_of_sight
from deepseis_core.rinex_nav import read_rinex_nav
from deepseis_core.types import Ephemeris
from deepseis_ins.aiding import DopplerPredictor, KnotGrid
from deepseis_ins.truth_motion import TruthMotion
from deepseis_tracking.channel_state import AID
from deepseis_tracking.nco import aid_at

BLOCK = 80_000
START = GpsTime(2190, 525_600 * 10**9)


def satellite(number: int) -> Ephemeris:
    """A satellite of a circle around the station's meridian."""
    return Ephemeris(
        f"G{number:02d}", 2190, 525_600.0, 525_600.0, 1e-4, 1e-11, 0, 0, 5153.7, 0.01, 0.96,
        0.4 * number, 0.3, 0.7 * number, 4e-9, -8e-9, 0, 0, 0, 0, 0, 0, 0,
    )  # fmt: skip


TEN = tuple(f"G{i:02d}" for i in range(1, 11))
PACKED = pack([satellite(i) for i in range(1, 11)])


def shaken(t: np.ndarray, frequency: float, acceleration: float) -> np.ndarray:
    """Position, velocity, acceleration of shaking along one axis."""
    w = 2 * np.pi * frequency
    axis, amplitude = np.array([0.6, 0.64, 0.48]), acceleration / w**2
    parts = (np.sin(w * t), w * np.cos(w * t), -(w**2) * np.sin(w * t))
    states = np.hstack([amplitude * part[:, None] * axis for part in parts])
    states[:, :3] += STATION
    return states


def test_integrated_doppler_is_the_independent_simulators_carrier_phase(shared_data):
    folder = shared_data / "if_captures" / "independent_sim"
    with np.load(folder / MOVING.truth) as z:
        t, phase, prn = z["t_s"], z["carrier_phase_cycles"], z["prn"]
    names = tuple(f"G{n:02d}" for n in prn)
    time_ = MOVING.start
    chosen = select_ephemerides(read_rinex_nav(folder / NAV).ephemerides, time_.week, time_.tow_ns)
    packed = pack([chosen[name] for name in names])
    trajectory = TruthMotion(folder / MOVING.truth).trajectory
    predictor = DopplerPredictor("truth", MOVING.start, RATE)
    grid = KnotGrid.of_span(0, round(29.99 * RATE), RATE)
    antenna = trajectory.states(grid.seconds(RATE))
    doppler = predictor.predict(grid, antenna, names, packed).carrier_doppler_hz
    # Simpson's rule from one truth epoch to the next: exact for cubics.
    weights = np.tile([2.0, 4.0], grid.count // 2 + 1)[: grid.count]
    running = np.cumsum(doppler * weights, axis=1) / 3000
    predicted = (running[:, ::10] - doppler[:, ::10] / 3000).T
    difference = predicted - phase[: len(predicted)]
    for low, high in ((0, 1000), (1010, len(predicted))):
        span = slice(low, high)
        trend = np.polynomial.polynomial.polyfit(t[span], difference[span], 3)
        # What is left out changes slowly: ionosphere, and the simulator's c (299792458/1575.42e6
        # rounded) and light time.
        assert np.abs(trend[1]).max() < 0.02  # [Hz]
        assert np.abs(trend[2]).max() < 1e-4  # [Hz/s]
        rest = difference[span] - np.polynomial.polynomial.polyval(t[span], trend).T
        # The truth is printed with 6 decimals; 1.5 cycles of motion must vanish below that.
        assert np.abs(rest).max() < 5e-6


def test_towards_a_satellite_doppler_rises_by_speed_over_wavelength():
    grid = KnotGrid.of_span(0, BLOCK, RATE)
    predictor = DopplerPredictor("truth", START, RATE)
    still = np.tile(np.r_[STATION, np.zeros(6)], (grid.count, 1))
    unit = line_of_sight(PACKED, START.week, START.tow_ns, STATION).unit[0]
    moving = still.copy()
    moving[:, 3:6] = -1.5 * unit  # against the direction from satellite to receiver
    rows = [predictor.predict(grid, s, TEN, PACKED).carrier_doppler_hz[0, 0] for s in
            (still, moving)]  # fmt: skip
    assert_allclose(rows[1] - rows[0], 1.5 / L1_WAVELENGTH, rtol=1e-5)  # v/c of the satellite


@pytest.mark.parametrize("rate_hz", [4e6, 16.3676e6, 38.192e6])
def test_neighbouring_spans_share_knots_and_any_cut_gives_the_same_numbers(rate_hz):
    predictor = DopplerPredictor("truth", START, rate_hz)
    block = round(0.02 * rate_hz)

    def aiding(first, count):
        grid = KnotGrid.of_span(first, count, rate_hz)
        antenna = shaken(grid.seconds(rate_hz), 2.0, 19.0)
        return grid, predictor.predict(grid, antenna, TEN, PACKED)

    first, last = 7 * block, 11 * block
    whole_grid, whole = aiding(first, last - first)
    for start in range(first, last, block):
        grid, part = aiding(start, block)
        assert grid.samples[0] <= start
        assert grid.samples[-1] >= start + block
        assert grid.step <= 1.001e-3 * rate_hz
        k = (grid.first - whole_grid.first) // grid.step
        columns = slice(k, k + grid.count)
        assert_array_equal(part.carrier_doppler_hz, whole.carrier_doppler_hz[:, columns])
        assert_array_equal(part.carrier_doppler_rate, whole.carrier_doppler_rate[:, columns])


@pytest.mark.parametrize(("frequency", "tolerance_hz"), [(2.0, 1e-9), (10.0, 1e-7), (100.0, 1e-4)])
def test_cubics_between_knots_leave_the_stated_error(frequency, tolerance_hz):
    grid = KnotGrid.of_span(0, BLOCK, RATE)
    predictor = DopplerPredictor("truth", START, RATE)
    antenna = shaken(grid.seconds(RATE), frequency, 2 * 9.8)
    knots = predictor.predict(grid, antenna, TEN, PACKED)
    samples = np.arange(500, BLOCK, 1000)
    fine = KnotGrid(0, BLOCK - 1, 500, 1000, len(samples))
    direct = predictor.predict(fine, shaken(samples / RATE, frequency, 2 * 9.8), TEN, PACKED)
    for i in range(len(TEN)):
        table = knots.carrier_doppler_hz[i], knots.carrier_doppler_rate[i]
        aid = np.zeros(1, AID)[0]
        aid["first"], aid["step"] = grid.first, grid.step
        between = [aid_at(float(s), aid, *table, RATE) for s in samples]
        assert_allclose(between, direct.carrier_doppler_hz[i], rtol=0, atol=tolerance_hz + 1e-9)


def test_fields_say_what_the_span_is():
    grid = KnotGrid.of_span(3 * BLOCK, BLOCK, RATE)
    antenna = shaken(grid.seconds(RATE), 2.0, 1.0)
    aiding = DopplerPredictor("fusion", START, RATE).predict(grid, antenna, TEN, PACKED)
    assert (aiding.source, aiding.valid) == ("fusion", True)
    assert (aiding.valid_from, aiding.valid_through) == (3 * BLOCK, 4 * BLOCK - 1)
    assert (aiding.knot_sample_index, aiding.knot_step_samples) == (3 * BLOCK, 4000)
    assert aiding.carrier_doppler_hz.shape == aiding.carrier_doppler_rate.shape == (10, 21)
    assert np.isnan(aiding.clock_drift_hz)
    nobody = DopplerPredictor("fusion", START, RATE).predict(grid, antenna, (), PACKED[:0])
    assert not nobody.valid


def test_a_block_of_ten_satellites_takes_less_than_a_millisecond():
    predictor = DopplerPredictor("truth", START, RATE)
    took = []
    for k in range(30):
        grid = KnotGrid.of_span(k * BLOCK, BLOCK, RATE)
        antenna = shaken(grid.seconds(RATE), 2.0, 19.0)
        started = time.perf_counter()
        predictor.predict(grid, antenna, TEN, PACKED)
        took.append(time.perf_counter() - started)
    assert min(took) < 1e-3
